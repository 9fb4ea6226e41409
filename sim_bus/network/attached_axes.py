"""Mechanics of a network's devices, as the arrays of its loop: those of a rig, or the loads of single drives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coulombus.host.cycle.controllers import unused_law
from coulombus.host.cycle.records import AxisRecord, LawFunction, PlaneFunctions
from coulombus.kernels.records import Floats, Integers, RecordArray, new_records, overwrite
from coulombus.sim_bus.network.deadline_tree import IDENTIFIERS
from coulombus.sim_bus.network.event_loop import TOLD_FRAMES, HostCycle, World
from coulombus.sim_bus.rig.plant import TRUTH_COLUMNS
from coulombus.sim_bus.rig.records import NO_HAND, PlantRecord, RigAxis
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import Frame

__all__ = ["AttachedAxes", "with_load", "without_mechanics"]


@dataclass(frozen=True)
class AttachedAxes:
    """Mechanics connected to a network's devices: its axes with their plants and force blocks, and the host, as
    the kernel's arrays.

    Their types are the same without an axis and without a host, so that one compiled kernel serves
    every network.
    """

    axes: RecordArray[RigAxis]
    axis_of: Integers
    plant: RecordArray[PlantRecord]
    f_h: Floats
    truth: Floats
    host: HostCycle
    law_function: LawFunction
    arm: PlaneFunctions | None = None


def without_mechanics(devices: int) -> AttachedAxes:
    """Return no axis and no host."""
    return AttachedAxes(
        axes=new_records(RigAxis, 0),
        axis_of=np.full(devices, -1, np.int64),
        plant=new_records(PlantRecord, 0),
        f_h=np.zeros((0, 1)),
        truth=np.zeros((0, 1, len(TRUTH_COLUMNS))),
        host=HostCycle(
            axes=new_records(AxisRecord, 1), owner=np.zeros(IDENTIFIERS, np.int64), told=new_records(Frame, TOLD_FRAMES)
        ),
        law_function=unused_law(),
    )


def with_load(world: World, row: int, plant: RecordArray[PlantRecord]) -> World:
    """Return the world with a further axis, from now on: the device in `row` drives `plant`, which nobody holds."""
    n = len(world.axes)
    axes, plants = new_records(RigAxis, n + 1), new_records(PlantRecord, n + 1)
    overwrite(axes[:n], world.axes)
    overwrite(plants[:n], world.plant)
    overwrite(plants[n:], plant)
    axis, load = axes[n], plants[n]
    axis["motor"] = axis["brake"] = row  # a drive has no brake's output: it stays 0
    axis["operator_start_ns"], axis["force_end_ns"], axis["steps_per_knot"] = NO_HAND, NEVER_NS, NEVER_NS
    load["t_ns"] = int(world.state["t_ns"]) // int(load["step_ns"]) * int(load["step_ns"])
    world.axis_of[row] = n
    world.nodes[row]["load_counts_s2"] = load["motor_Nm_pm"] / load["inertia"] * load["counts_rad"]
    truth = np.zeros((n + 1, 1, len(TRUTH_COLUMNS)))
    return world._replace(axes=axes, plant=plants, f_h=np.zeros((n + 1, 2)), truth=truth)
