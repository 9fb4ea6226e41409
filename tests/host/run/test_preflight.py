"""The place that a refusal and a trip name: the line of this project that a report needs."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from coulombus.host.errors import SafetyTrip
from coulombus.host.run import preflight
from coulombus.host.run.preflight import place_of, refusing
from coulombus.recording.file_content import unpack_late
from coulombus.rigs.errors import RigError


def frame(file, line, following=None):
    """Return an entry of a traceback, as Python links them: the innermost is the last one."""
    code = SimpleNamespace(co_filename=str(file))
    return SimpleNamespace(tb_frame=SimpleNamespace(f_code=code), tb_lineno=line, tb_next=following)


OUTER, INNER = preflight.PROJECT / "host" / "a.py", preflight.PROJECT / "host" / "run" / "b.py"


@pytest.mark.parametrize(
    ("lines", "place"),
    [
        ([(OUTER, 3)], "a.py:3"),
        ([(OUTER, 3), (INNER, 7)], "b.py:7"),
        ([(INNER, 7), (OUTER, 3)], "a.py:3"),
        ([(OUTER, 3), (INNER, 7), (json.__file__, 9)], "b.py:7"),
        ([(OUTER, 3), (json.__file__, 9), (INNER, 7), ("<string>", 1), ("<frozen os>", 2)], "b.py:7"),
        ([(preflight.PROJECT.parent / "numpy" / "core.py", 3)], ""),
        ([], ""),
    ],
)
def test_the_place_is_the_innermost_line_of_this_project(lines, place):
    trace = None
    for file, line in reversed(lines):
        trace = frame(file, line, trace)
    assert place_of(trace) == place


def test_an_error_of_a_library_is_named_by_the_line_that_called_it():
    """It was the line of json or pathlib, which says nothing about the cause."""
    with pytest.raises(ValueError, match="Expecting value") as caught:
        unpack_late(b"")
    lines = Path(unpack_late.__code__.co_filename).read_text(encoding="utf-8").splitlines()
    name, _, line = place_of(caught.value.__traceback__).partition(":")
    assert name == "file_content.py"
    assert "json.loads" in lines[int(line) - 1]


def test_a_refusal_has_kind_text_and_place_of_an_unexpected_error():
    with pytest.raises(SafetyTrip, match=r"^arming refused: JSONDecodeError: .*\(file_content\.py:\d+\)$"), refusing():
        unpack_late(b"")
    with pytest.raises(SafetyTrip, match=r"^arming refused: KeyError \("), refusing():
        raise KeyError
    with pytest.raises(RigError, match=r"^a\.toml: no$"), refusing():
        raise RigError(["a.toml: no"])
