"""Describe a PDO of a rig as text, at most 80 columns wide.

It has the bits as a diagram, objects and signals as a table, and the bits of status- and controlwords by name.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from coulombus.eds.cia402 import word_fields
from coulombus.monitor.snapshot import PdoRow
from coulombus.rigs.signals import RigPdo

__all__ = ["as_dict", "as_lines"]

COLUMNS = 80


def as_lines(pdo: RigPdo, now: PdoRow | None = None) -> Iterator[str]:
    """Yield head, diagram, table, and an empty line.

    With the bus' present state (`now`) also the last bytes, and values instead of the value of one bit.
    """
    layout = pdo.layout
    yield f"{pdo.node} {pdo.name}  {layout.cob_id:03X}h  {layout.length} bytes  {_when(pdo)}"
    yield from layout.diagram(COLUMNS).splitlines()
    if now is not None:
        yield f"     {_last(now)}"
    last = "value of one bit" if now is None else "last value"
    values = {} if now is None else {value.name: value.value for value in now.values}
    yield f"     {'bits':>5}  {'object':<9} {'signal':<32} {'unit':<7} {last}"
    for signal, entry, start in pdo.fields():
        bits = f"{start}-{start + entry.bits - 1}" if entry.bits > 1 else str(start)
        place, scale = f"{entry.index:04X}h:{entry.subindex}", f"{signal.scale:.6g}" if signal.unit else ""
        offset = f"{signal.offset:+.6g}" if signal.offset else ""
        value_text = f"{scale}{offset}" if now is None else _value(values.get(signal.name))
        yield f"     {bits:>5}  {place:<9} {signal.name:<32} {signal.unit:<7} {value_text}".rstrip()
        for part in word_fields(entry.index):
            first = start + part.start
            of = f"{first}-{first + part.bits - 1}" if part.bits > 1 else str(first)
            yield f"     {of:>5}  {'':<9}   .{part.name}"
    yield ""


def _last(now: PdoRow) -> str:
    if now.age_s is None:
        return "it did not come"
    return f"last {now.data.hex(' ').upper()}, {1e3 * now.age_s:.0f} ms ago, {now.rate_per_s:.1f} /s"


def _value(value: int | float | None) -> str:
    return "-" if value is None else f"{value:.6g}" if isinstance(value, float) else f"{value} ({value:X}h)"


def _when(pdo: RigPdo) -> str:
    kind = pdo.layout.transmission
    return "every SYNC" if kind == 1 else f"every {kind} SYNCs" if 1 < kind <= 240 else f"transmission type {kind}"


def as_dict(pdo: RigPdo, now: PdoRow | None = None) -> dict[str, Any]:
    """Return a PDO for ``--json``, with the bus' present state under the key ``now``."""
    layout = pdo.layout
    document: dict[str, Any] = {
        "node": pdo.node,
        "node_id": pdo.node_id,
        "pdo": pdo.name,
        "can_id": layout.cob_id,
        "length": layout.length,
        "transmission": layout.transmission,
        "fixed": pdo.fixed,
        "entries": [
            {
                "object": f"{entry.index:04X}:{entry.subindex:02X}",
                "name": entry.name,
                "signal": signal.name,
                "start": start,
                "bits": entry.bits,
                "signed": entry.signed,
                "kind": entry.kind,
                "scale": signal.scale,
                "offset": signal.offset,
                "unit": signal.unit,
                "fields": {part.name: [part.start, part.bits] for part in word_fields(entry.index)},
            }
            for signal, entry, start in pdo.fields()
        ],
    }
    if now is not None:
        document["now"] = {
            "data": now.data.hex() if now.age_s is not None else None,
            "age_s": now.age_s,
            "rate_per_s": now.rate_per_s,
            "signals": {value.name: value.value for value in now.values},
        }
    return document
