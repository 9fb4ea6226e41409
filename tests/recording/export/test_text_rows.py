"""Rows of text made of pieces, and times as Python writes them."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.recording.export.text_rows import TextRows, texts_of, times_of


def joined(rows, *places):
    content, _, begins = rows.joined(np.concatenate(places))
    return content.decode(), begins.tolist()


@pytest.mark.parametrize("most", [10**6, 10**9, 10**12, 10**15, 10**18])
def test_times_are_those_of_python(most):
    drawn = np.random.default_rng(most % 97).integers(-1 if most > 10**14 else 10**5, most, 3000)
    rounded = drawn // 10**6 * 10**6
    for t_ns in (drawn, rounded, np.maximum(drawn, 10**5), np.maximum(rounded, 10**5)):
        texts, numbers = times_of(t_ns)
        assert texts == [repr(t_s) for t_s in (t_ns / 1e9).tolist()]
        assert numbers.tolist() == list(range(len(t_ns)))


def test_the_edges_of_what_is_written_by_digits():
    assert times_of(np.zeros(0, np.int64))[0] == []
    for t_ns in (-1, 0, 10**5 - 1, 10**5, 999_999_999, 10**9, 123_456_789_012_345, 10**15 - 1, 10**15):
        assert times_of(np.array([t_ns]))[0] == [repr(t_ns / 1e9)]


@pytest.mark.parametrize(
    ("values", "word", "others", "expected"),
    [
        ([2.0, np.nan, 0.1, 2.0, np.nan], False, {"nan": "null"}, ["2.0", "null", "0.1", "2.0", "null"]),
        (
            [np.inf, 1e300, -np.inf, -1.5],
            False,
            {"inf": "1e999", "-inf": "-1e999"},
            ["1e999", "1e+300", "-1e999", "-1.5"],
        ),
        ([np.inf, np.nan, -np.inf], False, {"nan": ""}, ["inf", "", "-inf"]),
        ([2.0, np.nan, -7.0], True, {"nan": ""}, ["2", "", "-7"]),
        (np.array([2**64 - 1, 0], np.uint64), True, {}, ["18446744073709551615", "0"]),
        ([], False, {}, []),
    ],
)
def test_numbers_are_texts_and_others_are_named(values, word, others, expected):
    texts, numbers = texts_of(np.asarray(values), word, others)
    assert [texts[k] for k in numbers] == expected


def test_rows_of_several_tables_come_in_the_order_of_their_places():
    rows = TextRows()
    sizes = rows.add("a%s-%s\n", [(["x", "yy"], np.array([0, 1, 0])), (["1", "\u00e9"], np.array([1, 0, 0]))])
    assert sizes.tolist() == [6, 6, 5]
    rows.add("%s", [(["# note\n"], np.array([0]))])
    assert joined(rows, [0, 1, 4], [0.5]) == ("ax-\u00e9\n# note\nayy-1\nax-1\n", [0, 13, 19, 6])


def test_heads_stand_before_the_rows_of_the_last_table():
    rows = TextRows()
    rows.add("%s;", [(["a", "b"], np.array([0, 1]))])
    rows.put_before(np.frombuffer(b"H1H2", "S2"))
    rows.add("%s;", [(["c"], np.array([0]))])
    assert joined(rows, [2, 0], [1])[0] == "H2b;c;H1a;"
