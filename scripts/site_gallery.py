"""Draws the figures of docs/gallery.md when the site is built, by the page's own commands.

A comment `<!-- drawn: NAME -->` stands where the site shows the file NAME that a command above it
writes. The commands of sections with such a comment run one after the other in one folder.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from functools import cache
from hashlib import sha256
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory

from documented import commands_of
from places import ROOT

__all__ = ["DRAWN", "FOLDER", "PAGE", "commands", "digest", "pictures", "shown"]

PAGE = "gallery.md"
FOLDER = "gallery"
"""The pictures' folder on the site."""
DRAWN = re.compile(r"^<!-- drawn: (\S+) -->$", re.M)
SOURCES = ("coulombus", "host", "node", "sim_bus", "eds", "examples")
WIDTH_PX = 560
MOST_S = 1200
"""A command that takes longer ends the build; the first run compiles."""


def commands(text: str) -> list[str]:
    """Return the commands of the sections that have a picture of the site."""
    sections = re.split(r"^(?=## )", text, flags=re.M)
    return [line for section in sections if DRAWN.search(section) for line in commands_of(section)]


def pictures(text: str, builds: Path = ROOT / "out" / FOLDER) -> dict[str, bytes]:
    """Return a page's pictures by name: those of an earlier build with the same commands and
    sources, or new ones.

    Parameters
    ----------
    builds : folder of earlier builds

    Raises
    ------
    RuntimeError
        A command fails, or a picture is missing.
    """
    folder = builds / digest(commands(text))
    names = [Path(name).name for name in DRAWN.findall(text)]
    if not all((folder / name).is_file() for name in names):
        drawn = _drawn(text)
        rmtree(builds, ignore_errors=True)
        folder.mkdir(parents=True)
        for name, content in drawn.items():
            (folder / name).write_bytes(content)
    return {name: (folder / name).read_bytes() for name in names}


@cache
def _sources() -> bytes:
    """Return a digest of the sources that a picture may depend on."""
    whole = sha256()
    for top in SOURCES:
        for path in sorted(path for path in (ROOT / top).rglob("*") if path.suffix in (".py", ".toml", ".eds", ".csv")):
            whole.update(str(path.relative_to(ROOT)).encode() + sha256(path.read_bytes()).digest())
    return whole.digest()


def digest(lines: list[str]) -> str:
    """Return a name for the pictures that commands make with the present sources."""
    return sha256(_sources() + "\n".join(lines).encode()).hexdigest()[:16]


def _drawn(text: str) -> dict[str, bytes]:
    """Run the commands of a page, and return its pictures by name."""
    with TemporaryDirectory() as folder:
        (Path(folder) / "examples").symlink_to(ROOT / "examples")
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
        for line in commands(text):
            words = [sys.executable, "-m", *shlex.split(line)]
            done = subprocess.run(
                words, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=MOST_S
            )
            if done.returncode != 0 and not (done.returncode == 1 and line.startswith("coulombus diff ")):
                raise RuntimeError(f"{line}: exit status {done.returncode}: {done.stderr.strip()[-500:]}")
        contents: dict[str, bytes] = {}
        for name in DRAWN.findall(text):
            path = Path(folder) / name
            if not path.is_file():
                raise RuntimeError(f"no command of {PAGE} draws {name}")
            contents[path.name] = path.read_bytes()
        return contents


def shown(text: str) -> str:
    """Return the page with its pictures in place of the comments."""

    def picture(match: re.Match[str]) -> str:
        path = Path(match[1])
        return f"[![{path.stem}]({FOLDER}/{path.name}){{ width={WIDTH_PX} }}]({FOLDER}/{path.name})"

    return DRAWN.sub(picture, text)
