"""Why a commanded drive does not move: every reason has its name, and is reported once."""

from __future__ import annotations

import math

import pytest

from coulombus.eds.cia301 import NmtState
from coulombus.eds.cia402 import PowerState
from coulombus.eds.reader import parse_eds, read_eds
from coulombus.node.device import Device
from coulombus.node.drive402 import DRIVE402
from coulombus.node.record import new_nodes
from coulombus.node.slots402 import ACTS_SPEED
from coulombus.node.standstill import LOOKS, StandstillWatch, why_still
from coulombus.wire.frame import new_queue
from foreign_eds import MOTOR, another, without

VELOCITY, TORQUE, CSV, CST = 3, 4, 9, 10


def drive(mode=VELOCITY, target=1000, state=PowerState.OPERATION_ENABLED, description=None):
    """Return an enabled drive that could turn."""
    device = Device(description or read_eds("eds/motor.eds"), 5, DRIVE402, new_nodes(1)[0])
    device.power_on(0, new_queue())
    n = device.record
    n["nmt"], n["power_state"], n["mode"] = NmtState.OPERATIONAL, state, mode
    for index, value in ((0x6060, mode), (0x6072, 1000), (0x60FF if mode in (VELOCITY, CSV) else 0x6071, target)):
        device[index, 0] = value
    return device


def reason(device, holding_pm=0.0):
    why = why_still(device.record, device.dictionary, holding_pm)
    return None if why is None else why.name


def test_a_drive_that_could_turn_has_no_reason():
    assert reason(drive()) is None
    assert reason(drive(CST, -300)) is None
    assert reason(drive(state=PowerState.SWITCHED_ON, target=0)) is None  # nobody commands it


def test_a_drive_that_turns_has_no_reason():
    device = drive()
    device[0x6072, 0] = 0
    assert reason(device) == "torque_limit"
    device.record["in_velocity_counts_s"] = -1.0
    assert reason(device) is None


@pytest.mark.parametrize(
    ("mode", "target", "index", "name"),
    [
        (VELOCITY, 1000, 0x6072, "torque_limit"),
        (CST, 100, 0x6073, "torque_limit"),
        (TORQUE, 100, 0x60E0, "torque_limit"),
        (TORQUE, -100, 0x60E1, "torque_limit"),
        (VELOCITY, 1000, 0x60FF, "set_point"),
        (CST, 100, 0x6071, "set_point"),
        (VELOCITY, 1000, 0x6083, "slope"),
        (TORQUE, 1000, 0x6087, "slope"),
    ],
)
def test_an_object_that_is_0_is_named(mode, target, index, name):
    device = drive(mode, target)
    device[index, 0] = 0
    why = why_still(device.record, device.dictionary)
    assert why.name == name
    assert f"{index:04X}h" in why.text


@pytest.mark.parametrize(("target", "index"), [(-100, 0x60E0), (100, 0x60E1)])
def test_a_limit_of_the_other_direction_is_no_reason(target, index):
    device = drive(TORQUE, target)
    device[index, 0] = 0
    assert reason(device) is None


@pytest.mark.parametrize(
    ("field", "value", "name"), [("mode", 0, "mode"), ("controlword", 0x10F, "halt"), ("setpoint_stale", 1, "stale")]
)
def test_a_state_that_keeps_the_drive_still_is_named(field, value, name):
    device = drive()
    device.record[field] = value
    assert reason(device) == name


def test_an_offset_is_a_set_point():
    device = drive(CSV, 0)
    assert reason(device) == "set_point"
    device[0x60B1, 0] = 500
    assert reason(device) is None


def test_a_set_point_that_no_rpdo_maps_is_said_to_be_so():
    device = drive(VELOCITY, 0)
    assert "no valid RPDO maps it" in why_still(device.record, device.dictionary).text
    device.record["rpdo_carries"][0] = ACTS_SPEED
    device.record["rpdo"][0]["cob_id"] = 0x205
    device.record["rpdo_used"] = 1
    assert "RPDO" not in why_still(device.record, device.dictionary).text


def test_an_rpdo_that_waits_for_sync_is_named():
    device = drive(VELOCITY, 0)
    device.record["rpdo_pending"] = 1
    assert reason(device) == "sync"
    device.record["power_state"] = PowerState.SWITCH_ON_DISABLED
    assert reason(device) == "sync"


def test_a_position_at_its_limit_is_named_in_its_direction():
    for position, target, name in ((100, 5, "limit"), (100, -5, None), (-100, -5, "limit"), (0, 5, None)):
        device = drive(VELOCITY, target)
        device[0x607D, 1], device[0x607D, 2] = -100, 100
        device.record["in_position_counts"], device.record["limited"] = position, 1
        assert reason(device) == name


def test_a_file_without_607Dh_has_no_limit_of_the_position():
    device = drive(CST, 2000, description=parse_eds(without(another(MOTOR), "607D").encode(), "x.eds"))
    device.record["limited"] = 1
    assert reason(device) is None


def test_a_speed_limit_of_0_is_named():
    device = drive()
    device[0x6080, 0] = 0
    device.record["limited"] = 1
    assert reason(device) == "speed_limit"


@pytest.mark.parametrize("sign", [1, -1])
def test_a_load_that_holds_is_named(sign):
    device = drive(CST, sign * 20)
    device.record["out_torque_pm"] = sign * 20.0
    assert reason(device, 19.9) is None
    assert reason(device, 20.1) == "load"
    assert "blocked" in why_still(device.record, device.dictionary, math.inf).text


def test_a_drive_that_is_not_enabled_names_what_is_missing():
    device = drive(state=PowerState.SWITCH_ON_DISABLED)
    why = why_still(device.record, device.dictionary)
    assert why.name == "state"
    assert "SWITCH ON DISABLED, and 6040h is 0000h" in why.text
    device.record["power_state"] = PowerState.FAULT
    assert reason(device) == "fault"


def test_a_missing_supply_is_named_when_the_drive_is_to_be_enabled():
    device = drive(state=PowerState.READY_TO_SWITCH_ON, target=0)
    device.record["in_supply_ok"] = 0
    assert reason(device) is None
    device[0x6040, 0] = 0x0F
    assert reason(device) == "voltage"


def test_pdos_before_nmt_start_are_named():
    device = drive(state=PowerState.SWITCH_ON_DISABLED, target=0)
    device.record["nmt"] = NmtState.PRE_OPERATIONAL
    assert reason(device) is None
    device.record["dropped_unknown"] = 1
    why = why_still(device.record, device.dictionary)
    assert why.name == "nmt"
    assert "PRE-OPERATIONAL" in why.text


def test_a_device_that_is_off_has_no_reason():
    device = drive(VELOCITY, 0)
    device.record["powered"] = 0
    assert reason(device) is None


def looks(watch, device, count):
    reasons = [watch.update(device.record, device.dictionary) for _ in range(count)]
    return [None if why is None else why.name for why in reasons]


def test_a_reason_is_reported_once_when_it_lasts():
    device, watch = drive(VELOCITY, 0), StandstillWatch()
    assert looks(watch, device, 2 * LOOKS) == [*[None] * (LOOKS - 1), "set_point", *[None] * LOOKS]
    device[0x60FF, 0] = 500
    looks(watch, device, LOOKS)
    device[0x60FF, 0] = 0
    assert looks(watch, device, 2 * LOOKS) == [None] * 2 * LOOKS
    device[0x6072, 0] = 0
    assert looks(watch, device, LOOKS)[-1] == "torque_limit"


def test_a_reason_that_is_interrupted_does_not_last():
    device, watch = drive(VELOCITY, 0), StandstillWatch()
    for _ in range(3):
        device[0x60FF, 0] = 0
        assert looks(watch, device, LOOKS - 1) == [None] * (LOOKS - 1)
        device[0x60FF, 0] = 500
        assert looks(watch, device, 1) == [None]


def test_a_drive_that_was_enabled_may_be_disabled_without_a_word():
    device, watch = drive(state=PowerState.SWITCHED_ON), StandstillWatch()
    assert looks(watch, device, LOOKS)[-1] == "state"
    device, watch = drive(), StandstillWatch()
    looks(watch, device, 1)
    device.record["power_state"] = PowerState.SWITCH_ON_DISABLED
    assert looks(watch, device, 2 * LOOKS) == [None] * 2 * LOOKS
