"""The virtual-time event loop: bus, nodes, plant and host as functions of time, in one compiled kernel.

`run` goes from event to event in integer nanoseconds and returns to Python only when the control plane has work, as a virtual
machine exits to its monitor (`Exit`). Events at the same instant go in a fixed order: a frame's end first (so what arrives is handled
before a deadline is judged), then the script, the nodes, the host, and at last the start of the next frame (so that everything that is ready
takes part in the arbitration).
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np

from eds.cia402 import PowerState
from eds.compiled import borrowed, inlined, kernel
from host import step
from node import core
from sim_bus.arbiter import FAR_NS, end_frame, start_frame, start_ns
from sim_bus.plant import advance, sample_noise

__all__ = ["BRAKE", "MOTOR", "WORLD", "Exit", "next_event", "run"]

MOTOR, BRAKE = 0, 1
"""Rows of the node records, and their station numbers."""

OPERATION_ENABLED = int(PowerState.OPERATION_ENABLED)
SYNC = 0x80


class Exit(IntEnum):
    """Why the kernel returned."""

    UNTIL = 0  # the time was reached
    FORCE = 1  # the plant needs the next block of the operator's force
    LOG = 2  # the frame log is full
    SERVICE = 3  # the last frame of the log is for Python: `service` tells who wants it
    ENABLED = 4  # the drive entered Operation Enabled: the schedule begins
    PHASE = 5  # the host went to another phase
    SCRIPT = 6  # a script's entry is due


EXIT_UNTIL, EXIT_FORCE, EXIT_LOG = int(Exit.UNTIL), int(Exit.FORCE), int(Exit.LOG)
EXIT_SERVICE, EXIT_ENABLED, EXIT_PHASE, EXIT_SCRIPT = (
    int(Exit.SERVICE),
    int(Exit.ENABLED),
    int(Exit.PHASE),
    int(Exit.SCRIPT),
)

WORLD = np.dtype(
    [
        ("t_ns", np.int64),
        ("until_ns", np.int64),
        ("script_ns", np.int64),
        ("host_on", np.int64),  # 1: the host's cycle runs
        ("host_elsewhere", np.int64),  # 1: the host is another process; here nobody looks at what it would want
        ("phase", np.int64),  # the host's phase that Python knows
        ("operator_start_ns", np.int64),  # -1: the schedule has not begun
        ("log_count", np.int64),
        ("service", np.int64),  # bit i: node i wants the last frame; bit 62: the control plane does
        ("force_step", np.int64),  # the plant's step at which the force block begins
        ("force_end_ns", np.int64),  # the time at which it ends
        ("torque_pm", np.float64),  # what motor and brake are held at since the plant was last advanced
        ("brake_Nm", np.float64),
        ("steps_per_knot", np.int64),
        ("truth_on", np.int64),
    ],
    align=True,
)

CONTROL_PLANE = 1 << 62


@inlined
def _sample(plant: Any, motor: Any, brake: Any) -> None:
    """Let the devices look at the rig: encoder, motor current, transducer, coil."""
    p = plant[0]
    motor.in_position_counts = int(np.floor(p.x * p.counts_rad + 0.5))
    motor.in_velocity_counts_s = p.v * p.counts_rad
    motor.in_torque_pm = p.motor / p.motor_Nm_pm
    brake.in_handle_Nm = p.transducer_polarity * (p.f_operator + p.noise * sample_noise(p))
    brake.in_coil_A = p.coil * p.coil_A_Nm
    brake.in_coil_degC = p.temperature


@inlined
def _advance(w: Any, plant: Any, f_h: Any, truth: Any, t_ns: int) -> None:
    """Bring the plant to the last grid point at or before `t_ns` (within the force block) under the held commands."""
    p = plant[0]
    steps = (t_ns - p.t_ns) // p.step_ns
    if steps > 0:
        first = p.t_ns // p.step_ns - w.force_step
        row = first if w.truth_on else -1
        advance(p, w.torque_pm, w.brake_Nm, f_h, w.steps_per_knot, first, steps, truth, row)


@inlined
def _actuate(w: Any, plant: Any, nodes: Any, f_h: Any, truth: Any, t_ns: int) -> None:
    """Let the plant feel what the devices command from `t_ns` on, when that has changed."""
    torque, brake = nodes[MOTOR].out_torque_pm, nodes[BRAKE].out_brake_Nm
    if torque != w.torque_pm or brake != w.brake_Nm:
        _advance(w, plant, f_h, truth, t_ns)
        w.torque_pm = torque
        w.brake_Nm = brake


@inlined
def next_event(w: Any, b: Any, queue: Any, header: Any, nodes: Any, h: Any) -> tuple[int, int]:
    """Return when something happens next, and what: -1 end of frame, 0..n-1 node, n script, n + 1 host, n + 2 start of frame."""
    n = nodes.shape[0]
    t = b.end_ns if b.busy else FAR_NS  # strict comparisons keep the order of equals
    who = -1
    if w.script_ns < t:
        t, who = w.script_ns, n
    for i in range(n):
        if nodes[i].powered and nodes[i].next_ns < t:
            t, who = nodes[i].next_ns, i
    if w.host_on and h.next_ns < t:
        t, who = h.next_ns, n + 1
    if not b.busy:
        t_start = start_ns(b, queue, header[0].count)
        if t_start < t:
            t, who = t_start, n + 2
    return t, who


@kernel
def run(
    world: Any,
    bus: Any,
    queue: Any,
    header: Any,
    log: Any,
    nodes: Any,
    rpdo: Any,
    tpdo: Any,
    plant: Any,
    f_h: Any,
    truth: Any,
    control: Any,
    host: Any,
    host_rpdos: Any,
    host_tpdos: Any,
    law_function: Any,
    motion: Any,
    law: Any,
    state: Any,
) -> int:
    """Run until Python is needed; return the `Exit` that says why."""
    w, b, c, h = world[0], bus[0], control[0], host[0]
    queue, header, log = borrowed(queue), borrowed(header), borrowed(log)
    nodes, rpdo, tpdo = borrowed(nodes), borrowed(rpdo), borrowed(tpdo)
    plant, f_h, truth = borrowed(plant), borrowed(f_h), borrowed(truth)
    host_rpdos, host_tpdos = borrowed(host_rpdos), borrowed(host_tpdos)
    n = nodes.shape[0]
    while True:
        if w.log_count >= log.shape[0]:
            return EXIT_LOG
        t, who = next_event(w, b, queue, header, nodes, h)
        if t < w.t_ns:
            t = w.t_ns
        if t > w.until_ns:
            t, who = w.until_ns, n + 3
        if t > w.force_end_ns:
            _advance(w, plant, f_h, truth, w.force_end_ns)
            w.t_ns = w.force_end_ns
            return EXIT_FORCE
        w.t_ns = t
        if who == n + 2:
            start_frame(b, queue, header, t)
            continue
        if who == n + 3:
            _advance(w, plant, f_h, truth, t)
            return EXIT_UNTIL
        if who == n:
            _advance(w, plant, f_h, truth, t)
            return EXIT_SCRIPT
        if who == n + 1:
            step.on_time(c, h, host_rpdos, law_function, motion[0], law[0], state[0], t, queue, header)
        elif who >= 0:
            _advance(w, plant, f_h, truth, t)
            _sample(plant, nodes[MOTOR], nodes[BRAKE])
            core.on_time(nodes, rpdo, tpdo, who, t, queue, header)
            _actuate(w, plant, nodes, f_h, truth, t)
        else:
            row = w.log_count
            end_frame(b, log, row)
            w.log_count = row + 1
            w.service = 0
            if b.can_id == SYNC:
                _advance(w, plant, f_h, truth, t)
                _sample(plant, nodes[MOTOR], nodes[BRAKE])
            for i in range(n):
                if (
                    nodes[i].powered
                    and b.source != i
                    and core.on_frame(nodes, rpdo, tpdo, i, t, b.can_id, b.length, b.word, queue, header)
                ):
                    w.service |= 1 << i
            _actuate(w, plant, nodes, f_h, truth, t)
            if b.source != step.SOURCE_HOST and not w.host_elsewhere:
                wanted = step.on_frame(c, h, host_tpdos, t, b.can_id, b.length, b.word)
                if wanted == 1 and w.host_on:
                    step.finish(c, h, host_rpdos, law_function, motion[0], law[0], state[0], t, queue, header)
                elif wanted == 2:
                    w.service |= CONTROL_PLANE
            if w.service != 0:
                _advance(w, plant, f_h, truth, t)
                _sample(plant, nodes[MOTOR], nodes[BRAKE])
                return EXIT_SERVICE
        if w.operator_start_ns < 0 and nodes[MOTOR].power_state == OPERATION_ENABLED:
            w.operator_start_ns = t
            return EXIT_ENABLED
        if h.phase != w.phase:
            w.phase = h.phase
            return EXIT_PHASE
