"""Who notices the host's loss and within what time: each kind of device with each of its watches."""

from __future__ import annotations

import pytest

from coulombus.host.cycle.controller import Controller
from coulombus.host.setup.host_loss import FAULTS, Reaction, reactions_of
from coulombus.host.setup.settings import Setting, settings_of
from coulombus.rigs.rig import load_rig
from eds_edit import edit, fixed, mapped
from foreign_eds import BRAKE, MOTOR
from foreign_rigs import Part, brake, drive, rig_of

NOTHING = ("", None, "its last set-point stays", None)
DEADLINE, HEARTBEAT = ("RPDO deadline 1400h:05", 0.01), ("heartbeat consumer 1016h:01", 0.15)
GUARDING, SYNC = ("life guarding 100Ch, 100Dh", 0.15), ("SYNC time-out 2002h", 0.02)
DISABLED, OFF = "torque 0, disabled", "the fault value: off"


def watched(by, what):
    return (*by, what, by[1])


def found(rig, node, change=lambda settings: settings):
    axis = rig.one_axis()
    limit_pm = Controller(axis, "hybrid").drive_limit_pm()
    return reactions_of(axis, node, change(list(settings_of(axis, node, "hybrid", limit_pm))))


def one_of(reactions):
    """Return what all three faults lead to."""
    assert [(one.device, one.fault) for one in reactions] == [(reactions[0].device, fault) for fault in FAULTS]
    (what,) = {tuple(one)[2:] for one in reactions}
    return what


def without(*indices):
    return lambda settings: [one for one in settings if one.index not in indices]


@pytest.mark.parametrize(
    ("kind", "watch", "expected"),
    [
        ("own", "all", watched(DEADLINE, DISABLED)),
        ("own", "deadline", watched(DEADLINE, DISABLED)),
        ("own", "heartbeat", watched(HEARTBEAT, DISABLED)),
        ("own", "guarding", watched(GUARDING, DISABLED)),
        ("own", "sync", watched(SYNC, DISABLED)),
        ("A", "deadline", watched(DEADLINE, DISABLED)),
        ("A", "heartbeat", watched(HEARTBEAT, DISABLED)),
        ("A", "guarding", watched(GUARDING, DISABLED)),
    ],
)
def test_a_drive_notices_the_loss_by_the_fastest_of_its_watches(kind, watch, expected):
    gone = {"deadline": (0x1016, 0x2002), "heartbeat": (0x1400, 0x2002), "guarding": (0x1400, 0x2002)}
    gone |= {"sync": (0x1400, 0x1016), "all": ()}
    reactions = found(rig_of(drive(kind, watch), brake("own")), "motor", without(*gone[watch]))
    assert one_of(reactions) == expected
    assert reactions[0].device == "motor"


def test_another_makers_2002h_is_no_watch():
    assert one_of(found(rig_of(drive("A"), brake("own")), "motor", without(0x1400, 0x1016))) == NOTHING


def test_our_drive_without_a_time_out_for_sync_does_not_watch_it():
    def zero(settings):
        return [Setting(0x2002, 0, 0) if one.index == 0x2002 else one for one in settings if one.index != 0x1400]

    assert one_of(found(rig_of(drive("own"), brake("own")), "motor", zero)) == watched(HEARTBEAT, DISABLED)


@pytest.mark.parametrize(("kind", "what", "safe_s"), [("own", DISABLED, 0.01), ("A", "the drive's own reaction", None)])
def test_a_drive_that_is_told_nothing_of_its_reaction_has_its_own(kind, what, safe_s):
    reactions = found(rig_of(drive(kind), brake("own")), "motor", without(0x6007))
    assert one_of(reactions) == (*DEADLINE, what, safe_s)


@pytest.mark.parametrize(("kind", "what"), [("404", OFF), ("401", OFF), ("8ao", OFF), ("402", DISABLED)])
@pytest.mark.parametrize("watch", ["deadline", "heartbeat", "guarding"])
def test_another_makers_brake_goes_to_its_fault_value_or_is_disabled(kind, what, watch):
    by = {"deadline": DEADLINE, "heartbeat": HEARTBEAT, "guarding": GUARDING}[watch]
    gone = (0x1016,) if watch == "deadline" else (0x1400,)
    assert one_of(found(rig_of(drive("own"), brake(kind, watch)), "brake", without(*gone))) == watched(by, what)


@pytest.mark.parametrize(("kind", "objects"), [("404", (0x6340, 0x7341)), ("401", (0x6443, 0x6444))])
def test_a_brake_without_both_objects_of_a_fault_value_keeps_its_set_point(kind, objects):
    rig = rig_of(drive("own"), brake(kind))
    assert one_of(found(rig, "brake")) == watched(DEADLINE, OFF)
    for index in objects:
        assert one_of(found(rig, "brake", without(index))) == NOTHING


def test_a_fault_value_and_its_mode_are_of_the_same_output():
    rig = rig_of(drive("own"), brake("8ao"))

    def elsewhere(settings):
        return [Setting(0x6340, 2, 1) if one.index == 0x6340 else one for one in settings]

    assert one_of(found(rig, "brake", elsewhere)) == NOTHING


def test_a_brake_that_is_a_drive_and_told_nothing_has_its_own_reaction():
    rig = rig_of(drive("own"), brake("402"))
    assert one_of(found(rig, "brake", without(0x6007))) == (*DEADLINE, "the drive's own reaction", None)


def test_our_brake_ramps_off_when_its_set_point_is_old():
    rig = rig_of(drive("own"), brake("own"), "brake.hold_s=0.2", "brake.ramp_s=0.3")
    what = one_of(found(rig, "brake"))
    assert what == ("set-point age 2001h", 0.2, "ramped off", pytest.approx(0.5))
    assert one_of(found(rig, "brake", without(0x2005))) == ("set-point age 2001h", 0.2, "ramped off", 0.2)


def test_our_brake_without_an_age_ramps_off_by_the_heartbeat_and_not_by_its_deadline():
    rig = rig_of(drive("own"), brake("own"), "brake.ramp_s=0.3")
    assert one_of(found(rig, "brake", without(0x2001))) == (*HEARTBEAT, "ramped off", pytest.approx(0.45))
    assert one_of(found(rig, "brake", without(0x2001, 0x1016))) == NOTHING


def test_what_nothing_notices_is_told_as_that():
    reactions = found(rig_of(drive("A"), brake("own")), "motor", without(0x1400, 0x1016))
    assert reactions == tuple(Reaction("motor", fault, *NOTHING) for fault in FAULTS)


@pytest.mark.parametrize("name", ["left", "right"])
def test_a_device_of_a_named_axis_has_its_own_deadline(name):
    rig = load_rig("two_axes")
    axis = next(axis for axis in rig.axes if axis.name == name)
    settings = list(settings_of(axis, "motor", "hybrid", 97))
    (fastest, *_) = reactions_of(axis, "motor", settings)
    assert fastest.device == f"{name}.motor"
    assert (fastest.who, fastest.within_s) == ("RPDO deadline 1400h:05", axis.motor.setpoint_fault_s)


def test_a_deadline_of_an_rpdo_that_is_not_used_is_no_watch():
    """A deadline of RPDO 2, which the drive does not use, is none of the set-point."""
    rig = rig_of(drive("own"), brake("own"))

    def moved(settings):
        return [Setting(0x1401, 5, 10) if (one.index, one.subindex) == (0x1400, 5) else one for one in settings]

    assert one_of(found(rig, "motor", moved)) == watched(SYNC, DISABLED)


def test_a_motor_is_a_drive_whatever_its_1000h_says():
    part = Part(edit(MOTOR, "1000", DefaultValue="0x00020194"))
    assert one_of(found(rig_of(part, brake("own")), "motor")) == watched(DEADLINE, DISABLED)


def test_a_fault_value_needs_two_objects_and_no_more():
    rig = rig_of(drive("own"), brake("404", "guarding"))

    def two(settings):
        return [one for one in settings if one.index in (0x6340, 0x7341)]

    assert one_of(found(rig, "brake", two)) == watched(GUARDING, OFF)


def test_the_deadline_of_another_devices_rpdo_or_of_a_tpdos_number_is_no_watch():
    """The drive has its set-point in RPDO 2, the brake in RPDO 1; TPDO 3 of the drive is used."""
    eds = fixed(MOTOR, *(base + k for base in (0x1600, 0x1A00) for k in range(4)))
    eds = mapped(mapped(eds, 0x1600, 0x60600008), 0x1601, 0x60400010, 0x60710010)
    eds = mapped(mapped(eds, 0x1A00, 0x60410010), 0x1A02, 0x60640020, 0x60770010)
    rig = rig_of(Part(eds), Part(BRAKE))
    assert one_of(found(rig, "motor")) == watched(("RPDO deadline 1401h:05", 0.01), DISABLED)
    for index in (0x1400, 0x1402):

        def instead(settings, index=index):
            return [*(one for one in settings if one.index != 0x1401), Setting(index, 5, 10)]

        assert one_of(found(rig, "motor", instead)) == watched(SYNC, DISABLED)
