"""A run whose parameters were changed: the recording tells what, and a replay does it again bit for
bit.
"""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.host.cycle.parameter_changes import ChangeRefused
from coulombus.lab.replay.host_replay import ReplayError, host_replay
from coulombus.lab.simulate import simulate
from coulombus.recording.pcapng_reader import read_pcapng
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.recording.reading import read

MS = 1_000_000
PUSHED = (
    'phase=[{kind = "rest", duration_s = 0.3}, {kind = "stroke", duration_s = 20.0, speed_rad_s = 2.0, '
    "move_s = 0.3, dwell_s = 0.1}]"
)


def changes(world):
    """What somebody does at the sliders meanwhile."""
    world.at(1200 * MS, lambda w: w.set_parameters({"F_s": 1.4, "K_p": 250.0}, over_s=0.2))
    world.at(1300 * MS, lambda w: w.set_parameters({"F_d": 0.4, "compensation": 0.1 + 0.2}, over_s=0.15))
    world.at(1600 * MS, lambda w: w.undo_parameters(0.1))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("live") / "active.pcapng"
    assert simulate("bench", "active", 1.5, record=path, seed=3, overrides=(PUSHED,), script=changes).trip is None
    return path


def test_the_changes_are_markers_of_the_recording(recorded):
    found = [text for _, text in read(recorded).markers if text.startswith("set ")]
    assert [text.partition(" [")[0] for text in found] == [
        "set F_s_Nm 1.2 -> 1.4 Nm, K_p_Nm_rad 100 -> 250 Nm/rad in 0.2 s",
        "set F_d_Nm 1 -> 0.4 Nm, compensation 0.97 -> 0.3 in 0.24 s",
        "set F_d_Nm 0.4 -> 1 Nm, compensation 0.3 -> 0.97 in 0.1 s (undo)",
    ]
    assert f"compensation={(0.97).hex()}>{(0.1 + 0.2).hex()} in 240]" in found[1]


@pytest.mark.thorough
def test_a_replay_of_a_run_with_changes_is_bit_for_bit(recorded):
    found = host_replay(recorded)
    assert (found.difference, found.exit_status, found.unchecked, found.refused) == (None, 0, 0, 0)
    assert found.frames["motor.RPDO1"] == np.count_nonzero(read_pcapng(recorded).frames["can_id"] == 0x201) > 1000


def test_the_changes_are_felt(recorded, tmp_path):
    plain = tmp_path / "plain.pcapng"
    simulate("bench", "active", 1.5, record=plain, seed=3, overrides=(PUSHED,))
    with_them, without = read(recorded)["motor.target_torque_Nm"], read(plain)["motor.target_torque_Nm"]
    first = np.flatnonzero(with_them.values[: len(without)] != without.values[: len(with_them)])[0]
    assert 1.2 < with_them.t_s[first] < 1.6


def test_another_value_in_the_marker_is_another_run(recorded, tmp_path):
    """So the replay has its values from there."""
    path = rewritten(recorded, tmp_path / "r.pcapng", lambda text: text.replace(f">{(0.4).hex()}", f">{(0.45).hex()}"))
    assert host_replay(path).difference is not None


def test_a_change_without_its_marker_cannot_be_replayed(recorded, tmp_path):
    path = rewritten(recorded, tmp_path / "r.pcapng", lambda text: text.replace("set F_d", "said F_d"))
    with pytest.raises(ReplayError, match=r"order 2\), and the marker 'set' that tells which is not in it"):
        host_replay(path)


def test_a_change_of_one_axis_leaves_the_others_alone(tmp_path):
    path = tmp_path / "two.pcapng"

    def change(world):
        world.at(1000 * MS, lambda w: w.set_parameters({"F_d": 2.125}, "right", over_s=0.1))
        world.at(1200 * MS, lambda w: w.set_parameters({"F_s": 3.75}, "left", over_s=0.1))
        worlds.append(world)

    worlds = []
    simulate("two_axes", "passive", 0.8, record=path, script=change)
    law = worlds[0].controllers.axes["law"]
    assert law["F_d"][1] == 2.125
    assert law["F_d"][0] != 2.125
    assert law["F_s"][0] == 3.75
    assert law["F_s"][1] != 3.75
    assert host_replay(path).difference is None


@pytest.mark.thorough
def test_the_named_parameters_of_a_law_are_replayed(tmp_path):
    path, overrides = tmp_path / "r.pcapng", (PUSHED, "law.function='lugre'")

    def change(world):
        world.at(1200 * MS, lambda w: w.set_parameters({"F_c": 1 / 3, "sigma_2": 0.1}, over_s=0.1))

    simulate("bench", "active", 1.2, record=path, seed=3, overrides=overrides, script=change)
    assert f"F_c_Nm=0x1.0000000000000p+0>{(1 / 3).hex()}" in " ".join(text for _, text in read(path).markers)
    assert host_replay(path).difference is None


@pytest.mark.thorough
def test_an_undo_in_the_midst_of_a_ramp_is_replayed(tmp_path):
    """From where the value has come, back to where it was, and again away before it is there."""
    path = tmp_path / "r.pcapng"
    seen = []

    def change(world):
        world.at(1200 * MS, lambda w: w.set_parameters({"F_s": 1.45, "F_d": 0.5}, over_s=0.3))
        world.at(1290 * MS, lambda w: seen.append(float(w.controllers.axes["law"]["F_s"][0])))
        world.at(1300 * MS, lambda w: w.undo_parameters(0.2))
        world.at(1410 * MS, lambda w: w.set_parameters({"F_s": 1.4}, over_s=0.1))
        world.at(1460 * MS, lambda w: w.undo_parameters(0.1))

    simulate("bench", "active", 1.2, record=path, seed=3, overrides=(PUSHED,), script=change)
    assert 1.2 < seen[0] < 1.45
    assert sum("(undo)" in text for _, text in read(path).markers) == 2
    found = host_replay(path)
    assert (found.difference, found.unchecked) == (None, 0)


@pytest.mark.thorough
def test_a_trip_in_the_midst_of_a_ramp_is_replayed(tmp_path):
    path = tmp_path / "r.pcapng"

    def change(world):
        world.at(1250 * MS, lambda w: w.set_parameters({"F_s": 1.45, "K_p": 250.0}, over_s=0.5))
        world.at(1500 * MS, lambda w: seen.append(float(w.controllers.axes["law"]["F_s"][0])))

    seen, faults = [], tmp_path / "cut.toml"
    cut = 'kind = "cut"\nhalves = [["motor", "brake"], ["host"]]\nat_s = 1.4\nduration_s = 0.2'
    faults.write_text(f"[[fault]]\n{cut}\n", encoding="utf-8")
    result = simulate("bench", "active", 1.2, record=path, seed=3, overrides=(PUSHED,), script=change, faults=faults)
    assert result.trip is not None
    assert result.trip_ns < 1500 * MS
    assert 1.2 < seen[0] < 1.45
    found = host_replay(path)
    assert (found.difference, found.unchecked) == (None, 0)
    assert found.computed_trip == found.recorded_trip == result.trip


@pytest.mark.thorough
def test_changes_under_a_law_of_ones_own_are_replayed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    law = "def law(motion, law, state):\n    state.brake_Nm = law.F_s\n    return -law.F_d * motion.v_rad_s\n"
    (tmp_path / "own.py").write_text(law)
    path, own = tmp_path / "r.pcapng", "law.function='own.py:law'"

    def change(world):
        world.at(1200 * MS, lambda w: w.set_parameters({"F_d": 0.4, "F_s": 1.5}, over_s=0.2))
        world.at(1300 * MS, lambda w: w.undo_parameters(0.1))

    simulate("bench", "active", 0.9, record=path, seed=3, overrides=(PUSHED, own), script=change)
    assert sum(text.startswith("set ") for _, text in read(path).markers) == 2
    found = host_replay(path, overrides=(own,))
    assert (found.judged, found.difference, found.unchecked) == (True, None, 0)


@pytest.mark.thorough
def test_changes_of_both_axes_that_overlap_are_replayed(tmp_path):
    path = tmp_path / "two.pcapng"

    def change(world):
        for axis, at, values in (
            ("left", 1000, {"F_s": 3.4}),
            ("right", 1050, {"F_d": 2.1}),
            ("left", 1150, {"F_d": 2.9}),
        ):
            world.at(at * MS, lambda w, axis=axis, values=values: w.set_parameters(values, axis, over_s=0.1))
        world.at(1100 * MS, lambda w: w.undo_parameters(0.1))

    simulate("two_axes", "hybrid", 0.8, record=path, script=change)
    assert sum(text.startswith("set ") for _, text in read(path).markers) == 4
    found = host_replay(path)
    assert (found.difference, found.unchecked) == (None, 0)


def test_a_refused_change_leaves_no_trace(tmp_path):
    def asking(changes):
        def script(world):
            def ask(w):
                with pytest.raises(ChangeRefused):
                    w.set_parameters({"F_s": 400.0})

            if changes:
                world.at(900 * MS, ask)

        return script

    for name, changes in (("a", True), ("b", False)):
        simulate("bench", "hybrid", 0.6, record=tmp_path / name, seed=5, script=asking(changes))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def rewritten(recorded, path, change):
    capture = read_pcapng(recorded)
    with PcapngWriter(path, attachments=capture.attachments) as writer:
        writer.write(capture.frames, {row: change(text) for row, text in capture.comments})
    return path
