"""Write the messages of a rig, or of devices by their EDS files, for cantools, SavvyCAN, PlotJuggler, CANdevStudio.

::

    coulombus dbc --rig bench -o bench.dbc
    coulombus dbc --eds 5=drive.eds -o drive.dbc
    cantools monitor -i coulombus -c bench bench.dbc

The PDOs of a rig are messages ``motor_TPDO1``, ..., with the signals' names, scales and units of the
rig. The PDOs of an EDS file are messages ``node5_TPDO1``, ..., with the objects' names and raw
values, as `coulombus.monitor.decode` has them. SYNC, NMT, heartbeats and emergencies are included,
so that all cyclic frames are decoded. SDO has no fixed layout and is not included.

A status- or controlword is one signal, as `coulombus.read` has it, or, with `bits`, a signal for
its state and one for each bit: signals of a DBC may not overlap.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping
from typing import TypeAlias

from cantools.database.can import Database, Message, Node, Signal
from cantools.database.conversion import BaseConversion

from coulombus.eds.cia301 import EMCY_TEXT, CobId, NmtCommand
from coulombus.eds.cia402 import WordField, word_fields
from coulombus.eds.pdo import Entry
from coulombus.eds.sdo_frames import where
from coulombus.eds.units import fixed_unit
from coulombus.monitor.services import STATES
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.rigs.signals import RigPdo
from coulombus.rigs.signals import Signal as RigSignal
from coulombus.system.quoting import dbc, xml

__all__ = ["WRITERS", "database", "database_text", "file_encoding"]

Choices: TypeAlias = Mapping[int, str]

LONGEST_NAME = 32
"""Characters of a name in a DBC file."""
WRITERS: Mapping[str, str] = {".dbc": "as_dbc_string", ".kcd": "as_kcd_string", ".sym": "as_sym_string"}
"""Methods of cantools' database by the suffix of the file that they write."""


def file_encoding(suffix: str) -> dict[str, str]:
    """Return encoding and errors of a file: readers of DBC and SYM files expect Windows-1252."""
    if suffix in (".dbc", ".sym"):
        return {"encoding": "cp1252", "errors": "replace"}
    return {"encoding": "utf-8", "errors": "strict"}


def database_text(bus: KnownBus, suffix: str = ".dbc", *, bits: bool = False) -> str:
    """Return the text of a file of a kind of `WRITERS`; `bits` as for `database`."""
    bus_database = database(bus, bits=bits)
    if suffix == ".sym":
        _rename_alike(bus_database)
    text: str = getattr(bus_database, WRITERS[suffix])()
    return text.replace("\r\n", "\n")


def database(bus: KnownBus, *, bits: bool = False) -> Database:
    """Return the messages of a bus as cantools' database.

    Parameters
    ----------
    bits : split a status- or controlword into its state and its bits
    """
    period_ms = round(bus.period_s * 1e3)
    host = [] if bus.host is None else [bus.host.name]
    messages = [_pdo(pdo, period_ms, host, bits) for pdo in bus.pdos]
    taken = {message.frame_id for message in messages}
    messages += [message for message in _services(bus, host, period_ms) if message.frame_id not in taken]
    nodes = [Node(_word(name), f"node {number}") for number, name in bus.names.items()]
    return Database(sorted(messages, key=lambda message: message.frame_id), nodes=nodes, version=dbc(bus.name))


def _rename_alike(database: Database) -> None:
    """Prefix signals with their message's name where another one of that name is otherwise: a SYM file has
    one list of signals for all messages.
    """
    first_forms: dict[str, tuple[object, ...]] = {}
    for message in database.messages:
        for signal in message.signals:
            form = (
                *(signal.length, signal.is_signed, signal.is_float, signal.scale, signal.offset),
                *(signal.unit, signal.comment, str(signal.choices)),
            )
            if first_forms.setdefault(signal.name, form) != form:
                signal.name = f"{message.name}_{signal.name}"


def _word(name: str) -> str:
    """Return a node's name as a DBC identifier."""
    word = name.replace(".", "_")
    return f"node{word}" if word[:1].isdigit() else word


def _names(pdo: RigPdo) -> Iterator[str]:
    """Yield the name of each signal: of its role or, without a rig, of its object; each once."""
    used = set[str]()
    for signal, entry, start in pdo.fields():
        name = signal.identifier
        if pdo.node.isdecimal() and entry.name:  # without a rig
            plain = unicodedata.normalize("NFKD", entry.name.replace("ß", "ss")).encode("ascii", "ignore").decode()
            word = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_")[:LONGEST_NAME]
            name = f"_{word}" if word[:1].isdigit() else word or name
        if name.lower() in used:
            suffix = f"_{entry.index:04X}_{entry.subindex:02X}_{start}"
            name = name[: LONGEST_NAME - len(suffix)] + suffix
        used.add(name.lower())
        yield name


def _pdo(pdo: RigPdo, period_ms: int, host: list[str], bits: bool) -> Message:
    layout, node = pdo.layout, _word(pdo.node)
    senders, receivers = (host, [node]) if layout.direction == "rpdo" else ([node], host)
    return Message(
        frame_id=layout.cob_id,
        name=f"{node}_{pdo.name}",
        length=layout.length,
        signals=[
            part
            for (signal, entry, start), name in zip(pdo.fields(), _names(pdo), strict=True)
            for part in _signals(
                signal, entry, start, name, receivers, word_fields(entry.index) if bits and entry.bits == 16 else ()
            )
        ],
        senders=senders,
        cycle_time=period_ms or None,
        comment=f"{layout.direction.upper()} {layout.number} of {'node' if pdo.node.isdecimal() else 'the'} {pdo.node}",
    )


def _signals(
    signal: RigSignal, entry: Entry, start: int, name: str, receivers: list[str], parts: tuple[WordField, ...]
) -> Iterator[Signal]:
    comment = dbc(xml(f"{where(entry.index, entry.subindex)} {entry.name}")).rstrip()
    for field in parts:
        part = _field(f"{name}_{field.name}", start + field.start, field.bits, receivers, field.values or None)
        part.comment = f"{comment}, bits {field.start} to {field.start + field.bits - 1}"
        yield part
    if parts:
        return
    scale, offset = _whole(signal.scale), _whole(signal.offset)
    minimum, maximum = _range(entry, scale, offset)
    yield Signal(
        name=name,
        start=start,
        length=entry.bits,
        is_signed=entry.signed,
        conversion=BaseConversion.factory(scale=scale, offset=offset, is_float=entry.kind == "real"),
        minimum=minimum,
        maximum=maximum,
        unit=dbc(xml(signal.unit or _unit(entry, signal))) or None,
        receivers=receivers,
        comment=comment,
    )


def _unit(entry: Entry, signal: RigSignal) -> str:
    """Return the unit of a raw number: of its file, or as CiA 301 and 402 define it; "" if unknown."""
    fixed = fixed_unit(entry.index, entry.subindex)
    usual = "" if fixed is None or (fixed.scale, signal.scale) != (1, 1) else fixed.unit
    return entry.unit or usual if signal.scale == 1 else ""


def _range(entry: Entry, scale: float, offset: float) -> tuple[float | None, float | None]:
    """Return the range of the entry in SI units; None for a REAL, which has no bounds."""
    if entry.kind == "real":
        return None, None
    lowest = -(1 << entry.bits - 1) if entry.signed else 0
    ends = [raw * scale + offset for raw in (lowest, lowest + (1 << entry.bits) - 1)]
    return min(ends), max(ends)


def _whole(number: float) -> float:
    """Return `number`, as an integer if whole: cantools then keeps bit fields as integers."""
    return int(number) if float(number).is_integer() else float(number)


def _services(bus: KnownBus, host: list[str], period_ms: int) -> Iterator[Message]:
    everyone = ([] if bus.host is None else [bus.host]) + list(bus.nodes)
    others = [_word(node.name) for node in bus.nodes]
    yield Message(CobId.SYNC, "SYNC", 0, [], senders=host, cycle_time=period_ms or None, comment="SYNC")
    commands = {command.value: command.name.lower() for command in NmtCommand}
    targets = {0: "all"} | {node.node_id: node.name for node in bus.nodes}
    yield Message(
        CobId.NMT,
        "NMT",
        2,
        [_field("command", 0, 8, others, choices=commands), _field("node", 8, 8, others, choices=targets)],
        senders=host,
        comment="NMT command",
    )
    for node in everyone:
        name = _word(node.name)
        listeners = [_word(other.name) for other in everyone if other is not node]
        yield Message(
            CobId.HEARTBEAT + node.node_id,
            f"{name}_heartbeat",
            1,
            [_field("state", 0, 8, listeners, choices={code: text.replace("-", "_") for code, text in STATES.items()})],
            senders=[name],
            cycle_time=round(node.heartbeat_s * 1e3) or None,
            comment=f"Heartbeat of {'node' if node.name.isdecimal() else 'the'} {node.name}",
        )
        if not node.emcy_id:
            continue
        yield Message(
            node.emcy_id,
            f"{name}_EMCY",
            8,
            [
                _field("code", 0, 16, listeners, choices=EMCY_TEXT),
                _field("error_register", 16, 8, listeners),
                _field("manufacturer", 24, 40, listeners),
            ],
            senders=[name],
            comment=f"Emergency of {'node' if node.name.isdecimal() else 'the'} {node.name}",
        )


def _field(name: str, start: int, length: int, receivers: list[str], choices: Choices | None = None) -> Signal:
    named = None if choices is None else {code: text.replace('"', "'") for code, text in choices.items()}
    return Signal(
        name=name,
        start=start,
        length=length,
        conversion=BaseConversion.factory(choices=named),  # type: ignore[arg-type]
        receivers=receivers,
    )
