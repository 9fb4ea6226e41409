"""Differences of two device descriptions, object by object, whichever form their files have."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from coulombus.eds.cia301 import DATA_TYPES
from coulombus.eds.description import Description, Variable
from coulombus.eds.eds_keys import spelled
from coulombus.eds.sections import number_of
from coulombus.eds.xdd import is_xml

__all__ = ["EdsChange", "changes"]


class EdsChange(NamedTuple):
    """A difference: its object ("6064h:00", "[DeviceInfo]"), its subject, and both values; "": absent."""

    place: str
    subject: str
    a: str
    b: str

    def __str__(self) -> str:
        return f"{self.place} {self.subject}: {self.a or 'none'} -> {self.b or 'none'}"


def changes(a: Description, b: Description) -> Iterator[EdsChange]:
    """Yield what `b` has otherwise than `a`: node id and bit rate, [DeviceInfo], and objects by index."""
    yield from _changes("file", "node id", a.node_id, b.node_id)
    yield from _changes("file", "bit rate [bit/s]", a.bit_rate, b.bit_rate)
    infos = [{key.lower(): text for key, text in description.info.items()} for description in (a, b)]
    names = {key.lower(): key for description in (b, a) for key in description.info}
    for key, name in names.items():
        texts = [info.get(key, "") for info in infos]
        if "" in texts and any(is_xml(description.text) for description in (a, b)):
            continue  # an XDD has no place for some of these keys
        numbers = [number.value if (number := number_of(text)) else text for text in texts]
        if numbers[0] != numbers[1]:
            yield from _changes("[DeviceInfo]", name, *texts)
    for index in sorted(a.objects.keys() | b.objects.keys()):
        old, new = a.objects.get(index), b.objects.get(index)
        place = f"{index:04X}h"
        if old is None or new is None:
            yield EdsChange(place, "object", "" if old is None else old.name, "" if new is None else new.name)
            continue
        subs = old.variables.keys() | new.variables.keys()
        if subs != {0}:
            yield from _changes(place, "name", old.name, new.name)
        yield from _changes(place, "object type", old.object_type, new.object_type)
        for sub in sorted(subs):
            first, second = old.variables.get(sub), new.variables.get(sub)
            if first is None or second is None:
                texts = ["" if variable is None else variable.name for variable in (first, second)]
                yield EdsChange(f"{place}:{sub:02X}", "sub-index", *texts)
                continue
            for (subject, value), (_, changed) in zip(_facts(first), _facts(second), strict=True):
                yield from _changes(f"{place}:{sub:02X}", subject, value, changed)


def _changes(place: str, subject: str, a: object, b: object) -> Iterator[EdsChange]:
    if a != b:
        yield EdsChange(place, subject, str(a or ""), str(b or ""))


def _facts(variable: Variable) -> Iterator[tuple[str, str]]:
    kind = DATA_TYPES.get(variable.data_type)
    yield "name", variable.name
    yield "type", f"{variable.data_type:04X}h" if kind is None else kind.name
    yield "access", variable.access
    yield "mapping", "may be mapped" if variable.pdo_mappable else ""
    default = spelled(variable, variable.default, relative=variable.node_relative)
    yield "default", "unreadable" if variable.unreadable else default or ""
    yield "lowest", spelled(variable, variable.low) or ""
    yield "highest", spelled(variable, variable.high) or ""
    yield "unit", variable.unit
