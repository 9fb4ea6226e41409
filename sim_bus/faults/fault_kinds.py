"""Kinds of faults: their keys, their effects, and where `coulombus inject` lets them act.

A fault file, a test's plugin and `coulombus inject` all build these; a script's device faults have the
same names (`sim_bus.network.device_faults`).
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from coulombus.eds.cia301 import CobId
from coulombus.sim_bus.can_bus.faults import TAIL_BIT
from coulombus.sim_bus.network.device_faults import EFFECTS

__all__ = [
    "BASES",
    "BIT_NAMES",
    "KINDS",
    "OF_NO_NODE",
    "RESTART_MS",
    "AnyFault",
    "Babble",
    "Controller",
    "Cut",
    "Delay",
    "Drift",
    "Flip",
    "Lasting",
    "NodeFault",
    "NodeName",
    "Noise",
    "OnFrame",
    "OtherNodeId",
    "Reset",
    "SecondMaster",
    "SlowSdo",
    "Strict",
    "StuckDominant",
    "Trigger",
    "effect_of",
]

NodeName = Annotated[str | int, Field(union_mode="left_to_right")]
"""A node by its name in the rig ("motor", "brake", "host") or by its node id."""

RESTART_MS = 100
"""Time from bus-off to the begin of recovery, as CAN interfaces are usually set up: long enough for other
stations to notice.
"""

BASES = {
    "NMT": 0x000,
    "SYNC": CobId.SYNC,
    "EMCY": CobId.EMCY,
    "TIME": CobId.TIME,
    **{name: CobId[name] for name in ("TPDO1", "TPDO2", "TPDO3", "TPDO4")},
    **{name: CobId[name] for name in ("RPDO1", "RPDO2", "RPDO3", "RPDO4")},
    "SDO RESPONSE": CobId.SDO_TX,
    "SDO REQUEST": CobId.SDO_RX,
    "HEARTBEAT": CobId.HEARTBEAT,
}
"""Identifiers of the predefined connection set (CiA 301, 7.3.5); the node id is added."""
OF_NO_NODE = ("NMT", "SYNC", "TIME")
MOST_COUNTED = 10**12
LAST_BIT = 160
TAIL_BITS = ("crc_delimiter", "ack_slot", "ack_delimiter", *(f"eof{n}" for n in range(1, 8)))
BIT_NAMES = {name: TAIL_BIT + n for n, name in enumerate((*TAIL_BITS, "intermission1", "intermission2"))}
_TRIGGER = re.compile(
    r"(?:(?P<every>every)\s+)?(?:(?P<nth>\d+)(?:st|nd|rd|th)\s+)?(?P<frame>0x[0-9a-f]+|[a-z]+ ?[a-z]*\d?)(?:\s+of\s+(?:node\s+)?(?P<node>[\w.]+))?",
    re.IGNORECASE,
)


class Strict(BaseModel):
    """A table of a fault file: no unknown key, no conversion."""

    # validators are built when a fault file is read: most runs have none
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)


class Trigger(Strict):
    """Frames that trigger a fault: the `nth` frame of a kind, and then every `every`-th.

    Default: the first.
    """

    frame: str | None = None
    can_id: int | None = Field(None, ge=0, le=0x1FFFFFFF)
    extended: bool = False
    remote: bool = False
    node: NodeName | None = None
    sender: NodeName | None = None
    nth: int = Field(1, ge=1, le=MOST_COUNTED)
    every: int = Field(0, ge=0, le=MOST_COUNTED)

    @model_validator(mode="before")
    @classmethod
    def _words(cls, value: Any) -> Any:
        if not isinstance(value, str):
            return value
        match = _TRIGGER.fullmatch(value.strip())
        if match is None:
            raise ValueError('expected a text such as "3rd TPDO1 of node 2", "every 10th SYNC" or "1st 0x181"')
        nth, node = int(match["nth"] or 1), match["node"]
        words: dict[str, Any] = {"nth": nth, "every": nth if match["every"] else 0}
        if match["frame"].lower().startswith("0x"):
            words["can_id"] = int(match["frame"], 16)
        else:
            words["frame"] = match["frame"]
        if node is not None:
            words["node"] = int(node) if node.isdigit() else node
        return words

    @model_validator(mode="after")
    def _one_frame(self) -> Trigger:
        neither = self.frame is None and self.can_id is None
        if (self.frame is not None and self.can_id is not None) or (neither and self.sender is None):
            raise ValueError('expected either frame, as in "TPDO1", or can_id')
        if self.frame is not None:
            name = self.frame.upper()
            if name not in BASES:
                near = difflib.get_close_matches(name, BASES, 1)
                hint = f"; did you mean {near[0]}?" if near else ""
                raise ValueError(f"frame '{self.frame}'; expected {', '.join(BASES)}{hint}")
            if name == "EMCY" and self.node is None:
                raise ValueError('EMCY: expected a node too, as in "EMCY of node 1"')
        if self.node is not None and (self.frame is None or self.frame.upper() in OF_NO_NODE):
            what = "an identifier" if self.frame is None else self.frame.upper()
            raise ValueError(
                f"{what} is of no node; leave the node out, or say who sends it with the table's key sender"
            )
        if isinstance(self.node, int) and not 1 <= self.node <= 127:
            raise ValueError(f"node {self.node}; expected a node id from 1 to 127")
        return self


class _OnBus(Strict):
    bus: str | None = None


class _Fault(_OnBus):
    place: ClassVar[str] = ""
    """Key that has the node of ``inject --on NODE``; empty: the fault is of the wire alone."""
    wire: ClassVar[bool] = True
    """Whether ``inject --on bus`` is possible."""
    usual: ClassVar[Mapping[str, Any]] = {}
    """Values of keys that `inject` gives, and a file must have."""

    at_s: float = Field(0.0, ge=0, le=1e7)
    after: Literal["start", "enabled"] = "start"


class OnFrame(_Fault):
    """A fault of the frames selected by `on`."""

    place = "sender"
    on: Trigger | None = None
    duration_s: float | None = Field(None, ge=1e-9, le=1e7)
    most: int = Field(0, ge=0, le=MOST_COUNTED)


class Lasting(_Fault):
    """A fault that lasts for a time."""

    duration_s: float | None = Field(None, ge=1e-9, le=1e7)


class Flip(OnFrame):
    """Invert one bit of a frame, for all receivers or for one."""

    kind: Literal["flip"]
    bit: int | str = 0
    seen_by: NodeName | None = None

    @field_validator("bit", mode="before")
    @classmethod
    def _valid_bit(cls, bit: Any) -> Any:
        if bit in BIT_NAMES if isinstance(bit, str) else type(bit) is int and 0 <= bit <= LAST_BIT:
            return bit
        raise ValueError(f"expected 0 (the start of frame) to {LAST_BIT}, or {', '.join(BIT_NAMES)}")


class CorruptCrc(OnFrame):
    """Send a frame with a wrong CRC."""

    kind: Literal["corrupt_crc"]


class Drop(OnFrame):
    """Lose a frame without an error, for all receivers or for one."""

    kind: Literal["drop"]
    lost_for: NodeName | None = None


class Delay(OnFrame):
    """Delay a frame."""

    usual = {"delay_us": 1000.0}
    kind: Literal["delay"]
    delay_us: float = Field(ge=1e-3, le=1e9)


class Duplicate(OnFrame):
    """Send a frame twice."""

    kind: Literal["duplicate"]


class Reset(OnFrame):
    """Reset a node, as by NMT, after a frame or at a time."""

    place, wire = "node", False
    kind: Literal["reset"]
    node: NodeName


class Cut(_Fault):
    """Cut the cable into two halves, at a time or after a frame.

    Nodes that `halves` does not name are in the first half. `node` instead: the cable is cut in front of it, so that
    it and the nodes behind it, in the rig's order, are in the second half.
    """

    place, wire = "node", False
    kind: Literal["cut"]
    on: Trigger | None = None
    most: int = Field(0, ge=0, le=MOST_COUNTED)
    duration_s: float | None = Field(None, ge=1e-9, le=1e7)
    halves: tuple[list[NodeName], list[NodeName]] | None = Field(None, strict=False)  # TOML has lists only
    node: NodeName | None = None

    @field_validator("halves")
    @classmethod
    def _two(cls, halves: tuple[list[NodeName], list[NodeName]] | None) -> tuple[list[NodeName], list[NodeName]] | None:
        if halves is None:
            return None
        both = set(halves[0]) & set(halves[1])
        if both or not halves[1]:
            raise ValueError('expected the nodes of both halves, each in one, as in [["host", "brake"], ["motor"]]')
        return halves

    @model_validator(mode="after")
    def _one_place(self) -> Cut:
        if (self.halves is None) == (self.node is None):
            raise ValueError('expected either halves, as in [["host", "brake"], ["motor"]], or node')
        return self


class Drift(Lasting):
    """Let a node's clock run fast or slow."""

    place, wire, usual = "node", False, {"ppm": 1000.0}
    kind: Literal["drift"]
    node: NodeName
    ppm: float = Field(ge=-1e5, le=1e5)


class Babble(Lasting):
    """Let a node send one frame periodically, in addition to its normal frames."""

    place, wire, usual = "node", False, {"can_id": 16, "data": "55"}
    kind: Literal["babble"]
    node: NodeName
    can_id: int = Field(ge=0, le=0x1FFFFFFF)
    extended: bool = False
    data: str = Field("", pattern=r"^([0-9A-Fa-f]{2} ?){0,8}$")
    period_us: float = Field(100.0, ge=10, le=1e9)


class StuckDominant(Lasting):
    """Hold the wire dominant."""

    kind: Literal["stuck_dominant"]


class Noise(Lasting):
    """Invert random bits, each with the probability `rate`, for all receivers or for one."""

    place, usual = "seen_by", {"rate": 1e-3}
    kind: Literal["noise"]
    rate: float = Field(gt=0, le=1)
    seen_by: NodeName | None = None


class SlowSdo(Lasting):
    """Let a node's SDO server answer late."""

    place, wire = "node", False
    kind: Literal["slow_sdo"]
    node: NodeName
    delay_ms: float = Field(2000.0, ge=1e-3, le=1e6)


class SecondMaster(Lasting):
    """Let a second master send set-points of 0 to a node, in its first RPDO."""

    place, wire = "node", False
    kind: Literal["second_master"]
    node: NodeName
    period_us: float = Field(1000.0, ge=10, le=1e9)


class OtherNodeId(Lasting):
    """Let a node boot with another node id: `node_id`, or the next that is free."""

    place, wire = "node", False
    kind: Literal["other_node_id"]
    node: NodeName
    node_id: int = Field(0, ge=0, le=127)


class NodeFault(Lasting):
    """Let a device fail (`sim_bus.network.device_faults`)."""

    place, wire = "node", False
    kind: Literal[
        "over_current",
        "over_temperature",
        "encoder_lost",
        "supply_low",
        "coil_open",
        "coil_short",
        "blocked",
        "power_off",
        "heartbeat_off",
        "pdo_length",
    ]
    node: NodeName


AnyFault = Annotated[
    NodeFault
    | OtherNodeId
    | SlowSdo
    | SecondMaster
    | Babble
    | StuckDominant
    | Noise
    | Cut
    | Reset
    | Drift
    | Drop
    | Delay
    | Duplicate
    | CorruptCrc
    | Flip,
    Field(discriminator="kind"),
]
KINDS: Mapping[str, type[_Fault]] = {
    kind: model for model in get_args(get_args(AnyFault)[0]) for kind in get_args(model.model_fields["kind"].annotation)
}
"""Models of all kinds of faults, by name."""


def effect_of(kind: str) -> str:
    """Return the effect of a kind of fault, as one sentence."""
    return EFFECTS.get(kind) or (KINDS[kind].__doc__ or "").partition("\n")[0]


class Controller(_OnBus):
    """Settings of a node's CAN controller."""

    node: NodeName
    restart_ms: Annotated[float, Field(ge=0, le=1e7)] | Literal["manual"] = RESTART_MS
    one_shot: bool = False
    listen_only: bool = False
    loopback: bool = False
    queue_limit: int = Field(0, ge=0, le=1000)
