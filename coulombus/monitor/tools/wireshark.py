"""A dissector in Lua and a profile for Wireshark and tshark.

The dissector is `dissector.lua` with the rig's tables prepended. Fields are named as
``coulombus.motor.position`` [rad], in SI units. Values equal those of `coulombus.read` bit for bit,
except that positions are not unwrapped.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from coulombus.eds.cia301 import EMCY_TEXT, CobId, NmtCommand
from coulombus.eds.cia402 import word_fields
from coulombus.monitor.services import STATES
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.rigs.signals import RigPdo
from coulombus.system.quoting import lua, uat_cell

__all__ = ["dissector", "profile"]

COLOURS = (
    ("Coulombus: emergency", "coulombus.emcy.code != 0", "65535,65535,65535", "42000,0,0"),
    ("Coulombus: wrong length", "coulombus.length.expert", "0,0,0", "65535,58000,30000"),
    ("Coulombus: NMT", "coulombus.nmt.command", "0,0,0", "65535,64000,47000"),
    ("Coulombus: SYNC", 'coulombus.service == "sync"', "30000,30000,30000", "62000,62000,62000"),
    ("Coulombus: heartbeat", "coulombus.heartbeat.state", "20000,20000,20000", "65535,60000,64000"),
    ("Coulombus: told by the host", 'coulombus.pdo contains "told"', "20000,20000,20000", "65535,65535,57000"),
    ("Coulombus: from the host", 'coulombus.pdo contains "RPDO"', "0,0,0", "57000,61000,65535"),
    ("Coulombus: to the host", 'coulombus.pdo contains "TPDO"', "0,0,0", "58000,65535,58000"),
)
"""Colour rules: name, filter, text and background; the first match counts."""
LINES = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")
TOLD = "told"
"""Name of telemetry frames, which were on no bus (`recording.host_telemetry`)."""
CAN_EFF_MASK = 0x1FFFFFFF
BUTTONS = (
    ("The bus alone", 'frame.interface_name != "coulombus-host"'),
    ("Emergencies", "coulombus.emcy.code != 0"),
    ("No SYNC, no heartbeats", '!(coulombus.service == "sync") && !coulombus.heartbeat.state'),
    ("NMT", "coulombus.nmt.command"),
)


def dissector(bus: KnownBus) -> str:
    """Return the dissector's source: load it by ``-X lua_script:F.lua``, or from the plug-in
    folder.
    """
    nodes = bus.names
    services = {int(CobId.NMT): ("nmt", ""), int(CobId.SYNC): ("sync", "")}
    services |= {CobId.HEARTBEAT + number: ("heartbeat", name) for number, name in nodes.items()}
    services |= {node.emcy_id: ("emcy", node.name) for node in bus.nodes if node.emcy_id}
    rows = (
        f"    [{can_id:#05x}] = {{name = {lua(name)}{', node = ' + lua(node) if node else ''}}},"
        for can_id, (name, node) in sorted(services.items())
    )
    lines = (
        f"local RIG = {lua(bus.name)}",
        f"local NODES = {_table(nodes)}",
        f"local EMCY = {_table({int(code): text for code, text in EMCY_TEXT.items()})}",
        f"local STATES = {_table(STATES)}",
        f"local COMMANDS = {_table({command.value: command.name.lower().replace('_', ' ') for command in NmtCommand})}",
        "local SERVICES = {",
        *rows,
        "}",
        "local PDOS = {",
        *(_pdo(pdo, pdo.name) for pdo in bus.pdos),
        *(_pdo(pdo, f"{TOLD} {pdo.layout.number}") for pdo in bus.telemetry),
        "}",
        "",
        Path(__file__).with_name("dissector.lua").read_text(encoding="utf-8"),
    )
    return "\n".join(lines)


def _pdo(pdo: RigPdo, name: str) -> str:
    head = f"node = {lua(pdo.node)}, pdo = {lua(name)}, length = {pdo.layout.length}"
    rows = []
    for signal, entry, start in pdo.fields():
        words = {
            "key": lua(signal.plain_name),
            "label": lua(signal.plain_name.rpartition(".")[2]),
            "unit": lua(signal.unit),
            "object": lua(f"{entry.index:04X}h:{entry.subindex}" if entry.index else "no object"),
            "start": str(start),
            "bits": str(entry.bits),
            "signed": str(entry.signed).lower(),
            "real": str(entry.kind == "real").lower(),
            "scale": repr(float(signal.scale)),
            "offset": repr(float(signal.offset)),
        }
        parts = word_fields(entry.index)
        if parts and entry.bits == 16:
            shown = (
                f"{{key = {lua(part.name)}, mask = {part.mask:#x}, flag = {str(part.bits == 1).lower()}"
                + (f", values = {_table(part.values)}" if part.values else "")
                + "}"
                for part in parts
            )
            words["parts"] = "{\n            " + ",\n            ".join(shown) + "}"
        rows.append("        {" + ", ".join(f"{key} = {value}" for key, value in words.items()) + "},")
    return "\n".join((f"    [{pdo.layout.cob_id & CAN_EFF_MASK:#05x}] = {{{head}, fields = {{", *rows, "    }},"))


def _table(values: Mapping[int, str]) -> str:
    return "{" + ", ".join(f"[{key}] = {lua(text)}" for key, text in values.items()) + "}"


def profile(bus: KnownBus) -> dict[str, str]:
    """Return the files of a Wireshark profile by name: colours, columns, buttons, and an I/O graph
    of every signal.
    """
    columns = (
        ("No.", "%m"),
        ("Time", "%t"),
        ("ID", "%Cus:can.id:0:R"),
        ("Protocol", "%p"),
        ("Length", "%Cus:can.len:0:R"),
        ("Info", "%i"),
    )
    shown = ",\n\t".join(f'"{title}", "{what}"' for title, what in columns)
    graphs = [
        _row("Disabled" if number else "Enabled", name, "", LINES[number % len(LINES)], "Line", "AVG(Y Field)", field)
        for number, (name, field) in enumerate(_graphs(bus))
    ]
    return {
        "preferences": f"gui.column.format:\n\t{shown}\n",
        "colorfilters": "".join(f"@{name}@{rule}@[{back}][{text}]\n" for name, rule, text, back in COLOURS),
        "dfilter_buttons": "".join(f'"TRUE",{uat_cell(name)},{uat_cell(rule)},""\n' for name, rule in BUTTONS),
        "io_graphs": "".join(graphs),
    }


def _graphs(bus: KnownBus) -> list[tuple[str, str]]:
    quantities = [(s.name, f"coulombus.{s.plain_name}") for _, s in bus.signals() if not word_fields(s.index)]
    return [*quantities, ("time since SYNC [s]", "coulombus.sync_delay")]


def _row(enabled: str, *cells: str) -> str:
    return ",".join(uat_cell(cell) for cell in (enabled, *cells, "None", "1")) + "\n"
