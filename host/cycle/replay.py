"""Replay of the host's cycle: the recorded inputs give the recorded outputs, bit for bit.

The inputs of the step, and their places in a recording:

=========================================  ============================================================================
received frames with their time stamps     the recording; the trace (`recording.trace`) says which of its frames these
                                           are; a stamp matters to heartbeats only, whose age counts from it
frames that the step saw in a cycle        virtual time: their stamps; real time: the trace
times at which a cycle was due and ended   the same; skipped periods add to the position's age, which divides the
                                           velocity
stop requests, the dead man's switch       the trace; in virtual time also the changes of the host's clock, which sets
                                           its deadlines
models of a world outside                  the attachments "host.models" (`host.world.recorded`); the trace has the cycle
                                           in which each was taken
changed parameters                         the markers "set" (`host.cycle.parameter_changes`); the trace has the cycle
                                           in which each was taken
rig, mode, law                             attached (a user's law: its file in the folder of the recording)
=========================================  ============================================================================

The step has no other input: no clock, and no period but `CONTROL.period_ns`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coulombus.host.cycle import axes
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.live_parameters import offer
from coulombus.host.cycle.parameter_changes import ParameterOrder
from coulombus.host.cycle.records import Trip
from coulombus.host.world.recorded import place
from coulombus.kernels.records import Records, new_records
from coulombus.recording.trace import EVENT, Event, Moment
from coulombus.wire.clock import NEVER_NS, Clock, bus_ns, own_ns, set_clock
from coulombus.wire.frame import CAN_ERR_FLAG, new_queue

__all__ = ["HostFrame", "Inputs", "replay"]

AHEAD = 4096
"""Number of frames and rows that are read from their arrays at a time."""


class HostClock(Clock):
    """The host's clock.

    It needs a field of its own, because Numba reuses code compiled for `Clock` for every record that
    begins with the fields of `Clock`.
    """

    changes: int  # number of clock changes


class HostFrame(NamedTuple):
    """A frame that the step sends: its cycle (from 1), the time at which it was ready, and the time by
    which it was sent, if it was.
    """

    cycle: int
    t_ns: int
    until_ns: int
    refusable: int
    """Number of this cycle's frames that the bus refused; these are not in the recording."""
    can_id: int
    length: int
    word: int


@dataclass(frozen=True)
class Inputs:
    """The host's inputs in the order of their arrival.

    frames : FRAME records that the host received
    trace : rows of `recording.trace.TRACE`, or of EVENT for virtual time, in which a frame is handled
    at its stamp and the host at its deadline
    orders : changed parameters, by their numbers in the trace
    models : models of a world outside (`host.world.recorded`), by their numbers in the trace
    """

    frames: Records
    trace: npt.NDArray[Any]
    orders: Mapping[int, ParameterOrder] = field(default_factory=dict)
    models: Mapping[int, Any] = field(default_factory=dict)

    @property
    def virtual(self) -> bool:
        """Whether the run was in virtual time."""
        return self.trace.dtype == EVENT


def replay(controllers: Controllers, inputs: Inputs) -> Iterator[HostFrame]:
    """Yield the frames that new `controllers` send on these inputs, until the trace ends (virtual
    time: without end).
    """
    run = _Replay(controllers, inputs)
    return run.in_virtual_time(inputs.trace) if inputs.virtual else run.by_trace(inputs.trace)


class _Replay:
    def __init__(self, controllers: Controllers, inputs: Inputs) -> None:
        self.k = controllers
        self.clock = new_records(HostClock)[0]
        self.out = new_queue()
        self.axes, self.host = controllers.axes, controllers.host
        self.law_function, self.arm = controllers.law_function, controllers.arm
        self.orders, self.models = inputs.orders, inputs.models
        self.frames = inputs.frames[["t_ns", "can_id", "length", "word"]]
        self.row = self.first = 0
        self.ahead: list[tuple[int, ...]] = []

    def _next(self) -> tuple[int, ...]:
        """Return the next frame; after the last one, a frame at NEVER_NS."""
        if not 0 <= self.row - self.first < len(self.ahead):
            self.first = self.row
            self.ahead = self.frames[self.row : self.row + AHEAD].tolist() or [(NEVER_NS, 0, 0, 0)]
        return self.ahead[self.row - self.first]

    def _feed(self) -> int:
        """Handle the next frame; return the result of `on_frame`."""
        frame = self._next()
        self.row += 1
        if frame[1] & CAN_ERR_FLAG:  # the loop handles error frames, the step never sees them
            return 0
        return int(axes.on_frame(self.axes, self.k.owner, int(own_ns(self.clock, frame[0])), *frame[1:]))

    def _sent(self, cycle: int, until_ns: int = NEVER_NS, refusable: int = 0) -> Iterator[HostFrame]:
        count = int(self.out["count"])
        if count == 0:
            return
        self.out["count"] = 0
        for frame in self.out.frames[:count].tolist():
            yield HostFrame(cycle, frame[0], until_ns, refusable, *frame[1:4])

    def _want(self, number: int) -> None:
        """Publish an order, which the step takes in the next cycle."""
        order = self.orders[number]
        live = self.axes["live"][order.axis]
        offer(live, number, order.values, order.cycles)
        live["wanted"] = number

    def _render(self, key: int) -> None:
        """Publish a model of the world, which the step takes in the next cycle."""
        row = self.models[key]
        place(self.axes["world"], row["model"], int(row["number"]))

    def by_trace(self, trace: npt.NDArray[Any]) -> Iterator[HostFrame]:
        """Repeat the loop of `host.realtime.loop`."""
        period_ns = int(self.k.control["period_ns"][0])
        cycle = due_ns = refused_before = 0
        for t_ns, received, kind, value, refused, until_ns, later in _rows(trace):
            if received > len(self.frames):
                return  # the recording has ended
            if kind == Moment.START:
                self.row = received
                self.k.start(t_ns)
                due_ns = t_ns - period_ns
                continue
            while self.row < received:
                self._feed()
            if kind == Moment.SET:
                self._want(value)
                continue
            if kind == Moment.MODEL:
                self._render(value)
                continue
            if kind == Moment.BEGIN:
                cycle += 1
                self.host["position_age"] += (t_ns - due_ns) // period_ns - 1
                due_ns, refused_before = t_ns, refused
                self.host["deadman_ok"] = value
                axes.begin(self.axes, t_ns, self.out)
            elif kind == Moment.END:
                axes.safe_setpoints(self.axes, t_ns, self.out)
            else:
                if value:
                    axes.ask_to_stop(self.axes, value)
                axes.finish(self.axes, self.law_function, t_ns, int(kind == Moment.WINDOW), self.out, self.arm)
            yield from self._sent(cycle, until_ns, later - refused_before)

    def in_virtual_time(self, events: npt.NDArray[Any]) -> Iterator[HostFrame]:
        """Repeat the kernel of `sim_bus.network.event_loop`: at one instant, arriving frames come before
        the host.
        """
        running = False
        for t_ns, received, next_ns, kind, value in (*events.tolist(), (0, NEVER_NS, NEVER_NS, None, 0)):
            while self.row < received or (running and int(self.host["next_ns"].min()) < next_ns):
                arrives_ns = self._next()[0]
                due_ns = int(bus_ns(self.clock, int(self.host["next_ns"].min()))) if running else NEVER_NS
                if min(arrives_ns, due_ns) == NEVER_NS:
                    return  # the recording has ended
                now_ns = int(own_ns(self.clock, min(arrives_ns, due_ns)))
                if due_ns < arrives_ns:
                    axes.on_time(self.axes, self.law_function, now_ns, self.out, self.arm)
                elif self._feed() == 1 and running:
                    axes.finish(self.axes, self.law_function, now_ns, 0, self.out, self.arm)
                for sent in self._sent(int(self.host["cycle"][0])):
                    yield sent._replace(t_ns=int(bus_ns(self.clock, sent.t_ns)))
            if kind == Event.START:
                running = True
                self.k.start(t_ns)
            elif kind == Event.CLOCK:
                set_clock(self.clock, t_ns, value)
                self.clock.changes += 1
            elif kind == Event.STOP:
                self.k.stop(Trip(value))
            elif kind == Event.SET:
                self._want(value)
            elif kind == Event.MODEL:
                self._render(value)


def _rows(trace: npt.NDArray[Any]) -> Iterator[tuple[int, ...]]:
    """Yield the rows; each ends with the time of the next cycle, and the number of frames that the bus
    had refused by then.
    """
    cycles = np.flatnonzero(np.isin(trace["kind"], (Moment.BEGIN, Moment.END)))
    following = np.searchsorted(cycles, np.arange(len(trace)), "right")
    columns = [trace[name] for name in ("t_ns", "received", "kind", "value", "refused")]
    columns.append(np.append(trace["t_ns"][cycles], NEVER_NS)[following])
    columns.append(np.append(trace["refused"][cycles], trace["refused"][-1:])[following])
    for first in range(0, len(trace), AHEAD):
        yield from zip(*(column[first : first + AHEAD].tolist() for column in columns), strict=True)
