"""Guesses about a drive tried with their other readings."""

from __future__ import annotations

import pytest

from coulombus.lab.guess_trials import OtherReading, _tried, readings
from coulombus.rigs.draft.discover import DeviceChoice, gather
from coulombus.rigs.draft.draft import Draft
from coulombus.rigs.rig import load_rig
from foreign_eds import MOTOR, another, geared, without


@pytest.fixture
def draft(tmp_path):
    (tmp_path / "drive.eds").write_text(geared(without(another(MOTOR), "20")), encoding="utf-8")
    devices = gather((DeviceChoice("motor", str(tmp_path / "drive.eds")), DeviceChoice("brake", "bench")), tmp_path)
    made = Draft(devices, load_rig("bench").one_axis(), str(tmp_path / "try.toml"), rehearse=True)
    made.acknowledge(("motor: no reaction to the host's loss",))
    return made


def test_only_marked_guesses_have_other_readings(draft):
    axis, text = draft.rig.one_axis(), str(draft)
    keys = {reading.key for reading in readings(axis, text)}
    assert keys == {
        *("motor.rated_torque_Nm", "motor.encoder_counts_rev"),
        *("mechanics.motor_polarity", "mechanics.encoder_polarity"),
    }
    assert list(readings(axis, text.replace("# CHECK:", "#"))) == []


def test_each_reading_is_another_plant_and_the_same_belief(draft):
    for reading in readings(draft.rig.one_axis(), str(draft)):
        true = draft.rig.variant(*reading.overrides).one_axis()
        assert true.motor == draft.rig.one_axis().motor
        assert true.plant != draft.rig.one_axis().plant, reading


def test_the_other_sense_is_noticed_before_the_handle_has_gone_far(draft, tmp_path):
    reading = OtherReading("mechanics.motor_polarity", "the other sense", ("plant.motor_polarity=-1",))
    trial = _tried(draft.rig, "active", reading, tmp_path / "a.npz")
    assert trial.noticed_by == "SIGN_ENCODER"
    assert 0.0 < trial.angle_rad < 0.2
    assert trial.motor_Nm > 0.0


def test_a_rig_that_is_not_armed_moves_nothing(draft, tmp_path):
    wrong = draft.rig.variant("motor.encoder_counts_rev=8192", "plant.encoder_counts_rev=8192")
    trial = _tried(wrong, "active", OtherReading("x", "x", ()), tmp_path / "a.npz")
    assert trial.noticed_by.startswith("before arming: motor (node 1): 6064h counts 360")
    assert (trial.angle_rad, trial.speed_rad_s, trial.motor_Nm) == (0.0, 0.0, 0.0)
