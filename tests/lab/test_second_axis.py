"""A rig on the second axis of a dual drive: drafted, checked, armed and run with the objects and the
PDOs of that axis; the first one stays as it was.
"""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.eds.reader import parse_eds
from coulombus.host.cycle.controller import Controller
from coulombus.host.errors import DeviceMismatch
from coulombus.host.setup.bringup import bring_up
from coulombus.host.setup.device_plan import device_plans
from coulombus.lab.simulate import simulate
from coulombus.rigs.draft.discover import DeviceChoice, gather
from coulombus.rigs.draft.draft import Draft
from coulombus.rigs.errors import RigError
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.network.event_loop import MOTOR
from coulombus.sim_bus.network.virtual_rig import BOOT_NS, VirtualRig
from foreign_eds import MOTOR as MOTOR_EDS
from foreign_eds import another, dual, edited, geared, without
from foreign_rigs import QUICK

SINGLE = without(geared(another(MOTOR_EDS)), "20")
DUAL = dual(SINGLE)
"""Both axes count 360 in a turn of their motors."""


@pytest.fixture
def drafted(tmp_path, monkeypatch):
    """Draft a rehearsal of a drive's axis in a folder of its own."""
    monkeypatch.chdir(tmp_path)

    def make(text, axis=2):
        (tmp_path / "drive.eds").write_text(text, encoding="utf-8")
        choices = (DeviceChoice("motor", "drive.eds", axis=axis), DeviceChoice("brake", "bench"))
        return Draft(gather(choices, tmp_path), load_rig("bench").one_axis(), "my.toml", rehearse=True)

    return make


def motor_plan(rig, mode="hybrid"):
    return device_plans(Controller(rig.one_axis(), mode))[0]


def armed(rig):
    """Return a world whose devices are brought up."""
    world = VirtualRig(rig.variant(*QUICK), "hybrid")
    world.power_on()
    world.wait_ns(BOOT_NS)
    bring_up(world.controllers, world)
    return world


def test_every_role_is_an_object_of_the_second_axis(drafted):
    axis = drafted(DUAL).rig.one_axis()
    places = {row.kind.name: row.entry.index for row in axis.allocation.bound.bindings if row.node == "motor"}
    words = {"controlword": 0x6840, "statusword": 0x6841}
    assert places == words | {"torque_setpoint": 0x6871, "position": 0x6864, "torque": 0x6877}
    assert axis.motor.drive_axis == 2
    assert axis.motor.encoder_counts_rev == 360


def test_bring_up_sets_the_second_axis_and_leaves_the_first_alone(drafted):
    plan = motor_plan(drafted(DUAL).rig)
    written = {row.index for row in plan.writes if 0x6000 <= row.index < 0xA000}
    assert {0x6860, 0x6871, 0x6872, 0x6807, 0x685A, 0x685E} <= written
    assert all(index >= 0x6800 for index in written)
    assert plan.problems == ()
    assert plan.position.drive_axis == 2


def test_its_own_pdos_take_the_identifiers_that_the_first_axis_gives_up(drafted):
    rig = drafted(DUAL).rig
    axis, writes = rig.one_axis(), motor_plan(rig).writes
    pdos = {(pdo.layout.direction, pdo.layout.number): pdo.layout.cob_id for pdo in axis.pdos() if pdo.node == "motor"}
    assert pdos == {("rpdo", 65): 0x201, ("tpdo", 65): 0x181}
    assert {(row.index, row.subindex): row.value for row in writes}[0x1800, 1] >> 31 == 1
    first_off = next(k for k, row in enumerate(writes) if row.index == 0x1800)
    assert all(row.index != 0x1840 for row in writes[:first_off])


@pytest.mark.parametrize(("pdos", "number"), [(0, 1), (8, 9), (0x40, 65)])
def test_the_makers_pdo_numbers_are_read_from_the_default_maps(drafted, pdos, number):
    axis = drafted(dual(SINGLE, pdos)).rig.one_axis()
    assert {pdo.layout.number for pdo in axis.pdos() if pdo.node == "motor"} == {number}


def test_an_identifier_of_the_file_is_taken_for_a_further_pdo(drafted):
    text = edited(edited(DUAL, "1440sub1", DefaultValue="0x80000333"), "1840sub1", DefaultValue="$NODEID+0x80000290")
    axis = drafted(text).rig.one_axis()
    assert {pdo.layout.cob_id for pdo in axis.pdos() if pdo.node == "motor"} == {0x333, 0x291}


def test_no_identifier_is_taken_from_a_pdo_that_keeps_it(drafted):
    text = edited(DUAL, "1800sub1", AccessType="ro")
    axis = drafted(text).rig.one_axis()
    tpdos = [pdo.layout for pdo in axis.pdos() if pdo.node == "motor" and pdo.layout.direction == "tpdo"]
    assert [(layout.number, layout.cob_id) for layout in tpdos] == [(66, 0x281)]


def test_where_every_pdo_keeps_its_identifier_the_axis_is_refused_with_the_reason(drafted):
    text = DUAL
    for number in range(4):
        text = edited(text, f"{0x1800 + number:04X}sub1", AccessType="ro")
        text = without(text, f"{0x1A40 + number:04X}")
        text = edited(text, f"{0x1A00 + number:04X}sub0", AccessType="ro")
    with pytest.raises(RigError) as caught:
        drafted(text)
    assert "6841h:0 finds no place in a TPDO" in str(caught.value)


def test_the_live_device_has_its_mode_and_its_limit_on_the_second_axis(drafted):
    rig = drafted(DUAL).rig
    device = armed(rig).motor
    assert device[0x6861, 0] == 10
    assert device[0x6872, 0] == Controller(rig.one_axis(), "hybrid").drive_limit_pm()
    as_delivered = parse_eds(DUAL.encode(), "x")
    for index in (0x6060, 0x6072, 0x605A):
        assert device[index, 0] == as_delivered.variable(index, 0).default


def test_the_second_axis_displays_and_its_fault_trips_the_host(drafted, tmp_path):
    seen = {}

    def fault(world):
        if world.enabled_ns is None or world.t_ns < world.enabled_ns + 150_000_000:
            world.at(world.t_ns + 1_000_000, fault)
            return
        seen["operation enabled"] = world.motor[0x6841, 0] & 0x6F, world.motor[0x6041, 0] & 0x6F
        world.nodes[MOTOR].in_supply_ok = 0
        world.nodes[MOTOR].next_ns = world.t_ns
        world.at(world.t_ns + 2_000_000, lambda w: seen.update(code=(w.motor[0x683F, 0], w.motor[0x603F, 0])))

    made = drafted(DUAL)
    (tmp_path / "my.toml").write_text(str(made), encoding="utf-8")
    result = simulate("my.toml", "hybrid", 0.4, overrides=QUICK, script=lambda world: world.at(1_000_000, fault))
    assert seen["operation enabled"] == (0x27, 0)
    assert seen["code"][0] & 0xF000 == 0x3000  # CiA 402-2: voltage
    assert seen["code"][1] == 0
    assert result.trip.startswith(("EMCY_MOTOR", "VOLTAGE", "DRIVE_STATE"))
    assert result.cycles > 20


def test_a_scale_of_the_second_axis_is_held_against_the_rig_file_by_its_own_objects(drafted):
    rig = drafted(dual(without(another(MOTOR_EDS), "20")) + "\n" + geared("")).rig
    wrong = rig.variant("motor.encoder_counts_rev=360", "plant.encoder_counts_rev=360")
    with pytest.raises(DeviceMismatch, match=r"6864h counts 8192 .*688Fh = 8192/1.*the rig file says 360"):
        armed(wrong)


def test_an_axis_that_the_drive_does_not_have_is_refused(drafted):
    with pytest.raises(RigError, match="has no object of axis 2, from 6800h on"):
        drafted(SINGLE)
    with pytest.raises(RigError, match="has no object of axis 3, from 7000h on"):
        drafted(DUAL, 3)


def test_check_names_the_limit_of_the_second_axis(drafted, tmp_path):
    arguments = ("init", "--drive", "drive.eds", "--axis", "2", "--brake", "bench", "-o", "two.toml")
    (tmp_path / "drive.eds").write_text(DUAL, encoding="utf-8")
    made = CliRunner().invoke(main, arguments)
    assert made.exit_code == 0, made.output
    result = CliRunner().invoke(main, ("check", "--rig", "two.toml"))
    assert result.exit_code in (0, 3), result.output
    assert "drive torque limit 6872h" in result.stdout
    assert "6072h" not in result.stdout
