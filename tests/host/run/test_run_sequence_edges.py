"""The course of a run in virtual time: how long it arms, displays and waits for the safe state, what
it marks, and which figures it has.
"""

from __future__ import annotations

from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from coulombus.host.cycle.records import Trip
from coulombus.host.run import run_sequence
from coulombus.host.run.run_sequence import Course, Figures
from coulombus.recording.measures import Measures
from coulombus.recording.pcapng_blocks import RecordingError

SECOND = 1_000_000_000
BEGIN_NS = 100 * SECOND
TICK_NS = SECOND // 4


class Marks:
    """The phases' markers."""

    def __init__(self, rig=None):
        self.rig, self.begun, self.asked = rig, 0, []

    def begin(self, axis, start_ns):
        self.asked.append(("begin", axis, start_ns))

    def due(self, before_ns):
        self.asked.append(("due", before_ns))
        return [(before_ns, "phase stroke")]

    def end(self, shown_ns):
        self.asked.append(("end", shown_ns))
        return [(shown_ns, "phase end")]


class Controllers(list):
    """Two axes, of which the test says what they do."""

    def __init__(self, *starts):
        super().__init__(SimpleNamespace(host={"enabled_ns": [start]}) for start in starts)
        self.rig, self.arming_s, self.ending_s = "the rig", 1.5, 0.5
        self.ending = self.done = self.safe = False
        self.safe_ns = self.trip = None

    @property
    def each(self):
        return list(self)


class Virtual(Course):
    """A course whose time passes by `TICK_NS` in each look, and at which `at` says what happens."""

    def __init__(self, *starts, at=(), path=None):
        super().__init__(Controllers(*starts), path, None)
        assert self.marks.rig == "the rig"
        self.t_ns, self.at, self.stops, self.looks, self.alive = BEGIN_NS, list(at), [], [], True
        self.marks = Marks()
        self.marked, self.steps = [], []
        self.recorder = SimpleNamespace(mark=lambda t_ns, text: self.marked.append((t_ns, text)))

    @property
    def now_ns(self):
        return self.t_ns

    def advance(self, until_ns, done):
        assert type(until_ns) is int
        self.looks.append((until_ns, done()))
        self.t_ns += TICK_NS
        for t_ns, action in self.at:
            if t_ns == self.t_ns:
                action(self)
        return self.alive

    def stop(self, trip=Trip.NONE):
        self.stops.append(trip)

    def set_up(self):
        self.steps.append("set up")
        return ("a loss",)

    @contextmanager
    def armed(self):
        self.steps.append("armed")
        yield
        self.steps.append("safe")

    def end(self):
        self.steps.append("end")

    def result(self):
        self.steps.append("result")
        return self.losses

    def enable(self, axis, t_ns):
        self.controllers[axis].host["enabled_ns"][0] = t_ns


@pytest.fixture(autouse=True)
def _marks_of_no_rig(monkeypatch):
    monkeypatch.setattr(run_sequence, "PhaseMarks", Marks)


def test_a_run_is_set_up_armed_displayed_made_safe_and_ended():
    run = Virtual(BEGIN_NS)
    run.display = lambda seconds: run.steps.append(("display", seconds))
    assert run.run(2.5) == ("a loss",)
    assert run.steps == ["set up", "armed", ("display", 2.5), "safe", "end", "result"]


@pytest.mark.parametrize("step", ["set_up", "armed", "display"])
def test_a_run_that_fails_or_is_interrupted_is_ended_and_has_no_result(step):
    run = Virtual(BEGIN_NS)

    def interrupted(*_):
        raise KeyboardInterrupt

    setattr(run, step, interrupted)
    with pytest.raises(KeyboardInterrupt):
        run.run(None)
    assert run.steps[-1] == "end"
    assert run.steps.count("end") == 1
    assert "result" not in run.steps


# arming and display


@pytest.mark.parametrize(
    ("starts", "each", "last"),
    [
        ((-1, -1), (None, None), None),
        ((5, -1), (5, None), None),
        ((-1, 5), (None, 5), None),
        ((5, 7), (5, 7), 7),
        ((9, 7), (9, 7), 9),
        ((0, 0), (0, 0), 0),
    ],
)
def test_a_run_begins_with_the_last_of_its_axes(starts, each, last):
    run = Virtual(*starts)
    assert run.starts_ns == each
    assert run.enabled_ns == last


def test_arming_is_waited_for_twice_its_time():
    run = Virtual(-1, -1)
    run.display(5.0)
    assert run.now_ns == BEGIN_NS + 3 * SECOND
    assert {until_ns for until_ns, _ in run.looks} == {BEGIN_NS + 3 * SECOND}
    assert run.marks.asked == [("end", run.now_ns)]
    assert run.marked == [(run.now_ns, "phase end")]


@pytest.mark.parametrize("seconds", [0.0, 2.0, 2.1])
def test_the_law_is_displayed_from_the_last_start_on(seconds):
    armed_ns = BEGIN_NS + 2 * TICK_NS
    run = Virtual(
        BEGIN_NS,
        -1,
        at=[(armed_ns, lambda run: run.enable(1, armed_ns))],
    )
    run.display(seconds)
    ends = armed_ns + round(seconds * 1e9)
    assert ends <= run.now_ns < ends + TICK_NS
    assert {until_ns for until_ns, _ in run.looks[2:]} <= {ends}
    assert len(run.looks) == 2 + -(-round(seconds * 1e9) // TICK_NS)


def test_a_display_without_an_end_goes_on_until_a_look_says_no():
    def end(run):
        run.alive = False

    run = Virtual(BEGIN_NS, BEGIN_NS, at=[(BEGIN_NS + 400 * TICK_NS, end)])
    run.display(None)
    assert run.now_ns == BEGIN_NS + 400 * TICK_NS
    assert {until_ns for until_ns, _ in run.looks} == {1 << 62}


def test_a_look_that_says_no_ends_the_arming_and_the_display():
    run = Virtual(-1, -1)
    run.alive = False
    run.display(5.0)
    assert len(run.looks) == 1


def test_a_display_is_looked_at_until_the_axes_end():
    run = Virtual(BEGIN_NS, BEGIN_NS, at=[(BEGIN_NS + TICK_NS, lambda run: setattr(run.controllers, "ending", True))])
    run.display(1.0)
    assert [done for _, done in run.looks] == [False, True, True, True]


@pytest.mark.parametrize(
    ("starts", "begun", "ending", "more"),
    [
        ((-1, -1), 0, False, False),
        ((5, -1), 0, False, True),
        ((5, -1), 1, False, False),
        ((5, 6), 1, False, True),
        ((5, 6), 2, False, False),
        ((-1, -1), 0, True, True),
        ((5, 6), 1, True, True),
    ],
)
def test_a_look_of_arming_ends_with_a_start_that_is_not_marked_yet(starts, begun, ending, more):
    run = Virtual(*starts)
    run.marks.begun, run.controllers.ending = begun, ending
    assert run._one_more() is more


# the safe state


def test_the_safe_state_is_waited_for_ten_seconds_beside_the_brakes_ramp():
    run = Virtual(BEGIN_NS, BEGIN_NS)
    run.make_safe()
    assert run.stops == [Trip.NONE]
    assert run.now_ns == BEGIN_NS + 10 * SECOND + SECOND // 2
    assert {until_ns for until_ns, _ in run.looks} == {BEGIN_NS + 10 * SECOND + SECOND // 2}
    assert run.marked == [(run.now_ns, "safe")]


def test_the_safe_state_ends_when_all_axes_are_done():
    run = Virtual(BEGIN_NS, BEGIN_NS, at=[(BEGIN_NS + 2 * TICK_NS, lambda run: setattr(run.controllers, "done", True))])
    run.make_safe()
    assert len(run.looks) == 2


@pytest.mark.parametrize(
    ("done", "safe", "marked", "looked"),
    [(True, False, False, True), (False, True, False, True), (False, True, True, False), (False, False, False, False)],
)
def test_a_look_ends_when_the_axes_are_done_or_safe_and_not_marked(done, safe, marked, looked):
    run = Virtual(BEGIN_NS, BEGIN_NS)
    found = []

    def look(until_ns, ended):
        run.controllers.safe, run._end_marked = safe, marked
        run.controllers.done = done
        found.append(ended())
        run.controllers.done = True
        return True

    run.advance = look
    run.make_safe()
    assert found == [looked]


# markers


@pytest.mark.parametrize(("trip", "text"), [(None, "safe"), ("SPEED", "trip SPEED")])
@pytest.mark.parametrize("safe_ns", [None, BEGIN_NS - 7])
def test_the_end_is_marked_once_when_the_safe_state_began(trip, text, safe_ns):
    run = Virtual(BEGIN_NS, BEGIN_NS)
    run.controllers.trip, run.controllers.safe_ns = trip, safe_ns
    run.mark_end()
    run.mark_end()
    assert run.marked == [(BEGIN_NS if safe_ns is None else safe_ns, text)]


@pytest.mark.parametrize(
    ("before", "safe", "due"), [(-5, None, -5), (0, None, 0), (5, None, 1), (5, -3, -2), (-9, -3, -9), (5, 3, 1)]
)
def test_phases_are_marked_up_to_now_or_to_the_safe_state(before, safe, due):
    run = Virtual(7, -1)
    run.controllers.safe_ns = None if safe is None else BEGIN_NS + safe
    run.mark_course(BEGIN_NS + before)
    assert run.marks.asked == [("begin", 0, 7), ("due", BEGIN_NS + due)]
    assert run.marked == [(BEGIN_NS + due, "phase stroke")] + [(run.controllers.safe_ns, "safe")] * (safe is not None)


def test_without_a_recording_nothing_is_marked():
    run = Virtual(7, 8)
    run.recorder = None
    run.mark(5, "x")
    run.record(lambda recorder: pytest.fail("there is none"))
    assert run.marked == []


def test_a_recording_that_fails_is_a_trip_and_nothing_more_is_written():
    run = Virtual(7, 8)
    written = []

    def fail(recorder):
        raise RecordingError("no space")

    run.record(written.append)
    assert (written, run.failure, run.trip) == ([run.recorder], None, None)
    run.record(fail)
    run.record(written.append)
    assert (len(written), run.stops) == (1, [Trip.RECORDING])
    assert run.trip == "RECORDING: no space"


# the result


@pytest.fixture
def figured(monkeypatch):
    monkeypatch.setattr(run_sequence, "file_sha256", lambda path: "abc")
    monkeypatch.setattr(run_sequence, "blocks", lambda path: SimpleNamespace(axes=[1, 2]))
    monkeypatch.setattr(run_sequence, "measure", lambda axis: f"figures {axis}")


def test_figures_are_of_the_recording_of_a_run_that_displayed(figured, tmp_path):
    path = tmp_path / "run.pcapng"
    path.write_bytes(b"")
    run = Virtual(5, 6, path=path)
    assert run.figures() == Figures(["figures 1", "figures 2"], "abc")
    run.failure = "no space"
    assert run.figures() == Figures([Measures(), Measures()], "abc")
    assert Virtual(5, -1, path=path).figures() == Figures([Measures(), Measures()], "abc")


def test_a_run_without_a_file_has_no_figures(figured, tmp_path):
    none = Figures([Measures(), Measures()], None)
    assert Virtual(5, 6).figures() == none
    assert Virtual(5, 6, path=tmp_path).figures() == none  # as /dev/null, no file
    assert Virtual(5, 6, path=tmp_path / "missing").figures().sha256 == "abc"


def test_a_result_has_the_runs_own_fields_too(monkeypatch, tmp_path):
    monkeypatch.setattr(
        run_sequence, "RunResult", SimpleNamespace(from_controllers=lambda *given, **named: (given, named))
    )
    run = Virtual(5, 6, path=tmp_path / "run.pcapng")
    run.controllers.trip, run.losses = "SPEED", ("one",)
    given, named = run.result_of(Figures(["figures"], "abc"), seconds=3)
    assert given == (run.controllers, ["figures"])
    assert named == {
        "record": run.path,
        "recording_sha256": "abc",
        "trip": "SPEED",
        "losses": ("one",),
        "seconds": 3,
    }
    assert run.safe_ns is None


# the marker of a trip


@pytest.mark.parametrize(
    ("trip", "marked"), [(None, ["phase stroke", "safe"]), ("ESTOP", ["phase stroke", "phase end", "trip ESTOP"])]
)
def test_a_trip_ends_the_display_before_its_marker(trip, marked):
    run = Virtual(BEGIN_NS, BEGIN_NS)
    run.controllers.safe_ns, run.controllers.trip = BEGIN_NS, trip
    run.mark_course(BEGIN_NS + TICK_NS)
    assert [text for _, text in run.marked] == marked


def test_a_trip_that_came_behind_the_safe_state_is_marked_once():
    run = Virtual(BEGIN_NS, BEGIN_NS)
    run.controllers.safe_ns = BEGIN_NS
    run.mark_end()
    run.t_ns += TICK_NS
    run.mark_trip()  # there is none yet
    run.controllers.trip = "EMCY_BRAKE"
    run.mark_trip()
    run.mark_trip()
    assert run.marked == [(BEGIN_NS, "safe"), (BEGIN_NS + TICK_NS, "trip EMCY_BRAKE")]


def test_a_trip_that_the_safe_state_has_is_not_marked_again():
    run = Virtual(BEGIN_NS, BEGIN_NS)
    run.controllers.safe_ns, run.controllers.trip = BEGIN_NS, "EMCY_BRAKE"
    run.mark_end()
    run.mark_trip()
    assert run.marked == [(BEGIN_NS, "trip EMCY_BRAKE")]
