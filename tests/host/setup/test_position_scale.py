"""The drive's own scale of its position: held against the rig file's before anything moves."""

from __future__ import annotations

import math

import pytest

from coulombus.eds.cia301 import NmtState
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.errors import DeviceMismatch
from coulombus.host.setup.bringup import bring_up, plans_of
from coulombus.rigs.rig import load_rig_text
from coulombus.sim_bus.network.virtual_rig import BOOT_NS, VirtualRig
from foreign_eds import BRAKE, I32, MOTOR, U8, another, edited, geared, with_variable, without
from places import RIGS

BENCH = (RIGS / "bench.toml").read_text(encoding="utf-8")
FOREIGN = ("motor.vendor_id=0x99",)
GEARED = geared(without(another(MOTOR), "20"))
RATIO = 9.587


def rig_of(motor, *overrides, text=""):
    return load_rig_text(BENCH + text, "r.toml", {"motor.eds": motor, "mr_brake.eds": BRAKE}, (*FOREIGN, *overrides))


def counting(counts_rev):
    return f"motor.encoder_counts_rev={counts_rev}", f"plant.encoder_counts_rev={counts_rev}"


def brought_up(rig):
    """Return the world after bring-up, and what bring-up has left out."""
    world = VirtualRig(rig, "hybrid")
    world.power_on()
    world.wait_ns(BOOT_NS)
    return world, bring_up(world.controllers, world)


def plan_of(motor, *overrides):
    return plans_of(Controllers(rig_of(motor, *overrides), "hybrid"))[0]


@pytest.mark.parametrize("counts_rev", [359, 361, 8192])
def test_a_drive_that_counts_otherwise_than_the_rig_file_is_not_started(counts_rev):
    world = VirtualRig(rig_of(GEARED, *counting(counts_rev)), "hybrid")
    world.power_on()
    world.wait_ns(BOOT_NS)
    with pytest.raises(DeviceMismatch) as caught:
        bring_up(world.controllers, world)
    text = f"6064h counts 360 in one turn of the motor (6092h = 3600/1, 6091h = 10:1), the rig file says {counts_rev}"
    assert text in str(caught.value)
    assert caught.value.exit_status == 3
    assert world.motor.record["nmt"] == NmtState.PRE_OPERATIONAL
    assert float(world.plant[0]["motor_pm"]) == 0.0


def test_a_drive_that_counts_as_the_rig_file_says_is_started():
    world, losses = brought_up(rig_of(GEARED, *counting(360)))
    assert world.motor.record["nmt"] == NmtState.OPERATIONAL
    assert not any("scale" in loss for loss in losses)


def test_what_bring_up_writes_to_the_drive_is_its_scale():
    row = '\n[[motor.sdo]]\nindex = 0x6092\nsub = 1\ntype = "UNSIGNED32"\nvalue = 81920\n'
    world, _ = brought_up(rig_of(GEARED, text=row))
    assert world.motor[0x6092, 1] == 81920
    assert float(world.plant[0]["counts_rad"]) == pytest.approx(8192 * RATIO / (2 * math.pi))


@pytest.mark.parametrize(("place", "counts_rev"), [("6064", 360), ("6063", 8192)])
def test_a_scale_that_a_role_gives_is_held_against_the_drive_too(place, counts_rev):
    eds = with_variable(GEARED, "6063", I32, 0, "ro")
    for factor, fits in ((1.0, True), (1.01, False)):
        scale = factor * 2 * math.pi / (counts_rev * RATIO)
        rig = rig_of(eds, text=f'\n[role.position]\nobject = "{place}"\nscale_rad = {scale}\n')
        if fits:
            brought_up(rig)
            continue
        with pytest.raises(DeviceMismatch, match=r"role\.position\.scale_rad"):
            brought_up(rig)


def test_a_scale_that_the_rig_file_vouches_for_is_not_compared():
    _, losses = brought_up(rig_of(GEARED, 'host.accept=["motor: position scale is the rig file\'s"]'))
    assert any("no object of the drive is held against it" in loss for loss in losses)


def test_an_encoder_on_another_device_or_object_is_not_compared():
    eds = with_variable(GEARED, "2042", I32, 0, "ro")
    rig = rig_of(eds, text='\n[role.position]\nobject = "2042"\nscale_rad = 0.001\n')
    assert plans_of(Controllers(rig, "hybrid"))[0].position is None


def test_check_says_what_the_file_leaves_open_and_what_nothing_guards():
    assert any("counts 360" in text and "says 8192" in text for text in plan_of(GEARED).questions)
    untold = edited(another(MOTOR), "608Fsub1", DefaultValue="")
    assert any("does not tell the scale" in text for text in plan_of(untold).questions)
    unguarded = "nothing guards motor.encoder_counts_rev"
    assert any(unguarded in text for text in plan_of(without(another(MOTOR), "608F")).losses)
    assert not any("scale" in text for text in (*plan_of(another(MOTOR)).questions, *plan_of(another(MOTOR)).losses))


@pytest.mark.parametrize("stored", ["0xC0", "0x40"])
def test_the_polarity_is_written_where_the_drive_has_another_one_only(stored):
    motor = with_variable(another(MOTOR), "607E", U8, stored, "rw")
    row = '\n[[motor.sdo]]\nindex = 0x607E\nsub = 0\ntype = "UNSIGNED8"\nvalue = 0xC0\n'
    rig = rig_of(motor, text=row)
    (setting,) = (write for write in plans_of(Controllers(rig, "hybrid"))[0].writes if write.index == 0x607E)
    assert setting.unless_equal
    world, _ = brought_up(rig)
    assert world.motor[0x607E, 0] == 0xC0
