"""A drive that does not take the mode that its file offers: refused with the modes' names before the
power is switched on.
"""

from __future__ import annotations

import pytest

from coulombus.eds.cia301 import NmtState
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.errors import DeviceMismatch, SdoAborted
from coulombus.host.setup.bringup import bring_up, plans_of
from coulombus.host.setup.device_plan import NOT_SHOWN
from coulombus.node import drive402
from coulombus.rigs.rig import load_rig_text
from coulombus.sim_bus.network.virtual_rig import BOOT_NS, VirtualRig
from foreign_eds import BRAKE, MOTOR, another, edited, without
from places import RIGS

BENCH = (RIGS / "bench.toml").read_text(encoding="utf-8")
FOREIGN = without(another(MOTOR), "20")
OFFERS = edited(FOREIGN, "6502", DefaultValue="0x389")
"""Modes 1, 4, 8, 9 and 10."""


def world_of(motor=FOREIGN, *overrides, text=""):
    files = {"motor.eds": motor, "mr_brake.eds": BRAKE}
    rig = load_rig_text(BENCH + text, "r.toml", files, ("motor.vendor_id=0x99", *overrides))
    world = VirtualRig(rig, "hybrid")
    world.power_on()
    world.wait_ns(BOOT_NS)
    return world


def keeping(monkeypatch, world, mode, until_ns=1 << 62):
    """Let the drive show a mode of its own until a time, whatever it is told."""
    wait_ns = world.wait_ns

    def wait(duration_ns):
        wait_ns(duration_ns)
        world.motor[0x6061, 0] = mode if world.t_ns < until_ns else world.motor[0x6060, 0]

    world.motor[0x6061, 0] = mode
    monkeypatch.setattr(world, "wait_ns", wait)


def test_a_drive_that_keeps_its_mode_is_refused_with_both_names_and_the_remedy(monkeypatch):
    world = world_of(OFFERS)
    keeping(monkeypatch, world, 8)
    with pytest.raises(DeviceMismatch) as caught:
        bring_up(world.controllers, world)
    text = str(caught.value)
    assert "6061h shows mode 8 (cyclic synchronous position)" in text
    assert "10 (cyclic synchronous torque) was written" in text
    assert "6502h of the drive offers 1 (profile position), 4 (profile torque), 8 (cyclic" in text
    assert "(motor.mode)" in text
    assert f'host.accept = ["motor: {NOT_SHOWN}"]' in text
    assert world.motor.record["nmt"] == NmtState.PRE_OPERATIONAL


def test_a_drive_that_takes_its_time_is_waited_for(monkeypatch):
    world = world_of()
    keeping(monkeypatch, world, 8, until_ns=world.t_ns + 700_000_000)
    losses = bring_up(world.controllers, world)
    assert world.motor[0x6061, 0] == 10
    assert not any("6061h" in loss for loss in losses)


def test_a_drive_that_shows_no_mode_yet_is_told(monkeypatch):
    world = world_of()
    keeping(monkeypatch, world, 0)
    assert any("6061h shows no mode before the drive is enabled" in loss for loss in bring_up(world.controllers, world))


def test_a_wrong_display_is_acknowledged_by_name(monkeypatch):
    world = world_of(FOREIGN, f'host.accept=["motor: {NOT_SHOWN}"]')
    keeping(monkeypatch, world, 8)
    assert f"motor: {NOT_SHOWN} (host.accept)" in bring_up(world.controllers, world)


def test_a_drive_that_aborts_the_mode_is_refused_with_its_name(monkeypatch):
    world = world_of(OFFERS)
    monkeypatch.setattr(drive402, "_modes", lambda objects: 0x189)  # 1, 4, 8, 9
    with pytest.raises(
        SdoAborted, match=r"it refuses mode 10 \(cyclic synchronous torque\); 6502h .*4 \(profile torque\)"
    ):
        bring_up(world.controllers, world)


def test_6502h_of_the_live_drive_is_compared_before_anything_is_written():
    world = world_of(OFFERS)
    world.motor[0x6502, 0] = 0x1
    with pytest.raises(DeviceMismatch, match="6502h = 0x00000001 do not include cyclic synchronous torque"):
        bring_up(world.controllers, world)
    assert world.motor[0x1800, 1] >> 31 == 0


def test_a_drive_of_ours_is_not_asked():
    rig = load_rig_text(BENCH, "r.toml", {"motor.eds": MOTOR, "mr_brake.eds": BRAKE})
    assert not any(plan.shows_mode for plan in plans_of(Controllers(rig, "hybrid")))
