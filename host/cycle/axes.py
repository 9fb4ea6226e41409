"""The axes of one bus as one host: the cycle's compiled functions over all their records.

Each axis is one AXIS record of the array `axes`, with its own phases, limits and law's parameters;
the functions of `host.cycle.step` know one axis only. They share the cycle: the first axis leads,
it sends SYNC and the host's heartbeat. A trip of one axis stops all (`Trip.OTHER_AXIS`): a hand
that holds one handle may hold the next.

`owner[identifier]` is the axis that a frame belongs to; the first one counts what belongs to
nobody.
"""

from __future__ import annotations

from coulombus.host.cycle import step
from coulombus.host.cycle.records import AxisRecords, Image, LawFunction, Phase, Trip
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
"""Whether the time is over in which the TPDOs of a cycle have to come."""


@kernel
def next_ns(axes: AxisRecords) -> int:
    """Return when `on_time` wants to be called."""
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
def on_frame(axes: AxisRecords, owner: Integers, t_ns: int, can_id: int, length: int, data: int) -> int:
    """Take a frame; return 1 when it completes an axis' TPDOs of this cycle, 2 when the control
    plane wants it, else 0.
    """
    k = owner[can_id] if can_id <= 0x7FF else 0
    return int(step.on_frame(axes[k], t_ns, can_id, length, data))


@kernel
def begin(axes: AxisRecords, t_ns: int, out: Queue) -> None:
    """Begin the cycle of all axes that is due at `t_ns`."""
    for k in range(axes.shape[0]):
        step.begin(axes[k], t_ns, out)


@kernel
def ask_to_stop(axes: AxisRecords, trip: int) -> None:
    """Ask all axes for the safe state for the reason `trip`, or without one (1).

    The first reason counts.
    """
    for k in range(axes.shape[0]):
        h = axes[k].host
        if h.stop < trip and h.stop <= 1:
            h.stop = trip


@kernel
def _couple(axes: AxisRecords) -> None:
    """Let all axes stop where one has tripped."""
    for k in range(axes.shape[0]):
        if axes[k].host.trip != Trip.NONE:
            for other in range(axes.shape[0]):
                h = axes[other].host
                if h.phase < Phase.SAFE and h.stop <= 1:
                    h.stop = Trip.OTHER_AXIS
            return


@kernel
def finish(axes: AxisRecords, law_function: LawFunction, t_ns: int, window_over: int, out: Queue) -> int:
    """Finish the cycle of the axes whose TPDOs have all come.

    When the window for them is over, of all that still wait.

    Returns how many axes still wait.
    """
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
def on_time(axes: AxisRecords, law_function: LawFunction, t_ns: int, out: Queue) -> None:
    """Do what is due at `t_ns`: the end of the window for TPDOs, or the next cycle, whose SYNC the
    first axis sends.
    """
    finish(axes, law_function, t_ns, WINDOW_OVER, out)
    first = axes[0]
    if t_ns >= first.host.sync_ns + first.control.period_ns or first.host.cycle == 0:
        begin(axes, t_ns, out)


@kernel
def ramps_a_brake(axes: AxisRecords) -> bool:
    """Tell whether a brake still has torque that only the host ramps off: its driver would hold it,
    or let go at once. Only our own driver ramps by itself.
    """
    for k in range(axes.shape[0]):
        h = axes[k].host
        if axes[k].control.brake_ramps == 0 and h.brake_Nm > 0.0 and Phase.OFF < h.phase < Phase.DISABLE:
            return True
    return False


@kernel
def safe_setpoints(axes: AxisRecords, t_ns: int, out: Queue) -> None:
    """Send the last set-points: drive disabled and without torque, the brake as it is, which its
    driver ramps off.

    A brake that is a CiA 402 drive is disabled, too. While the bus lives its torque has been ramped
    off before (`ramps_a_brake`).

    A SYNC follows, since RPDOs may act on the next SYNC only.
    """
    for k in range(axes.shape[0]):
        h = axes[k].host
        h.torque_Nm = 0.0
        h.image[Image.CONTROLWORD] = 0
        h.image[Image.BRAKE_CONTROLWORD] = 0
        step.send(axes[k], t_ns, out)
    push(out, step.SOURCE_HOST, t_ns, axes[0].control.sync_cob_id, 0, 0)
