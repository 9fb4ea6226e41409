"""Cached state of a world after its set-up, for reuse in another world.

The frames of bring-up do not depend on plant and hand. So of two worlds that differ only in these,
the second can continue from the end of the first one's set-up: the bytes are the same as after its
own set-up (`tests/lab/test_set_up.py`).

The plants are not reused. They are advanced through the set-up's time, without commands. If the
result depends on the number of pieces, `adopt` refuses: a set-up advances in hundreds of pieces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.kernels.records import Records, copied, overwrite
from coulombus.node.device import DeviceState
from coulombus.sim_bus.network.event_loop import Exit
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.sim_bus.rig.plant import NOISE_FACTOR, NOISE_MASK, NOISE_SUMMAND
from coulombus.wire.clock import NEVER_NS

__all__ = ["WorldState", "adopt", "state_of"]

ARRAYS = ("bus", "nodes", "deadlines", "wants", "listening")
"""Fields of `sim_bus.network.event_loop.World` that belong to bus and nodes alone."""
RECORDS = ("state", "out")
SEEN = ("temperature", "coil", "motor", "coil_fault")
MOST_DRAWS = 100_000
PIECES = (1, 2, 13)
"""Numbers of pieces in which the plants are advanced for comparison: the state must be the same."""


@dataclass(frozen=True)
class WorldState:
    """State of a world, without its plants, at an instant."""

    t_ns: int
    arrays: tuple[Any, ...]
    records: tuple[Any, ...]
    log: Records
    host: Records
    seen: tuple[tuple[float, ...], ...]
    """Quantities of each plant that the devices measure and act on by themselves: `SEEN`."""
    draws: tuple[tuple[int, int], ...]
    """For each plant: factor and summand from its noise's first state to the present state."""
    devices: tuple[DeviceState, ...]
    exits: dict[Exit, int]


def state_of(world: VirtualRig, noise: Sequence[int]) -> WorldState | None:
    """Return a world's state; None if the world has more state than that: faults, a script, stations,
    delivered frames, an object that shows the plant by itself, an open transfer.

    `noise` has the initial value of `random` of each plant.
    """
    parts = world.arguments[0]
    w, nodes = parts.state, parts.nodes
    simple = (
        world.plain
        and not parts.axes["foreign"].any()
        and (parts.axes["operator_start_ns"] < 0).all()
        and not parts.axes["truth_on"].any()
        and not nodes["tpdo_events"].any()
        and not nodes["latched"].any()
        and (nodes["sdo_deadline_ns"] == NEVER_NS).all()
        and int(parts.out.count) == 0
        and not (w.tells or w.keep_sent or w.host_on or w.sent_count)
        and w.t_ns < parts.axes["force_end_ns"].min()
        and world.exits[Exit.LOG] == 0
    )
    draws = [_drawn(*pair) for pair in zip(noise, parts.plant["random"].tolist(), strict=True)]
    exact_draws = tuple(draw for draw in draws if draw is not None)
    if not simple or len(exact_draws) < len(draws):
        return None
    return WorldState(
        t_ns=world.t_ns,
        arrays=tuple(copied(getattr(parts, name)) for name in ARRAYS),
        records=tuple(getattr(parts, name).copy() for name in RECORDS),
        log=copied(parts.log[: int(w.log_count)]),
        host=copied(world.controllers.axes),
        seen=_seen(parts.plant),
        draws=exact_draws,
        devices=tuple(device.state() for device in world.devices),
        exits=dict(world.exits),
    )


def adopt(world: VirtualRig, state: WorldState) -> bool:
    """Restore `state` into a fresh world. False (and no change) if it does not fit."""
    parts, _, _, course, _ = world.arguments
    if JIT_DISABLED or not (world.plain and world.t_ns == 0 and (state.t_ns < parts.axes["force_end_ns"]).all()):
        return False
    advanced = (_advanced(parts, course, a, state.t_ns) for a in range(len(parts.axes)))
    plants = [plant for plant in advanced if plant is not None]
    if len(plants) < len(parts.axes) or _seen(np.concatenate(plants)) != state.seen:
        return False
    for plant, (factor, summand) in zip(plants, state.draws, strict=True):
        plant["random"] = (int(plant["random"][0]) * factor + summand) & NOISE_MASK
    for name, array in zip(ARRAYS, state.arrays, strict=True):
        overwrite(getattr(parts, name), array)
    for name, record in zip(RECORDS, state.records, strict=True):
        target = getattr(parts, name)
        for field in record.dtype.names:
            target[field] = record[field]
    overwrite(parts.log[: len(state.log)], state.log)
    for a, plant in enumerate(plants):
        overwrite(parts.plant[a : a + 1], plant)
    overwrite(world.controllers.axes, state.host)
    for device, device_state in zip(world.devices, state.devices, strict=True):
        device.adopt(device_state)
    world.exits.update(state.exits)
    return True


def _drawn(first: int, present: int) -> tuple[int, int] | None:
    """Return the factor and the summand that lead from `first` to `present` in the generator, an affine map
    (`sim_bus.rig.plant.sample_noise`); None if the number of draws is too large.
    """
    factor, summand = 1, 0
    for _ in range(MOST_DRAWS):
        if (first * factor + summand) & NOISE_MASK == present:
            return factor, summand
        factor = factor * NOISE_FACTOR & NOISE_MASK
        summand = (summand * NOISE_FACTOR + NOISE_SUMMAND) & NOISE_MASK
    return None


def _seen(plants: Records) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(plant[name]) for name in SEEN) for plant in plants.view(np.ndarray))


def _advanced(parts: Any, course: Any, a: int, t_ns: int) -> Records | None:
    """Return the plant of axis `a` at `t_ns`; None if it depends on the pieces of the way there, or on another axis."""
    if parts.plant["plane"]["on"].any():
        return None
    results = []
    axis, f_h, truth = parts.axes[a], parts.f_h[a : a + 1], parts.truth[a : a + 1]
    per_knot = int(axis["steps_per_knot"])
    for pieces in PIECES:
        plant = copied(parts.plant[a : a + 1])
        p = plant[0]
        now_ns, step_ns = int(p["t_ns"]), int(p["step_ns"])
        for piece in range(1, pieces + 1):
            steps = (t_ns * piece // pieces - now_ns) // step_ns
            course(plant, 0, f_h, per_knot, now_ns // step_ns, steps, truth, -1)
            now_ns += steps * step_ns
        results.append(plant)
    return results[0] if len({plant.tobytes() for plant in results}) == 1 else None
