"""The last line of `coulombus check`: what is proved, and what is open."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main


@pytest.fixture
def draft(tmp_path):
    path = tmp_path / "draft.toml"
    words = ["init", "--drive", "bench", "--brake", "bench", "--rehearse", "--no-trials", "-o", str(path)]
    assert CliRunner().invoke(main, words).exit_code == 0
    return path


def checked(path):
    """Return the last line, and what --json says."""
    text = CliRunner().invoke(main, ["check", "--rig", str(path)])
    told = CliRunner().invoke(main, ["check", "--rig", str(path), "--json"])
    assert text.exit_code == told.exit_code == 0
    return text.output.splitlines()[-1], json.loads(told.stdout)


def test_a_draft_with_a_guess_is_ok_to_rehearse_alone(draft):
    last, told = checked(draft)
    (guess,) = told["guesses"]
    assert "# CHECK:" in "".join(draft.read_text().splitlines()[guess["line"] - 5 : guess["line"]])
    assert last == f"ok to rehearse: 1 guess unproved (line {guess['line']})"


def test_without_marks_it_is_ok(draft):
    draft.write_text("".join(line for line in draft.read_text().splitlines(True) if "# CHECK:" not in line))
    last, told = checked(draft)
    assert (last, told["guesses"], told["losses"]) == ("ok", [], [])
