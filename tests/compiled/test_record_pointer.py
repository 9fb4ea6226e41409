"""A record comes into a kernel by its address."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from coulombus.compiled import record_pointer
from coulombus.compiled.decorator import JIT_DISABLED, Entry, kernel
from coulombus.compiled.records import new_records

KIND = np.dtype([("count", np.int64), ("rows", np.float64, (3, 2))])


@kernel
def moved(source: Any, target: Any) -> int:
    for i in range(3):
        for k in range(2):
            target.rows[i, k] = 2.0 * source.rows[i, k]
    target.count += 1
    return int(source.count)


@pytest.mark.parametrize("call", [moved, Entry(moved)])
@pytest.mark.parametrize(("source", "target"), [(0, 2), (2, 0), (1, 1)])
def test_a_kernel_works_on_the_records_that_it_is_given(call, source, target):
    records = new_records(KIND, 4)
    for k in range(4):
        records[k]["count"], records[k]["rows"][:] = 10 * k, k + 1
    before = records.copy()
    assert call(records[source], records[target]) == 10 * source + (source == target)
    assert records[target]["count"] == 10 * target + 1
    assert (records[target]["rows"] == 2 * (source + 1)).all()
    for k in {0, 1, 2, 3} - {target}:
        assert records[k] == before[k]


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_a_record_that_outlives_its_array_is_still_there():
    kept = [new_records(KIND, 2)[1] for _ in range(50)]
    for record in kept:
        moved(record, record)
    assert [int(record["count"]) for record in kept] == [1] * 50


def test_this_numpy_keeps_the_address_where_it_is_read():
    assert record_pointer._as_expected()


@pytest.mark.parametrize("place", [0, 16, 4096])
def test_where_numpy_keeps_it_elsewhere_numbas_own_way_stays(monkeypatch, place):
    monkeypatch.setattr(record_pointer, "OBVAL", place)
    assert not record_pointer.read_by_address()
