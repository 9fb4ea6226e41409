"""The site's page of the compiled records: each field with its type and what it is, from the sources."""

from __future__ import annotations

import ast
import inspect
import io
import tokenize
from collections.abc import Iterator

from coulombus.eds.codec import PdoRecord
from coulombus.host.cycle.records import AxisRecord, ControlRecord, HostRecord, LiveRecord, OrderRecord
from coulombus.host.laws.law import LawRecord, LawStateRecord, MotionRecord
from coulombus.host.realtime.shared_memory import PlaneRecord
from coulombus.kernels.records import Record
from coulombus.node.record import BrakeFields, DriveFields, InputOutputFields, NodeRecord
from coulombus.recording.trace import TraceRow
from coulombus.sim_bus.can_bus.records import BusRecord, ControllerRecord, FaultRecord
from coulombus.sim_bus.rig.records import PlantRecord, RigAxis
from coulombus.wire.clock import Clock
from coulombus.wire.frame import Frame, Queue

__all__ = ["SHOWN", "fields_of_record", "records_page"]

SHOWN: tuple[type[Record], ...] = (
    *(MotionRecord, LawRecord, LawStateRecord, AxisRecord, ControlRecord, HostRecord, LiveRecord, OrderRecord),
    *(PlaneRecord, TraceRow, Frame, Queue, Clock, PdoRecord),
    *(NodeRecord, DriveFields, BrakeFields, InputOutputFields),
    *(BusRecord, ControllerRecord, FaultRecord, RigAxis, PlantRecord),
)
"""In the order of the page: what a law sees, the host, frames, a node, the virtual bus and rig."""


def fields_of_record(record: type[Record]) -> Iterator[tuple[str, str, str]]:
    """Yield name, type and description of each field that `record` itself declares."""
    source = inspect.getsource(record)
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    words = {
        token.start[0]: token.string.removeprefix("#").strip() for token in tokens if token.type == tokenize.COMMENT
    }
    (body,) = ast.parse(source).body
    assert isinstance(body, ast.ClassDef)
    for line in body.body:
        if isinstance(line, ast.AnnAssign):
            text = next((words[k] for k in range(line.lineno, (line.end_lineno or 0) + 1) if k in words), "")
            yield ast.unparse(line.target), _kind(line.annotation), text


def _kind(annotation: ast.expr) -> str:
    """Return how a field's type is written: ``int``, ``float[16]``, ``Frame[1024]``."""
    if not isinstance(annotation, ast.Subscript) or not isinstance(annotation.slice, ast.Tuple):
        return ast.unparse(annotation)
    kind, shape, *width = map(ast.unparse, annotation.slice.elts)
    if kind == "int":
        return shape.removeprefix("np.")
    element = {"IntegerField": "int", "FloatField": "float"}.get(
        kind, kind.removeprefix("RecordArray[").removesuffix("]")
    )
    return f"{width[0].removeprefix('np.') if width else element}[{shape}]"


def records_page() -> str:
    """Return a table of the fields of each record."""
    parts = [
        "# The compiled records\n\nWhat a kernel reads and writes. The page is made from the classes",
        "that declare the records. `int` is 64 bits wide, a time is in ns, and all else has its unit in its name.\n",
    ]
    for record in SHOWN:
        doc = " ".join((record.__doc__ or "").split())
        parts += [
            f"\n## {record.__name__}\n\n`{record.__module__}`: {doc}\n\n| field | type | what it is |\n|---|---|---|"
        ]
        for name, kind, text in fields_of_record(record):
            cell = text.replace("|", "\\|").replace("<", "&lt;")
            parts.append(f"| `{name}` | `{kind}` | {cell} |")
    return "\n".join(parts) + "\n"
