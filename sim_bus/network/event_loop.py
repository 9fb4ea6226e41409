"""Virtual-time event loop: bus, devices, any number of axes and an optional host in one compiled kernel.

`run` goes from event to event in integer nanoseconds and returns to Python only when the control
plane has work, as a virtual machine exits to its monitor (`Exit`). Events at the same instant have
a fixed order: a frame's end first (so that a received frame is handled before a deadline is
checked), then the script, the devices, the host, and at last the start of the next frame (so that
every ready frame takes part in the arbitration).

A device is a row of the node records; that row is its station number. An axis is a motor's row, a
brake's row, and the rig between them: a row of the plants and one of the blocks of the operator's
force. Further devices of an axis show the quantities of the rig's roles (`sim_bus.rig.coupling`). A
device that belongs to no axis has no rig, and no cost from it.

    w : the `WorldRecord`        b : the `BusRecord`        p : the `PlantRecord` of an axis
"""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated, NamedTuple

import numpy as np

from coulombus.eds.cia301 import CobId
from coulombus.eds.cia402 import PowerState
from coulombus.host.cycle import axes as host_axes
from coulombus.host.cycle import step
from coulombus.host.cycle.records import AxisRecords, LawFunction, PlaneFunctions
from coulombus.host.cycle.telemetry import write_axes
from coulombus.kernels.decorator import inlined, kernel
from coulombus.kernels.numba_inside import borrowed
from coulombus.kernels.records import Floats, IntegerField, Integers, RecordArray, dtype_of
from coulombus.node import core, emcy, own_time
from coulombus.node.record import NodeRecord
from coulombus.recording.host_telemetry import MOST_FRAMES
from coulombus.sim_bus.can_bus.arbiter import end_frame, receives, start_frame, start_ns
from coulombus.sim_bus.can_bus.cable_cut import SEVERAL, choose, on_its_bus
from coulombus.sim_bus.can_bus.error_path import detailed_end, detailed_start
from coulombus.sim_bus.can_bus.records import MOST_ROWS, BusRecord, Delivered, Stage
from coulombus.sim_bus.network.deadline_tree import keep_deadline, look_again, next_device
from coulombus.sim_bus.rig.coupling import BrakeOutput, brake_torque, show
from coulombus.sim_bus.rig.plant import coil_current, encoder_rad, transducer_Nm
from coulombus.sim_bus.rig.plant_step import CourseFunction
from coulombus.sim_bus.rig.records import NOT_BEGUN, PlantRecord, RigAxis
from coulombus.wire.clock import NEVER_NS, Clock, bus_ns, own_ns, to_bus
from coulombus.wire.frame import BUS_SHIFT, QUEUE_CAPACITY, Frame, Queue

__all__ = [
    "BRAKE",
    "LOG_FRAMES",
    "MOST_DEVICES",
    "MOTOR",
    "TOLD_FRAMES",
    "WORLD",
    "Exit",
    "HostCycle",
    "World",
    "actuate",
    "next_event",
    "refresh",
    "run",
]

MOTOR, BRAKE = 0, 1
"""Rows of the node records of a rig, which are their station numbers."""
MOST_DEVICES = 127

ENCODER_LOST = 1 << emcy.ENCODER - emcy.FIRST_DEVICE_CAUSE


class Exit(IntEnum):
    """Reason why the kernel returned."""

    UNTIL = 0  # the end time was reached
    FORCE = 1  # a plant needs the next force block of the operator: that of `axis`
    LOG = 2  # the frame log is full
    SERVICE = 3  # Python needs the last frame of the log: `services`, `control_plane` and `heard` tell for whom
    ENABLED = 4  # the drive of `axis` entered Operation Enabled: the schedule begins
    PHASE = 5  # the host entered another phase
    SCRIPT = 6  # a script's entry is due
    FAULT = 7  # a frame has triggered a fault that the bus cannot inject itself
    DETAIL = 8  # the bus needs its detailed path, which is not compiled yet


FRAME_END, SCRIPT, DEVICE, HOST, FRAME_START, NOTHING = 0, 1, 2, 3, 4, 5
"""Next event, in the order of events at the same instant."""

LOG_FRAMES = 1 << 15
SENT_FRAMES = 1 << 12
TOLD_FRAMES = 1 << 13
"""Capacity in frames of the log, of the host's sent frames, and of its telemetry."""


class WorldRecord(Clock):
    """State of the loop besides the records of bus, nodes and rig."""

    t_ns: int
    until_ns: int
    script_ns: int
    stale: int  # 1: Python has changed the records since the kernel last read all of them
    host_on: int  # 1: the host's cycle runs
    host_elsewhere: int  # 1: the host is another process, or there is none
    phase: int  # phases of the host's axes as Python knows them, four bits each
    log_count: int
    # only for a replay of the host (`recording.trace`)
    had: Annotated[IntegerField, LOG_FRAMES, np.int8]  # by row of the log: 1: the host has received this frame
    keep_sent: int  # 1: store the frames that the host requests, whatever becomes of them
    sent_count: int
    sent: Annotated[RecordArray[Frame], SENT_FRAMES]
    tells: int  # 1: the host sends telemetry after each cycle (`host.cycle.telemetry`)
    told_count: int
    # receivers of the last frame
    services: int  # number of devices
    service: Annotated[IntegerField, MOST_DEVICES]  # rows of the devices
    control_plane: int  # 1: the host's
    heard: int  # 1: stations in Python
    listen_all: int  # 1: one of them receives frames outside `listening`: remote, extended and error frames
    # axes
    axis: int  # axis of the exit
    to_begin: int  # axes whose schedule has not begun
    force_end_ns: int  # first time at which an axis's force block ends


WORLD = dtype_of(WorldRecord)


class World(NamedTuple):
    """Arguments of the loop except the host's cycle."""

    state: WorldRecord
    """A record of `WorldRecord`."""
    bus: RecordArray[BusRecord]
    """`sim_bus.can_bus.arbiter.new_bus`: the wire, and its second half while the cable is cut."""
    out: Queue
    """A record of `wire.frame.Queue`: frames requested to be sent."""
    log: RecordArray[Frame]
    """Records of `wire.frame.Frame`: frames sent on the bus."""
    nodes: RecordArray[NodeRecord]
    """`node.record.new_nodes`: the devices."""
    deadlines: Integers
    """`sim_bus.network.deadline_tree.new_deadlines`: next call of each device."""
    wants: Integers
    """`sim_bus.network.deadline_tree.new_wants`: receivers of each frame."""
    listening: Integers
    """By identifier: 1 if a station in Python receives the frame."""
    axes: RecordArray[RigAxis]
    """Records of `AxisRecord`."""
    axis_of: Integers
    """By row of a device: its axis, or -1."""
    plant: RecordArray[PlantRecord]
    """Records of `sim_bus.rig.records.PlantRecord`, one per axis."""
    f_h: Floats
    """By axis: block of the operator's force."""
    truth: Floats
    """By axis: block of the plant's true course."""


class HostCycle(NamedTuple):
    """Host's cycle in the form of `host.cycle.axes`."""

    axes: AxisRecords  # `host.cycle.records.AxisRecord` records
    owner: Integers  # by identifier: axis that its frames belong to
    told: RecordArray[Frame]  # `TOLD_FRAMES` records of `wire.frame.Frame`: telemetry


@inlined
def _sample(p: PlantRecord, axis: RigAxis, nodes: RecordArray[NodeRecord]) -> None:
    """Let the devices measure the rig: encoder, motor current, transducer, coil."""
    motor, brake = nodes[axis.motor], nodes[axis.brake]
    if motor.in_faults & ENCODER_LOST:
        motor.in_velocity_counts_s = 0.0  # the counter stands still
    else:
        motor.in_position_counts = int(np.floor(encoder_rad(p) * p.counts_rad + 0.5))
        motor.in_velocity_counts_s = p.v * p.counts_rad
    motor.in_torque_pm = p.motor / p.motor_Nm_pm
    brake.in_handle_Nm = transducer_Nm(p)
    brake.in_coil_A = coil_current(p, brake.out_brake_Nm if axis.brake_output == BrakeOutput.TORQUE else p.brake_Nm)
    brake.in_coil_degC = p.temperature
    if axis.foreign != 0:
        show(axis, p, nodes, brake.in_handle_Nm, brake.in_coil_A)


@inlined
def _advance(world: World, course: CourseFunction, a: int, t_ns: int) -> None:
    """Advance the plant of axis `a` to the last grid point at or before `t_ns` (within the force block), with
    constant commands.
    """
    axis, p = world.axes[a], world.plant[a]
    steps = (t_ns - p.t_ns) // p.step_ns
    if steps > 0:
        first = p.t_ns // p.step_ns - axis.force_step
        row = first if axis.truth_on else -1
        course(world.plant, a, world.f_h, axis.steps_per_knot, first, steps, world.truth, row)


@inlined
def _measure(world: World, course: CourseFunction, a: int, t_ns: int) -> None:
    """Advance the rig of axis `a` to `t_ns` and let its devices measure it."""
    _advance(world, course, a, t_ns)
    _sample(world.plant[a], world.axes[a], world.nodes)


@kernel
def _read(world: World, course: CourseFunction, a: int, t_ns: int) -> None:
    """Do the same for a reading between the samples: it shows the transducer's next noise without drawing it, so
    that a reading changes nothing later.
    """
    p = world.plant[a]
    random = p.random
    _measure(world, course, a, t_ns)
    p.random = random


@inlined
def actuate(world: World, course: CourseFunction, a: int, t_ns: int) -> None:
    """Apply the devices' commands to the rig of axis `a` from `t_ns` on, if they have changed."""
    axis, p = world.axes[a], world.plant[a]
    motor, brake = world.nodes[axis.motor], world.nodes[axis.brake]
    brake_Nm = brake.out_brake_Nm if axis.brake_output == BrakeOutput.TORQUE else brake_torque(axis, brake)
    if motor.out_torque_pm != p.motor_pm or brake_Nm != p.brake_Nm or brake.out_reverse_A != p.reverse_A:
        _advance(world, course, a, t_ns)
        p.reverse_A = brake.out_reverse_A
        p.motor_pm = motor.out_torque_pm
        p.brake_Nm = brake_Nm


@kernel
def _keep(w: WorldRecord, out: Queue, first: int) -> None:
    """Store the frames that the host has pushed from index `first` on."""
    if w.clock_on != 0:
        to_bus(w, out, first)
    if w.keep_sent != 0:
        for k in range(first, out.count):
            frame, sent = out.frames[k], w.sent[w.sent_count]
            sent.t_ns = frame.t_ns
            sent.can_id = frame.can_id
            sent.length = frame.length
            sent.word = frame.word
            w.sent_count += 1


@kernel
def _end(world: World, course: CourseFunction, b: BusRecord) -> None:
    """End a frame, or a bit-level simulation.

    Report the states of the controllers to their devices.
    """
    w, nodes, t = world.state, world.nodes, world.state.t_ns
    first = w.log_count
    if b.stage == Stage.FRAME:
        end_frame(b, world.log, w.log_count)
        w.log_count += 1
        if b.cut == SEVERAL:
            world.log[first].source += b.half << BUS_SHIFT
        return
    for row in range(detailed_end(b, world.out)):
        report, frame = b.report[row], world.log[first + row]
        frame.t_ns = report.t_ns
        frame.can_id = report.can_id
        frame.length = report.length
        frame.word = report.word
        frame.source = report.source
        if b.cut == SEVERAL:
            frame.source += b.half << BUS_SHIFT
        w.log_count += 1
    if b.delivered != Delivered.NOBODY:
        b.partial_row = w.log_count - 1
    if b.confinements == 0:
        return
    b.confinements = 0
    for i in range(nodes.shape[0]):
        change, b.stations[i].confinement = b.stations[i].confinement, 0
        if change != 0:
            own_time.confinement_changed(nodes, i, t, change, world.out)
            keep_deadline(world.deadlines, i, nodes[i])
            if world.axis_of[i] >= 0:
                actuate(world, course, world.axis_of[i], t)


@kernel
def refresh(
    w: WorldRecord, nodes: RecordArray[NodeRecord], axes: RecordArray[RigAxis], deadlines: Integers, wants: Integers
) -> None:
    """Update all lookup tables from the records that Python may have written."""
    w.stale = 0
    look_again(nodes, deadlines, wants)
    w.to_begin = 0
    w.force_end_ns = NEVER_NS
    for a in range(axes.shape[0]):
        w.to_begin += axes[a].operator_start_ns == NOT_BEGUN
        w.force_end_ns = min(w.force_end_ns, axes[a].force_end_ns)


@inlined
def next_event(w: WorldRecord, b: BusRecord, out: Queue, deadlines: Integers, host: AxisRecords) -> tuple[int, int]:
    """Return the time and the kind of the next event."""
    t = b.end_ns if b.stage != Stage.FREE else NEVER_NS  # strict comparisons keep the order at equal times
    what = FRAME_END
    if w.script_ns < t:
        t, what = w.script_ns, SCRIPT
    if deadlines[1] < t:
        t, what = deadlines[1], DEVICE
    if w.host_on:
        t_host = bus_ns(w, host_axes.next_ns(host))
        if t_host < t:
            t, what = t_host, HOST
    if b.stage == Stage.FREE:
        t_start = start_ns(b, out)
        if t_start < t:
            t, what = t_start, FRAME_START
    return t, what


@kernel
def run(
    world: World,
    host: HostCycle,
    law_function: LawFunction | None,
    course: CourseFunction,
    arm: PlaneFunctions | None,
) -> int:
    """Run until Python is needed; return the `Exit` that says why.

    `law_function` None: there is no host in this world. `arm`: the host's axes are the joints of one arm. Numba omits
    code that depends on an argument that is None.
    """
    world, host = borrowed(world), borrowed(host)  # each use of an array would change its reference count
    w, bus, out, nodes = world.state, world.bus, world.out, world.nodes
    axes, axis_of, deadlines, wants = world.axes, world.axis_of, world.deadlines, world.wants
    cable = bus[0]
    if w.stale:
        refresh(w, nodes, axes, deadlines, wants)
    while True:
        if w.log_count + MOST_ROWS > world.log.shape[0] or w.sent_count + QUEUE_CAPACITY > SENT_FRAMES:
            return Exit.LOG
        if w.told_count + MOST_FRAMES * host.axes.shape[0] > TOLD_FRAMES:
            return Exit.LOG
        b = cable if cable.cut == 0 else bus[choose(bus, out)]
        if cable.fault_calls != 0:
            for a in range(axes.shape[0]):
                _measure(world, course, a, w.t_ns)
            return Exit.FAULT
        t, what = next_event(w, b, out, deadlines, host.axes)
        if t < w.t_ns:
            t = w.t_ns
        if t > w.until_ns:
            t, what = w.until_ns, NOTHING
        if t > w.force_end_ns:
            w.t_ns = t = w.force_end_ns
            for a in range(axes.shape[0]):
                if axes[a].force_end_ns == t:
                    _advance(world, course, a, t)
                    w.axis = a
                    return Exit.FORCE
        w.t_ns = t
        if what == FRAME_START:
            if not start_frame(b, out, t):
                if b.detailed == 0:
                    return Exit.DETAIL
                detailed_start(b, out, t)
            continue
        if what in (NOTHING, SCRIPT):
            for a in range(axes.shape[0]):
                _read(world, course, a, t)
            return Exit.UNTIL if what == NOTHING else Exit.SCRIPT
        if what == HOST:
            if law_function is not None:
                first, t_host = out.count, own_ns(w, t)
                host_axes.on_time(host.axes, law_function, t_host, out, arm)
                if w.clock_on + w.keep_sent != 0:
                    _keep(w, out, first)
                if w.tells != 0:
                    w.told_count = write_axes(host.axes, t, host.told, w.told_count)
        elif what == DEVICE:
            i = next_device(deadlines)
            a = axis_of[i]
            if a >= 0:
                _measure(world, course, a, t)
            own_time.on_time(nodes, i, t, out)
            keep_deadline(deadlines, i, nodes[i])
            if a >= 0:
                actuate(world, course, a, t)
        else:
            _end(world, course, b)
            if b.delivered == Delivered.NOBODY:
                continue
            w.services = w.control_plane = w.heard = 0
            if b.can_id == CobId.SYNC or b.can_id == CobId.NMT:
                for a in range(axes.shape[0]):
                    _measure(world, course, a, t)
            plain = b.can_id <= 0x7FF
            for k in range(wants[b.can_id, 0] if plain else nodes.shape[0]):
                i = wants[b.can_id, k + 1] if plain else k
                if nodes[i].powered and receives(b, i) and on_its_bus(b, i):
                    if axis_of[i] >= 0 and core.reads_inputs(nodes[i], b.can_id):
                        _read(world, course, axis_of[i], t)
                    if own_time.on_frame(nodes, i, t, b.can_id, b.length, b.word, out) != 0:
                        w.service[w.services] = i
                        w.services += 1
                    keep_deadline(deadlines, i, nodes[i])
                    if axis_of[i] >= 0:
                        actuate(world, course, axis_of[i], t)
            if law_function is not None and not w.host_elsewhere and receives(b, step.SOURCE_HOST):
                w.had[w.log_count - 1] = 1
                first, t_host = out.count, own_ns(w, t)
                request = host_axes.on_frame(host.axes, host.owner, t_host, b.can_id, b.length, b.word)
                if request == 1 and w.host_on:
                    host_axes.finish(host.axes, law_function, t_host, host_axes.WINDOW_OPEN, out, arm)
                    if w.clock_on + w.keep_sent != 0:
                        _keep(w, out, first)
                    if w.tells != 0:
                        w.told_count = write_axes(host.axes, t, host.told, w.told_count)
                elif request == 2:
                    w.control_plane = 1
            w.heard = world.listening[b.can_id] if plain else w.listen_all
            if w.services != 0 or w.control_plane != 0 or w.heard != 0:
                for a in range(axes.shape[0]):
                    _measure(world, course, a, t)
                return Exit.SERVICE
        if w.to_begin > 0:
            for a in range(axes.shape[0]):
                if (
                    axes[a].operator_start_ns == NOT_BEGUN
                    and nodes[axes[a].motor].power_state == PowerState.OPERATION_ENABLED
                ):
                    axes[a].operator_start_ns = t
                    w.to_begin -= 1
                    w.axis = a
                    return Exit.ENABLED
        phases = host_axes.phases(host.axes)
        if phases != w.phase:
            w.phase = phases
            return Exit.PHASE
