"""Objects in the user's notation: by index and sub-index, or by the name in the EDS."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

from coulombus.eds.description import Description

__all__ = ["object_key"]

_NUMBERS = re.compile(r"(?:0x)?([0-9A-Fa-f]{4})h?(?::(?:0x)?([0-9A-Fa-f]{1,2})h?)?")


def object_key(text: str, description: Description) -> tuple[int, int] | str:
    """Return index and sub-index of an object, given as "7300:01" or by its name in the EDS; if there is no
    such object, return the text of the expectation instead.
    """
    numbers = _NUMBERS.fullmatch(text.strip())
    if numbers:
        key = int(numbers[1], 16), int(numbers[2] or "0", 16)
        if description.has(*key):
            return key
        entry = description.objects.get(key[0])
        subs = ", ".join(f"{key[0]:04X}:{sub:02X}" for sub in entry.variables) if entry else ""
        return f"an object of {description.path}" + (f"; it has {subs}" if subs else "")
    names: dict[str, list[tuple[int, int]]] = {}
    for index, entry in description.objects.items():
        for subindex, variable in entry.variables.items():
            names.setdefault(variable.name, []).append((index, subindex))
    places = names.get(text.strip(), [])
    if len(places) == 1:
        return places[0]
    if places:
        keys = " or ".join(f"{index:04X}:{subindex:02X}" for index, subindex in places[:4])
        return f"one object; this is the name of {len(places)}: {keys}"
    return f"INDEX:SUB as 7300:01, or a name in {description.path}{_nearest(text, names)}"


def _nearest(text: str, names: Iterable[str]) -> str:
    matches = difflib.get_close_matches(text, names, 1, 0.6)
    return f"; did you mean '{matches[0]}'?" if matches else ""
