"""Export the rig's messages as a DBC file for cantools, SavvyCAN, PlotJuggler, CANdevStudio.

::

    coulombus dbc --rig bench -o bench.dbc
    cantools monitor -i coulombus -c bench bench.dbc

The five PDOs are messages ``motor_TPDO1``, ..., with the signals' names, scales and units of the
rig. SYNC, NMT, heartbeats and emergencies are included, so that all cyclic frames are decoded. SDO
has no fixed layout and is not included.

A status- or controlword is one signal, as `coulombus.read` has it, or, with `bits`, a signal for
its state and one for each bit: signals of a DBC may not overlap.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeAlias

from cantools.database.can import Database, Message, Node, Signal
from cantools.database.conversion import BaseConversion

from coulombus.eds.cia301 import EMCY_TEXT, CobId, NmtCommand
from coulombus.eds.cia402 import WordField, word_fields
from coulombus.eds.pdo import Entry
from coulombus.monitor.names import fields, identifier
from coulombus.monitor.services import STATES
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo
from coulombus.rigs.signals import Signal as RigSignal
from coulombus.system.quoting import dbc

__all__ = ["database", "dbc_text"]

Choices: TypeAlias = Mapping[int, str]

HOST = "host"


def dbc_text(rig: Rig, *, bits: bool = False) -> str:
    """Return the DBC file of `rig`; `bits` as for `database`."""
    return database(rig, bits=bits).as_dbc_string().replace("\r\n", "\n")


def database(rig: Rig, *, bits: bool = False) -> Database:
    """Return the rig's messages as cantools' database.

    Parameters
    ----------
    bits : split a status- or controlword into its state and its bits
    """
    ids = {HOST: rig.host.node_id} | {_word(node.name): node.node_id for node in rig.nodes}
    period_ms = round(rig.bus.period_s * 1e3)
    messages = [_pdo(pdo, period_ms, bits) for pdo in rig.pdos()]
    messages += _services(ids, rig, period_ms)
    nodes = [Node(name, f"node {number}") for name, number in ids.items()]
    return Database(sorted(messages, key=lambda message: message.frame_id), nodes=nodes, version=dbc(rig.name))


def _word(name: str) -> str:
    """Return a node's name as a DBC identifier."""
    return name.replace(".", "_")


def _pdo(pdo: RigPdo, period_ms: int, bits: bool) -> Message:
    layout, node = pdo.layout, _word(pdo.node)
    sender, receiver = (HOST, node) if layout.direction == "rpdo" else (node, HOST)
    return Message(
        frame_id=layout.cob_id,
        name=f"{node}_{pdo.name}",
        length=layout.length,
        signals=[
            part
            for signal, entry, start in fields(pdo)
            for part in _signals(signal, entry, start, receiver, word_fields(entry.index) if bits else ())
        ],
        senders=[sender],
        cycle_time=period_ms or None,
        comment=f"{layout.direction.upper()} {layout.number} of the {pdo.node}",
    )


def _signals(
    signal: RigSignal, entry: Entry, start: int, receiver: str, parts: tuple[WordField, ...]
) -> Iterator[Signal]:
    name = identifier(signal)
    comment = dbc(f"{entry.index:04X}h:{entry.subindex} {entry.name}")
    for field in parts:
        part = _field(f"{name}_{field.name}", start + field.start, field.bits, [receiver], field.values or None)
        part.comment = f"{comment}, bits {field.start} to {field.start + field.bits - 1}"
        yield part
    if parts:
        return
    scale, offset = _whole(signal.scale), _whole(signal.offset)
    least, most = _range(entry, scale, offset)
    yield Signal(
        name=name,
        start=start,
        length=entry.bits,
        is_signed=entry.signed,
        conversion=BaseConversion.factory(scale=scale, offset=offset, is_float=entry.kind == "real"),
        minimum=least,
        maximum=most,
        unit=signal.unit or None,
        receivers=[receiver],
        comment=comment,
    )


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


def _services(ids: Mapping[str, int], rig: Rig, period_ms: int) -> Iterator[Message]:
    yield Message(CobId.SYNC, "SYNC", 0, [], senders=[HOST], cycle_time=period_ms or None, comment="SYNC")
    commands = {command.value: command.name.lower() for command in NmtCommand}
    targets = {0: "all"} | {number: name for name, number in ids.items() if name != HOST}
    others = [name for name in ids if name != HOST]
    yield Message(
        CobId.NMT,
        "NMT",
        2,
        [_field("command", 0, 8, others, choices=commands), _field("node", 8, 8, others, choices=targets)],
        senders=[HOST],
        comment="NMT command",
    )
    heartbeat_s = {HOST: rig.host.heartbeat_s} | {_word(node.name): node.part.heartbeat_s for node in rig.nodes}
    emcy_ids = {node.node_id: node.emcy_id for node in rig.nodes}
    for name, number in ids.items():
        listeners = [other for other in ids if other != name]
        yield Message(
            CobId.HEARTBEAT + number,
            f"{name}_heartbeat",
            1,
            [_field("state", 0, 8, listeners, choices={code: text.replace("-", "_") for code, text in STATES.items()})],
            senders=[name],
            cycle_time=round(heartbeat_s[name] * 1e3),
            comment=f"Heartbeat of the {name}",
        )
        if name == HOST:
            continue
        yield Message(
            emcy_ids[number],
            f"{name}_EMCY",
            8,
            [
                _field("code", 0, 16, listeners, choices=EMCY_TEXT),
                _field("error_register", 16, 8, listeners),
                _field("manufacturer", 24, 40, listeners),
            ],
            senders=[name],
            comment=f"Emergency of the {name}",
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
