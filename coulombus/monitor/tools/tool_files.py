"""All files of `coulombus tools`, by their names in the folder."""

from __future__ import annotations

import json
from typing import Any
from xml.etree import ElementTree

from coulombus.eds.cia402 import word_fields
from coulombus.monitor.dbc import database
from coulombus.monitor.tools.wireshark import dissector, profile
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.rigs.signals import RigPdo, Signal
from coulombus.system.quoting import xml
from coulombus.wire.address import default_address

__all__ = ["tool_files"]

COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf")
RECIPES = """# {title} in other tools

Written by `coulombus tools` from {source}; write it anew when that has changed. A signal is called
as in `coulombus.read`{units}.

| file | for |
|---|---|
| `{rig}.dbc` | cantools, SavvyCAN, asammdf, PlotJuggler: every signal |
| `{rig}-bits.dbc` | the same, with state and bits of status- and controlwords by name |
| `{rig}.kcd`, `{rig}.sym` | Kayak, PCAN-Explorer: as `{rig}-bits.dbc` |
| `{rig}.lua` | Wireshark and tshark: the dissector |
| `wireshark/{rig}/` | Wireshark: a profile with colours, columns, buttons and I/O graphs |
| `{rig}-plotjuggler.xml` | PlotJuggler: a layout |
| `{rig}-foxglove.json` | Foxglove: a layout |

## cantools

    candump -L can0 | cantools decode --single-line {rig}-bits.dbc
    cantools monitor -i socketcan -c can0 {rig}-bits.dbc
    cantools monitor -i coulombus -c {rig} {rig}-bits.dbc
    can_logconvert run.pcapng run.log && cantools decode {rig}.dbc < run.log

## Wireshark and tshark

    tshark -X lua_script:{rig}.lua -r run.pcapng
    tshark -X lua_script:{rig}.lua -r run.pcapng -Y '{example} > 1'
    tshark -X lua_script:{rig}.lua -r run.pcapng -T fields -e frame.time_relative -e {example}
    coulombus watch --bus coulombus:{rig} --pcapng - | wireshark -k -i - -X lua_script:{rig}.lua -C {rig}

Copy `{rig}.lua` to `~/.local/lib/wireshark/plugins/` and it is always there. Copy the folder
`wireshark/{rig}` to `~/.config/wireshark/profiles/` and choose the profile `{rig}`. There,
Statistics > I/O Graphs has a line for each signal. `coulombus.sync_delay` is the time from SYNC to
a PDO, [s]. SDO and LSS are left to Wireshark's CANopen: `-d can.subdissector,canopen`, or Analyze >
Decode As > CAN next level dissector.

## SavvyCAN

1. `can_logconvert run.pcapng run.log`, then File > Load Log File, "candump".
2. File > DBC File Manager > Load: `{rig}-bits.dbc`, and "Interpret Frames" in the main window.
3. RE Tools > Graph Data draws a signal. Live: Connection > Add New > SocketCAN.

## asammdf

    can_logconvert run.pcapng run.mf4
    python -c "from asammdf import MDF; MDF('run.mf4').extract_bus_logging({{'CAN': [('{rig}.dbc', 0)]}}).to_dataframe()"

## PlotJuggler and Foxglove

    coulombus export run.pcapng --to csv -o run.csv       # PlotJuggler: load it, then the layout
    coulombus export run.pcapng --to mcap -o run.mcap     # Foxglove: open it, import the layout
"""

OF_RIG = {"source": "the rig file", "units": ", in SI units"}
OF_EDS = {"title": "Devices of EDS files", "source": "the EDS files", "units": ", with raw values"}
"""The words of `RECIPES` that depend on the source."""


def tool_files(bus: KnownBus) -> dict[str, str]:
    """Return the text of each file by its path within the folder."""
    split = database(bus, bits=True)
    filters = [f"coulombus.{signal.plain_name}" for _, signal in bus.signals()]
    example = next((text for text in filters if text.endswith("motor.position")), (filters or ["coulombus.node"])[0])
    name = default_address(bus.name).name  # valid as a file's name on any system and in the commands of README.md
    files = {
        f"{name}.dbc": database(bus).as_dbc_string(),
        f"{name}-bits.dbc": split.as_dbc_string(),
        f"{name}.kcd": split.as_kcd_string(),
        f"{name}.sym": split.as_sym_string(),
        f"{name}.lua": dissector(bus),
        f"{name}-plotjuggler.xml": _plotjuggler(bus),
        f"{name}-foxglove.json": _foxglove(bus),
        "README.md": RECIPES.format(
            rig=name, example=example, **(OF_EDS if bus.host is None else OF_RIG | {"title": f"The rig {name}"})
        ),
    }
    files |= {f"wireshark/{name}/{part}": text for part, text in profile(bus).items()}
    return {path: text.replace("\r\n", "\n") for path, text in files.items()}


def _by_unit(bus: KnownBus) -> dict[str, list[tuple[RigPdo, Signal]]]:
    """Return the plotted signals by unit; bit fields follow the quantities."""
    groups: dict[str, list[tuple[RigPdo, Signal]]] = {}
    for pdo, signal in sorted(bus.signals(), key=lambda pair: bool(word_fields(pair[1].index))):
        groups.setdefault(signal.unit, []).append((pdo, signal))
    return groups


def _plotjuggler(bus: KnownBus) -> str:
    """Return a PlotJuggler layout (version 2.3, as PlotJuggler 3 writes it): a plot for each unit.

    It uses the names of `coulombus.read`, which are the columns of a CSV or Parquet export.
    """
    root = ElementTree.Element("root")
    widget = ElementTree.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    tab = ElementTree.SubElement(widget, "Tab", containers="1", tab_name=xml(bus.name))
    container = ElementTree.SubElement(tab, "Container")
    groups = _by_unit(bus)
    sizes = ";".join(f"{1 / len(groups):.6f}" for _ in groups)
    splitter = ElementTree.SubElement(container, "DockSplitter", orientation="-", sizes=sizes, count=str(len(groups)))
    for unit, group in groups.items():
        area = ElementTree.SubElement(splitter, "DockArea", name=f"[{unit or '1'}]")
        plot = ElementTree.SubElement(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
        for number, (_, signal) in enumerate(group):
            ElementTree.SubElement(plot, "curve", name=xml(signal.name), color=COLOURS[number % len(COLOURS)])
    ElementTree.SubElement(widget, "currentTabIndex", index="0")
    ElementTree.SubElement(root, "use_relative_time_offset", enabled="1")
    ElementTree.indent(root)
    return "<?xml version='1.0' encoding='UTF-8'?>\n" + ElementTree.tostring(root, encoding="unicode") + "\n"


def _foxglove(bus: KnownBus) -> str:
    """Return a Foxglove layout: a plot for each unit, above each other, and the markers' log beside them.

    It uses an MCAP export: a topic per PDO, with messages nested by the names' dots.
    """
    panels: dict[str, Any] = {}
    for number, (unit, group) in enumerate(_by_unit(bus).items()):
        panels[f"Plot!coulombus{number}"] = {
            "title": f"{bus.name} [{unit or '1'}]",
            "paths": [
                {
                    "value": f"/{pdo.node}/{pdo.name}.{signal.name}",
                    "label": signal.name,
                    "enabled": True,
                    "timestampMethod": "receiveTime",
                    "color": COLOURS[k % len(COLOURS)],
                }
                for k, (pdo, signal) in enumerate(group)
            ],
            "xAxisVal": "timestamp",
            "showLegend": True,
            "isSynced": True,
        }
    plots = list(panels)
    panels["RawMessages!coulombus"] = {"topicPath": "/markers", "diffEnabled": False}
    layout: Any = plots[-1]
    for left, name in zip(range(len(plots) - 1, 0, -1), reversed(plots[:-1]), strict=True):
        layout = {
            "direction": "column",
            "first": name,
            "second": layout,
            "splitPercentage": 100 / (len(plots) - left + 1),
        }
    layout = {"direction": "row", "first": layout, "second": "RawMessages!coulombus", "splitPercentage": 80}
    content = {"configById": panels, "globalVariables": {}, "userNodes": {}, "layout": layout}
    return json.dumps(content, indent=2) + "\n"
