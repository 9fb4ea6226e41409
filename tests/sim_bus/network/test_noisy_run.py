"""A third of a minute on a noisy bus: no frame is lost unseen, none is there twice without a reason
(`python -m benchmarks loss` does it for an hour).
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.loss import account
from coulombus.recording.reading import read
from coulombus.wire.frame import CAN_ERR_FLAG


@pytest.mark.thorough
def test_every_frame_on_a_noisy_bus_is_accounted_for(tmp_path):
    file = tmp_path / "r.pcapng"
    found, result, world = account(6.0, tmp_path, file)
    assert result.trip is None
    sent_again = sum(c["retransmissions"] for c in result.controllers.values())
    assert sent_again > 0.005 * found.frames
    assert sum(c["dropped"] + c["bus_offs"] for c in result.controllers.values()) == 0
    assert found.differ == 0  # what the witness heard, and what the recorder was given
    frames = read(file).frames
    good = frames["can_id"][frames["can_id"] & CAN_ERR_FLAG == 0]
    assert len(good) == found.frames
    assert found.errors == sent_again + found.overloads + found.false_starts
    assert min(found.overloads, found.false_starts, found.twice.total()) > 0
    cycles = int(world.controllers.host["cycle"][0])
    for can_id, count in found.expected(cycles).items():
        assert np.count_nonzero(good == can_id) == count
