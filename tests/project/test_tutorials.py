"""Each tutorial as it is printed, from an empty folder: its files, its commands, what it shows."""

from __future__ import annotations

import json
import re

import pytest

from places import ROOT
from reader import Reader, missing

TUTORIALS = ROOT / "docs" / "tutorials"
NOT_RUN = ("dask ", "coulombus sweep still.toml -o out --dask")
"""Commands of a cluster: tests/lab runs a sweep on one."""
NOTEBOOKS = (
    "own-law.ipynb",
    "recording.ipynb",
    "limit-cycle.ipynb",
    "commission-a-rig.ipynb",
    "friction-in-the-plane.ipynb",
)
pytestmark = pytest.mark.slow


def pieces(page):
    """Yield what a page has, in its order: ("file", name, text), ("command", line), ("shows", lines)."""
    text = re.sub(r" \\\n\s+", " ", (TUTORIALS / page).read_text())
    for piece in re.finditer(r'^```(\w*)(?: title="([^"]+)")?\n(.*?)^```$|^    (\S[^\n]*)$', text, re.M | re.S):
        language, title, inside, command = piece.groups()
        if command is not None:
            yield "command", command
        elif title is not None:
            yield "file", title, inside
        elif not language:
            yield "shows", inside.splitlines()


def follow(page, folder):
    """Follow a page; what needs a program that is not installed is left out, with what it shows."""
    shown, absent = 0, []
    left_out = False
    with Reader(folder) as reader:
        for kind, *what in pieces(page):
            if kind == "file":
                (folder / what[0]).write_text(what[1])
            elif kind == "command":
                left_out = missing(what[0]) or what[0].startswith(NOT_RUN)
                absent += missing(what[0])
                if not left_out:
                    reader.command(what[0])
            elif not left_out:
                reader.shows(*what)
                shown += 1
    assert shown
    if absent:
        pytest.skip(f"all other commands passed; not installed: {', '.join(dict.fromkeys(absent))}")


@pytest.mark.parametrize(
    "page", ["first-experiment.md", "first-rig.md", "my-machine-stopped.md", "plane.md", "sweep.md", "study.md"]
)
def test_a_tutorial_in_virtual_time(page, tmp_path):
    follow(page, tmp_path)


@pytest.mark.thorough
@pytest.mark.real_time
@pytest.mark.parametrize("page", ["break-a-bus.md", "can-tour.md", "own-device.md"])
def test_a_tutorial_on_a_live_bus(page, tmp_path, private_sockets):
    folder = tmp_path / "desk"
    folder.mkdir()
    follow(page, folder)


@pytest.mark.thorough
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_from_its_first_cell_to_its_last(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    cells = json.loads((TUTORIALS / name).read_text())["cells"]
    scope = {"__name__": "__main__"}
    for cell in cells:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []  # nothing recorded is kept
            exec(compile("".join(cell["source"]), f"{name}:{cell['id']}", "exec"), scope)
    assert capsys.readouterr().out


def test_every_tutorial_is_followed():
    found = {path.name for path in TUTORIALS.iterdir()}
    assert found == {
        *("index.md", "first-experiment.md", "first-rig.md", "sweep.md", "study.md", "can-tour.md", "own-device.md"),
        "break-a-bus.md",
        *(*NOTEBOOKS, "my-machine-stopped.md", "plane.md"),
    }
