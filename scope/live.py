"""What is on a bus right now: the last value of every PDO, rates, ages, the nodes' states, and what happened.

Taking a frame is a dictionary's look-up and a few stores, so a reader keeps up with a full bus; decoding is done when
somebody looks (`Live.snapshot`). Time is an argument: nanoseconds since 1970, as the frames' stamps.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from eds.cia301 import CobId, NmtState, abort_text
from eds.cia402 import STATE_OF_STATUSWORD, PowerState
from eds.rig import Rig
from eds.signals import RigPdo
from scope.recording import decode_field
from scope.services import STATES, emcy, nmt

__all__ = ["Event", "Live", "NodeRow", "PdoRow", "Snapshot", "Value"]

CAN_EFF_FLAG, CAN_RTR_FLAG, CAN_ERR_FLAG = 0x80000000, 0x40000000, 0x20000000
WINDOW_NS = 1_000_000_000
SYNC_SILENT_NS = 100_000_000
STATUSWORD = 0x6041
ERROR_CLASSES = {
    0x001: "transmission timed out", 0x002: "arbitration lost", 0x004: "controller problem", 0x008: "protocol violation",
    0x010: "transceiver problem", 0x020: "no acknowledgement", 0x040: "bus off", 0x080: "bus error", 0x100: "restarted",
}  # fmt: skip
"""Classes of error frames, linux/can/error.h."""


@dataclass(frozen=True)
class Event:
    """Something that happened: when [ns since 1970], and what; `grave` where a run cannot go on."""

    t_ns: int
    text: str
    grave: bool = False


@dataclass(frozen=True)
class Value:
    """A signal's last value in `unit`; None: it never came."""

    name: str
    value: int | float | None
    unit: str


@dataclass(frozen=True)
class PdoRow:
    """One PDO: frames so far and each second, age of the last one [s] (None: none came), values."""

    name: str
    can_id: int
    count: int
    rate_per_s: float
    age_s: float | None
    malformed: int
    values: tuple[Value, ...]


@dataclass(frozen=True)
class NodeRow:
    """One node: NMT state (None: never heard), age of its heartbeat [s], power state and last emergency, if any."""

    name: str
    node_id: int
    state: str | None
    age_s: float | None
    silent: bool
    power_state: str | None
    emergency: str | None


@dataclass(frozen=True)
class Snapshot:
    """All of it at one time."""

    t_ns: int
    frames: int
    frames_per_s: float
    sync_per_s: float
    error_frames: int
    unknown: int
    pdos: tuple[PdoRow, ...]
    nodes: tuple[NodeRow, ...]
    events: tuple[Event, ...]
    """Those since the last snapshot."""


@dataclass
class _Line:
    """Frames of one identifier."""

    length: int = -1  # expected, -1: any
    count: int = 0
    malformed: int = 0
    t_ns: int = 0
    data: bytes = b""


@dataclass
class _Node:
    name: str
    node_id: int
    timeout_ns: int
    state: int = -1
    power: int = -1
    silent: bool = False
    emergency: str | None = None
    heartbeat: _Line = field(default_factory=_Line)


class Live:
    """The state of a rig's bus; `take` frames, look at `snapshot`."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self._pdos = rig.pdos()
        self._lines = {pdo.layout.cob_id: _Line(pdo.layout.length) for pdo in self._pdos}
        self._sync = self._lines[CobId.SYNC] = _Line()
        timeouts_s = (("motor", rig.motor.heartbeat_timeout_s), ("brake", rig.brake.heartbeat_timeout_s))
        self._nodes = [
            _Node(name, getattr(rig, name).node_id, round(timeout_s * 1e9))
            for name, timeout_s in (*timeouts_s, ("host", 3 * rig.host.heartbeat_s))
        ]
        self._by_id = {node.node_id: node for node in self._nodes}
        self._statusword = next(
            (pdo.layout.cob_id, start // 8)
            for pdo in self._pdos
            for entry, start in zip(pdo.layout.entries, pdo.layout.starts, strict=True)
            if entry.index == STATUSWORD
        )
        self._events: list[Event] = []
        self._history: deque[tuple[int, dict[int, int], int]] = deque()
        self._sync_silent = False
        self._error_class = 0
        self.frames = self.error_frames = self.unknown = 0

    def take(self, received: Iterable[tuple[int, int, int, bytes]]) -> None:
        """Take frames: (stamp, identifier with flags, length, eight data bytes) each; nothing in them raises."""
        lines = self._lines
        statusword_id = self._statusword[0]
        for t_ns, can_id, length, data in received:
            self.frames += 1
            line = lines.get(can_id)
            if line is None:
                self._other(t_ns, can_id, data[:length])
                continue
            if line.length not in (-1, length):
                line.malformed += 1
                continue
            line.count += 1
            line.t_ns = t_ns
            if can_id == statusword_id and data != line.data:
                self._power_state(t_ns, data)
            line.data = data

    def tell(self, t_ns: int, text: str, grave: bool = False) -> None:
        """Note an event that is seen elsewhere, as the bus going away."""
        self._events.append(Event(t_ns, text, grave))

    def _power_state(self, t_ns: int, data: bytes) -> None:
        start = self._statusword[1]
        state = int(STATE_OF_STATUSWORD[data[start] & 0x7F])
        motor = self._nodes[0]
        if state == motor.power:
            return
        fault = state in (PowerState.FAULT, PowerState.FAULT_REACTION_ACTIVE)
        if motor.power >= 0 or fault:
            self.tell(t_ns, f"motor: {_power_text(motor.power)} -> {_power_text(state)}", fault)
        motor.power = state

    def _other(self, t_ns: int, can_id: int, data: bytes) -> None:
        if can_id & CAN_ERR_FLAG:
            self._error(t_ns, can_id)
            return
        if can_id & (CAN_RTR_FLAG | CAN_EFF_FLAG):
            self.unknown += 1
            return
        if can_id == CobId.NMT:
            row = nmt(data, lambda number: self._by_id[number].name if number in self._by_id else str(number))
            if "command" in row:
                self.tell(t_ns, f"NMT: {row['command']}, to {row['node']}")
            return
        function, node = can_id & 0x780, self._by_id.get(can_id & 0x7F)
        if function == CobId.HEARTBEAT and node is not None and len(data) == 1:
            self._heartbeat(t_ns, node, data[0] & 0x7F)
        elif function == CobId.EMCY and node is not None and len(data) == 8:
            row = emcy(data)
            node.emergency = row["text"] if row["code"] else None
            text = node.emergency or "error reset or no error"
            self.tell(t_ns, f"{node.name}: EMCY {text} (register {row['register']:02X}h)", grave=bool(row["code"]))
        elif function in (CobId.SDO_TX, CobId.SDO_RX) and node is not None and len(data) == 8:
            if data[0] == 0x80:
                index, subindex = int.from_bytes(data[1:3], "little"), data[3]
                reason = abort_text(int.from_bytes(data[4:8], "little"))
                self.tell(t_ns, f"{node.name}: SDO abort {index:04X}h:{subindex}: {reason}")
        else:
            self.unknown += 1

    def _heartbeat(self, t_ns: int, node: _Node, state: int) -> None:
        name = _nmt_text(state)
        if node.silent:
            self.tell(t_ns, f"{node.name}: heard again, {name}")
        elif state == NmtState.INITIALISING:
            self.tell(t_ns, f"{node.name}: {name}")
        elif node.state >= 0 and state != node.state:
            self.tell(t_ns, f"{node.name}: {_nmt_text(node.state)} -> {name}")
        node.state, node.silent = state, False
        node.heartbeat.count += 1
        node.heartbeat.t_ns = t_ns

    def _error(self, t_ns: int, can_id: int) -> None:
        self.error_frames += 1
        kind = can_id & 0x1FF
        if kind != self._error_class:  # a bad cable sends thousands of them each second
            texts = [text for bit, text in ERROR_CLASSES.items() if kind & bit]
            self.tell(t_ns, f"error frame: {', '.join(texts) or 'unknown class'}", grave=bool(kind & 0x40))
        self._error_class = kind

    def snapshot(self, t_ns: int) -> Snapshot:
        """Return what is known at `t_ns`, with the events since the last call."""
        self._watch(t_ns)
        counts = {can_id: line.count for can_id, line in self._lines.items()}
        self._history.append((t_ns, counts, self.frames))
        while len(self._history) > 2 and self._history[1][0] <= t_ns - WINDOW_NS:
            self._history.popleft()
        before_ns, before, frames = self._history[0]
        seconds = (t_ns - before_ns) / 1e9

        def rate(now: int, then: int) -> float:
            return (now - then) / seconds if seconds > 0 else 0.0

        events, self._events = tuple(self._events), []
        return Snapshot(
            t_ns=t_ns,
            frames=self.frames,
            frames_per_s=rate(self.frames, frames),
            sync_per_s=rate(self._sync.count, before[CobId.SYNC]),
            error_frames=self.error_frames,
            unknown=self.unknown,
            pdos=tuple(
                self._pdo_row(pdo, t_ns, rate(counts[pdo.layout.cob_id], before[pdo.layout.cob_id]))
                for pdo in self._pdos
            ),
            nodes=tuple(_node_row(node, t_ns) for node in self._nodes),
            events=events,
        )

    def _watch(self, t_ns: int) -> None:
        """Note what did not come."""
        for node in self._nodes:
            age_ns = t_ns - node.heartbeat.t_ns
            if node.state >= 0 and not node.silent and age_ns > node.timeout_ns:
                node.silent = True
                self.tell(t_ns, f"{node.name}: no heartbeat for {node.timeout_ns / 1e9:g} s", grave=True)
        silent = self._sync.count > 0 and t_ns - self._sync.t_ns > SYNC_SILENT_NS
        if silent != self._sync_silent:
            self.tell(t_ns if silent else self._sync.t_ns, "SYNC stopped" if silent else "SYNC again", grave=silent)
        self._sync_silent = silent

    def _pdo_row(self, pdo: RigPdo, t_ns: int, rate_per_s: float) -> PdoRow:
        layout = pdo.layout
        line = self._lines[layout.cob_id]
        values = []
        word = np.frombuffer(line.data, "<i8").astype(np.int64) if line.count else None
        for signal, entry, start in zip(pdo.signals, layout.entries, layout.starts, strict=True):
            value = None
            if word is not None:
                raw = decode_field(word, start, entry)[0].item()
                value = raw if not signal.unit and signal.scale == 1 else signal.si(raw)
                if not math.isfinite(value):
                    value = None
            values.append(Value(signal.name, value, signal.unit))
        return PdoRow(
            name=f"{pdo.node}.{layout.direction.upper()}{layout.number}",
            can_id=layout.cob_id,
            count=line.count,
            rate_per_s=rate_per_s,
            age_s=max(0.0, (t_ns - line.t_ns) / 1e9) if line.count else None,
            malformed=line.malformed,
            values=tuple(values),
        )


def _node_row(node: _Node, t_ns: int) -> NodeRow:
    heard = node.state >= 0
    return NodeRow(
        name=node.name,
        node_id=node.node_id,
        state=_nmt_text(node.state) if heard else None,
        age_s=max(0.0, (t_ns - node.heartbeat.t_ns) / 1e9) if heard else None,
        silent=node.silent,
        power_state=_power_text(node.power) if node.power >= 0 else None,
        emergency=node.emergency,
    )


def _nmt_text(state: int) -> str:
    return STATES.get(state, f"unknown state {state}")


def _power_text(state: int) -> str:
    return "unknown state" if state < 0 else PowerState(state).name.lower().replace("_", " ")
