"""Functions that kernels call by an address in a record."""

from __future__ import annotations

import pytest

from coulombus.kernels.by_address import call_part, part_address
from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import Record, dtype_of, new_records


class Counter(Record):
    part: int
    count: int
    scale: float


def _add(n: Counter, a: int, b: int, c: int) -> int:
    n.count += a
    n.scale *= 0.5
    return n.count * b - c


def _subtract(n: Counter, a: int, b: int, c: int) -> int:
    n.count -= a
    return c - b


@kernel
def call(n: Counter, a: int, b: int, c: int) -> int:
    return call_part(n.part, n, a, b, c)


@pytest.fixture
def counter():
    record = new_records(Counter)[0]
    record["count"], record["scale"] = 30, 3.0
    return record


def test_the_function_acts_on_the_record_and_returns_its_result(counter):
    counter["part"] = part_address(_add, dtype_of(Counter))
    assert call(counter, 4, -3, 7) == 34 * -3 - 7
    assert (counter["count"], counter["scale"]) == (34, 1.5)


def test_each_record_has_its_own_function(counter):
    counter["part"] = part_address(_subtract, dtype_of(Counter))
    assert call(counter, 4, -3, 7) == 10
    assert (counter["count"], counter["scale"]) == (26, 3.0)


def test_a_function_has_the_same_address_each_time():
    assert part_address(_add, dtype_of(Counter)) == part_address(_add, dtype_of(Counter)) != 0
