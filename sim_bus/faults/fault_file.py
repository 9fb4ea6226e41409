"""Fault file: faults on the bus, and their times (docs/bus.md).

::

    seed = 7                             # of the noise; default: the run's seed

    [[fault]]
    kind = "flip"                        # FaultKind, in small letters
    on = "3rd TPDO1 of node 2"           # or { frame = "TPDO1", node = 2, nth = 3, every = 10 }
    bit = 30

    [[fault]]
    kind = "noise"
    at_s = 1.5                           # from power-on; with after = "enabled" from the drive's Operation Enabled
    duration_s = 10.0
    rate = 1e-4

    [[controller]]
    node = "motor"
    restart_ms = 100                     # bus-off to the begin of recovery; "manual": never
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, field_validator, model_validator

from coulombus.eds.cia301 import CobId
from coulombus.rigs.toml_kind import of_another_kind
from coulombus.rigs.toml_lines import Document, Key, read_text, read_toml
from coulombus.sim_bus.can_bus.faults import TAIL_BIT
from coulombus.sim_bus.can_bus.records import MAX_FAULTS
from coulombus.sim_bus.faults.error_text import mistakes
from coulombus.system.errors import CoulombusError

__all__ = [
    "BASES",
    "BIT_NAMES",
    "OF_NO_NODE",
    "RESTART_MS",
    "Babble",
    "Cut",
    "Delay",
    "Drift",
    "FaultError",
    "FaultPlan",
    "Flip",
    "Lasting",
    "NodeName",
    "Noise",
    "OnFrame",
    "Reset",
    "Trigger",
    "faults_of",
    "read_faults",
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


class FaultError(CoulombusError, ValueError):
    """An unusable fault file; one line for each mistake, with its position."""

    exit_status = 3


class _Strict(BaseModel):
    # validators are built when a fault file is read: most runs have none
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)


class Trigger(_Strict):
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
    def _words(cls, given: Any) -> Any:
        if not isinstance(given, str):
            return given
        match = _TRIGGER.fullmatch(given.strip())
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
        if (self.frame is None) == (self.can_id is None):
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


class _OnBus(_Strict):
    bus: str | None = None


class _Fault(_OnBus):
    at_s: float = Field(0.0, ge=0, le=1e7)
    after: Literal["start", "enabled"] = "start"


class OnFrame(_Fault):
    """A fault of the frames selected by `on`."""

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
    def _known(cls, bit: Any) -> Any:
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

    kind: Literal["delay"]
    delay_us: float = Field(ge=1e-3, le=1e9)


class Duplicate(OnFrame):
    """Send a frame twice."""

    kind: Literal["duplicate"]


class Reset(OnFrame):
    """Reset a node, as by NMT, after a frame or at a time."""

    kind: Literal["reset"]
    node: NodeName


class Cut(_Fault):
    """Cut the cable into two halves, at a time or after a frame.

    Nodes that `halves` does not name are in the first half.
    """

    kind: Literal["cut"]
    on: Trigger | None = None
    most: int = Field(0, ge=0, le=MOST_COUNTED)
    duration_s: float | None = Field(None, ge=1e-9, le=1e7)
    halves: tuple[list[NodeName], list[NodeName]] = Field(strict=False)  # TOML has lists only

    @field_validator("halves")
    @classmethod
    def _two(cls, halves: tuple[list[NodeName], list[NodeName]]) -> tuple[list[NodeName], list[NodeName]]:
        both = set(halves[0]) & set(halves[1])
        if both or not halves[1]:
            raise ValueError('expected the nodes of both halves, each in one, as in [["host", "brake"], ["motor"]]')
        return halves


class Drift(Lasting):
    """Let a node's clock run fast or slow."""

    kind: Literal["drift"]
    node: NodeName
    ppm: float = Field(ge=-1e5, le=1e5)


class Babble(Lasting):
    """Let a node send one frame periodically, in addition to its normal frames."""

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

    kind: Literal["noise"]
    rate: float = Field(gt=0, le=1)
    seen_by: NodeName | None = None


AnyFault = Annotated[
    Flip | CorruptCrc | Drop | Delay | Duplicate | Reset | Cut | Drift | Babble | StuckDominant | Noise,
    Field(discriminator="kind"),
]


class Controller(_OnBus):
    """Settings of a node's CAN controller."""

    node: NodeName
    restart_ms: Annotated[float, Field(ge=0, le=1e7)] | Literal["manual"] = RESTART_MS
    one_shot: bool = False
    listen_only: bool = False
    loopback: bool = False
    queue_limit: int = Field(0, ge=0, le=1000)


class _File(_Strict):
    seed: int | None = Field(None, ge=0, lt=2**62)
    fault: list[AnyFault] = []
    controller: list[Controller] = []


@dataclass(frozen=True)
class FaultPlan:
    """Contents of a fault file, or its part for one bus; `faults` and `controllers` map to the positions in
    the file, `lines` to the line numbers; `text` is the whole file.
    """

    path: str
    text: str
    file: _File
    lines: tuple[int, ...]
    document: Document
    faults: tuple[int, ...]
    controllers: tuple[int, ...]

    def on(self, channel: str, channels: Collection[str]) -> FaultPlan:
        """Return the plan of one of the buses `channels` of a rig.

        Raises
        ------
        FaultError
            an entry names an unknown bus, or none although the rig has several
        """
        kept: dict[str, list[int]] = {"fault": [], "controller": []}
        known = ", ".join(f'"{bus}"' for bus in channels if bus) or "one without a name; leave the key out"
        for section, entries in (("fault", self.file.fault), ("controller", self.file.controller)):
            for n, entry in enumerate(entries):
                if entry.bus is None and len(channels) > 1:
                    raise self.mistake((section, n), f"the rig has several buses; expected bus = one of {known}")
                if entry.bus is not None and entry.bus not in channels:
                    raise self.mistake((section, n, "bus"), f"there is no bus '{entry.bus}'; the rig has {known}")
                if entry.bus in (None, channel):
                    kept[section].append(n)
        return replace(
            self,
            file=self.file.model_copy(
                update={
                    "fault": [self.file.fault[n] for n in kept["fault"]],
                    "controller": [self.file.controller[n] for n in kept["controller"]],
                }
            ),
            lines=tuple(self.lines[n] for n in kept["fault"]),
            faults=tuple(kept["fault"]),
            controllers=tuple(kept["controller"]),
        )

    def on_one(self, channels: Sequence[str]) -> FaultPlan:
        """Return the plan of the buses of one host.

        Raises
        ------
        FaultError
            the host has several buses, or as from `on`
        """
        if len(channels) > 1:
            buses = ", ".join(channels)
            raise FaultError(
                f"{self.path}: faults strike a host's only bus, and the arm has the buses {buses}: put its joints on one"
            )
        return self.on(channels[0], channels)

    def mistake(self, key: Key, text: str) -> FaultError:
        """Return the error for a value, with its position."""
        return FaultError(f"{self.path}:{self.document.line(key)}: {'.'.join(str(part) for part in key)}: {text}")


def read_faults(path: Path) -> FaultPlan:
    """Return the faults of the file `path`.

    Raises
    ------
    FaultError
        the file is unreadable, or has mistakes; the text has a line for each, with file and line
    """
    return faults_of(read_text(path, "fault file", FaultError), str(path))


def faults_of(text: str, path: str) -> FaultPlan:
    """Return the faults of a fault file's text; errors name it `path`.

    Raises
    ------
    FaultError
        the text has mistakes, a line for each
    """
    document = read_toml(text)
    if document.problems:
        raise FaultError("\n".join(f"{path}:{line}: {problem}" for line, problem in document.problems))
    if other := of_another_kind(document.values, "faults"):
        raise FaultError(f"{path}: {other}")
    try:
        file = TypeAdapter(_File).validate_python(document.values)
    except ValidationError as error:
        raise FaultError("\n".join(mistakes(path, document, error, _File, get_args(get_args(AnyFault)[0])))) from None
    if len(file.fault) > MAX_FAULTS:
        line = document.line(("fault", MAX_FAULTS))
        raise FaultError(f"{path}:{line}: {len(file.fault)} faults; a file may have {MAX_FAULTS}")
    if not file.fault and not file.controller:
        raise FaultError(f"{path}: it has no fault; expected [[fault]] or [[controller]], once for each (docs/bus.md)")
    lines = tuple(document.line(("fault", n)) for n in range(len(file.fault)))
    return FaultPlan(path, text, file, lines, document, tuple(range(len(lines))), tuple(range(len(file.controller))))
