"""Bring-up of the rig in virtual time, as on a real rig."""

from __future__ import annotations

from coulombus.host.setup.bringup import bring_up
from coulombus.sim_bus.network.virtual_rig import VirtualRig

__all__ = ["switch_on"]


def switch_on(world: VirtualRig) -> tuple[str, ...]:
    """Switch the nodes of `world` on and bring them up over SDO, as `host.setup.bringup` does on a
    rig; return the omissions.
    """
    world.boot()
    return bring_up(world.controllers, world)
