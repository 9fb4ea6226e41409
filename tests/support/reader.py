"""Somebody who follows a page of the documents in a folder, command by command."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

from real_bench import PATIENCE_S, end
from warm_start import Warm

__all__ = ["Reader", "missing"]

OPTIONAL = ("tshark", "candump", "cansend", "cangen", "canplayer", "chromium", "wireshark", "gcc", "cyclictest")

READY = ("is ready", "is on bus", "waits on bus", "are joined")


def missing(line):
    """Return the optional programs that a command line calls and that are not installed."""
    called = (part.split()[:1] for part in line.split(" | "))
    return [word for words in called for word in words if word in OPTIONAL and shutil.which(word) is None]


class Reader:
    """Who follows a page in a folder: `coulombus` starts warm, everything else in a shell."""

    def __init__(self, folder):
        self.folder, self.beside, self.printed, self.tells = folder, [], "", None
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        self.environment = {**os.environ, "PATH": path, "COLUMNS": "100"}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in self.beside:
            end(process)

    def start(self, line, out, beside):
        given = {
            "cwd": self.folder,
            "env": self.environment,
            "stdin": subprocess.DEVNULL,
            "stdout": out,
            "stderr": subprocess.STDOUT,
        }
        words = shlex.split(line, comments=True)
        if words[0] == "coulombus" and not set(words) & {"|", "<", ">"}:
            return Warm(words[1:], **given)
        return subprocess.Popen(["bash", "-o", "pipefail", "-c", f"exec {line}" if beside else line], **given)

    def command(self, line):
        wanted = re.search(r"# exit status (\d+)", line)
        out = self.folder / f".out-{len(self.beside)}"
        with out.open("w") as file:
            process = self.start(line.removesuffix(" &"), file, line.endswith(" &"))
        if line.endswith(" &"):
            self.beside.append(process)
            self.tells = process, out
            deadline = time.monotonic() + PATIENCE_S
            while not any(word in out.read_text() for word in READY):
                assert process.poll() is None, out.read_text()
                assert time.monotonic() < deadline, out.read_text()
                time.sleep(0.02)
        else:
            self.tells = None
            status = process.wait(PATIENCE_S)
            assert status == int(wanted[1] if wanted else 0), f"{line}: {status}\n{out.read_text()}"
        self.printed = out.read_text()

    def shows(self, lines):
        """Each line that the page shows is a part of a line that was printed, but for blanks.

        A command that runs beside may still be about to print it.
        """
        deadline = time.monotonic() + PATIENCE_S
        while True:
            alive = self.tells is not None and self.tells[0].poll() is None
            if self.tells is not None:
                self.printed = self.tells[1].read_text()
            there = [" ".join(line.split()) for line in self.printed.splitlines()]
            missing = [line for line in lines if not any(" ".join(line.split()) in one for one in there)]
            if not missing or not alive or time.monotonic() > deadline:
                break
            time.sleep(0.02)
        assert missing == [], f"not in:\n{self.printed}"
