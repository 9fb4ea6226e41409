"""Records: one class says what NumPy, Numba, mypy and the documents know of each."""

from __future__ import annotations

import ast
from typing import Annotated

import numpy as np
import pytest

from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import (
    FloatField,
    IntegerField,
    Record,
    RecordArray,
    copied,
    dtype_of,
    new_records,
    overwrite,
)
from places import ROOT

SOURCES = [
    path for top in ("coulombus", "host", "node", "eds", "sim_bus") for path in sorted((ROOT / top).rglob("*.py"))
]


class Inner(Record):
    """Within another one."""

    n: int
    x: float


class Outer(Inner):
    """Its base has the first fields."""

    inner: Inner
    rows: Annotated[RecordArray[Inner], 3]
    words: Annotated[IntegerField, 4]
    matrix: Annotated[FloatField, (2, 3)]
    small: Annotated[int, np.int16]
    bytes_: Annotated[IntegerField, 5, np.int8]


def test_the_dtype_is_what_the_class_declares():
    inner = [("n", "<i8"), ("x", "<f8")]
    assert dtype_of(Outer) == np.dtype(
        [
            *inner,
            *[("inner", inner), ("rows", inner, (3,)), ("words", "<i8", (4,))],
            *[("matrix", "<f8", (2, 3)), ("small", "<i2"), ("bytes_", "i1", (5,))],
        ],
        align=True,
    )


@kernel
def _fill(record: Outer) -> int:
    record.n = 7
    record.rows[1].x = 0.5
    record.words[2] = record.small = 3
    record.matrix[1, 2] = record.rows[1].x * 2
    return record.n + record.inner.n


def test_kernels_write_the_fields():
    records = new_records(Outer, 2)
    records[1].inner.n = 5
    assert _fill(records[1]) == 12
    record = records[1]
    assert (record.n, record.rows[1].x, record.words[2], record.small, record.matrix[1, 2]) == (7, 0.5, 3, 3, 1.0)
    assert records[0].n == 0


def test_a_name_that_numpy_has_already_is_refused():
    class Message(Record):
        data: int

    with pytest.raises(TypeError, match="Message: NumPy's records have data of their own"):
        dtype_of(Message)


def test_copies_are_of_their_own():
    records = new_records(Inner, 2)
    other = copied(records)
    other["n"] = 3
    assert list(records["n"]) == [0, 0]
    overwrite(records, other)
    assert list(records["n"]) == [3, 3]


def test_no_record_of_a_kernel_is_of_any_type():
    seen = 0
    for path in SOURCES:
        text = path.read_text()
        if "kernel" not in text:
            continue
        assert "Record: TypeAlias = Any" not in text, path
        for function in ast.walk(ast.parse(text)):
            if not isinstance(function, ast.FunctionDef) or not {"kernel", "inlined"} & {
                name.id for name in function.decorator_list if isinstance(name, ast.Name)
            }:
                continue
            for argument in function.args.args:
                kind = "" if argument.annotation is None else ast.unparse(argument.annotation)
                seen += 1
                assert kind not in ("", "Record", "np.record"), f"{path}:{function.lineno}: {argument.arg}"
    assert seen > 1000
