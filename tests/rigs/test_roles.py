"""Roles and PDOs: which object has which role, by which scale, and which PDO carries it, for
devices of every kind of map.
"""

from __future__ import annotations

import math
import re

import pytest

from coulombus.rigs.rig import RigError, load_rig_text
from eds_edit import SENSOR, edit, fixed, gone, mapped
from places import RIGS, ROOT

BENCH = (RIGS / "bench.toml").read_text(encoding="utf-8")
MOTOR, BRAKE = ((ROOT / "eds" / name).read_text(encoding="utf-8") for name in ("motor.eds", "mr_brake.eds"))
COUNT = 2 * math.pi / (8192 * 9.587)


def rig_of(motor=MOTOR, brake=BRAKE, *overrides, text="", **others):
    return load_rig_text(BENCH + text, "r.toml", {"motor.eds": motor, "mr_brake.eds": brake, **others}, overrides)


def errors(*arguments, **keys):
    with pytest.raises(RigError) as caught:
        rig_of(*arguments, **keys)
    return caught.value


def carried(rig):
    return {f"{p.node} {p.name}": [s.key for s in p.signals] for p in rig.pdos()}


def signals(rig):
    return {s.key: s for p in rig.pdos() for s in p.signals}


# roles and scales


def test_the_rig_file_says_which_object_a_role_is():
    text = '\n[role.position]\nobject = "6063"\nscale_rad = 0.001\n[role.torque]\nobject = "6078"\nscale_Nm = 0.002\n'
    motor = edit(MOTOR, "606B", ParameterName="another")  # any mappable object of 32 bits
    rig = rig_of(motor, BRAKE, "mechanics.encoder_polarity=-1", text=text.replace("6063", "606B"))
    by_name = signals(rig)
    assert (by_name["motor.position_rad"].index, by_name["motor.position_rad"].scale) == (0x606B, -0.001)
    assert by_name["motor.torque_Nm"].index == 0x6078
    assert by_name["motor.torque_Nm"].scale == pytest.approx(0.002 * 9.587)
    assert rig.one_axis().allocation.bound["torque"].decided == "role.torque.scale_Nm"


@pytest.mark.parametrize("polarity", [1, -1])
def test_a_velocity_is_mapped_only_where_it_is_asked_for(polarity):
    assert "motor.velocity_rad_s" not in signals(rig_of())
    text = '\n[role.velocity]\nobject = "606C"\nscale_rad_s = 0.5\n'
    by_name = signals(rig_of(MOTOR, BRAKE, f"mechanics.encoder_polarity={polarity}", text=text))
    assert by_name["motor.velocity_rad_s"].scale == pytest.approx(polarity * 0.5 / 9.587)
    text = '\n[role.velocity]\nobject = "606C"\n'
    (error,) = errors(text=text).errors
    assert "60A9h (unit of velocity) is missing; give [role.velocity] its scale_rad_s" in error
    rpm = MOTOR.replace("\n1=0x", "\n1=0x", 1)
    rpm = re.sub(
        r"(\[OptionalObjects\]\nSupportedObjects=)(\d+)\n",
        lambda m: f"{m[1]}{int(m[2]) + 1}\n{int(m[2]) + 1}=0x60A9\n",
        rpm,
    )
    rpm += "\n[60A9]\nParameterName=Unit\nObjectType=0x7\nDataType=0x0007\nAccessType=ro\nDefaultValue=0xFFB44700\n"
    by_name = signals(rig_of(rpm, BRAKE, text=text))
    assert by_name["motor.velocity_rad_s"].scale == pytest.approx(0.1 * 2 * math.pi / 60 / 9.587)


def test_an_object_of_no_known_scale_needs_one():
    text = '\n[role.torque_setpoint]\nobject = "60FF"\n'
    refused = errors(text=text)
    (problem,) = refused.problems
    assert (problem.role, problem.node, problem.object) == ("torque_setpoint", "motor", "60FFh:0")
    assert problem.remedy == "give [role.torque_setpoint] its scale_Nm"
    assert refused.errors[0].startswith(f"r.toml:{BENCH.count(chr(10)) + 2}: role.torque_setpoint: ")
    rig = rig_of(MOTOR, BRAKE, "mechanics.motor_polarity=-1", text=text + "scale_Nm = 0.001\n")
    assert signals(rig)["motor.target_torque_Nm"].scale == pytest.approx(-0.001 * 9.587)


def test_a_table_is_monotone_and_begins_at_0():
    good = "\n[role.brake_setpoint]\ntable = [[0, 0.0], [100, 0.5], [300, 5.0]]\n"
    binding = rig_of(text=good).one_axis().allocation.bound["brake_setpoint"]
    assert binding.table == ((0, 0.0), (100, 0.5), (300, 5.0))
    assert binding.scale == pytest.approx(4.5 / 200)
    falling = "\n[role.brake_setpoint]\ntable = [[-10, 0.0], [-100, 0.5]]\n"
    assert rig_of(text=falling).one_axis().allocation.bound["brake_setpoint"].scale < 0
    for wrong in ("[[0, 0.0]]", "[[0, 0.1], [1, 1.0]]", "[[0, 0.0], [1, 1.0], [1, 2.0]]", "[[0, 0.0], [5, 2.0], [9, 1.0]]",
                  "[[0, 0.0], [5, 1.0], [3, 2.0]]", str([[k, float(k)] for k in range(17)]), '"x"'):  # fmt: skip
        (error,) = errors(text=f"\n[role.brake_setpoint]\ntable = {wrong}\n").errors
        assert "expected a list of 2 to 16 points [raw, Nm], from 0 Nm on, both columns monotone" in error


@pytest.mark.parametrize(
    ("role", "lost"),
    [
        ("torque", "takes the command for it"),
        ("handle_torque", "no sign check of a transducer"),
        ("coil_current", "the command times brake.coil_A_Nm"),
        ("coil_temperature", "not recorded"),
    ],
)
def test_what_is_lost_without_an_optional_role_is_told(role, lost):
    axis = rig_of(text=f'\n[role.{role}]\nobject = "none"\n').one_axis()
    assert axis.allocation.bound.get(role) is None
    (loss,) = axis.allocation.losses
    assert lost in loss


def test_a_role_that_is_needed_cannot_be_none():
    (error,) = errors(text='\n[role.position]\nobject = "none"\n').errors
    assert "the host cannot do without this role; name the object that it is" in error


def test_an_object_has_one_role():
    text = '\n[role.torque]\nobject = "6064"\nscale_Nm = 1.0\n'
    (error,) = errors(text=text).errors
    assert "6064h:0 of motor is the position already" in error


# sensors


def test_a_sensor_has_a_node_of_its_own_and_the_role_keeps_its_name():
    rig = rig_of(MOTOR, BRAKE, text=SENSOR, **{"cell.eds": BRAKE})
    assert [(n.name, n.node_id) for n in rig.nodes] == [("motor", 1), ("brake", 2), ("cell", 3)]
    assert carried(rig)["cell TPDO1"] == ["brake.handle_torque_Nm"]
    assert carried(rig)["brake TPDO1"] == ["brake.coil_current_A", "brake.coil_temperature_degC"]
    assert [p.layout.cob_id for p in rig.pdos()] == [0x201, 0x181, 0x202, 0x182, 0x183]
    assert load_rig_text(rig.effective(), "again.toml", rig.eds_texts) == rig


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("node_id = 3", "node_id = 2"), "sensor.cell.node_id: got '2', expected another id than brake.node_id, which is 2"),
        (("node_id = 3", "node_id = 2000"), "sensor.cell.node_id: got '2000', expected an integer from 1 to 127"),
        (("heartbeat_s = 0.05", "hartbeat_s = 0.05"), "sensor.cell.hartbeat_s: unknown key"),
        (("heartbeat_s = 0.05", "heartbeat_s = 0.2"), "less than sensor.cell.heartbeat_timeout_s, which is 0.15"),
        (('node = "cell"', 'node = "sell"'), "role.handle_torque: there is no device 'sell'; name one of motor, brake, cell"),
        (("[sensor.cell]", "[sensor.Cell]"), "'Cell' names a sensor; expected a name of small letters"),
        (("[role.handle_torque]", "[role.handle_torq]"), "role.handle_torq: unknown key"),
    ],
)  # fmt: skip
def test_mistakes_of_sensors_and_roles_have_their_line(change, expected):
    mistakes = errors(MOTOR, BRAKE, text=SENSOR.replace(*change), **{"cell.eds": BRAKE}).errors
    assert any(expected in text for text in mistakes), mistakes
    assert all(text.startswith("r.toml:") for text in mistakes)


# PDOs


def test_free_maps_are_filled_in_the_order_of_their_numbers():
    assert carried(rig_of(gone(MOTOR, "1800sub1"))) | {} == {
        "motor RPDO1": ["motor.controlword", "motor.target_torque_Nm"],
        "motor TPDO2": ["motor.statusword", "motor.position_rad", "motor.torque_Nm"],
        "brake RPDO1": ["brake.setpoint_Nm"],
        "brake TPDO1": ["brake.handle_torque_Nm", "brake.coil_current_A", "brake.coil_temperature_degC"],
    }


def test_a_record_of_two_entries_keeps_statusword_and_position_together():
    narrow = gone(MOTOR, *(f"1A00sub{k}" for k in range(3, 9)), *(f"1600sub{k}" for k in range(2, 9)))
    assert carried(rig_of(narrow)) == {
        "motor RPDO2": ["motor.controlword", "motor.target_torque_Nm"],
        "motor TPDO1": ["motor.statusword", "motor.position_rad"],
        "motor TPDO2": ["motor.torque_Nm"],
        "brake RPDO1": ["brake.setpoint_Nm"],
        "brake TPDO1": ["brake.handle_torque_Nm", "brake.coil_current_A", "brake.coil_temperature_degC"],
    }


def test_fixed_maps_are_used_where_they_hold_what_is_wanted():
    every = [base + k for base in (0x1600, 0x1A00) for k in range(4)]
    motor = fixed(MOTOR, *every)
    motor = mapped(motor, 0x1600, 0x60600008, 0x60400010, 0x60710010)
    motor = mapped(motor, 0x1A00, 0x60610008, 0x60410010)
    motor = mapped(motor, 0x1A01, 0x606C0020)
    motor = mapped(motor, 0x1A02, 0x60640020, 0x60770010)
    rig = rig_of(motor)
    assert carried(rig) | {"brake RPDO1": 0, "brake TPDO1": 0} == {
        "motor RPDO1": ["motor.6060h_0", "motor.controlword", "motor.target_torque_Nm"],
        "motor TPDO1": ["motor.6061h_0", "motor.statusword"],
        "motor TPDO3": ["motor.position_rad", "motor.torque_Nm"],
        "brake RPDO1": 0,
        "brake TPDO1": 0,
    }
    rpdo = rig.pdos()[0]
    assert rpdo.fixed
    assert [(c.index, c.subindex, c.value) for c in rpdo.constants] == [(0x6060, 0, 10)]
    (loss,) = rig.one_axis().allocation.losses
    assert loss == "motor: RPDO1 carries 6060h:0 too, which is sent as 10 (the mode of operation)"


def test_read_only_identifiers_are_the_devices_own_and_bit_30_stays():
    motor = edit(MOTOR, "1800sub1", AccessType="ro", DefaultValue="$NODEID+0x400001C0")
    pdo = next(p for p in rig_of(motor).pdos() if p.name == "TPDO1")
    assert (pdo.layout.cob_id, pdo.layout.rtr_allowed, pdo.fixed) == (0x1C1, False, True)
    both = edit(MOTOR, "1800sub1", DefaultValue="$NODEID+0x40000180")
    assert next(p for p in rig_of(both).pdos() if p.name == "TPDO1").layout.rtr_allowed is False


def test_a_pdo_that_cannot_be_made_invalid_is_mapped_anew_last_and_told():
    motor = edit(MOTOR, "1800sub1", AccessType="ro")
    motor = mapped(motor, 0x1A00, 0x60410010)
    assert carried(rig_of(motor))["motor TPDO1"] == ["motor.statusword"]  # as it stands
    other = mapped(motor, 0x1A00, 0x606C0020)
    assert "motor TPDO1" not in carried(rig_of(other))
    only = gone(other, *(f"180{k}sub1" for k in (1, 2, 3)))
    rig = rig_of(only)
    assert carried(rig)["motor TPDO1"] == ["motor.statusword", "motor.position_rad", "motor.torque_Nm"]
    (loss,) = rig.one_axis().allocation.losses
    assert loss == "motor: TPDO1 is mapped while it is valid, as its identifier is read-only"
    assert not next(p for p in rig.pdos() if p.name == "TPDO1" and p.node == "motor").fixed


def test_two_devices_of_one_identifier_are_refused():
    motor = edit(MOTOR, "1800sub1", AccessType="ro", DefaultValue="0x182")
    (error,) = errors(motor).errors
    assert "TPDO1 of brake has the identifier 182h of TPDO1 of motor; give one of the devices another node id" in error


def test_a_tpdo_that_cannot_follow_sync_has_its_event_timer():
    own = edit(MOTOR, "1800sub2", AccessType="ro", DefaultValue=255)
    rig = rig_of(own)
    pdo = next(p for p in rig.pdos() if p.name == "TPDO1")
    assert (pdo.layout.transmission, pdo.layout.event_ns, pdo.every_cycle) == (255, 1_000_000, False)
    assert (
        "TPDO1 does not follow SYNC (transmission type 255); it is sent every 1 ms"
        in rig.one_axis().allocation.losses[0]
    )
    (error,) = errors(gone(own, "1800sub5")).errors
    assert "is sent only when something changes; limits.missed_tpdo_cycles allow 3 ms" in error
    seldom = edit(edit(MOTOR, "1800sub2", AccessType="ro", DefaultValue=10), "1800sub5", AccessType="ro")
    (error,) = errors(seldom).errors
    assert "is sent every 10 ms" in error
    assert rig_of(seldom, BRAKE, "limits.missed_tpdo_cycles=10").pdos()


def test_a_pdo_that_is_sent_on_request_only_is_not_used():
    motor = edit(MOTOR, "1800sub2", AccessType="ro", DefaultValue=253)
    assert "motor TPDO1" not in carried(rig_of(motor))


def test_an_encoder_that_wraps_before_a_jump_is_seen_is_refused():
    motor = edit(MOTOR, "6064", DataType="0x0003", LowLimit="", HighLimit="")
    (error,) = errors(motor, BRAKE, "limits.encoder_jump_counts=11000").errors
    assert "a position of 16 bits wraps after 65536 counts" in error
    assert next(p for p in rig_of(motor).pdos() if p.name == "TPDO1").layout.length == 6


def test_a_switch_beside_full_tpdos_has_one_of_its_own():
    rig = rig_of(MOTOR, BRAKE, "host.deadman=object:606C:0:0x10", text="")
    assert carried(rig)["motor TPDO2"] == ["motor.deadman"]


# brakes of other profiles

INPUTS = ("6131", "6132", "7130")


def test_a_brake_that_is_a_cia_402_drive_has_its_power_states():
    drive = edit(MOTOR, "1018sub2", DefaultValue="0x404")
    (error,) = errors(MOTOR, drive).errors
    assert "no object tells what a count of 6071h:0 is; give [role.brake_setpoint] its scale_Nm or table" in error
    rig = rig_of(MOTOR, drive, text="\n[role.brake_setpoint]\nscale_Nm = 0.005\n")
    assert carried(rig)["brake RPDO1"] == ["brake.controlword", "brake.setpoint_Nm"]
    assert carried(rig)["brake TPDO1"] == ["brake.statusword"]
    assert len(rig.one_axis().allocation.losses) == 3  # handle torque, coil current, temperature
    (error,) = errors(
        MOTOR, drive, text='\n[role.brake_setpoint]\nscale_Nm = 0.005\n[role.brake_statusword]\nobject = "none"\n'
    ).errors
    assert "a brake that is a CiA 402 drive has a statusword and a controlword" in error


def test_a_brake_in_volts_has_a_table():
    volts = edit(BRAKE, "6301sub1", DefaultValue="0x00260000")
    (error,) = errors(MOTOR, volts).errors
    assert "6301h:1 is 0x00260000; expected 0x00560000 (Nm), a prefix allowed; give [role.brake_setpoint]" in error
    rig = rig_of(MOTOR, volts, text="\n[role.brake_setpoint]\ntable = [[0, 0.0], [2000, 1.0], [5000, 5.0]]\n")
    assert signals(rig)["brake.setpoint_Nm"].index == 0x7300
