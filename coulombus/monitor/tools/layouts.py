"""Layouts of PlotJuggler and Foxglove: a plot for each unit, with the signals by name.

PlotJuggler uses the names of `coulombus.read`, which are the columns of a CSV or Parquet export.
Foxglove uses an MCAP export: a topic per PDO, with messages nested by the names' dots.
"""

from __future__ import annotations

import json
from typing import Any
from xml.etree import ElementTree

from coulombus.eds.cia402 import word_fields
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.rigs.signals import RigPdo, Signal
from coulombus.system.quoting import xml

__all__ = ["foxglove", "plotjuggler"]

COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf")


def _by_unit(bus: KnownBus) -> dict[str, list[tuple[RigPdo, Signal]]]:
    """Return the plotted signals by unit; bit fields follow the quantities."""
    groups: dict[str, list[tuple[RigPdo, Signal]]] = {}
    for pdo, signal in sorted(bus.signals(), key=lambda pair: bool(word_fields(pair[1].index))):
        groups.setdefault(signal.unit, []).append((pdo, signal))
    return groups


def plotjuggler(bus: KnownBus) -> str:
    """Return a PlotJuggler layout (version 2.3, as PlotJuggler 3 writes it)."""
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


def foxglove(bus: KnownBus) -> str:
    """Return a Foxglove layout: the plots above each other, and the markers' log beside them."""
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
