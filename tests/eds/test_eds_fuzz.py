"""Fuzzing of the EDS reader: whatever the bytes, a description with diagnoses or an EdsError, in
bounded time.
"""

from __future__ import annotations

import re

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from coulombus.eds.check import check
from coulombus.eds.cia301 import DATA_TYPES
from coulombus.eds.description import Description
from coulombus.eds.reader import EdsError, parse_eds
from eds_text import HEAD, record, variable
from places import EDS

PDO = "".join(
    f"[{index:04X}]\nParameterName=P\nObjectType=9\nSubNumber=3\n"
    + "".join(
        f"[{index:04X}sub{k}]\nParameterName=P\nDataType={kind}\nAccessType=rw\nDefaultValue={value}\n"
        for k, (kind, value) in enumerate(rows)
    )
    for index, rows in (
        (0x1800, ((5, 2), (7, "$NODEID+0x180"), (5, 1))),
        (0x1A00, ((5, 2), (7, "0x20000010"), (7, "0x00050008"))),
    )
)
SMALL = (HEAD + PDO + variable(DefaultValue="-5", LowLimit="-9", HighLimit="0x7FFF", PDOMapping="1")).split("\n")
LARGE = (EDS / "mr_brake.eds").read_text().split("\n")

WORDS = st.text(max_size=12) | st.sampled_from(
    (
        *("[", "]", "[2000]", "[2000sub1]", "[1A00sub1]", "[1800]", "[2000Name]", "[2000Value]", "=", ";", "#"),
        *("0x", "0xFFFFFFFFFFFFFFFFFF", "-0x8000", "-1", "007", "1e999", "nan", "inf", "1,5", "VAR", "0x9"),
        *("$NODEID", "$NODEID+", "+$NODEID+0x180", "0x180+$NODEID", "\x00", "\x1a", "\ufeff", "ü", "\ud7ff"),
        *("CompactSubObj=254", "CompactSubObj=0xFFFF", "SubNumber=999", "ObjectType=0x7", "LowLimit=5", "HighLimit=-5"),
        *("DataType=0x0008", "DataType=0x0001", "DataType=0x000F", "DataType=0x1B", "DefaultValue="),
        *(
            "ParameterValue=1",
            "ParameterValue=0x60410010",
            "[1A00Value]",
            "1=0x20000010",
            "[DeviceComissioning]",
            "NodeID=5",
        ),
    )
)
VALUES = WORDS | st.integers(-(1 << 70), 1 << 70).flatmap(lambda n: st.sampled_from([str(n), hex(n)]))


def examine(raw: bytes) -> Description | None:
    """Read, check, and hold what every description promises; None where it is refused."""
    try:
        description = parse_eds(raw, "fuzz.eds")
    except EdsError as error:
        refusal = str(error)
    else:
        refusal = ""
    if refusal:
        assert re.match(r"fuzz\.eds:\d+: .+; .+", refusal)
        return None
    lines = len(re.split(r"\r*\n|\r", description.text))
    report = check(description, 127)
    for d in report.diagnoses:
        assert 1 <= d.line <= lines
        assert d.text
        assert d.assumed
    for text in report.refusals:
        assert re.match(r"fuzz\.eds:\d+: .+; .+", text)
    for pdo in report.pdos:
        assert sum(entry.bits for entry in pdo.entries) <= 64
        assert -1 <= pdo.cob_id <= 0x7FF
    for entry in description.objects.values():
        for x in entry.variables.values():
            kind = DATA_TYPES.get(x.data_type)
            if kind and kind.kind == "int" and x.default is not None:
                low = -(1 << x.bits - 1) if kind.signed else 0
                assert low <= x.default < low + (1 << x.bits)
    return description


@settings(max_examples=120, deadline=None, derandomize=True)
@given(st.binary(max_size=400))
@example(b"")
@example(b"\xff\xfe")
@example(b"\x00[")
@example(b"[2000]\n" + b"9" * 10_000 + b"=" + b"9" * 10_000)
def test_random_bytes(raw):
    examine(raw)
    examine(b"[2000]\nParameterName=x\n" + raw)


@pytest.mark.thorough
@pytest.mark.slow
@settings(max_examples=120, deadline=None, derandomize=True)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["[1A00]", "[1A00sub0]", "[2000sub1]", "DefaultValue", "ParameterValue", "DataType"]),
            VALUES,
        ),
        max_size=20,
    )
)
def test_lines_of_known_and_unknown_words(rows):
    text = "\n".join(key if key[0] == "[" else f"{key}={value}" for key, value in rows)
    examine((HEAD + record("[2000sub0]", "[2000sub1]") + text).encode("utf-8", "replace"))


@pytest.mark.slow
@settings(max_examples=80, deadline=None, derandomize=True)
@given(st.data(), st.sampled_from(["utf-8", "cp1252", "utf-16", "utf-16-le"]), st.sampled_from(["\n", "\r\n", "\r"]))
def test_mutated_small_files(data, encoding, end):
    lines = list(SMALL)
    for _ in range(data.draw(st.integers(1, 12))):
        at = data.draw(st.integers(0, len(lines) - 1))
        key, _, value = lines[at].partition("=")
        lines[at : at + 1] = data.draw(
            st.sampled_from(
                [[], [lines[at]] * 2, [f"{key}={data.draw(VALUES)}"], [data.draw(WORDS) + lines[at]], [value]]
            )
        ) or [""]
    examine(end.join(lines).encode(encoding, "replace"))


@pytest.mark.slow
@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.integers(0, len("".join(LARGE))), st.integers(0, 255)), min_size=1, max_size=60))
def test_a_real_file_with_bytes_overwritten(changes):
    raw = bytearray("\n".join(LARGE).encode())
    for at, byte in changes:
        raw[at] = byte
    assert examine(bytes(raw)) is not None


def test_a_pdo_that_is_read_is_the_undamaged_one_or_said_to_be_another():
    """Each single character of a map's defaults that is replaced leads to another map by the file's
    own word, or to a refusal.
    """
    clean = check(parse_eds("\n".join(SMALL).encode(), "fuzz.eds"), 127).pdos[0].entries
    assert [(e.index, e.bits) for e in clean] == [(0x2000, 16), (5, 8)]
    text = "\n".join(SMALL)
    start = text.index("0x20000010")
    for at in range(start, start + 10):
        for character in "x#; zZg.":
            report = check(parse_eds((text[:at] + character + text[at + 1 :]).encode(), "fuzz.eds"), 127)
            if character != text[at]:
                assert report.refusals
                assert report.pdos == ()


def test_long_lines_and_many_sections_take_no_time_beyond_their_length():
    spaces, many = " " * 200_000, "".join(f"[{index:04X}]\nParameterName=n\n" for index in range(0x2000, 0x5000))
    for text in (
        f"[2000]\nDefaultValue=a{spaces}b\n",
        f"[2000{spaces}x]\n",
        "[" * 200_000,
        f"[2000]\nDefaultValue={'+' * 100_000}$NODEID\n",
        many,
    ):
        examine((HEAD + text).encode())
