"""Answers to a study by keys of a terminal, without Enter."""

import fcntl
import os
import pty
import sys
import termios
import threading
from types import SimpleNamespace

import pytest

from coulombus.cli import experiment
from coulombus.lab.study.trials import Trial

PAIR = Trial(1, 1, None, False, 2.2, 2.0, 1)
ONE = Trial(1, 1, None, False, 2.2, None, 0)


@pytest.fixture
def terminal(monkeypatch):
    """A pseudo-terminal that is the standard input, and this process' own; yields its other end."""
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "r") as file:
        monkeypatch.setattr("sys.stdin", file)
        monkeypatch.setattr(experiment, "in_foreground", lambda: True)
        yield ours
    os.close(ours)


@pytest.fixture
def people():
    return experiment._at_the_terminal(SimpleNamespace(file=SimpleNamespace(question="more?")))


def asked(terminal, ask, given, strokes):
    """Ask in a thread; strike the keys once the terminal gives them one by one."""
    found = []
    before = termios.tcgetattr(terminal)
    thread = threading.Thread(target=lambda: found.append(ask(given)))
    thread.start()
    while termios.tcgetattr(terminal)[3] & termios.ICANON:
        os.sched_yield()
    os.write(terminal, strokes)
    thread.join(30)
    assert found, "no answer was taken"
    assert termios.tcgetattr(terminal)[3] == before[3]  # as the shell had it
    return found[0]


@pytest.mark.parametrize(
    ("strokes", "answer"), [(b"1", "1"), (b"2", "2"), (b"x3\r 2", "2"), (b"q", None), (b"\x04", None)]
)
def test_a_key_answers_without_enter_and_other_keys_do_not(terminal, people, strokes, answer):
    assert asked(terminal, people.ask, PAIR, strokes) == answer


def test_what_was_struck_before_the_question_is_no_answer(terminal, people):
    os.write(terminal, b"1111\n")
    while int.from_bytes(fcntl.ioctl(sys.stdin, termios.FIONREAD, bytes(4)), sys.byteorder) < 5:
        os.sched_yield()  # the system passes strokes on later
    assert asked(terminal, people.ask, PAIR, b"2") == "2"


@pytest.mark.parametrize(("strokes", "goes_on"), [(b"y", True), (b"12q", False), (b"\x04", False)])
def test_a_break_ends_by_y_and_the_session_by_q(terminal, people, strokes, goes_on):
    assert asked(terminal, people.go_on, "Time for a break.", strokes) is goes_on


def test_a_magnitude_is_a_line(terminal, people, capsys):
    os.write(terminal, b"-1\nnan\n12.5\n")
    assert people.ask(ONE) == "12.5"
    assert capsys.readouterr().err.count("a number of 0 or more") == 3
    os.write(terminal, b"q\n")
    assert people.ask(ONE) is None


def test_keys_that_are_struck_one_behind_the_other_answer_one_question_each(terminal, people):
    assert asked(terminal, people.ask, PAIR, b"12") == "1"
    assert asked(terminal, people.ask, PAIR, b"2") == "2"
