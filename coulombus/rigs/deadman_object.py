"""A dead man's switch that is an object of a device:
``host.deadman = "object:60FD:0:0x00010000"``.
"""

from __future__ import annotations

from collections.abc import Sequence

from coulombus.eds.pdo import Entry
from coulombus.rigs.roles import Binding, RoleKind, checked_entry
from coulombus.rigs.signals import Parts

__all__ = ["bind_switch", "deadman_mask"]

ANY_BIT = 8
"""Widest object [bits] that may be a switch without a mask.

A wider object has further inputs, such as limit switches in 60FDh.
"""


def deadman_mask(deadman: str) -> int:
    """Return the mask of ``host.deadman``; 0 if it has none."""
    parts = deadman.split(":")
    return int(parts[3], 16) if len(parts) == 4 else 0


def bind_switch(parts: Parts, bindings: Sequence[Binding]) -> Binding | None:
    """Return the dead man's switch that ``host.deadman`` names, of the first device that has the
    object; None when it is no object.

    The switch is held while all bits of its mask (`deadman_mask`) are 1; with 0: while any bit is.

    Raises
    ------
    ValueError
        no device has the object, it cannot be mapped, or its mask is missing, 0 or wider than the
        object
    """
    deadman = parts.host.deadman
    if not deadman.startswith("object:"):
        return None
    index, subindex = (int(part, 16) for part in deadman.split(":")[1:3])
    for node in parts.devices:
        description = parts.description(node)
        if not description.has(index, subindex):
            continue
        entry = checked_entry(description, index, subindex, "tpdo")
        if any(binding.place == (node, index, subindex) for binding in bindings):
            raise ValueError(f"{index:04X}h:{subindex} of the {node} is mapped already, so it cannot be a switch")
        _check_mask(deadman, node, entry)
        return Binding(RoleKind("deadman", f"{node}.deadman", "tpdo", "", True), node, entry)
    raise ValueError(f"no EDS file describes {index:04X}h:{subindex}")


def _check_mask(deadman: str, node: str, entry: Entry) -> None:
    """Raise ValueError with the reason if the mask cannot be a switch."""
    what = f"{entry.index:04X}h:{entry.subindex} of the {node}"
    mask = deadman_mask(deadman)
    if deadman.count(":") < 3:
        if entry.bits > ANY_BIT:
            example = f'"{deadman}:0x{1 << entry.bits // 2:0{entry.bits // 4}X}"'
            raise ValueError(
                f"{what} has {entry.bits} bits, and any of them would hold the switch: name the switch's own by a mask, as in {example}"
            )
    elif mask == 0:
        raise ValueError(f"the mask is 0, and a switch has at least one bit of {what}")
    elif mask >> entry.bits:
        raise ValueError(f"the mask 0x{mask:X} is wider than {what}, which has {entry.bits} bits")
