"""The cycle's compiled functions over all axes of one bus.

Each axis is one AXIS record of the array `axes`, with its own phase, limits and law parameters. The
functions of `host.cycle.step` work on one axis. All axes share the cycle: the first axis sends SYNC and
the host's heartbeat. A trip of one axis stops all (`Trip.OTHER_AXIS`), because the same person may hold
several handles.

`owner[identifier]` is the axis to which a frame belongs; frames of unknown identifiers go to the first
axis, which counts them.
"""

from __future__ import annotations

from coulombus.host.cycle import step
from coulombus.host.cycle.joints import finish_joints
from coulombus.host.cycle.records import AxisRecords, Image, LawFunction, Phase, Trip
from coulombus.host.plane.plane_step import PlaneFunctions
from coulombus.kernels.decorator import constant, kernel
from coulombus.kernels.records import Integers
from coulombus.wire.frame import Queue, push

__all__ = [
    "WINDOW_OPEN",
    "WINDOW_OVER",
    "ask_to_stop",
    "begin",
    "finish",
    "next_ns",
    "on_frame",
    "on_time",
    "phases",
    "ramps_a_brake",
    "safe_setpoints",
]

WINDOW_OPEN, WINDOW_OVER = constant(0), constant(1)
"""Whether the window for the TPDOs of a cycle is still open or over."""


@kernel
def next_ns(axes: AxisRecords) -> int:
    """Return the time at which `on_time` is due."""
    first: int = axes[0].host.next_ns
    for k in range(1, axes.shape[0]):
        first = min(first, axes[k].host.next_ns)
    return first


@kernel
def phases(axes: AxisRecords) -> int:
    """Return the phases of all axes as one number, four bits each."""
    phase_bits: int = axes[0].host.phase
    for k in range(1, axes.shape[0]):
        phase_bits |= axes[k].host.phase << (4 * k)
    return phase_bits


@kernel
def on_frame(axes: AxisRecords, owner: Integers, t_ns: int, can_id: int, length: int, word: int) -> int:
    """Handle a frame; return 1 if it completes an axis' TPDOs of this cycle, 2 if the control plane needs
    it, else 0.
    """
    k = owner[can_id] if can_id <= 0x7FF else 0
    return int(step.on_frame(axes[k], t_ns, can_id, length, word))


@kernel
def begin(axes: AxisRecords, t_ns: int, out: Queue) -> None:
    """Start the cycle of all axes due at `t_ns`."""
    for k in range(axes.shape[0]):
        step.begin(axes[k], t_ns, out)


@kernel
def ask_to_stop(axes: AxisRecords, trip: int) -> None:
    """Request the safe state of all axes with the reason `trip`, or without a reason (1).

    The first reason counts.
    """
    for k in range(axes.shape[0]):
        h = axes[k].host
        if h.stop < trip and h.stop <= 1:
            h.stop = trip


@kernel
def _couple(axes: AxisRecords) -> None:
    """Stop all axes if one has tripped."""
    for k in range(axes.shape[0]):
        if axes[k].host.trip != Trip.NONE:
            for other in range(axes.shape[0]):
                h = axes[other].host
                if h.phase < Phase.SAFE and h.stop <= 1:
                    h.stop = Trip.OTHER_AXIS
            return


@kernel
def finish(
    axes: AxisRecords,
    law_function: LawFunction,
    t_ns: int,
    window_over: int,
    out: Queue,
    arm: PlaneFunctions | None = None,
) -> int:
    """Finish the cycle of each axis whose TPDOs are complete, or of all waiting axes if the window is over.

    With `arm` the axes are the joints of one arm, which finish together. Return the number of axes that
    still wait.
    """
    if arm is not None:
        return int(finish_joints(axes, arm, t_ns, window_over, out))
    waiting = 0
    for k in range(axes.shape[0]):
        h = axes[k].host
        if h.waiting and (window_over or h.arrived & axes[k].control.awaited == axes[k].control.awaited):
            step.finish(axes[k], law_function, t_ns, out)
        waiting += h.waiting
    if axes.shape[0] > 1:
        _couple(axes)
    return waiting


@kernel
def on_time(
    axes: AxisRecords, law_function: LawFunction, t_ns: int, out: Queue, arm: PlaneFunctions | None = None
) -> None:
    """Do what is due at `t_ns`: end the window for TPDOs, or start the next cycle."""
    finish(axes, law_function, t_ns, WINDOW_OVER, out, arm)
    first = axes[0]
    if t_ns >= first.host.sync_ns + first.control.period_ns or first.host.cycle == 0:
        begin(axes, t_ns, out)


@kernel
def ramps_a_brake(axes: AxisRecords) -> bool:
    """Return whether a brake still has torque that only the host can ramp off.

    A third-party driver would hold the torque or drop it at once. Only this project's driver ramps it
    off by itself.
    """
    for k in range(axes.shape[0]):
        h = axes[k].host
        if axes[k].control.brake_ramps == 0 and h.brake_Nm > 0.0 and Phase.OFF < h.phase < Phase.DISABLE:
            return True
    return False


@kernel
def safe_setpoints(axes: AxisRecords, t_ns: int, out: Queue) -> None:
    """Send the last set-points: drive disabled and without torque, brake unchanged.

    The brake's driver ramps the brake off. A brake that is a CiA 402 drive is disabled, too. While the bus
    works, the host has ramped its torque off before (`ramps_a_brake`).

    A SYNC follows, because RPDOs may act on the next SYNC only.
    """
    for k in range(axes.shape[0]):
        h = axes[k].host
        h.torque_Nm = 0.0
        h.image[Image.CONTROLWORD] = 0
        h.image[Image.BRAKE_CONTROLWORD] = 0
        step.send(axes[k], t_ns, out)
    push(out, step.SOURCE_HOST, t_ns, axes[0].control.sync_cob_id, 0, 0)
