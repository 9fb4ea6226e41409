"""A host that ends in order: its last cycle comes before its order, and nothing of it is an incident."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.explain.explained import Explainer
from coulombus.lab.simulate import simulate
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.recording.reading import read

MS = 1_000_000


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The frames of an orderly run, and when its last SYNC came."""
    path = tmp_path_factory.mktemp("run") / "run.pcapng"
    simulate("bench", "hybrid", 2.0, record=path)
    recording = read(path)
    frames = np.array(recording.frames)
    return frames, int(frames["t_ns"][frames["can_id"] == 0x80].max()), recording.rig


def later(frames, last_ns, delay_ns):
    """Let what follows the last cycle come later; heartbeats go on meanwhile."""
    frames = frames.copy()
    after = frames["t_ns"] > last_ns + MS - 1
    frames["t_ns"][after] += delay_ns
    parts = [frames]
    for node in (1, 2, 127):
        beats = frames[frames["can_id"] == 0x700 + node]
        known = beats[beats["t_ns"] <= last_ns]
        period_ns = int(np.median(np.diff(known["t_ns"][-10:])))
        end_ns = int(beats["t_ns"][len(known)]) if len(beats) > len(known) else last_ns + delay_ns
        for t_ns in range(int(known["t_ns"][-1]) + period_ns, end_ns - period_ns // 2, period_ns):
            parts.append(known[-1:].copy())
            parts[-1]["t_ns"] = t_ns
    whole = np.concatenate(parts)
    return whole[np.argsort(whole["t_ns"], kind="stable")].view(np.recarray)


def looked_at(frames, rig, step):
    """Take the frames in steps; return all incidents that were ever shown."""
    explainer, shown = Explainer(KnownBus(rig)), []
    for first in range(0, len(frames), step):
        explainer.add_frames(frames[first : first + step])
        explainer.note_overdue()
        shown += [incident.root.kind for incident in explainer.explanation().incidents]
    explainer.end()
    return [*shown, *(incident.root.kind for incident in explainer.explanation().incidents)]


@pytest.mark.thorough
@pytest.mark.parametrize("delay_ns", [0, 100 * MS, 300 * MS, 900 * MS])
@pytest.mark.parametrize("knows_the_rig", [True, False])
@pytest.mark.parametrize("step", [200, 1_000_000])
def test_a_host_takes_its_time_to_order_the_nodes(run, delay_ns, knows_the_rig, step):
    frames, last_ns, rig = run
    assert looked_at(later(frames, last_ns, delay_ns), rig if knows_the_rig else None, step) == []


@pytest.mark.thorough
@pytest.mark.parametrize("step", [40, 1_000_000])
def test_a_host_that_is_gone_while_the_drive_is_enabled_is_an_incident(run, step):
    frames, last_ns, rig = run
    middle_ns = last_ns - 1_000 * MS
    hosts = np.isin(frames["can_id"], (0x0, 0x80, 0x201, 0x202, 0x77F)) | (frames["can_id"] & 0x780 == 0x600)
    tpdos = np.isin(frames["can_id"], (0x181, 0x182))
    cut = frames[~((hosts | tpdos) & (frames["t_ns"] > middle_ns))]
    assert looked_at(cut.view(np.recarray), rig, step) != []
