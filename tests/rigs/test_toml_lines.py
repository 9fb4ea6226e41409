"""The scan for lines, and files that are damaged at random."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.rigs.rig import RigError, load_rig, load_rig_text
from coulombus.rigs.toml_lines import read_toml
from places import RIGS, ROOT

BENCH = (RIGS / "bench.toml").read_text(encoding="utf-8")
EDS = {name: (ROOT / "eds" / name).read_text(encoding="utf-8") for name in ("motor.eds", "mr_brake.eds")}


def test_the_line_of_every_key() -> None:
    text = 'a.b = 1\n[s]\nx = [1, # one ]\n  2]\ny = """\n[no]\nz = 1\n"""\n"q.r" = \'#\'\n[[t]]\nk = 1\n[t.u]\nv = 2\n[[t]]\nk = {m = 1}\n'
    document = read_toml(text)
    assert document.problems == []
    assert document.lines == {
        ("a", "b"): 1, ("s",): 2, ("s", "x"): 3, ("s", "y"): 5, ("s", "q.r"): 9, ("t", 0): 10, ("t", 0, "k"): 11,
        ("t", 0, "u"): 12, ("t", 0, "u", "v"): 13, ("t", 1): 14, ("t", 1, "k"): 15,
    }  # fmt: skip
    assert document.line(("t", 1, "k", "m")) == 15
    assert document.line(("nowhere",)) == 1
    assert document.values["t"][1] == {"k": {"m": 1}}


@settings(max_examples=60, deadline=None, derandomize=True)
@given(data=st.data())
def test_a_damaged_file_is_read_or_refused_with_lines(data: st.DataObject) -> None:
    text = BENCH
    tokens = [
        *"[]{}\"'=#.,\n\\a1-_ \r\0",
        '"""',
        "'''",
        "[[",
        "nan",
        "[bus]",
        "9" * 5000,
        "[[phase]]",
        "\N{MICRO SIGN}",
        "]" * 2000,
    ]
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text) - 1))
        gone = data.draw(st.sampled_from([0, 0, 1, 4, 40]))
        text = text[:at] + data.draw(st.sampled_from(["", *tokens])) + text[at + gone :]
    mistakes: tuple[str, ...] = ()
    try:
        rig = load_rig_text(text, "r.toml", EDS)
    except RigError as error:
        mistakes = error.errors
    else:
        assert load_rig_text(rig.effective(), "again", EDS) == rig
    assert len(set(mistakes)) == len(mistakes)
    for mistake in mistakes:
        place = re.match(r"r\.toml:(\d+): ", mistake)
        assert place, mistake
        assert 1 <= int(place[1]) <= text.count("\n") + 1


@pytest.mark.parametrize(
    ("text", "mistake"),
    [
        ("x = " + "[" * 100_000 + "]" * 100_000, "more than 32 brackets within each other"),
        ("x = " + "{a=" * 100_000, "more than 32 brackets within each other"),
        ("x = " + "9" * 5_000, "a number or a name of more than 500 characters"),
        ("k" * 100_000 + " = 1", "a number or a name of more than 500 characters"),
        (".".join("a" * 50_000) + " = 1", "a key of more than 16 parts"),
        ("[" + ". ".join("a" * 50_000) + "]", "a key of more than 16 parts"),
        ("x\n" * 100_000, "lines; expected at most 10000"),
        ("#" * (1 << 25), "characters; expected at most"),
    ],
    ids=["nested", "inline", "digits", "key", "parts", "header", "lines", "long"],
)
def test_what_would_keep_a_reader_busy_for_minutes_is_refused_at_once(text: str, mistake: str) -> None:
    document = read_toml("a = 1\n" + text)
    ((line, problem),) = document.problems
    assert mistake in problem
    assert line in (1, 2, 10_001)
    assert document.is_broken(("a",))


def test_long_texts_and_comments_and_deep_texts_are_read() -> None:
    text = (
        f'# {"x" * 10_000}\na = "{"[" * 10_000}" # {"]" * 1000}\nb = \'{"y" * 10_000}\'\nc = """\n{"z" * 10_000}\n"""\n'
    )
    document = read_toml(text)
    assert document.problems == []
    assert set(document.values) == {"a", "b", "c"}


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero"), lambda path: path.mkdir()])
def test_a_rig_file_without_an_end_is_refused(tmp_path: Path, make: Callable[[Path], None]) -> None:
    make(tmp_path / "rig.toml")
    with pytest.raises(RigError, match=r"rig\.toml: cannot be read"):
        load_rig(str(tmp_path / "rig.toml"))
