"""The afternoon of docs/deploy.md, performed: its commands as they stand there, in their order, and
each line of output that it shows.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from contextlib import suppress

import pytest

from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig
from places import ROOT
from real_bench import PATIENCE_S, Observer, end
from warm_start import Warm

__all__ = ["Afternoon", "blocks"]

PRINTED_BUS = "coulombus:lab"
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


class Afternoon:
    """Who runs the commands on `bus`: those that end with `&` go on beside the others.

    `instead` are the words that stand for --shared-machine, which a SocketCAN interface refuses.
    """

    def __init__(self, folder, bus, instead=("--shared-machine",)):
        self.folder, self.bus, self.instead = folder, bus, instead
        self.beside = {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in self.beside.values():
            end(process)

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

    def done(self, words):
        """Run a command to its end; again, up to three times, if a simulated node had to wait for a
        processor meanwhile and the host said so.
        """
        for _ in range(3):
            self.start(words)
            status, printed = self.finish(words[0])
            if status != TRIPPED or "--shared-machine" not in words or "TPDO_LOST" not in printed:
                break
        return status, printed

    def masked(self, text):
        """Return a line without its figures and its columns' widths."""
        text = re.sub(r"\s+", " ", text.replace(self.bus, PRINTED_BUS)).strip()
        if self.bus.startswith("socketcan:"):  # the kernel knows the bit rate
            text = text.replace(" is ready at 1 Mbit/s;", " is ready;")
        text = re.sub(r"\([0-9A-F]{4}h\)", "(#)", text)
        return re.sub(r"(?<![\w.])-?\d+(\.\d+)?(e-?\d+)?(?!\w)", "#", text)

    def shown(self, lines, printed):
        """Hold what the document shows against what was printed; figures may differ."""
        there = {self.masked(line) for line in printed.splitlines()}
        assert not [line for line in lines if self.masked(line) not in there], printed

    def words(self, line):
        """Return what to run for a line of the document, without `coulombus`."""
        words = shlex.split(line.partition(" | ")[0].replace(PRINTED_BUS, self.bus))[1:]
        return [part for word in words for part in (self.instead if word == "--shared-machine" else (word,))]

    def perform(self):
        """Do it all, and look at what came of it."""
        printed, runs = "", 0
        for kind, what in blocks():
            if kind == "shows":
                if what[0].startswith("coulombus: likely causes"):
                    status, printed = self.finish("run")
                    assert status == TRIPPED, printed
                    if "coulombus help TPDO_LOST" in printed:  # the other watch that sees it was first
                        continue
                    assert "--shared-machine" in self.instead, printed  # with the rig's own limits it always is
                self.shown(what, printed)
                continue
            words = self.words(what)
            verb = words[0]
            if verb == "emulate":
                self.start(words[:-1])
                printed = self.until("emulate", "is ready")
            elif words[-1] == "&":
                with Observer(self.bus) as observer:
                    observer.until_enabled(self.start(words[:-1]))
                runs += 1
            else:
                status, printed = self.done(words)
                refused = verb == "nmt" and "--beside-host" not in words
                allowed = (0, 1) if verb in EITHER else (REFUSED,) if refused else (0,)
                assert status in allowed, printed
                if verb == "stop":
                    status, told = self.finish("run")
                    assert status == 0, told
                    assert "coulombus stop" in told
        friction_Nm = load_rig(str(self.folder / "my-rig.toml")).one_axis().mechanics.friction_Nm
        assert friction_Nm == pytest.approx(0.2, rel=0.05)
        assert "<svg" in (self.folder / "my-rig.commission" / "report.html").read_text()
        assert (self.folder / "wakeup.png").stat().st_size > 1000
        assert read(self.folder / "trip.pcapng")["motor.target_torque_Nm"].values[-1] == 0
        assert runs == 2
