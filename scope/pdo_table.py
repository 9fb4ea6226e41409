"""A PDO of a rig for the eye: its bits as a diagram, its objects and signals as a table, the bits
of status- and controlwords by name. At most 80 columns.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from coulombus.eds.cia402 import word_fields
from coulombus.rigs.signals import RigPdo
from coulombus.scope.names import fields

__all__ = ["as_dict", "as_lines"]

COLUMNS = 80


def as_lines(pdo: RigPdo) -> Iterator[str]:
    """Yield head, diagram, table, and an empty line."""
    layout = pdo.layout
    yield f"{pdo.node} {pdo.name}  {layout.cob_id:03X}h  {layout.length} bytes  {_when(pdo)}"
    yield from layout.diagram(COLUMNS).splitlines()
    yield f"     {'bits':>5}  {'object':<9} {'signal':<32} {'unit':<7} value of one bit"
    for signal, entry, start in fields(pdo):
        bits = f"{start}-{start + entry.bits - 1}" if entry.bits > 1 else str(start)
        place, one = f"{entry.index:04X}h:{entry.subindex}", f"{signal.scale:.6g}" if signal.unit else ""
        offset = f"{signal.offset:+.6g}" if signal.offset else ""
        yield f"     {bits:>5}  {place:<9} {signal.name:<32} {signal.unit:<7} {one}{offset}".rstrip()
        for part in word_fields(entry.index):
            first = start + part.start
            of = f"{first}-{first + part.bits - 1}" if part.bits > 1 else str(first)
            yield f"     {of:>5}  {'':<9}   .{part.name}"
    yield ""


def _when(pdo: RigPdo) -> str:
    kind = pdo.layout.transmission
    return "every SYNC" if kind == 1 else f"every {kind} SYNCs" if 1 < kind <= 240 else f"transmission type {kind}"


def as_dict(pdo: RigPdo) -> dict[str, Any]:
    """Return a PDO for ``--json``."""
    layout = pdo.layout
    return {
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
            for signal, entry, start in fields(pdo)
        ],
    }
