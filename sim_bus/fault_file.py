"""A fault file: what goes wrong on the bus, and when (docs/bus.md).

::

    seed = 7                             # of the noise; without it the run's seed

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
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, field_validator, model_validator

from eds.toml_lines import Document, Key, read_toml
from sim_bus.attempt import refresh
from sim_bus.controller import MANUAL, STATIONS
from sim_bus.fault_words import mistakes
from sim_bus.faults import MAX_FAULTS, TAIL_BIT, FaultKind, plan_alarm
from sim_bus.noise import seeded
from sim_bus.slow_motion import ALL, CLIENT_ROWS, CLIENTS
from sim_bus.waiting import FAR_NS
from wire.frame import CAN_EFF_FLAG, CAN_RTR_FLAG, data_word

__all__ = ["FaultError", "FaultPlan", "Injected", "NodeName", "begin_enabled", "injections", "install", "read_faults"]

NodeName = Annotated[str | int, Field(union_mode="left_to_right")]
"""A node by its name in the rig ("motor", "brake", "host") or by its node id."""

RESTART_MS = 100
"""From bus-off to the begin of recovery, as a CAN interface is usually set up: long enough that whoever depends on the station notices."""

BASES = {
    "NMT": 0x000,
    "SYNC": 0x080,
    "EMCY": 0x080,
    "TIME": 0x100,
    **{f"TPDO{n}": 0x080 + 0x100 * n for n in range(1, 5)},
    **{f"RPDO{n}": 0x100 + 0x100 * n for n in range(1, 5)},
    "SDO RESPONSE": 0x580,
    "SDO REQUEST": 0x600,
    "HEARTBEAT": 0x700,
}
"""Identifiers of the predefined connection set (CiA 301, 7.3.5); a node's is that plus its node id."""
HOST_ROW = 255
SOURCE_HOST = -1
OF_NO_NODE = ("NMT", "SYNC", "TIME")
MOST_COUNTED = 10**12
LAST_BIT = 160
TAIL_BITS = ("crc_delimiter", "ack_slot", "ack_delimiter", *(f"eof{n}" for n in range(1, 8)))
BIT_NAMES = {name: TAIL_BIT + n for n, name in enumerate((*TAIL_BITS, "intermission1", "intermission2"))}
_TRIGGER = re.compile(
    r"(?:(?P<every>every)\s+)?(?:(?P<nth>\d+)(?:st|nd|rd|th)\s+)?(?P<frame>0x[0-9a-f]+|[a-z]+ ?[a-z]*\d?)(?:\s+of\s+(?:node\s+)?(?P<node>[\w.]+))?",
    re.IGNORECASE,
)


class FaultError(ValueError):
    """A fault file that cannot be used; one line for each mistake, with its place."""

    exit_status = 3


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Trigger(_Strict):
    """Which frames are meant: the `nth` one of a kind, and then every `every`-th; without either, the first."""

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
        found = _TRIGGER.fullmatch(given.strip())
        if found is None:
            raise ValueError('expected a text such as "3rd TPDO1 of node 2", "every 10th SYNC" or "1st 0x181"')
        nth, node = int(found["nth"] or 1), found["node"]
        words: dict[str, Any] = {"nth": nth, "every": nth if found["every"] else 0}
        if found["frame"].lower().startswith("0x"):
            words["can_id"] = int(found["frame"], 16)
        else:
            words["frame"] = found["frame"]
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


class _OnFrame(_Fault):
    on: Trigger | None = None
    duration_s: float | None = Field(None, ge=1e-9, le=1e7)
    most: int = Field(0, ge=0, le=MOST_COUNTED)


class _Lasting(_Fault):
    duration_s: float | None = Field(None, ge=1e-9, le=1e7)


class Flip(_OnFrame):
    """Turn one bit of a frame around, for all or for one receiver."""

    kind: Literal["flip"]
    bit: int | str = 0
    seen_by: NodeName | None = None

    @field_validator("bit", mode="before")
    @classmethod
    def _known(cls, bit: Any) -> Any:
        if bit in BIT_NAMES if isinstance(bit, str) else type(bit) is int and 0 <= bit <= LAST_BIT:
            return bit
        raise ValueError(f"expected 0 (the start of frame) to {LAST_BIT}, or {', '.join(BIT_NAMES)}")


class CorruptCrc(_OnFrame):
    """Send a frame with a wrong CRC."""

    kind: Literal["corrupt_crc"]


class Drop(_OnFrame):
    """Lose a frame without an error, for all or for one receiver."""

    kind: Literal["drop"]
    lost_for: NodeName | None = None


class Delay(_OnFrame):
    """Hold a frame back."""

    kind: Literal["delay"]
    delay_us: float = Field(ge=1e-3, le=1e9)


class Duplicate(_OnFrame):
    """Send a frame twice."""

    kind: Literal["duplicate"]


class Reset(_OnFrame):
    """Reset a node, as by NMT, when the frame has been sent or at a time."""

    kind: Literal["reset"]
    node: NodeName


class Cut(_Fault):
    """Cut the cable into two halves, at a time or when a frame has been sent; whom `halves` does not name is in the first."""

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


class Drift(_Lasting):
    """Let a node's clock run fast, or slow."""

    kind: Literal["drift"]
    node: NodeName
    ppm: float = Field(ge=-1e5, le=1e5)


class Babble(_Lasting):
    """Let a node send one frame again and again, whatever else it does."""

    kind: Literal["babble"]
    node: NodeName
    can_id: int = Field(ge=0, le=0x1FFFFFFF)
    extended: bool = False
    data: str = Field("", pattern=r"^([0-9A-Fa-f]{2} ?){0,8}$")
    period_us: float = Field(100.0, ge=10, le=1e9)


class StuckDominant(_Lasting):
    """Hold the wire dominant."""

    kind: Literal["stuck_dominant"]


class Noise(_Lasting):
    """Turn bits around at random, each with the probability `rate`, for all or for one receiver."""

    kind: Literal["noise"]
    rate: float = Field(gt=0, le=1)
    seen_by: NodeName | None = None


AnyFault = Annotated[
    Flip | CorruptCrc | Drop | Delay | Duplicate | Reset | Cut | Drift | Babble | StuckDominant | Noise,
    Field(discriminator="kind"),
]


class Controller(_OnBus):
    """How a node's CAN controller is set up."""

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
    """A fault file's contents, or those about one bus; `faults` and `controllers` tell where in the file they stand, `lines` in which line."""

    path: str
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
            an entry names another bus, or none where the rig has several
        """
        kept: dict[str, list[int]] = {"fault": [], "controller": []}
        known = ", ".join(f'"{one}"' for one in channels if one) or "one without a name; leave the key out"
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

    def mistake(self, key: Key, text: str) -> FaultError:
        """Return the error of a value, with its place."""
        return FaultError(f"{self.path}:{self.document.line(key)}: {'.'.join(str(part) for part in key)}: {text}")


@dataclass(frozen=True)
class Injected:
    """What a fault of the file came to."""

    kind: str
    line: int
    times: int
    first_s: float | None
    last_s: float | None


def read_faults(path: Path) -> FaultPlan:
    """Return the faults of the file `path`.

    Raises
    ------
    FaultError
        it cannot be read, or holds a mistake; the text has a line for each, with file and line
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise FaultError(f"{path}: the fault file cannot be read ({error.strerror or error})") from None
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise FaultError(f"{path}:{line}: byte {raw[error.start]:02X}h is not UTF-8; save the file as UTF-8") from None
    document = read_toml(text)
    if document.problems:
        raise FaultError("\n".join(f"{path}:{line}: {problem}" for line, problem in document.problems))
    try:
        file = TypeAdapter(_File).validate_python(document.values)
    except ValidationError as error:
        raise FaultError(
            "\n".join(mistakes(str(path), document, error, _File, get_args(get_args(AnyFault)[0])))
        ) from None
    if len(file.fault) > MAX_FAULTS:
        line = document.line(("fault", MAX_FAULTS))
        raise FaultError(f"{path}:{line}: {len(file.fault)} faults; a file may have {MAX_FAULTS}")
    lines = tuple(document.line(("fault", n)) for n in range(len(file.fault)))
    return FaultPlan(str(path), file, lines, document, tuple(range(len(lines))), tuple(range(len(file.controller))))


class _Nodes:
    """Station numbers of the nodes that a file names."""

    def __init__(self, plan: FaultPlan, stations: Mapping[str, int], node_ids: Mapping[int, int]) -> None:
        self.plan, self.stations, self.node_ids = plan, stations, node_ids

    def station(self, name: str | int | None, key: Key) -> int:
        """Return the station of a node, `ALL` of None."""
        if name is None:
            return ALL
        table: Mapping[Any, int] = self.node_ids if isinstance(name, int) else self.stations
        if name not in table:
            known = ", ".join([*self.stations, *map(str, self.node_ids)])
            raise self.plan.mistake(key, f"there is no node {name!r} on this bus; it has {known}")
        return table[name]

    def node_id(self, name: str | int, key: Key) -> int:
        """Return the node id of a node."""
        if isinstance(name, int):
            return name
        station = self.station(name, key)
        for node_id, other in self.node_ids.items():
            if other == station:
                return node_id
        raise self.plan.mistake(key, f"'{name}' has no node id; name the sender with sender = \"{name}\"")


def _match(row: Any, on: Trigger, nodes: _Nodes, key: Key) -> None:
    flags = (CAN_EFF_FLAG if on.extended else 0) | (CAN_RTR_FLAG if on.remote else 0)
    if on.can_id is not None:
        if on.can_id > 0x7FF:
            flags |= CAN_EFF_FLAG
        row.match_id, row.match_mask = on.can_id | flags, 0xFFFFFFFF
    else:
        assert on.frame is not None
        name = on.frame.upper()
        row.match_id, row.match_mask = BASES[name] | flags, 0xFFFFFFFF
        if name not in OF_NO_NODE:
            if on.node is None:
                row.match_mask = 0xFFFFFF80
            else:
                row.match_id |= nodes.node_id(on.node, (*key, "node"))
    row.framed, row.nth, row.every = 1, on.nth, on.every
    row.match_source = nodes.station(on.sender, (*key, "sender"))


def _at_one_time(a: _Lasting, b: _Lasting) -> bool:
    """Tell whether two faults may last at the same time; when Operation Enabled is, nobody knows before."""
    if a.after != b.after:
        return True
    first, second = sorted((a, b), key=lambda one: one.at_s)
    return first.duration_s is None or round((first.at_s + first.duration_s) * 1e9) > round(second.at_s * 1e9)


def _refuse_twice(plan: FaultPlan, nodes: _Nodes) -> None:
    """Refuse what a file says twice: a node's controller, and, for one time, the drift of a node's clock."""
    known: dict[int, int] = {}
    for n, given in enumerate(plan.file.controller):
        key = ("controller", plan.controllers[n], "node")
        station = nodes.station(given.node, key)
        if station in known:
            line = plan.document.line(("controller", plan.controllers[known[station]]))
            raise plan.mistake(key, f"{given.node!r} has a [[controller]] in line {line} already; put all of it there")
        known[station] = n
    for n, fault in enumerate(plan.file.fault):
        for m, other in enumerate(plan.file.fault[:n]):
            if isinstance(fault, Drift) and isinstance(other, Drift):
                clocks = {
                    nodes.station(one.node, ("fault", plan.faults[k], "node")) for k, one in ((m, other), (n, fault))
                }
                if len(clocks) == 1 and _at_one_time(fault, other):
                    text = f"the clock of {fault.node!r} drifts by line {plan.lines[m]} already; let one end before the other begins"
                    raise plan.mistake(("fault", plan.faults[n], "node"), text)


def install(
    bus: Any, plan: FaultPlan, seed: int, stations: Mapping[str, int], node_ids: Mapping[int, int]
) -> list[tuple[int, int]]:
    """Put the faults of a file into the bus's table; return (row, nanoseconds) of those that count from Operation Enabled.

    Parameters
    ----------
    bus : the record of `sim_bus.arbiter.BUS`
    seed : of the noise, where the file has none of its own
    stations, node_ids : stations by name and by node id

    Raises
    ------
    FaultError
        a node is named that is not on this bus, or something is said twice
    """
    nodes = _Nodes(plan, stations, node_ids)
    _refuse_twice(plan, nodes)
    bus.noise_state = seeded(plan.file.seed if plan.file.seed is not None else seed)
    later = []
    for n, fault in enumerate(plan.file.fault):
        row, key = bus.faults[n], ("fault", plan.faults[n])
        row.kind = int(FaultKind[fault.kind.upper()])
        row.nth, row.every, row.most = 1, 0, 0
        row.match_source = row.station = ALL
        duration = getattr(fault, "duration_s", None)
        _what(row, fault, nodes, key)
        if isinstance(fault, _OnFrame):
            row.most = fault.most
            if fault.on is not None:
                _match(row, fault.on, nodes, (*key, "on"))
            elif duration is not None:
                row.every = 1
        elif isinstance(fault, Cut):
            row.most, row.lasts_ns = fault.most, FAR_NS if duration is None else round(duration * 1e9)
            duration = None
            if fault.on is not None:
                _match(row, fault.on, nodes, (*key, "on"))
        length_ns = FAR_NS if duration is None else round(duration * 1e9)
        if fault.after == "enabled":
            row.from_ns = row.next_ns = FAR_NS
            row.until_ns = length_ns
            later.append((n, round(fault.at_s * 1e9)))
        else:
            _begin(row, round(fault.at_s * 1e9), length_ns)
    bus.fault_count = len(plan.file.fault)
    for station in stations.values():
        bus.stations["restart_ns"][_rows(station)] = RESTART_MS * 1_000_000
    named: dict[int, int] = {}
    for n, given in zip(plan.controllers, plan.file.controller, strict=True):
        place: Key = ("controller", n)
        station = nodes.station(given.node, (*place, "node"))
        if station in named:
            line = plan.document.line(("controller", named[station]))
            raise plan.mistake((*place, "node"), f"{given.node!r} is set up in line {line} already; put all keys there")
        named[station] = n
        if station == CLIENTS and given.listen_only:
            raise plan.mistake(
                (*place, "listen_only"), "here each client says itself whether it listens only; leave it out"
            )
        c, rows = bus.stations, _rows(station)
        c["restart_ns"][rows] = MANUAL if given.restart_ms == "manual" else round(given.restart_ms * 1e6)
        for name in ("one_shot", "loopback", "queue_limit"):
            c[name][rows] = getattr(given, name)
        if station != CLIENTS:
            c["listen_only"][rows] = given.listen_only
    plan_alarm(bus, 0)
    refresh(bus)
    return later


def _rows(station: int) -> slice:
    """Return the rows of a station, or of all that it stands for."""
    row = station % STATIONS
    return CLIENT_ROWS if station == CLIENTS else slice(row, row + 1)


def _begin(row: Any, from_ns: int, length_ns: int) -> None:
    row.from_ns = from_ns
    row.next_ns = FAR_NS if row.framed else from_ns
    row.until_ns = min(from_ns + length_ns, FAR_NS)


def begin_enabled(bus: Any, later: list[tuple[int, int]], now_ns: int) -> None:
    """Let the faults that count from Operation Enabled count from `now_ns`."""
    for n, after_ns in later:
        row = bus.faults[n]
        _begin(row, now_ns + after_ns, int(row.until_ns))
    plan_alarm(bus, now_ns)
    refresh(bus)


def _what(row: Any, fault: Any, nodes: _Nodes, key: Key) -> None:
    """Set what a fault does, and to whom."""
    for name in ("seen_by", "lost_for", "node"):
        if getattr(fault, name, None) is not None:
            row.station = nodes.station(getattr(fault, name), (*key, name))
    host = row.station in (SOURCE_HOST, CLIENTS)
    if isinstance(fault, Reset) and host:
        raise nodes.plan.mistake((*key, "node"), "the host is no node that could be reset; expected a node of the rig")
    if isinstance(fault, Babble) and host:
        row.station = SOURCE_HOST  # in a bus of clients a station of its own
    if isinstance(fault, Flip | Noise) and row.station not in (ALL, CLIENTS):
        row.station %= STATIONS  # the controller that sees it, by its row: the host's is the last
    if isinstance(fault, Flip):
        row.bit = BIT_NAMES[fault.bit] if isinstance(fault.bit, str) else fault.bit
    elif isinstance(fault, Cut):
        named_before: set[int] = set()
        for half, named in enumerate(fault.halves):
            for k, node in enumerate(named):
                station = nodes.station(node, (*key, "halves", half, k))
                station = HOST_ROW if station == CLIENTS else station % STATIONS
                if station in named_before:
                    raise nodes.plan.mistake((*key, "halves", half, k), f"{node!r} is named twice; name each node once")
                named_before.add(station)
                row.far[station] = half
        if row.far[HOST_ROW]:
            row.far[CLIENT_ROWS] = 1
    elif isinstance(fault, Delay):
        row.delay_ns = round(fault.delay_us * 1e3)
    elif isinstance(fault, Noise):
        row.rate = fault.rate
    elif isinstance(fault, Babble):
        data = bytes.fromhex(fault.data)
        row.can_id = fault.can_id | (CAN_EFF_FLAG if fault.extended or fault.can_id > 0x7FF else 0)
        row.length, row.word = len(data), data_word(data)
        row.period_ns = round(fault.period_us * 1e3)


def injections(rows: Any, plan: FaultPlan) -> list[Injected]:
    """Return what each fault of the file came to."""
    out = []
    for n, fault in enumerate(plan.file.fault):
        row = rows[n]
        times = int(row.fired)
        seconds = (int(row.first_ns) * 1e-9, int(row.last_ns) * 1e-9) if times else (None, None)
        out.append(Injected(fault.kind, plan.lines[n], times, *seconds))
    return out
