"""Set-up of a simulated rig: power-on, bring-up over SDO and NMT start, as on a real rig; its cache for rigs that
differ only in plant and hand.

Power-on, bring-up over SDO and NMT start are much of a run's work, and in a sweep they are mostly
identical, frame by frame. A finished world is therefore kept, and restarts after its set-up with
the plant and the hand of the next run (`ready_world`, `return_world`); or another world of the same
devices continues from the end of the set-up (`set_up`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from coulombus.host.laws.plane.plane_laws import builtin_laws
from coulombus.host.setup.bringup import bring_up, meet, plans_of
from coulombus.host.setup.device_plan import DevicePlan
from coulombus.rigs.axis import NO_DEVICES, Axis, Sections
from coulombus.rigs.rig import Rig
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.sim_bus.network.world_state import WorldState, adopt, state_of

__all__ = ["clear_cache", "ready_world", "return_world", "set_up"]

CAPACITY = 6
"""Maximum cached set-ups: 1 to 2 MB each, and as much for an idle world."""


@dataclass
class _CachedSetup:
    key: tuple[Any, ...]
    state: WorldState
    plans: tuple[DevicePlan, ...]
    losses: tuple[str, ...]
    idle: list[VirtualRig] = field(default_factory=list)
    """At most one idle world: a thread that takes it owns it."""


_cache: list[_CachedSetup] = []
"""Cached set-ups, the newest first."""


def ready_world(rig: Rig, mode: str, seed: int) -> tuple[VirtualRig, tuple[str, ...]] | None:
    """Return an idle world after its set-up, with the plants and hands of `rig`, and the set-up's
    omissions; None if no world fits.

    The caller owns it until `return_world`.
    """
    needs = tuple(map(_needs, rig.axes))
    for entry in [entry for entry in _cache if entry.key == (mode, entry.key[1], needs, needs)]:
        try:
            world = entry.idle.pop()
        except IndexError:
            return None
        world.renew(rig, seed)
        return (world, entry.losses) if adopt(world, entry.state) else None
    return None


def return_world(world: VirtualRig) -> None:
    """Cache a finished world for `ready_world`, if host and plant share one rig and the law is built in."""
    if world.controllers.rig is world.rig and world.rig.law_function in builtin_laws(world.rig):
        needs = tuple(map(_needs, world.rig.axes))
        for entry in _cache:
            if entry.key == (world.mode, entry.key[1], needs, needs):
                entry.idle[:] = [world]


def set_up(world: VirtualRig, *, cached: bool = False) -> tuple[str, ...]:
    """Switch the nodes on and bring them up over SDO; return the omissions.

    With `cached` the world may continue from the end of an earlier set-up of such a rig, with the same bytes.
    """
    key = _key(world) if cached else None
    for entry in [entry for entry in _cache if entry.key == key]:
        if adopt(world, entry.state):
            meet(entry.plans, world.controllers)
            return entry.losses
    noise = world.plant["random"].tolist()
    world.boot()
    losses = bring_up(world.controllers, world)
    state = None if key is None else state_of(world, noise)
    if key is not None and state is not None and all(entry.key != key for entry in _cache):
        _cache.insert(0, _CachedSetup(key, state, plans_of(world.controllers), losses))
        del _cache[CAPACITY:]
    return losses


def clear_cache() -> None:
    """Clear the cache."""
    _cache.clear()


def _key(world: VirtualRig) -> tuple[Any, ...]:
    rigs, host = (world.rig, world.controllers.rig), world.controllers.axes.tobytes()  # a law's file may be edited
    return world.mode, host, *(tuple(map(_needs, rig.axes)) for rig in rigs)


def _needs(axis: Axis) -> tuple[Any, ...]:
    values = (getattr(axis, name) for name in Sections.model_fields if name not in NO_DEVICES)
    return axis.name, *(description.text for description in axis.descriptions), *values
