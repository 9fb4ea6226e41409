"""A record's misspelt field, or a wrong type, does not pass `make check`, which runs this beside mypy: it uses mypy's cache."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from places import ROOT

PLANTED = """
from typing import Annotated

from coulombus.kernels.records import IntegerField, Record, RecordArray


class State(Record):
    phase: int
    gain: float
    track: Annotated[IntegerField, 4]


def step(h: State, states: RecordArray[State]) -> int:
    h.phase = 1
    h.gain = 1
    h.phse = 1
    h.phase = 0.5
    states[0].phse = 1
    states[0].track[1] = 2
    states[0].track[1] = 0.5
    return states[0].phase
"""


@pytest.mark.long
def test_a_misspelt_field_and_a_wrong_type_are_found_by_mypy(tmp_path):
    path = tmp_path / "planted.py"
    path.write_text(PLANTED)
    command = [sys.executable, "-m", "mypy", "--strict", str(path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=800)
    messages = dict(re.findall(r":(\d+): error: (.*)  \[", done.stdout))
    assert messages == {
        "16": '"State" has no attribute "phse"; maybe "phase"?',
        "17": 'Incompatible types in assignment (expression has type "float", variable has type "int")',
        "18": '"State" has no attribute "phse"; maybe "phase"?',
        "20": 'No overload variant of "__setitem__" of "IntegerField" matches argument types "int", "float"',
    }
