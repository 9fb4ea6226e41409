"""What the data plane's loop obeys, in plain Python and virtual time: the dead man's key, the parent,
the commands, and what it says of a bus that is lost.
"""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from coulombus.host.cycle.records import Phase, Trip
from coulombus.host.realtime import bus_sockets, loop
from coulombus.host.realtime.shared_memory import BINS, PlaneCommand, PlaneStatus
from coulombus.kernels.libc import EAGAIN, EINTR
from coulombus.recording.trace import Moment

SHARED = 1 << 20
"""The address of the shared memory."""
NOW_NS = 5_000_000_000
EBADF = 9
OWN = (
    "stop",
    "_skip",
    "_look_after_parent",
    "_all_done",
    "failed",
    "_count",
    "_collect",
    "_obey",
    "_goes_on",
    "watch",
    "run_plane",
)


def plain(kernel):
    return getattr(kernel, "py_func", kernel)


class Axes(list):
    """The axes' records, an array of one dimension."""

    @property
    def shape(self):
        return (len(self),)


class Shared(list):
    """The `PlaneRecord`, an array at an address."""

    ctypes = SimpleNamespace(data=SHARED)


class Bench:
    """The loop's own functions, with everything that they call in the test's hand."""

    def __init__(self, monkeypatch):
        self.now_ns, self.parent, self.error = NOW_NS, 100, 0
        self.memory, self.asked, self.traced, self.said = {}, [], [], []
        self.p = SimpleNamespace(
            lost_bus=0, asked=0, ordered=0, order_axis=0, parent=100, error=0, cpu_ns=1000, missed_deadlines=3
        )
        self.axes = Axes(
            SimpleNamespace(
                control=SimpleNamespace(deadman_key=1),
                host=SimpleNamespace(deadman_ok=7, phase=int(Phase.RUN), trip=0, trip_ns=0, position_age=k),
                live=SimpleNamespace(wanted=0),
                world=SimpleNamespace(on=0),
            )
            for k in range(2)
        )
        out = SimpleNamespace(count=9)
        poll, arrays = SimpleNamespace(ctypes=SimpleNamespace(data=77)), {}
        self.poll = type("Poll", (), {"ctypes": poll.ctypes, "__setitem__": lambda _, k, v: arrays.update({k: v})})()
        self.polled = arrays
        self.b = SimpleNamespace(fds=[5], plane=Shared([self.p]), axes=self.axes, trace=None, out=out, poll=self.poll)
        self.b.world_fd, self.b.world_state = -1, None
        self.ramps = False
        for name in OWN:
            monkeypatch.setattr(loop, name, plain(getattr(loop, name)))
        self.world = []
        for name in ("_take_models", "_tell_world"):
            monkeypatch.setattr(loop, name, lambda *_, name=name: self.world.append(name))
        for name, double in {
            "now_ns": lambda: self.now_ns,
            "load_acquire": lambda at: self.memory.get(at - SHARED, 0),
            "store_release": self.store,
            "getppid": lambda: self.parent,
            "errno": lambda: self.error,
            "ask_to_stop": lambda axes, trip: self.asked.append(int(trip)),
            "ramps_a_brake": lambda axes: self.ramps,
            "log_moment": lambda plane, trace, *row: self.traced.append(row),
        }.items():
            for module in (loop, bus_sockets):
                monkeypatch.setattr(module, name, double, raising=False)
        self.patch = monkeypatch.setattr

    def store(self, at, value):
        self.memory[at - SHARED] = int(value)
        self.said.append((at - SHARED, int(value)))

    @property
    def hosts(self):
        return [axis.host for axis in self.axes]


@pytest.fixture
def bench(monkeypatch):
    return Bench(monkeypatch)


# the dead man's key, stop and order


@pytest.mark.parametrize(("until_ns", "held"), [(NOW_NS + 1, 1), (NOW_NS, 0), (NOW_NS - 1, 0), (0, 0)])
def test_the_key_is_held_before_its_time_and_of_all_axes(bench, until_ns, held):
    bench.memory[loop.AT_DEADMAN] = until_ns
    loop._obey(bench.b)
    assert [host.deadman_ok for host in bench.hosts] == [held, held]


def test_a_switch_that_is_an_object_is_none_of_the_key(bench):
    bench.axes[0].control.deadman_key = 0
    bench.memory[loop.AT_DEADMAN] = NOW_NS + 1
    loop._obey(bench.b)
    assert [host.deadman_ok for host in bench.hosts] == [7, 7]


def test_the_parents_stop_is_passed_on(bench):
    bench.memory[loop.AT_STOP] = int(Trip.HOST)
    loop._obey(bench.b)
    assert bench.asked == [int(Trip.HOST)]
    assert bench.p.asked == Trip.HOST


@pytest.mark.parametrize("axis", [0, 1])
def test_an_order_is_taken_once_by_its_axis(bench, axis):
    bench.p.order_axis, bench.memory[loop.AT_ORDER] = axis, 3
    loop._obey(bench.b)
    assert [one.live.wanted for one in bench.axes] == [3 * (axis == 0), 3 * (axis == 1)]
    assert bench.p.ordered == 3
    assert bench.traced == [(Moment.SET, NOW_NS, 3)]
    loop._obey(bench.b)
    assert len(bench.traced) == 1


@pytest.mark.parametrize(
    ("asked", "trip", "stays"),
    [(0, 1, 1), (1, 5, 5), (5, 6, 5), (6, 5, 6), (2, 3, 2), (1, 1, 1), (5, 0, 5), (0, 0, 0), (1, 0, 1)],
)
def test_the_first_reason_to_stop_counts(bench, asked, trip, stays):
    bench.p.asked = asked
    loop.stop(bench.p, bench.axes, trip)
    assert bench.p.asked == stays
    assert bench.asked == [trip]


# the parent


@pytest.mark.parametrize(
    ("until_ns", "parent", "stopped"),
    [(0, 100, False), (NOW_NS, 100, False), (NOW_NS - 1, 100, True), (1, 100, True), (0, 1, True), (NOW_NS, 1, True)],
)
def test_a_parent_that_has_ended_or_stands_still_is_a_stop(bench, until_ns, parent, stopped):
    bench.memory[loop.AT_PARENT], bench.parent = until_ns, parent
    loop._obey(bench.b)
    assert bench.asked == [0] + [int(Trip.HOST)] * stopped
    assert loop.AT_COMMAND not in bench.memory


def test_a_loop_without_a_parent_misses_none(bench):
    bench.p.parent, bench.parent = 0, 1
    loop._look_after_parent(bench.p, SHARED, bench.axes)
    assert (bench.asked, bench.said) == ([], [])


@pytest.mark.parametrize("parent", [100, 1])
@pytest.mark.parametrize("done", [0, 1, 2])
def test_the_loop_ends_behind_its_parent_when_all_axes_are_done(bench, parent, done):
    bench.parent = parent
    for host in bench.hosts[:done]:
        host.phase = int(Phase.DONE)
    assert loop._all_done(bench.axes) is (done == 2)
    loop._look_after_parent(bench.p, SHARED, bench.axes)
    assert bench.said == [(loop.AT_COMMAND, int(PlaneCommand.QUIT))] * (parent == 1 and done == 2)


# times


@pytest.mark.parametrize(
    ("t_ns", "place"),
    [(-5_000, 0), (0, 0), (999, 0), (1000, 1), (5_999, 5), ((BINS - 1) * 1000, BINS - 1), (BINS * 1000, BINS - 1)],
)
def test_a_time_is_counted_in_its_microsecond(bench, t_ns, place):
    bins = [0] * BINS
    loop._count(bins, t_ns)
    loop._count(bins, t_ns)
    assert (bins[place], sum(bins)) == (2, 2)


@pytest.mark.parametrize(("periods", "skipped"), [(-1, 0), (0, 0), (1, 1), (4, 4)])
def test_periods_that_have_passed_are_skipped_and_counted(bench, periods, skipped):
    assert loop._skip(bench.p, bench.axes, periods) == skipped
    assert bench.p.missed_deadlines == 3 + skipped
    assert [host.position_age for host in bench.hosts] == [skipped, 1 + skipped]


@pytest.mark.parametrize(("error", "failed"), [(EINTR, False), (EAGAIN, False), (EBADF, True)])
def test_a_wait_that_fails_for_good_is_told_from_a_signal(bench, error, failed):
    bench.error = error
    assert loop.failed(bench.p) is failed
    assert bench.p.error == (error if failed else 0)


@pytest.mark.parametrize(
    ("command", "ramps", "goes_on", "asked"),
    [
        (PlaneCommand.CYCLE, False, True, []),
        (PlaneCommand.CYCLE, True, True, []),
        (0, False, False, []),
        (0, True, True, [1]),
    ],
)
def test_another_cycle_begins_as_commanded_or_while_a_brake_is_ramped(bench, command, ramps, goes_on, asked):
    bench.ramps = ramps
    assert loop._goes_on(bench.p, bench.axes, command if command else PlaneCommand.QUIT) is goes_on
    assert bench.asked == asked


# the window for TPDOs


def test_each_axis_takes_the_newest_models_when_its_tpdos_are_there(bench):
    found, left = [bus_sockets.COMPLETE, bus_sockets.TOOK, bus_sockets.COMPLETE], [1, 0, 0]
    bench.b.poll = type("Poll", (dict,), {"ctypes": SimpleNamespace(data=77)})({0: 1 << 48})
    bench.patch(loop, "ppoll_ns", lambda *_: 1)
    bench.patch(loop, "receive_message", lambda b, k, live: found.pop(0))
    bench.patch(loop, "transmit", lambda b, patience: 0)
    bench.patch(loop, "log_moment", lambda plane, trace, kind, *row: bench.world.append(Moment(kind).name))
    bench.patch(loop, "finish", lambda *_: bench.world.append("finish") or left.pop(0))
    assert loop._collect(bench.b, None, None, NOW_NS + 1) == 0
    cycle = ["_take_models", "ARRIVED", "finish"]
    assert bench.world == [*cycle, *cycle, "_take_models", "WINDOW", "finish"]


# commands


class Commanded(Bench):
    """A loop whose cycle and whose messages are the test's."""

    def __init__(self, monkeypatch, *commands):
        super().__init__(monkeypatch)
        self.commands, self.gone, self.found, self.ready = list(commands), 0, [], 0
        self.sent, self.safe, self.waited, self.cpu = [], [], [], [10, 250]
        self.patch(loop, "load_acquire", lambda at: self.next_command() if at - SHARED == loop.AT_COMMAND else 0)
        self.patch(loop, "clock_ns", lambda clock: self.cpu.pop(0))
        self.patch(loop, "_cycle", lambda b, law, arm: self.gone)
        self.patch(loop, "receive_message", self.take)
        self.patch(loop, "ppoll_ns", self.wait)
        self.patch(loop, "safe_setpoints", lambda axes, t_ns, out: self.safe.append((t_ns, out.count)))
        self.patch(loop, "transmit", self.transmit)

    def next_command(self):
        told = self.memory.get(loop.AT_COMMAND)
        return told if told is not None else int(self.commands.pop(0))

    def take(self, b, k, live):
        assert (k, live) == (0, 0)
        found = self.found.pop(0)
        self.p.lost_bus = int(found == loop.GONE)
        return found

    def wait(self, *given):
        self.waited.append(given)
        return self.ready

    def transmit(self, b, patience):
        self.sent.append(patience)
        self.p.error = 99

    def run(self):
        return loop.run_plane(self.b, None)

    @property
    def states(self):
        return [value for at, value in self.said if at == loop.AT_STATUS]


def test_a_bus_that_is_lost_in_a_cycle_trips_and_is_told(monkeypatch):
    bench = Commanded(monkeypatch, PlaneCommand.CYCLE)
    bench.gone, bench.p.error = 1, EBADF
    bench.hosts[1].phase, bench.hosts[1].trip, bench.hosts[1].trip_ns = int(Phase.SAFE), 4, 44
    assert bench.run() == PlaneStatus.LOST
    assert bench.states == [PlaneStatus.CYCLING, PlaneStatus.LOST]
    assert [(host.trip, host.trip_ns) for host in bench.hosts] == [(Trip.BUS_LOST, NOW_NS), (4, 44)]
    assert [host.phase for host in bench.hosts] == [Phase.DONE, Phase.DONE]
    assert (bench.safe, bench.sent) == ([(NOW_NS, 0)], [20])  # the last set-points, offered again
    assert bench.p.error == EBADF  # the loss, and not what sending on it says
    assert bench.traced == [(Moment.END, NOW_NS, 0)]
    assert bench.p.cpu_ns == 1240
    assert bench.polled == {0: 5 | 1 << 32}


def test_a_cycle_that_ends_as_commanded_trips_nothing_and_obeys_on(monkeypatch):
    bench = Commanded(monkeypatch, PlaneCommand.CYCLE, PlaneCommand.QUIT)
    assert bench.run() == PlaneStatus.ENDED
    assert bench.states == [PlaneStatus.CYCLING, PlaneStatus.ENDED]
    assert [(host.trip, host.phase) for host in bench.hosts] == [(0, Phase.DONE)] * 2
    assert bench.sent == [20]


@pytest.mark.parametrize(
    ("found", "ready", "error", "lost"),
    [
        (loop.GONE, 0, 0, True),
        (bus_sockets.TOOK, -1, EBADF, False),
        (loop.EMPTY, -1, EBADF, True),
        (loop.EMPTY, -1, EINTR, False),
        (loop.EMPTY, 0, EBADF, False),
        (loop.EMPTY, 1, EBADF, False),
    ],
)
def test_a_bus_that_is_lost_while_listening_is_told(monkeypatch, found, ready, error, lost):
    bench = Commanded(monkeypatch, PlaneCommand.LISTEN, PlaneCommand.QUIT)
    bench.found, bench.ready, bench.error = [found], ready, error
    assert bench.run() == (PlaneStatus.LOST if lost else PlaneStatus.ENDED)
    assert bench.states == [PlaneStatus.LISTENING, PlaneStatus.LOST if lost else PlaneStatus.ENDED]
    assert bench.waited == [(77, 1, 5_000_000)] * (found == loop.EMPTY)
    assert bench.said[-1] == (loop.AT_STATUS, bench.states[-1])


@pytest.mark.parametrize(("known", "parent", "ends"), [(100, 100, False), (100, 1, True), (0, 1, False)])
def test_a_loop_that_listens_ends_behind_its_parent(monkeypatch, known, parent, ends):
    bench = Commanded(monkeypatch, PlaneCommand.LISTEN, PlaneCommand.LISTEN, PlaneCommand.QUIT)
    bench.found, bench.p.parent, bench.parent = [bus_sockets.TOOK, bus_sockets.TOOK], known, parent
    assert bench.run() == PlaneStatus.ENDED
    assert bench.states == [PlaneStatus.LISTENING] * (1 if ends else 2) + [PlaneStatus.ENDED]
    assert ((loop.AT_COMMAND, int(PlaneCommand.QUIT)) in bench.said) is ends
