"""What is said of a kind of incident, and checks that several kinds share."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["CABLE", "MANUAL", "ONE_ID", "TERMINATION", "IncidentKind"]


class IncidentKind(NamedTuple):
    """A kind of clue; `checks` are three steps, the cheapest first."""

    rank: int
    title: str
    cause: str
    checks: tuple[str, str, str]
    why: str
    clause: str
    group: str = "node"


CABLE = "Look at plugs and cable to the node, and whether its lamp is lit."
TERMINATION = "Measure between CAN_H and CAN_L, bus switched off: 60 ohms with both terminators."
MANUAL = "Look the code up in the maker's manual."
ONE_ID = "Read serial numbers (1018h:04) one device at a time: unplug one, ask, plug it in, unplug the other."
