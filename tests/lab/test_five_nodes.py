"""One axis whose roles lie on five nodes, at 1 kHz: it is armed where the wire has room, and
refused with the numbers where it has not.
"""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.host.errors import DeviceMismatch
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.rigs.plan.rig_plan import plan, shortest_period_ns
from coulombus.rigs.plan.role_costs import longer_period
from coulombus.rigs.rig import RigError, load_rig, load_rig_text
from foreign_eds import BRAKE, MOTOR, U8, edited, with_array
from places import RIGS

BENCH = (RIGS / "bench.toml").read_text()
SWITCH = edited(with_array(BRAKE, "6000", U8, 1, "ro"), "6000sub1", DefaultValue=1)
"""A node with the temperature and the dead man's switch, which is held."""
ROLES = {"handle_torque": ("cell", 1), "coil_current": ("shunt", 2), "coil_temperature": ("thermo", 3)}
FILES = {"cell": "mr_brake.eds", "shunt": "mr_brake.eds", "thermo": "switch.eds"}
SLOW = ("motor.response_us=150", "brake.response_us=150", "host.compute_s=50e-6")


def sensor(name, node_id, eds):
    return (
        f'\n[sensor.{name}]\nnode_id = {node_id}\neds = "{eds}"\nvendor_id = 0x4C0\nproduct_code = 0x404\n'
        "heartbeat_s = 0.05\nheartbeat_timeout_s = 0.15\n"
    )


def text_of(spares=0):
    text = BENCH.replace("[host]\n", '[host]\ndeadman = "object:6000:1:0x01"\n', 1)
    for node_id, (name, eds) in enumerate(FILES.items(), 3):
        text += sensor(name, node_id, eds)
    for spare in range(spares):
        text += sensor(f"spare_{spare}", 6 + spare, "mr_brake.eds")
    for role, (node, sub) in ROLES.items():
        text += f'\n[role.{role}]\nnode = "{node}"\nobject = "7130:{sub}"\n'
    return text


def five(*overrides, spares=0):
    texts = {"motor.eds": MOTOR, "mr_brake.eds": BRAKE, "switch.eds": SWITCH}
    return load_rig_text(text_of(spares), "five.toml", texts, overrides)


def test_five_nodes_are_armed_at_1_khz_and_tell_all_that_one_tells(tmp_path):
    rig = five()
    assert len(rig.nodes) == 5
    found = plan(rig)
    assert (found.fits, found.timing.period_ns) == (True, 1_000_000)
    path = tmp_path / "five.pcapng"
    result = simulate(rig, "hybrid", 1.5, record=path, overrides=("phase.0.duration_s=1.0",))
    assert (result.trip, result.sign_check, result.exit_status) == (None, "agreed", 0)
    recording = read(path)
    assert {"motor.position_rad", "brake.handle_torque_Nm", "brake.coil_current_A"} <= set(recording.signals)
    assert recording["brake.coil_temperature_degC"].values[-1] == pytest.approx(22.0)
    ids = set(recording.frames["can_id"].tolist())
    assert {0x181, 0x183, 0x184, 0x185} <= ids
    assert not {0x182, 0x202 + 0x100} & ids  # the brake's driver tells nothing: nobody asks it


def test_the_switch_of_the_fifth_node_keeps_the_rig_from_arming():
    rig = five()
    released = edited(SWITCH, "6000sub1", DefaultValue=0)
    texts = {**rig.eds_texts, "switch.eds": released}
    result = simulate(load_rig_text(text_of(), "five.toml", texts), "hybrid", 0.5)
    assert "DEADMAN" in result.trip


def test_devices_that_are_too_slow_for_five_are_refused_with_the_numbers(tmp_path):
    assert plan(load_rig("bench", SLOW)).fits  # one node with all sensors on it: there they are not
    slow = five(*SLOW, *(f"sensor.{name}.response_us=150" for name in FILES))
    with pytest.raises(DeviceMismatch, match=r"brake RPDO1 \(202h\) is through \d+ us after SYNC's release and due at"):
        simulate(slow, "hybrid", 0.5)
    for name, text in slow.eds_texts.items():
        (tmp_path / name).write_text(text)
    mine = tmp_path / "five.toml"
    mine.write_text(slow.effective())
    checked = CliRunner().invoke(main, ["check", "--rig", str(mine)])
    assert checked.exit_code == 1
    busy_us = plan(slow).busy_ns // 1000
    told = f"FAIL: the cycle does not fit on the bus: {busy_us} us of frames in the worst case, every 1000 us"
    assert told in checked.output
    planned = CliRunner().invoke(main, ["plan", "--rig", str(mine), "--json"])
    assert planned.exit_code == 1
    would = json.loads(planned.stdout)["would_fit"]
    changed = five(*SLOW, *(f"sensor.{name}.response_us=150" for name in FILES), *would["period"]["set"])
    assert plan(changed).fits
    lean = five(*SLOW, *(f"sensor.{name}.response_us=150" for name in FILES), *would["without"]["set"])
    assert plan(lean).fits
    assert lean.bus.period_ns == 1_000_000


def test_eight_nodes_are_refused_with_the_numbers_and_a_ninth_is_none():
    """Their SDO transfers and EMCYs, all at once, leave too little of the bus."""
    rig = five(spares=3)
    found = plan(rig)
    assert sum("heartbeat" in message.name for message in found.messages) == 9  # the host's, too
    assert not found.fits
    assert any("host heartbeat (77Fh) takes" in reason for reason in found.reasons)
    change = longer_period(rig, found, shortest_period_ns(rig, found))
    assert change is not None
    assert plan(rig.variant(*change.overrides)).fits
    with pytest.raises(RigError, match="got 7 sensors, expected at most 6"):
        five(spares=4)
