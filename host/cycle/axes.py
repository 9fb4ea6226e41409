"""The axes of one bus as one host: the cycle's compiled functions over all their records.

Each axis has its own row of the arrays, its own phases, limits and law's parameters; the functions of `host.cycle.step` know one axis only.
They share the cycle: the first axis leads, it sends SYNC and the host's heartbeat. A trip of one axis stops all
(`Trip.OTHER_AXIS`): a hand that holds one handle may hold the next.

`owner[identifier]` is the axis that a frame belongs to; the first one counts what belongs to nobody.
"""

from __future__ import annotations

from typing import Any

from coulombus.compiled.decorator import inlined, kernel
from coulombus.eds.codec import pack
from coulombus.host.cycle import step
from coulombus.host.cycle.records import Image, Phase, Trip
from coulombus.wire.frame import push

__all__ = ["begin", "finish_complete", "finish_waiting", "next_ns", "on_frame", "on_time", "phases", "safe_setpoints"]

SAFE = int(Phase.SAFE)
CONTROLWORD, TARGET_TORQUE = int(Image.CONTROLWORD), int(Image.TARGET_TORQUE)
BRAKE_SETPOINT = int(Image.BRAKE_SETPOINT)
NONE, OTHER_AXIS = int(Trip.NONE), int(Trip.OTHER_AXIS)


@inlined
def next_ns(host: Any) -> int:
    """Return when `on_time` wants to be called."""
    first: int = host[0].next_ns
    for k in range(1, host.shape[0]):
        first = min(first, host[k].next_ns)
    return first


@inlined
def phases(host: Any) -> int:
    """Return the phases of all axes as one number, four bits each."""
    found: int = host[0].phase
    for k in range(1, host.shape[0]):
        found |= host[k].phase << (4 * k)
    return found


@inlined
def on_frame(control: Any, host: Any, tpdos: Any, owner: Any, t_ns: int, can_id: int, length: int, data: int) -> int:
    """Take a frame; return 1 when it completes an axis' TPDOs of this cycle, 2 when the control plane wants it, else 0."""
    k = owner[can_id] if can_id <= 0x7FF else 0
    return int(step.on_frame(control[k], host[k], tpdos[k], t_ns, can_id, length, data))


@inlined
def begin(control: Any, host: Any, t_ns: int, out: Any) -> None:
    """Begin the cycle of all axes that is due at `t_ns`."""
    for k in range(host.shape[0]):
        step.begin(control[k], host[k], t_ns, out)


@kernel
def _couple(host: Any) -> None:
    """Let all axes stop where one has tripped."""
    for k in range(host.shape[0]):
        if host[k].trip != NONE:
            for other in range(host.shape[0]):
                if host[other].phase < SAFE and host[other].stop <= 1:
                    host[other].stop = OTHER_AXIS
            return


@inlined
def _finish(
    control: Any,
    host: Any,
    rpdos: Any,
    law_function: Any,
    motion: Any,
    law: Any,
    state: Any,
    t_ns: int,
    out: Any,
    incomplete: int,
) -> None:
    for k in range(host.shape[0]):
        c, h = control[k], host[k]
        if h.waiting and (incomplete or h.arrived == (1 << c.tpdos) - 1):
            step.finish(c, h, rpdos[k], law_function, motion[k], law[k], state[k], t_ns, out)
    if host.shape[0] > 1:
        _couple(host)


@inlined
def finish_complete(
    control: Any,
    host: Any,
    rpdos: Any,
    law_function: Any,
    motion: Any,
    law: Any,
    state: Any,
    t_ns: int,
    out: Any,
) -> int:
    """Finish the cycle of the axes whose TPDOs have all come; return how many axes still wait."""
    _finish(control, host, rpdos, law_function, motion, law, state, t_ns, out, 0)
    waiting = 0
    for k in range(host.shape[0]):
        waiting += host[k].waiting
    return waiting


@inlined
def finish_waiting(
    control: Any,
    host: Any,
    rpdos: Any,
    law_function: Any,
    motion: Any,
    law: Any,
    state: Any,
    t_ns: int,
    out: Any,
) -> None:
    """Finish the cycle of the axes that still wait: the window for their TPDOs is over."""
    _finish(control, host, rpdos, law_function, motion, law, state, t_ns, out, 1)


@inlined
def on_time(
    control: Any,
    host: Any,
    rpdos: Any,
    law_function: Any,
    motion: Any,
    law: Any,
    state: Any,
    t_ns: int,
    out: Any,
) -> None:
    """Do what is due at `t_ns`: the end of the window for TPDOs, or the next cycle, whose SYNC the first axis sends."""
    finish_waiting(control, host, rpdos, law_function, motion, law, state, t_ns, out)
    if t_ns >= host[0].sync_ns + control[0].period_ns or host[0].cycle == 0:
        begin(control, host, t_ns, out)


@kernel
def safe_setpoints(control: Any, host: Any, rpdos: Any, t_ns: int, out: Any) -> None:
    """Send the last set-points: drive disabled and without torque, the brake no stronger than the safe state's, which its driver ramps off.

    A SYNC follows, since RPDOs may act on the next SYNC only.
    """
    for k in range(host.shape[0]):
        c, h = control[k], host[k]
        h.motor_Nm = 0.0
        h.brake_Nm = min(h.brake_Nm, c.safe_brake_Nm)
        h.image[CONTROLWORD] = 0
        h.image[TARGET_TORQUE] = 0
        h.image[BRAKE_SETPOINT] = min(max(round(h.brake_Nm / c.brake_Nm_raw), 0), c.brake_limit_raw)
        for i in range(c.rpdos):
            pdo = rpdos[k, i]
            push(out, step.SOURCE_HOST, t_ns, pdo.cob_id, pdo.length, pack(pdo, h.image))
    push(out, step.SOURCE_HOST, t_ns, control[0].sync_cob_id, 0, 0)
