"""The afternoon of docs/deploy.md: its commands as they stand there, in their order, on a bus with
devices that have no node id; and each line of output that it shows.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from contextlib import suppress

import pytest

from coulombus.recording.signals import read
from coulombus.rigs.rig import load_rig
from real_bench import PATIENCE_S, ROOT, Observer, end
from warm_start import Warm

pytestmark = [pytest.mark.real_time, pytest.mark.slow]

BUS = f"coulombus:lab-{os.getpid()}"
TEXT = (ROOT / "docs" / "deploy.md").read_text()
EITHER = ("doctor", "measure")
"""What they end with depends on the machine: 0 or 1."""
REFUSED, TRIPPED = 7, 7


def blocks():
    """Return what the document has in its order: ("command", line) and ("shows", lines)."""
    text = re.sub(r" \\\n\s+", " ", TEXT)
    found = []
    for piece in re.finditer(r"^    (coulombus [^\n]*)$|^```\n(.*?)^```$", text, re.M | re.S):
        found.append(("command", piece[1]) if piece[1] else ("shows", piece[2].splitlines()))
    return found


def masked(text):
    """Return a line without its figures and its columns' widths."""
    text = re.sub(r"\s+", " ", text.replace(BUS, "coulombus:lab")).strip()
    text = re.sub(r"\([0-9A-F]{4}h\)", "(#)", text)
    return re.sub(r"(?<![\w.])-?\d+(\.\d+)?(e-?\d+)?(?!\w)", "#", text)


def shown(lines, printed):
    """Hold what the document shows against what was printed; figures may differ."""
    there = {masked(line) for line in printed.splitlines()}
    assert not [line for line in lines if masked(line) not in there], printed


class Afternoon:
    """Who runs the commands: those that end with `&` go on beside the others."""

    def __init__(self, folder):
        self.folder, self.beside = folder, {}

    def start(self, words):
        name = words[0]
        environment = {**os.environ, "COLUMNS": "80"}
        with (self.folder / f"{name}.out").open("w") as out:
            self.beside[name] = Warm(words, cwd=self.folder, stdout=out, stderr=subprocess.STDOUT, env=environment)
        return self.beside[name]

    def printed(self, name):
        return (self.folder / f"{name}.out").read_text()

    def until(self, name, text):
        """Wait until it has printed a text."""
        while text not in self.printed(name):
            with suppress(subprocess.TimeoutExpired):
                raise AssertionError(f"ended with {self.beside[name].wait(0.05)}: {self.printed(name)}")
        return self.printed(name)

    def finish(self, name):
        process = self.beside.pop(name)
        status = process.wait(PATIENCE_S)
        return status, self.printed(name)


@pytest.fixture
def afternoon(tmp_path):
    day = Afternoon(tmp_path)
    yield day
    for process in day.beside.values():
        end(process)


def test_the_document_has_the_whole_afternoon():
    verbs = [shlex.split(line)[1] for kind, line in blocks() if kind == "command"]
    wanted = "sim scan lss lss sdo init check measure doctor commission commission run status stop run nmt nmt decode"
    assert verbs == wanted.split()


def test_the_afternoon_as_it_is_printed(afternoon, tmp_path):
    printed, runs = "", 0
    for kind, what in blocks():
        if kind == "shows":
            if what[0].startswith("coulombus: likely causes"):
                status, printed = afternoon.finish("run")
                assert status == TRIPPED, printed
            shown(what, printed)
            continue
        words = shlex.split(what.partition(" | ")[0].replace("coulombus:lab", BUS))[1:]
        beside = words[-1] == "&"
        verb = words[0]
        if verb == "sim":
            afternoon.start(words[:-1])
            printed = afternoon.until("sim", "is ready")
        elif beside:
            with Observer(BUS) as observer:
                observer.until_enabled(afternoon.start(words[:-1]))
            runs += 1
        else:
            afternoon.start(words)
            status, printed = afternoon.finish(verb)
            refused = verb == "nmt" and "--beside-host" not in words
            allowed = (0, 1) if verb in EITHER else (REFUSED,) if refused else (0,)
            assert status in allowed, printed
            if verb == "stop":
                status, told = afternoon.finish("run")
                assert status == 0, told
                assert "coulombus stop" in told
    assert load_rig(str(tmp_path / "my-rig.toml")).one_axis().mechanics.friction_Nm == pytest.approx(0.2, rel=0.05)
    assert "<svg" in (tmp_path / "my-rig.commission" / "report.html").read_text()
    assert (tmp_path / "wakeup.png").stat().st_size > 1000
    assert read(tmp_path / "trip.pcapng")["motor.target_torque_Nm"].values[-1] == 0
    assert runs == 2
