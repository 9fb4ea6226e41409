"""The course of a run against the wall clock, step by step: arming, what ends it, the safe end, and
the exit status. Data plane, bus and time are stand-ins.
"""

from __future__ import annotations

import signal
import termios
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from clocks import Clock
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import Phase, Trip
from coulombus.host.errors import SafetyTrip
from coulombus.host.realtime.shared_memory import PlaneStatus
from coulombus.host.run import realtime_sequence
from coulombus.host.run.realtime_sequence import FAILURES, RealCourse
from coulombus.host.run.run_sequence import Course
from coulombus.recording.pcapng_blocks import RecordingError
from coulombus.rigs.rig import load_rig
from coulombus.wire.address import BusUnavailable

MS, S = 1_000_000, 1_000_000_000
ZERO_NS = 5 * S


class Plane:
    """A data plane that keeps the calls that it gets."""

    status, alive, lost_text, fate, cycles = PlaneStatus.CYCLING, True, "No such device", "stands still", 7

    def __init__(self, log):
        self.log, self.real_time = log, []
        self.shared = SimpleNamespace(plane={"missed_deadlines": np.zeros(1, np.int64)})

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return lambda *what: self.log.append((name, *what))

    def hold_deadman(self, until_ns):
        self.log.append(("hold_deadman", until_ns))

    def take_frames(self):
        self.log.append(("take_frames",))
        return "frames"

    def take_trace(self):
        self.log.append(("take_trace",))
        return "rows"


class Keys:
    stop, struck = False, ()

    def strike(self, strokes):
        pass

    def strike_early(self, strokes):
        pass

    def read_markers(self):
        struck, self.struck = self.struck, ()
        return struck


@pytest.fixture
def run(monkeypatch):
    return course_of(monkeypatch)


def course_of(monkeypatch, rig="bench"):
    """Return a course in the middle of its run, whose `log` has what is called and `said` what is
    said.
    """
    found, clock, log = object.__new__(RealCourse), Clock(ZERO_NS), []
    monkeypatch.setattr(realtime_sequence, "time", clock)
    found.clock, found.log, found.said = clock, log, []
    monkeypatch.setattr(realtime_sequence, "say", found.said.append)
    rig = load_rig(rig)
    Course.__init__(found, Controllers(rig, "hybrid"), None, None)
    found.rig, found.address, found.buses = rig, SimpleNamespace(moves_hardware=False), "x"
    found.plane, found.zero_ns, found.deadman = Plane(log), ZERO_NS, "key"
    found.error, found._fate, found.stopped_by, found._touched = None, "", None, False
    found._seen, found._outcome, found._stack, found._bits = (7, clock.monotonic()), None, ExitStack(), "bits"
    found._keys, found.signals = Keys(), SimpleNamespace(number=0)
    found.door = SimpleNamespace(stop_wanted=lambda: False)
    found.notifier = SimpleNamespace(
        send=lambda **what: log.append(("send", what)), alive=lambda cycles: log.append(("alive", cycles))
    )
    found.world = SimpleNamespace(models=SimpleNamespace(take_rows=bytes), controlled=False, close=lambda: None)
    found.answers = SimpleNamespace(serve_status=lambda ns: log.append(("answer", ns)))
    found.control = SimpleNamespace(check_alone=lambda at: log.append(("alone until", at)), wait_ns=lambda ns: None)
    found.changes = SimpleNamespace(arm_key="")
    batch = SimpleNamespace(write=lambda *what: log.append(("write", *what)))
    found._order = SimpleNamespace(batch=lambda *what: log.append(("batch", *what)) or batch)
    return found


def recording(run, close=lambda: None):
    run.recorder = SimpleNamespace(
        keep_models=lambda rows: None, mark=lambda t_ns, text: run.log.append(("mark", t_ns, text)), close=close
    )
    return run.recorder


def raising(error):
    def what(*_, **__):
        raise error

    return what


def logged(run, *names):
    """Let methods of the course only note that they are called."""
    for name in names:
        setattr(run, name, lambda *what, name=name: run.log.append((name, *what)))


def at(run, **fields):
    """Set fields of all axes' host records."""
    for name, value in fields.items():
        run.controllers.host[name] = value


# changes, keys, recording


@pytest.mark.parametrize(
    ("status", "phase", "why"),
    [
        (PlaneStatus.LISTENING, Phase.OFF, "the host is not in its cycle yet: it is starting, or it has stopped"),
        (PlaneStatus.LISTENING, Phase.SAFE, "the host is not in its cycle yet: it is starting, or it has stopped"),
        (PlaneStatus.CYCLING, Phase.RUN, None),
        (PlaneStatus.CYCLING, Phase.SAFE, "the host ends: it is in its safe state"),
    ],
)
def test_a_change_is_taken_while_the_host_cycles_and_does_not_end(run, status, phase, why):
    run.plane.status = status
    at(run, phase=phase)
    assert run._why_no_change() == why


def test_no_change_is_taken_while_a_program_outside_has_control(run):
    run.world.controlled = True
    why = "a program outside has control (coulombus run --world): its models set the parameters"
    assert run._why_no_change() == why


def test_a_change_is_ordered_and_marked(run):
    recording(run)
    run.clock.sleep(2)
    run._apply(SimpleNamespace(index=1, number=4, marker="set F_s"))
    assert run.log == [("publish_order", 1, 4), ("mark", 2 * S, "set F_s")]


@pytest.mark.parametrize("error", [None, OSError(), termios.error()])
@pytest.mark.parametrize("foreground", [True, False])
def test_the_keys_of_a_terminal_are_watched_where_there_is_one(run, monkeypatch, foreground, error):
    log = []

    class Terminal:
        def __init__(self, strike, *, earlier):
            log.append((strike, earlier))

        def __enter__(self):
            if error:
                raise error
            log.append("entered")

        def __exit__(self, *_):
            log.append("left")

    monkeypatch.setattr(realtime_sequence, "in_foreground", lambda: foreground)
    monkeypatch.setattr(realtime_sequence, "Keys", Terminal)
    run._watch_keys()
    run._stack.close()
    both = [(run._keys.strike, run._keys.strike_early)]
    assert log == ([] if not foreground else both if error else [*both, "entered", "left"])


@pytest.mark.parametrize(("recorder", "failure"), [(True, None), (True, "full"), (False, None)])
def test_what_is_logged_is_taken_always_and_written_while_it_can_be(run, recorder, failure):
    run.failure = failure
    if recorder:
        recording(run)
        run.recorder.keep_models = lambda rows: run.log.append(("models", rows))
    run.drain(9)
    written = [("models", b""), ("batch", "frames", "rows", 9), ("write", run.recorder, "bits")]
    assert run.log == [("take_trace",), ("take_frames",), *(written if recorder and failure is None else [])]


@pytest.mark.parametrize(
    ("error", "told"), [(None, None), (RecordingError("full"), None), (ValueError("x"), "ValueError: x")]
)
def test_a_recording_that_cannot_be_closed_is_no_trip_but_for_an_error_of_this_process(run, error, told):
    run._give_up_recording()  # there is none
    recording(run, raising(error) if error else lambda: run.log.append("closed"))
    run._give_up_recording()
    assert (run.log == ["closed"]) is (error is None)
    assert (run.error or "").startswith(told or "")
    assert (run.error is None) is (told is None)


# preparing


def prepared(run, monkeypatch, losses=()):
    monkeypatch.setattr(
        realtime_sequence, "bring_up", lambda k, control: run.log.append(("bring_up", run._touched)) or losses
    )
    run.plane.wait_ready = lambda: (run.log.append(("ready",)), run.clock.sleep(3))
    logged(run, "drain")
    recording(run)


def test_the_nodes_are_touched_when_the_host_is_alone_and_the_data_plane_is_loaded(run, monkeypatch):
    prepared(run, monkeypatch, ("a loss", "another"))
    assert run.set_up() == ("a loss", "another")
    assert run.log == [
        ("ready",),
        ("drain", ZERO_NS + 3 * S),
        ("alone until", 6.0),  # it listens while the data plane is loaded
        ("bring_up", True),
        ("mark", 3 * S, "run hybrid"),
        ("mark", 3 * S, "deadman key"),
    ]
    assert run.said == ["coulombus: dead man's switch: key", "coulombus: a loss", "coulombus: another"]


def test_another_host_keeps_the_nodes_untouched(run, monkeypatch):
    prepared(run, monkeypatch)
    run.control.check_alone = raising(SafetyTrip("another host"))
    with pytest.raises(SafetyTrip):
        run.set_up()
    assert run._touched is False
    assert not [row for row in run.log if row[0] == "bring_up"]


def test_rights_that_were_refused_are_said(run, monkeypatch):
    prepared(run, monkeypatch)
    right = {"name": "SCHED_FIFO", "detail": "no right", "remedy": "ulimit", "granted": False}
    run.plane.real_time = [{**right, "name": "timer slack", "granted": True}, right]
    run.set_up()
    assert run.said == [
        "coulombus: SCHED_FIFO: refused (no right); to have it: ulimit",
        "coulombus: dead man's switch: key",
    ]


@pytest.mark.parametrize(
    ("deadman", "moves", "said"),
    [
        ("none", True, ["coulombus: no dead man's switch: host.deadman is none"]),
        ("none", False, []),
        ("key", True, ["coulombus: dead man's switch: key"]),
    ],
)
def test_the_dead_man_s_switch_is_said(run, monkeypatch, deadman, moves, said):
    prepared(run, monkeypatch)
    run.deadman, run.address.moves_hardware = deadman, moves
    run.set_up()
    assert run.said == said


class Switch:
    name, invitation = "the key", "hold the key"

    def __init__(self, clock, held_ns):
        self.clock, self.held_ns, self.log = clock, held_ns, []

    def __enter__(self):
        self.log.append("entered")

    def __exit__(self, *_):
        self.log.append("left")

    @property
    def held(self):
        return self.clock.ns >= self.held_ns


@pytest.mark.parametrize("seconds", [0.0, 0.02, 30.0])
def test_a_switch_that_is_held_in_time_arms(run, seconds):
    switch = Switch(run.clock, ZERO_NS + round(seconds * S))
    run._await_hand(switch)
    assert run.clock.ns == ZERO_NS + round(seconds * S)
    assert run.controllers.control["deadman_key"].tolist() == [1]
    assert (switch.log, run.said) == (["entered"], ["coulombus: hold the key"])
    run._stack.close()
    assert switch.log == ["entered", "left"]


def test_a_switch_that_nobody_holds_refuses_to_arm(run):
    with pytest.raises(SafetyTrip, match=r"^arming refused: the key was not held within 30 s$"):
        run._await_hand(Switch(run.clock, 1 << 62))
    assert run.clock.ns == ZERO_NS + 30 * S + 10 * MS


# the course


def coursing(run, monkeypatch, switch=None):
    monkeypatch.setattr(realtime_sequence, "switch_of", lambda *what: run.log.append(("switch", *what)) or switch)
    run.signals = SimpleNamespace(
        number=0, defer=lambda: run.log.append("defer"), stop=lambda: run.log.append("signals")
    )
    logged(run, "_watch_keys", "_await_hand", "make_safe")
    monkeypatch.setattr(Course, "display", lambda self, seconds: run.log.append(("display", seconds)))
    run.buses = "can0"


def display(run, seconds):
    with run.armed():
        run.display(seconds)


@pytest.mark.parametrize("deadman", ["key", "none"])
@pytest.mark.parametrize("switch", [None, "a switch"])
@pytest.mark.parametrize("now_ns", [ZERO_NS, ZERO_NS + 1, ZERO_NS + MS - 1])
def test_a_course_arms_displays_and_makes_safe(run, monkeypatch, deadman, switch, now_ns):
    coursing(run, monkeypatch, switch)
    run.deadman, run.clock.ns, run.changes.arm_key = deadman, now_ns, "ABCD" if switch else ""
    display(run, 2.5)
    assert run.log == [
        ("switch", deadman, run.plane.hold_deadman, run._keys.strike),
        *([("_watch_keys",)] if deadman != "key" else []),
        *([("_await_hand", switch)] if switch else []),
        "defer",
        "signals",
        ("attend",),
        ("start_cycle", ZERO_NS + (20 * MS if now_ns < ZERO_NS + MS else 21 * MS)),
        ("send", {"READY": 1, "STATUS": "cycling on can0 in mode hybrid"}),
        ("display", 2.5),
        ("make_safe",),
    ]
    assert run._seen == (0, now_ns * 1e-9)
    key = "coulombus: arm key, which coulombus set and the page need to change a parameter: ABCD"
    assert run.said == ([key] if switch else [])
    assert run.error is None


@pytest.mark.parametrize(
    ("status", "alive"),
    [(PlaneStatus.LISTENING, False), (PlaneStatus.LOST, True), (PlaneStatus.ENDED, True), (PlaneStatus.LOST, False)],
)
def test_a_bus_that_is_lost_before_is_not_armed(run, monkeypatch, status, alive):
    coursing(run, monkeypatch)
    run.plane.status, run.plane.alive = status, alive
    with pytest.raises(BusUnavailable, match=r"^bus can0: lost before anything was armed: No such device$"):
        display(run, 1.0)
    assert run.log[-2:] == ["defer", "signals"]


@pytest.mark.parametrize("where", ["display", "send"])
def test_an_error_of_this_process_is_a_trip_and_the_rig_is_made_safe(run, monkeypatch, where):
    coursing(run, monkeypatch)
    if where == "send":
        run.notifier.send = raising(ValueError("x"))
    else:
        run.display = raising(ValueError("x"))
    display(run, 1.0)
    assert run.log[-2:] == [("stop", Trip.HOST), ("make_safe",)]
    assert run.error.startswith("ValueError: x (")


def test_the_rig_is_made_safe_whatever_ends_this_process(run, monkeypatch):
    coursing(run, monkeypatch)
    run.display = raising(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        display(run, 1.0)
    assert run.log[-1] == ("make_safe",)


def test_the_first_error_of_this_process_counts(run):
    run._fail(ValueError("first"))
    assert run.error.startswith("ValueError: first (")
    run._fail(ValueError("second"))
    assert run.error.startswith("ValueError: first (")
    assert run.log == [("stop", Trip.HOST)] * 2


def test_an_error_that_cannot_even_be_told_is_one(run):
    run.plane.stop = raising(MemoryError())
    run._fail(ValueError("first"))
    assert run.error == "an error"


def test_the_data_plane_is_told_why_it_is_to_stop(run):
    run.stop()
    run.stop(Trip.RECORDING)
    assert run.log == [("stop", Trip.NONE), ("stop", Trip.RECORDING)]


# the safe end


def ending(run, *, done_after=None, supervise=None):
    """Let the safe end note what it does; the axes are done after so many looks."""
    looks = []

    def look():
        looks.append(run.clock.ns)
        run.log.append("look")
        if supervise is not None:
            return supervise()
        if len(looks) == done_after:
            at(run, phase=Phase.DONE)
        return True

    run._supervise = look
    logged(run, "_never_cycled", "mark_end")
    return looks


LAST = ["look", ("_never_cycled",), ("mark_end",)]
STOPPING = ("send", {"STOPPING": 1, "STATUS": "ending safely"})


def test_the_safe_state_is_asked_for_until_all_axes_are_done(run):
    ending(run, done_after=2)
    run.make_safe()
    assert run.log == [STOPPING, *[("stop",), "look"] * 2, ("stop",), *LAST]


def test_a_lost_bus_is_not_waited_for(run):
    ending(run)
    run.plane.status = PlaneStatus.LOST
    run.make_safe()
    assert run.log == [STOPPING, ("stop",), *LAST]


def test_a_data_plane_that_has_gone_is_not_waited_for(run):
    ending(run, supervise=lambda: False)
    run.make_safe()
    assert run.log == [STOPPING, ("stop",), "look", *LAST]


def test_the_safe_state_is_waited_for_ten_seconds_more_than_it_takes(run, monkeypatch):
    monkeypatch.setattr(Controllers, "ending_s", 2.5 + 3e-10)
    steps = [12_500_000_000 - 2, *[1] * 9]

    def later():
        run.clock.ns += steps.pop(0)
        return True

    looks = ending(run, supervise=later)
    run.make_safe()
    assert [ns - ZERO_NS - 12_500_000_000 for ns in looks[1:]] == [-2, -1, 0]  # the last one is behind the waiting


def test_errors_end_the_looking_on_but_not_the_first_of_them(run):
    looks = ending(run, supervise=raising(ValueError("x")))
    run.make_safe()
    assert len(looks) == FAILURES + 1 == 1001
    assert run.log[-2:] == LAST[-2:]
    assert run.error.startswith("ValueError: x (")


def test_an_error_now_and_then_does_not_end_the_waiting(run):
    turns = iter([ValueError("x"), None, ValueError("y"), None])

    def sometimes():
        error = next(turns, None)
        if error is not None:
            raise error
        return True

    ending(run, supervise=sometimes)
    run.plane.stop = lambda *trip: (
        run.log.append(("stop", *trip)) or (at(run, phase=Phase.DONE) if run.log.count(("stop",)) == 5 else None)
    )
    run.make_safe()
    assert run.log.count("look") == 5
    assert run.log.count(("stop", Trip.HOST)) == 2


def test_a_service_manager_that_does_not_listen_keeps_nothing_from_the_safe_end(run):
    ending(run, done_after=1)
    run.notifier.send = raising(OSError("gone"))
    run.make_safe()
    assert run.log == [("stop", Trip.HOST), ("stop",), "look", ("stop",), *LAST]


@pytest.mark.parametrize(("error", "tripped"), [(None, False), (OSError("gone"), False), (ValueError("x"), True)])
def test_requests_to_stop_are_answered_in_the_safe_state_too(run, error, tripped):
    ending(run, done_after=1)

    def stop_wanted():
        run.log.append("door")
        if error:
            raise error
        return False

    run.door.stop_wanted = stop_wanted
    run.make_safe()
    turn = [("stop",), "door", *([("stop", Trip.HOST)] if tripped else [])]
    assert run.log == [STOPPING, *turn, "look", *turn, *LAST]


# looking after the run


@pytest.mark.parametrize("name", ["nothing", "plane", "ending", "lost", "signal", "door", "key"])
def test_what_ends_a_display(run, name):
    run._supervise = lambda: name != "plane"
    if name == "ending":
        at(run, phase=Phase.SAFE)
    if name == "lost":
        run.plane.status = PlaneStatus.LOST
    run.signals.number = signal.SIGTERM if name == "signal" else 0
    run.door.stop_wanted = lambda: name in ("door", "signal")
    run._keys.stop = name in ("key", "door")
    assert run.advance(0, lambda: False) is (name == "nothing")
    assert run.stopped_by == {"signal": "SIGTERM", "door": "coulombus stop", "key": "a key"}.get(name)


def looked(run):
    logged(run, "mark_course", "drain", "_plane_gone")
    return run._supervise()


def test_a_look_attends_marks_records_and_answers(run):
    assert looked(run) is True
    t_ns = ZERO_NS + 10 * MS
    assert run.log == [("attend",), ("mark_course", t_ns + 1), ("drain", t_ns), ("answer", t_ns)]
    assert run._seen == (7, 5.0)


@pytest.mark.parametrize("error", [None, BusUnavailable("gone")])
def test_a_look_reads_the_socket_of_the_control_plane_and_does_not_wait(run, error):
    waited = []

    def wait_ns(ns):
        waited.append(ns)
        if error:
            raise error

    run.control.wait_ns = wait_ns
    assert looked(run) is True
    assert waited == [0]


def test_a_cycle_that_was_run_is_told_to_the_service_manager(run):
    run.plane.cycles = 8
    looked(run)
    assert run.log[1] == ("alive", 8)
    assert run._seen == (8, run.clock.monotonic())


@pytest.mark.parametrize("recorded", [True, False])
def test_keys_set_markers(run, recorded):
    if recorded:
        recording(run)
    run._keys.struck = ((ZERO_NS + S, "key 1"),)
    looked(run)
    assert (("mark", S, "key 1") in run.log) is recorded
    assert run.said == ["coulombus: key 1" + ("" if recorded else ": nothing is recorded")]


@pytest.mark.parametrize("enabled_ns", [-1, ZERO_NS])
@pytest.mark.parametrize("closed", [True, False])
def test_the_progress_counts_from_enabled_on(run, enabled_ns, closed):
    at(run, enabled_ns=enabled_ns)
    seen = []

    def progress(seconds):
        seen.append(seconds)
        if closed:
            raise OSError

    assert looked(run) is True  # nobody wants it
    run.progress = progress
    assert looked(run) is True
    assert seen == ([] if enabled_ns < 0 else [pytest.approx(0.02)])


@pytest.mark.parametrize(
    ("since_s", "alive", "status", "gone"),
    [
        (2.0, True, PlaneStatus.CYCLING, False),
        (2.001, True, PlaneStatus.CYCLING, True),
        (2.001, True, PlaneStatus.LISTENING, True),
        (2.001, True, PlaneStatus.LOST, False),
        (2.001, True, PlaneStatus.ENDED, False),
        (0.0, False, PlaneStatus.CYCLING, True),
        (0.0, False, PlaneStatus.LISTENING, True),
        (0.0, False, PlaneStatus.LOST, False),
        (0.0, False, PlaneStatus.ENDED, False),
    ],
)
def test_a_data_plane_that_has_gone_or_stands_still_is_noticed(run, since_s, alive, status, gone):
    run.clock.ns = 2 * S - 10 * MS
    run._seen = (7, 2.0 - since_s)
    run.plane.alive, run.plane.status = alive, status
    assert looked(run) is not gone
    assert (("_plane_gone",) in run.log) is gone


def test_the_axes_of_a_data_plane_that_has_gone_trip_and_end(monkeypatch):
    run = course_of(monkeypatch, "two_axes")
    run.controllers.host["phase"] = Phase.RUN, Phase.SAFE
    run.controllers.host["trip"][1], run.controllers.host["trip_ns"][1] = Trip.SPEED, 3
    run._plane_gone()
    assert run.controllers.host["trip"].tolist() == [Trip.DATA_PLANE, Trip.SPEED]
    assert run.controllers.host["trip_ns"].tolist() == [ZERO_NS, 3]
    assert run.controllers.done
    assert run._fate == "stands still"
    run.plane.fate = "ended with 1"
    run._plane_gone()
    assert run._fate == "stands still"


@pytest.mark.parametrize(
    ("status", "phases", "trips"),
    [
        (PlaneStatus.LOST, (Phase.STILL, Phase.SAFE), (Trip.BUS_LOST, Trip.SPEED)),
        (PlaneStatus.LOST, (Phase.SAFE, Phase.DISABLE), None),
        (PlaneStatus.CYCLING, (Phase.STILL, Phase.SAFE), None),
    ],
)
def test_a_bus_that_is_lost_before_the_first_cycle_is_a_trip(monkeypatch, status, phases, trips):
    run = course_of(monkeypatch, "two_axes")
    run.plane.status = status
    run.controllers.host["phase"], run.controllers.host["trip"][1] = phases, Trip.SPEED
    run._never_cycled()
    assert tuple(run.controllers.host["trip"]) == (trips or (Trip.NONE, Trip.SPEED))
    assert tuple(run.controllers.host["trip_ns"]) == (ZERO_NS if trips else 0, 0)
    assert tuple(run.controllers.host["phase"]) == ((Phase.DONE, Phase.DONE) if trips else phases)


def left(run, monkeypatch, **errors):
    """Let the end note what it does; some of that fails."""
    for name in ("release", "shut_down"):
        monkeypatch.setattr(
            realtime_sequence,
            name,
            raising(errors[name]) if name in errors else lambda *_, name=name: run.log.append(name),
        )
    logged(run, "mark_trip", "drain", "_give_up_recording")
    run.world.close = lambda: run.log.append("world")
    if "drain" in errors:
        run.drain = raising(errors["drain"])
    run.end()
    return [row if isinstance(row, str) else row[0] for row in run.log]


END = ["mark_trip", "drain", "world", "_give_up_recording", "close"]


@pytest.mark.parametrize(
    ("status", "alive", "phase", "touched", "steps"),
    [
        (PlaneStatus.CYCLING, True, Phase.DONE, True, ["release", "end_cycle", "shut_down"]),
        (PlaneStatus.CYCLING, True, Phase.SAFE, True, ["end_cycle", "await_end", "release", "end_cycle", "shut_down"]),
        (PlaneStatus.CYCLING, True, Phase.DONE, False, ["release", "end_cycle"]),
        (PlaneStatus.CYCLING, False, Phase.SAFE, True, ["shut_down"]),
        (PlaneStatus.LISTENING, True, Phase.OFF, True, ["shut_down"]),
        (PlaneStatus.LISTENING, True, Phase.OFF, False, []),
        (PlaneStatus.LOST, True, Phase.SAFE, True, ["shut_down"]),
    ],
)
def test_the_nodes_are_left_in_order(run, monkeypatch, status, alive, phase, touched, steps):
    run.plane.status, run.plane.alive, run._touched = status, alive, touched
    at(run, phase=phase)
    assert left(run, monkeypatch) == [*steps, *END]
    assert run.error is None


def test_a_bus_that_is_gone_at_the_end_is_no_error(run, monkeypatch):
    run._touched, error = True, BusUnavailable("gone")
    at(run, phase=Phase.DONE)
    assert left(run, monkeypatch, release=error, shut_down=error) == ["end_cycle", *END]
    assert run.error is None


def test_an_error_at_the_end_keeps_none_of_the_steps_from_it(run, monkeypatch):
    run._touched = True
    error = ValueError("x")
    run.plane.await_end = raising(error)
    steps = left(run, monkeypatch, release=error, shut_down=error, drain=error)
    failed = ["end_cycle", "stop", "stop", "end_cycle", "stop"]
    assert steps == [*failed, "mark_trip", "stop", "world", "_give_up_recording", "close"]
    assert run.error.startswith("ValueError: x")


def test_what_is_left_behind_is_said(run):
    run._stack.callback(raising(OSError("in use")))
    run.close()
    assert run.said == ["coulombus: something is left behind: in use"]


# the result


@pytest.mark.parametrize(
    ("trip", "error", "failure", "told"),
    [
        (Trip.NONE, None, None, None),
        (Trip.NONE, "an error", None, "HOST: an error"),
        (Trip.HOST, "an error", None, "HOST: an error"),
        (Trip.SPEED, "an error", None, "SPEED"),
        (Trip.SPEED, "an error", "disk full", "RECORDING: disk full"),
        (Trip.HOST, "an error", "disk full", "RECORDING: disk full"),
        (Trip.BUS_LOST, None, "disk full", "RECORDING: disk full"),
        (Trip.HOST, None, None, "(it hung for 2 s)"),
        (Trip.DATA_PLANE, None, None, "(it stands still)"),
        (Trip.BUS_LOST, None, None, "(No such device)"),
        (Trip.SPEED, None, None, "SPEED"),
    ],
)
def test_a_trip_is_told_with_what_this_process_knows_of_it(run, trip, error, failure, told):
    run.error, run.failure, run._fate = error, failure, "stands still"
    at(run, trip=trip, phase=Phase.SAFE)
    if told is None:
        assert run.trip is None
    elif trip == Trip.SPEED and failure is None:
        assert run.trip == run.controllers.trip
        assert run.trip.startswith("SPEED")
    elif told.startswith("("):
        assert run.trip == f"{run.controllers.trip} {told}"
    else:
        assert run.trip == told


def test_a_data_plane_of_no_known_fate_is_not_there(run):
    at(run, trip=Trip.DATA_PLANE, phase=Phase.SAFE)
    assert run.trip.endswith("(it is not there)")


@pytest.mark.parametrize(
    ("cycles", "missed", "lost", "share"), [(0, 3, (1, 2), 0.0), (8, 3, (1, 2), 0.625), (1, 0, (1, 0), 1.0)]
)
def test_the_lost_share_counts_the_axis_that_lost_most(monkeypatch, cycles, missed, lost, share):
    run = course_of(monkeypatch, "two_axes")
    run.plane.cycles = cycles
    run.plane.shared.plane["missed_deadlines"][0] = missed
    run.controllers.host["lost_pdos"] = lost
    assert run._lost_share() == share


@pytest.mark.parametrize(
    ("trip", "number", "more", "status"),
    [
        (Trip.SPEED, signal.SIGTERM, 1, 7),
        (Trip.NONE, signal.SIGTERM, 1, 143),
        (Trip.NONE, 0, 1, 8),
        (Trip.NONE, 0, 0, 0),
        (Trip.NONE, 0, -1, 0),
    ],
)
def test_the_exit_status_tells_the_worst(run, trip, number, more, status):
    at(run, trip=trip, phase=Phase.SAFE)
    run.signals.number = int(number)
    run._lost_share = lambda: run.rig.host.loss_limit + 1e-6 * more
    assert run._exit_status() == status


def test_figures_that_cannot_be_told_are_a_trip(run, tmp_path):
    assert run.figures().sha256 is None
    assert run.error is None
    run.path = Path(tmp_path / "none.pcapng")
    figures = run.figures()
    assert (len(figures.each), figures.sha256) == (1, None)
    assert run.error.startswith("FileNotFoundError")


def test_a_result_that_fails_once_is_told_and_one_that_fails_twice_is_a_trip(run):
    turns = [ValueError("first"), "the result"]

    def result():
        turn = turns.pop(0)
        if isinstance(turn, Exception):
            raise turn
        return turn

    run._result = result
    assert run.result() == "the result"
    assert run.error.startswith("ValueError: first")
    turns[:] = ["the result"]
    run.log.clear()
    assert run.result() == "the result"
    assert run.log == []
    turns[:] = [ValueError("second"), ValueError("third")]
    with pytest.raises(SafetyTrip, match=r"^HOST: ValueError: first"):
        run.result()
