"""Text of a DCF (CiA 306-1): the values that a file configures, and a file with other values."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

from coulombus.eds.cia301 import DATA_TYPES
from coulombus.eds.convert import eds_text
from coulombus.eds.description import Description, Value, Variable
from coulombus.eds.sections import OBJECT_SECTION

__all__ = ["configured", "with_values"]

Place = tuple[int, int]
HEAD = re.compile(r"\s*\[([^\]]*)\]?")
VALUE = re.compile(r"\s*ParameterValue\s*=\s*(\S?)", re.IGNORECASE)
COMPACT = re.compile(r"([0-9a-f]{4})value", re.IGNORECASE)
COMPACT_VALUE = re.compile(r"\s*([0-9]{1,3})\s*=\s*(\S?)")
COMMISSIONING = ("devicecomissioning", "devicecommissioning")


def configured(description: Description) -> tuple[Place, ...]:
    """Return the objects that the file configures, in its order; `Description.default` returns the
    configured values.
    """
    places: list[Place] = []
    for name, lines in _sections(eds_text(description)):
        if (place := _place(description, name)) is not None:
            if any((match := VALUE.match(line)) and match[1] for line in lines):
                places.append(place)
        elif compact := COMPACT.fullmatch(name):
            values = (COMPACT_VALUE.match(line) for line in lines)
            places += [(int(compact[1], 16), int(match[1])) for match in values if match and match[2]]
    return tuple(place for place in dict.fromkeys(places) if description.has(*place))


def with_values(description: Description, values: Mapping[Place, Value], node_id: int, bit_s: int = 0) -> str:
    """Return the file's text as a DCF that configures exactly these values.

    Parameters
    ----------
    node_id, bit_s : of [DeviceComissioning], CiA's spelling; 0 bit/s: unknown
    """
    end = "\r\n" if "\r\n" in description.text else "\n"
    left = dict(values)
    out: list[str] = []
    for name, lines in _sections(eds_text(description)):
        if COMPACT.fullmatch(name) or name.lower() in COMMISSIONING:
            continue
        place = _place(description, name)
        head = [f"[{name}]"] if name else []
        other_lines = [line for line in lines if place is None or not VALUE.match(line)]
        if place in left:
            head.append(f"ParameterValue={_spelled(description.variable(*place), left.pop(place))}")
        out += [*head, *other_lines]
    compact: dict[int, list[int]] = {}
    for index, subindex in sorted(left):
        compact.setdefault(index, []).append(subindex)
    for index, subs in compact.items():  # sub-indices of CompactSubObj: they have no sections
        rows = [f"{sub}={_spelled(description.variable(index, sub), left[index, sub])}" for sub in subs]
        out += ["", f"[{index:04X}Value]", f"NrOfEntries={len(subs)}", *rows]
    rate = [f"Baudrate={bit_s // 1000}"] if bit_s else []
    out += ["", "[DeviceComissioning]", f"NodeID={node_id}", *rate, "CANopenManager=0", ""]
    return end.join(out)


def _sections(text: str) -> Iterator[tuple[str, Sequence[str]]]:
    """Yield the name of each section and its lines; first the lines before any section, with the name ""."""
    name, lines = "", list[str]()
    for line in text.splitlines():
        head = HEAD.match(line)
        if head:
            yield name, lines
            name, lines = head[1].strip(), []
        else:
            lines.append(line)
    yield name, lines


def _place(description: Description, name: str) -> Place | None:
    """Return the object of a section; None for the head of an array or record."""
    match = OBJECT_SECTION.fullmatch(name)
    if match is None:
        return None
    index = int(match[1], 16)
    entry = description.objects.get(index)
    if entry is None:
        return None
    if match[2] is not None:
        return index, int(match[2], 16)
    return (index, 0) if len(entry.variables) == 1 and 0 in entry.variables else None


def _spelled(variable: Variable, value: Value) -> str:
    if isinstance(value, bytes):
        return value.hex(" ").upper()
    if isinstance(value, int):
        kind = DATA_TYPES.get(variable.data_type)
        signed = kind is None or kind.signed or kind.kind == "bool"
        return str(value) if signed else f"0x{value:0{max(1, variable.bits // 4)}X}"
    return repr(value) if isinstance(value, float) else str(value)
