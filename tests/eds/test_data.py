"""Bytes of an object's value: those that only extend a number."""

from __future__ import annotations

import pytest

from coulombus.eds.data import without_fill
from coulombus.eds.reader import Variable


def variable(data_type):
    return Variable(0x2100, 0, "X", data_type, "rw", None, False, None, None, False, 1)


@pytest.mark.parametrize(
    ("data", "data_type", "left"),
    [
        (b"\x05\0\0\0", 0x05, b"\x05"),  # UNSIGNED8
        (b"\xff\0\0\0", 0x05, b"\xff"),
        (b"\xff\xff\xff\xff", 0x05, None),
        (b"\x05\0\0\x01", 0x05, None),
        (b"\x05\x01\0\0", 0x05, None),
        (b"\x05", 0x05, None),
        (b"", 0x05, None),
        (b"\x05\0", 0x05, b"\x05"),
        (b"\x7f\0\0\0", 0x02, b"\x7f"),  # INTEGER8
        (b"\x80\xff\xff\xff", 0x02, b"\x80"),
        (b"\x80\0\0\0", 0x02, None),
        (b"\x7f\xff\xff\xff", 0x02, None),
        (b"\x00\x80\xff\xff", 0x03, b"\x00\x80"),  # INTEGER16
        (b"\x80\x00\0\0", 0x03, b"\x80\x00"),
        (b"\x80\x00\xff\xff", 0x03, None),
        (b"\x01\x02\x83\xff", 0x10, b"\x01\x02\x83"),  # INTEGER24
        (b"\x01\x02\x83\x00", 0x16, b"\x01\x02\x83"),  # UNSIGNED24
        (b"\x01\0\0\0", 0x01, b"\x01"),  # BOOLEAN
        (b"\x01\x02\x03\x04", 0x07, None),
        (b"\x01\x02\x03\x04\0", 0x08, b"\x01\x02\x03\x04"),  # REAL32
        (b"\0\0\0\0", 0x09, None),  # a text
    ],
)
def test_bytes_that_only_extend_a_number_are_cut(data, data_type, left):
    assert without_fill(variable(data_type), data) == (data if left is None else left)
