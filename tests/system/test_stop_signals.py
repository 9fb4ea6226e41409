"""Signals that end a verb, and the exit status that stands whatever becomes of the output."""

from __future__ import annotations

import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.system.stop_signals import (
    SIGNALS,
    InterruptsHeld,
    Signals,
    Stopped,
    StopSignals,
    as_exceptions,
    status_of,
    taken,
)
from places import ROOT

OTHERS = SIGNALS[1:]


def test_signals_are_taken_in_one_place():
    rooms = [path for path in (ROOT / "coulombus").iterdir() if path.is_dir()]
    sources = [path for room in rooms for path in room.resolve().rglob("*.py")]
    assert len(sources) > 200
    names = {path.name for path in sources if "signal.signal(" in path.read_text()}
    assert names == {"stop_signals.py"}
    assert {signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT} == set(SIGNALS)


@pytest.mark.parametrize("number", OTHERS)
@pytest.mark.parametrize("verb", ["check", "simulate"])
def test_each_signal_ends_a_verb_by_its_own_status(monkeypatch, verb, number):
    monkeypatch.setattr("coulombus.rigs.rig.load_rig", lambda *_: signal.raise_signal(number))
    result = CliRunner().invoke(main, [verb])
    assert result.exit_code == 128 + number == status_of(number)
    assert result.output == f"coulombus: ended by {signal.Signals(number).name}\n"
    assert signal.getsignal(number) is signal.SIG_DFL


def test_a_terminal_that_is_closed_sends_its_signal_twice_and_means_it_once():
    with as_exceptions():
        with pytest.raises(Stopped):
            signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGHUP)  # while what runs is being ended


@pytest.mark.parametrize("number", SIGNALS)
def test_whoever_waits_hears_of_each_signal(number):
    with StopSignals() as stop:
        assert not stop.wait(0)
        signal.raise_signal(number)
        assert stop.wait(0)
        assert stop.number == number


def test_nohup_is_heeded_and_a_background_job_is_stopped_all_the_same():
    heard = []
    before = {number: signal.signal(number, signal.SIG_IGN) for number in SIGNALS}
    try:
        with taken(lambda number, frame: heard.append(number)):
            for number in SIGNALS:
                signal.raise_signal(number)
        assert heard == [number for number in SIGNALS if number != signal.SIGHUP]
        assert {signal.getsignal(number) for number in SIGNALS} == {signal.SIG_IGN}
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@pytest.mark.parametrize("number", OTHERS)
def test_a_kernel_holds_every_signal_back(number):
    with as_exceptions(), InterruptsHeld() as held:
        signal.raise_signal(number)
        with pytest.raises(Stopped):
            held.pass_on()


PRINTS = (
    "import click; from coulombus.system.exit import verdict; from coulombus.cli.errors import errors\n"
    "with errors(), verdict({status}): click.echo('x' * 100)"
)


def end_of(status, stdout):
    code = PRINTS.format(status=status)
    with stdout:
        done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, stdout=stdout, stderr=subprocess.PIPE, text=True)
    return done.returncode, done.stderr


@pytest.mark.parametrize("status", [0, 1, 7])
def test_a_reader_that_has_gone_hides_no_status(status):
    with subprocess.Popen(["true"], stdin=subprocess.PIPE) as reader:
        reader.wait()
        assert end_of(status, reader.stdin) == (status, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_hides_no_trip():
    status, err = end_of(7, open("/dev/full", "wb"))  # noqa: SIM115
    assert status == 7
    assert "No space left on device" in err
    assert end_of(0, open("/dev/full", "wb"))[0] != 0  # noqa: SIM115


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_before_a_run_passes_every_broad_except(number):
    """It was an Exception: a broad except on its way (a law that is compiled, a recording that is
    closed) swallowed it.
    """
    with Signals() as signals, pytest.raises(Stopped, match="before the run had begun") as stopped, suppress(Exception):
        signal.raise_signal(number)
    assert stopped.value.number == signals.number == number
    assert not isinstance(stopped.value, Exception)


def test_a_signal_of_a_run_is_remembered_once_it_is_deferred():
    with Signals() as signals:
        signals.stop()
        signals.defer()
        signals.stop()
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        assert signals.number == signal.SIGTERM
        with pytest.raises(Stopped, match="SIGTERM before the run had begun"):
            signals.stop()
