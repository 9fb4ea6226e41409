"""Stamps of other people's logs: they step back, jump, and come out of order; nothing of it ends `explain`."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.explain.explained import Explainer
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "run.pcapng"
    simulate("bench", "hybrid", 0.5, record=path)
    return np.array(read(path).frames)


def explained(frames, step):
    explainer = Explainer()
    for first in range(0, len(frames), step):
        explainer.add_frames(frames[first : first + step].view(np.recarray))
        explainer.note_overdue()
    explainer.end()
    return explainer.explanation()


@pytest.mark.thorough
@pytest.mark.parametrize("step", [40, 300, 1_000_000])
@pytest.mark.parametrize("seed", range(6))
def test_stamps_out_of_order_end_nothing(frames, seed, step):
    rng = np.random.default_rng(seed)
    changed = frames.copy()
    kind = seed % 3
    if kind == 0:  # two writers: neighbours are exchanged
        changed["t_ns"] += rng.integers(-5_000_000, 5_000_000, len(changed))
    elif kind == 1:  # the clock was set
        for place in rng.integers(0, len(changed), 3):
            changed["t_ns"][place:] += int(rng.integers(-(10**12), 10**12))
    else:
        rng.shuffle(changed)
    assert explained(changed, step).frames == len(frames)
