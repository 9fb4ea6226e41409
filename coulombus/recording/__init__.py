"""Recordings: pcapng and other tools' logs, signals by name in SI units, figures of a display.

Its public names are imported when they are first used; docs/api.md lists them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from coulombus.system.lazy_names import lazy_names

if TYPE_CHECKING:
    from coulombus.recording.comparison import compare
    from coulombus.recording.friction.columns import read_table
    from coulombus.recording.friction.hysteresis_fit import identify_iron
    from coulombus.recording.friction.identify import Identification, identify
    from coulombus.recording.friction.table_identify import identify_table
    from coulombus.recording.measures import measure, phases
    from coulombus.recording.reading import read
    from coulombus.recording.signals import Recording, Series

__all__ = [
    "Identification",
    "Recording",
    "Series",
    "compare",
    "identify",
    "identify_iron",
    "identify_table",
    "measure",
    "phases",
    "read",
    "read_table",
]

_PLACES = {
    "Identification": "coulombus.recording.friction.identify",
    "Recording": "coulombus.recording.signals",
    "Series": "coulombus.recording.signals",
    "compare": "coulombus.recording.comparison",
    "identify": "coulombus.recording.friction.identify",
    "identify_iron": "coulombus.recording.friction.hysteresis_fit",
    "identify_table": "coulombus.recording.friction.table_identify",
    "measure": "coulombus.recording.measures",
    "phases": "coulombus.recording.measures",
    "read": "coulombus.recording.reading",
    "read_table": "coulombus.recording.friction.columns",
}

__getattr__, __dir__ = lazy_names(__name__, _PLACES)
