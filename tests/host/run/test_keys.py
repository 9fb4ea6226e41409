"""Keys of the terminal, and the markers that they and other programs set."""

import json
import os
import termios
from pathlib import Path
from types import SimpleNamespace

import pytest

from coulombus.host.run.client_requests import ClientAnswers
from coulombus.host.run.deadman import HeldKey
from coulombus.host.run.markers import StruckKeys
from coulombus.host.run.run import Outputs
from coulombus.system.keyboard import Keys, in_foreground

RUN = SimpleNamespace(recorder=object(), failure=None, path=Path("r.pcapng"), now_ns=7)


def wait_for(done):
    """Wait for the keys' thread; the test's own time-out ends it."""
    while not done():
        os.sched_yield()


def test_each_stroke_is_heard_and_the_terminal_is_as_before(terminal):
    heard = []
    before = termios.tcgetattr(terminal)[3]
    with Keys(heard.append):
        assert termios.tcgetattr(terminal)[3] != before  # a key is read without Enter
        os.write(terminal, b"3")
        wait_for(lambda: heard)
    assert heard == [b"3"]
    assert termios.tcgetattr(terminal)[3] == before


def test_a_terminal_of_another_session_is_not_in_our_foreground(terminal):
    assert not in_foreground()


def test_other_keys_than_the_dead_mans_are_handed_on(terminal):
    others = []
    with HeldKey(lambda until_ns: None, others.append):
        os.write(terminal, b" 5 ")
        wait_for(lambda: others)
    assert others == [b"5"]


def test_the_keys_1_to_9_are_markers():
    keys = StruckKeys(lambda: 7)
    keys.strike(b"1x0 9\xff")
    assert list(keys.read_markers()) == [(7, "mark 1"), (7, "mark 9")]
    assert not list(keys.read_markers())


@pytest.mark.parametrize(
    ("strokes", "stop"), [(b"q", True), (b"12Q", True), (b"\x1b", True), (b"\x1b[A", True), (b"1 y", False)]
)
def test_q_and_escape_stop(strokes, stop):
    keys = StruckKeys(lambda: 7)
    keys.strike(strokes)
    keys.strike(b"1")
    assert keys.stop is stop


def answers(run):
    return ClientAnswers(run, None, None, "coulombus:bench", Outputs())


@pytest.mark.parametrize("text", ["", "  ", "a\nb", "a\x1b[2J", "x" * 196])
def test_a_text_that_is_no_marker_is_refused(text):
    run = SimpleNamespace(**vars(RUN), mark=None)
    assert "expected a text of 1 to 195 printable characters" in json.loads(answers(run).mark(text))["error"]


def test_a_text_marks_the_recording_as_a_persons():
    marked = []
    run = SimpleNamespace(**vars(RUN), mark=lambda t_ns, text: marked.append((t_ns, text)))
    told = json.loads(answers(run).mark(" phase hold "))  # no phase of the run's
    assert told == {"marker": "mark phase hold", "recording": "r.pcapng"}
    assert marked == [(7, "mark phase hold")]


def test_nothing_is_marked_where_nothing_is_recorded():
    run = SimpleNamespace(**(vars(RUN) | {"recorder": None}), mark=None)
    assert "it does not record" in json.loads(answers(run).mark("x"))["error"]
