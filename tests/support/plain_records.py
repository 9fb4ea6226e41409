"""Records as plain Python objects: without the JIT a kernel runs on them thirty times as fast as on
NumPy's records.
"""

from __future__ import annotations

from functools import cache

from coulombus.kernels.decorator import JIT_DISABLED


class PlainRecords(list):
    """An array of records: `a[k]` is a record, `a["name"]` the column; `a["name"] = value` sets it
    in all.
    """

    @property
    def shape(self):
        return (len(self),)

    def __getitem__(self, key):
        if not isinstance(key, str):
            return super().__getitem__(key)
        return PlainRecords(getattr(record, key) for record in self)

    def __setitem__(self, key, value):
        if not isinstance(key, str):
            raise TypeError("a record is not replaced as a whole")
        for record in self:
            setattr(record, key, value)

    def view(self, kind):
        """Return what a view of an array gives: by name, then by index, as it is at that moment."""
        return _View(self, ())


class _View:
    def __init__(self, records, names):
        self._records, self._names = records, names

    def __getitem__(self, key):
        if isinstance(key, str):
            return _View(self._records, (*self._names, key))
        value = list.__getitem__(self._records, key)
        for name in self._names:
            value = getattr(value, name)
        return value


@cache
def _class_of(dtype):
    class Plain:
        __slots__ = dtype.names

        def __getitem__(self, name):
            return getattr(self, name)

        def __setitem__(self, name, value):
            setattr(self, name, value)

    return Plain


def _plain(dtype, value):
    if dtype.subdtype is not None:
        inner = dtype.subdtype[0]
        parts = [_plain(inner, part) for part in value]
        return PlainRecords(parts) if inner.names else parts
    if dtype.names is None:
        return value
    record = _class_of(dtype)()
    for name, part in zip(dtype.names, value, strict=True):
        setattr(record, name, _plain(dtype.fields[name][0], part))
    return record


def records_for_kernels(records):
    """Return `records` as they are, or as plain objects when the kernels are plain Python."""
    if not JIT_DISABLED:
        return records
    return PlainRecords(_plain(records.dtype, value) for value in records.tolist())


def record_for_kernels(record):
    """Return one `record` as it is, or as a plain object when the kernels are plain Python."""
    return record if not JIT_DISABLED else _plain(record.dtype, record.tolist())
