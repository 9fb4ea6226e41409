"""The plan by role: what each costs on the wire, and what to change where the plan does not fit."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.rigs.plan.rig_plan import Assumptions, plan, shortest_period_ns
from coulombus.rigs.plan.role_costs import longer_period, role_costs, without_roles
from coulombus.rigs.rig import load_rig, load_rig_text
from eds_edit import fixed, mapped
from places import RIGS, ROOT

BENCH = (RIGS / "bench.toml").read_text(encoding="utf-8")
MOTOR, BRAKE = ((ROOT / "eds" / name).read_text(encoding="utf-8") for name in ("motor.eds", "mr_brake.eds"))


def costs_of(rig):
    return {(cost.node, cost.role): cost for cost in role_costs(rig, rig.bus.bitrate_bit_s)}


@pytest.mark.parametrize("name", ["bench", "paper", "two_axes"])
def test_the_roles_together_are_the_frames_of_the_cycle(name):
    rig = load_rig(name)
    rig_plan = plan(rig)
    sync_ns = 55 * 1_000_000_000 // rig.bus.bitrate_bit_s
    assert sum(cost.wire_ns for cost in costs_of(rig).values()) == pytest.approx(rig_plan.busy_ns - sync_ns, abs=10)


@pytest.mark.parametrize("role", ["torque", "handle_torque", "coil_current", "coil_temperature"])
def test_what_a_role_saves_is_what_the_plan_without_it_saves(role):
    rig = load_rig("bench", ["bus.bitrate_bit_s=800000"])
    lean = rig.variant(f'role.{role}.object="none"')
    (cost,) = (cost for cost in costs_of(rig).values() if cost.role == role)
    assert cost.saved_ns == plan(rig).busy_ns - plan(lean).busy_ns == 25_000


def test_what_the_host_needs_is_not_offered():
    costs = costs_of(load_rig("bench"))
    assert {role for (_, role), cost in costs.items() if cost.saved_ns is None} == {
        *("controlword", "statusword", "torque_setpoint", "position", "brake_setpoint")
    }
    position = costs["motor", "position"]
    assert (position.place, position.pdo, position.bits) == ("6064h:00", "TPDO1", 32)
    switch = costs_of(load_rig("bench", ['host.deadman="object:6078:0:0x0001"']))["motor", "deadman"]
    assert (switch.place, switch.saved_ns) == ("6078h:00", None)


def test_a_role_of_a_fixed_map_saves_nothing_and_its_other_entries_are_told():
    brake = mapped(BRAKE, 0x1A00, 0x7130_01_10, 0x7130_02_10, 0x7130_03_10, 0x1001_00_08)
    brake = fixed(brake, 0x1A00, 0x1A01, 0x1A02, 0x1A03)
    rig = load_rig_text(BENCH, "r.toml", {"motor.eds": MOTOR, "mr_brake.eds": brake})
    costs = costs_of(rig)
    assert costs["brake", "coil_temperature"].saved_ns == 0
    assert costs["brake", ""].place == "1001h:00"


def test_a_period_is_proposed_that_the_rig_file_takes_and_that_fits():
    slow = ["motor.response_us=250", "brake.response_us=250", "host.compute_s=50e-6"]
    rig = load_rig("bench", slow)
    rig_plan = plan(rig)
    assert not rig_plan.fits
    change = longer_period(rig, rig_plan, shortest_period_ns(rig, rig_plan))
    assert change is not None
    changed = rig.variant(*change.overrides)
    assert plan(changed).fits
    assert changed.bus.period_ns == change.period_ns
    assert change.period_ns % 50_000 == 0
    shorter = change.period_ns - 50_000
    assert not plan(rig, period_ns=shorter).fits
    grid = load_rig("bench", [*slow, "plant.step_s=2e-4", "bus.period_s=1e-3"])
    rig_plan = plan(grid)
    change = longer_period(grid, rig_plan, shortest_period_ns(grid, rig_plan))
    assert change is not None
    assert change.period_ns % 200_000 == 0


@pytest.mark.parametrize(("period_us", "roles"), [(750, ("coil_temperature", "torque")), (600, None)])
def test_the_roles_are_proposed_without_which_the_period_fits(period_us, roles):
    rig = load_rig("bench", ["role.velocity.object=606C", "role.velocity.scale_rad_s=0.01"])
    rig_plan = plan(rig, period_ns=period_us * 1000, assumptions=Assumptions(host_ns=0))
    assert not rig_plan.fits
    change = without_roles(rig, rig_plan)
    if roles is None:
        assert change is None
        return
    assert change is not None
    assert change.roles[0] == "velocity"  # only recorded: the first to be given up
    assert change.roles[1:] == roles
    assert plan(rig.variant(*change.overrides), period_ns=period_us * 1000).fits
    assert any("net_work_J" in text for text in change.lost)


def test_a_role_that_does_not_help_stays():
    """The torque is given up early, and what fits with what is given up later keeps it."""
    rig = load_rig("bench")
    rig_plan = plan(rig, period_ns=700_000)
    change = without_roles(rig, rig_plan)
    assert change is not None
    assert change.roles == ("coil_temperature", "coil_current", "handle_torque")
    for role in change.roles:
        others = [f'role.{other}.object="none"' for other in change.roles if other != role]
        assert not plan(rig.variant(*others), period_ns=700_000).fits


def test_axes_are_named():
    rig = load_rig("two_axes")
    rig_plan = plan(rig, period_ns=1_250_000)
    change = without_roles(rig, rig_plan)
    assert change is not None
    assert change.roles == ("left.coil_temperature", "right.coil_temperature", "left.torque")
    assert change.overrides[0] == 'axis.left.role.coil_temperature.object="none"'
    assert plan(rig.variant(*change.overrides), period_ns=1_250_000).fits


def call(*words):
    return CliRunner().invoke(main, ["plan", *map(str, words)])


def test_the_verb_tells_the_roles_and_what_to_change():
    result = call("--period-us", 750)
    assert result.exit_code == 1
    assert "a period of 800 us fits:\n  --set bus.period_s=0.0008 --set bus.tpdo_window_s=0.000592\n" in result.output
    assert "this period fits without coil_temperature, torque:" in result.output
    assert "lost: the coil's temperature is not measured" in result.output
    assert "without the optional roles, too, this period does not fit" in call("--period-us", 500).output
    slow = call("--bitrate", 50_000).output
    assert "a period of 14792 us fits only with longer watches of SYNC and PDOs (motor and brake: sync_time" in slow
    document = json.loads(call("--period-us", 750, "--json").stdout)
    assert document["would_fit"]["period"]["set"] == ["bus.period_s=0.0008", "bus.tpdo_window_s=0.000592"]
    assert document["would_fit"]["without"]["roles"] == ["coil_temperature", "torque"]
    fits = json.loads(call("--json").stdout)
    assert (fits["would_fit"]["period"], fits["would_fit"]["without"]) == (None, None)
    row = next(row for row in fits["roles"] if row["role"] == "torque")
    assert row == {
        "role": "torque",
        "node": "motor",
        "object": "6077h:00",
        "pdo": "TPDO1",
        "bits": 16,
        "wire_us": 33.75,
        "saved_us": 20.0,
    }


def test_the_table_of_roles_is_right_at_80_columns():
    """Of a rig whose names are as long as they may be."""
    output = call("--rig", "two_axes").output
    table = output[output.index("role  ") : output.index("times in us")]
    assert max(map(len, table.splitlines())) <= 80
