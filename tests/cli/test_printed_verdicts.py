"""Who reads the standard output, or whether it takes anything, does not decide what a verb comes
to: each with a reader gone, closed, full.
"""

from __future__ import annotations

import errno
import os
import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

from coulombus.cli.main import main
from coulombus.kernels.records import new_records
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.wire.frame import Frame
from places import ROOT
from warm_start import Warm, WithoutStdout

real_run, run_verb = import_module("coulombus.host.run.real_run"), import_module("coulombus.cli.run")
EDS = shlex.quote(str(ROOT / "eds" / "motor.eds"))

ENDS = {
    "help": ("help exit", 0),
    "demo": ("demo --virtual --out /dev/null/out", 2),
    "simulate": ("simulate --seconds -1", 2),
    "sweep": ("sweep NONE.toml -o /dev/null/sweep", 3),
    "experiment": ("experiment NONE.toml -o out --subject S01", 3),
    "emulate": ("emulate --bus coulombus:none/", 2),
    "node": ("node NONE.eds --node-id 1 --bus coulombus:none", 3),
    "run": ("run --bus coulombus:none", 4),
    "stop": ("stop --bus coulombus:none", 4),
    "status": ("status --bus coulombus:none", 4),
    "watch": ("watch --bus coulombus:none", 4),
    "world": ("world --bus coulombus:none/", 2),
    "mark": ("mark grasp --bus coulombus:none", 4),
    "set": ("set F_s=2.0 --bus coulombus:none", 4),
    "replay": ("replay RECORDING --bus coulombus:none", 4),
    "bridge": ("bridge coulombus:none coulombus:other", 4),
    "conformance": (f"conformance --bus coulombus:none --node 1 --eds {EDS}", 4),
    "scan": ("scan --bus coulombus:none", 4),
    "lss": ("lss --bus coulombus:none", 4),
    "sdo": ("sdo get 1 1000h --bus coulombus:none", 4),
    "nmt": ("nmt start 1 --bus coulombus:none", 4),
    "warm-up": ("warm-up", 0),
    "eds": ("eds check OTHER", 3),
    "eds ok": (f"eds check {EDS}", 0),
    "init": (f"init --drive {EDS} --brake bench", 0),
    "doctor": ("doctor --bus socketcan:none7", 1),
    "systemd": ("systemd -o /dev/null/units", 2),
    "check": ("check --rig bench --set bus.bitrate_bit_s=125000", 1),
    "check ok": ("check --rig bench", 0),
    "measure": ("measure --bus coulombus:none", 4),
    "commission": ("commission --rig NONE.toml --virtual --yes", 3),
    "commission list": ("commission --list", 0),
    "inject": ("inject noise --on bus --bus coulombus:none", 4),
    "clear": ("clear --bus coulombus:none", 4),
    "plan": ("plan --rig bench --bitrate 125000", 1),
    "plan ok": ("plan --rig bench --json", 0),
    "explain": ("explain RECORDING", 0),
    "decode": ("decode RECORDING --rig bench", 0),
    "hz": ("hz RECORDING --rig bench", 0),
    "pdo": ("pdo", 0),
    "dbc": ("dbc", 0),
    "plot": ("plot RECORDING -o /dev/null/run.png", 2),
    "diff": ("diff RECORDING RECORDING --rig bench", 0),
    "export": ("export RECORDING --to csv -o /dev/null/run.csv", 2),
    "tools": ("tools /dev/null/tools", 2),
    "identify": ("identify RECORDING --rig bench", 1),
    "analyse": ("analyse fig10 --window 0.1", 0),
    "law": ("law dahl --motion OTHER", 3),
    "law list": ("law", 0),
}
"""Name -> a call, and what it ends with."""


@pytest.fixture
def call(tmp_path, private_sockets):
    """Return a function that runs a verb with a standard output of some kind, and returns its
    status and its stderr.
    """
    with PcapngWriter(tmp_path / "recording.pcapng", attachments={}) as writer:
        writer.write(new_records(Frame, 3))
    (tmp_path / "other").write_text("no EDS file\n")

    def run(words, stdout, cold=False):
        words = words.replace("RECORDING", str(tmp_path / "recording.pcapng")).replace("OTHER", str(tmp_path / "other"))
        options = {"cwd": ROOT, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL, "text": True}
        command = [sys.executable, "-m", "coulombus", *shlex.split(words)]
        if stdout == "closed" and cold:  # what Python starts with
            process = subprocess.Popen(["sh", "-c", f"exec {shlex.join(command)} >&-"], **options)
        elif stdout == "closed":
            process = WithoutStdout(shlex.split(words), **options)
        else:
            end = _without_reader() if stdout == "reader gone" else os.open("/dev/full", os.O_WRONLY)
            try:
                process = (subprocess.Popen if cold else Warm)(
                    command if cold else shlex.split(words), stdout=end, **options
                )
            finally:
                os.close(end)
        err = process.communicate(timeout=300)[1]
        assert "Traceback" not in err, err
        assert "Exception" not in err, err
        return process.returncode, err

    return run


def _without_reader():
    reading, writing = os.pipe()
    os.close(reading)
    return writing


def test_every_verb_is_in_this_test():
    assert {name.split()[0] for name in ENDS} == set(main.commands)


@pytest.mark.parametrize("name", ENDS)
@pytest.mark.parametrize("stdout", ["reader gone", "closed"])
def test_a_reader_that_has_gone_changes_no_status(call, name, stdout):
    words, status = ENDS[name]
    assert call(words, stdout)[0] == status


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["simulate", "eds ok", "decode", "law list"])
def test_python_itself_may_start_without_a_stdout(call, name):
    words, status = ENDS[name]
    assert call(words, "closed", cold=True)[0] == status


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize("name", ENDS)
def test_a_full_disk_is_an_error_and_hides_none(call, name):
    words, status = ENDS[name]
    found, err = call(words, "full")
    assert found == (status or 2), err
    if status == 0:
        assert "No space left on device" in err


def test_a_trip_is_told_where_no_file_can_be_opened_for_its_table(monkeypatch, capsys):
    trip = "HOST: OSError: [Errno 24] Too many open files (socket.py:293)"

    def no_file(*_):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(real_run, "real_run", lambda *_, **__: SimpleNamespace(trip=trip, exit_status=7))
    monkeypatch.setattr(run_verb, "print_runs", no_file)
    with pytest.raises(SystemExit) as ended:
        main(["run", "--bus", "coulombus:none"])
    assert ended.value.code == 7
    told = " ".join(capsys.readouterr().err.split())
    assert f"cannot be printed: Too many open files coulombus: trip: {trip}" in told
    assert "coulombus help HOST" in told


@pytest.mark.parametrize("words", ["--help", "run --help", "--version"])
def test_what_is_printed_in_front_of_a_verb_has_the_same_ends(call, words):
    assert call(words, "reader gone", cold=True)[0] == 0
    if Path("/dev/full").exists():
        assert call(words, "full", cold=True) == (
            2,
            "coulombus: No space left on device; free some space, or write elsewhere\n",
        )
