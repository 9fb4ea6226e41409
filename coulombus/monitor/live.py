"""Present state of a bus: last value of every PDO, rates, ages, the nodes' states, and events.

`Live.add_frames` only stores frames, so a reader keeps up with a full bus; NumPy counts and decodes them
when a snapshot is requested (`Live.snapshot`). Time is an argument: nanoseconds since 1970, as the
frames' stamps.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import itemgetter

import numpy as np
import numpy.typing as npt

from coulombus.eds.cia301 import TPDOS, CobId, NmtState
from coulombus.eds.cia402 import STATE_OF_STATUSWORD, PowerState
from coulombus.eds.drive_axis import first_axis_object
from coulombus.eds.sdo_channel import SdoChannel
from coulombus.eds.sdo_frames import where
from coulombus.monitor.services import STATES, emcy, lss, nmt
from coulombus.monitor.snapshot import Event, NodeRow, PdoRow, Snapshot, Value
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.recording.maps.log_maps import LogMaps
from coulombus.rigs.signals import RigPdo
from coulombus.wire.bits import worst_case_bits
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from coulombus.wire.client import Received
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.error_frames import BUS_OFF, error_frame
from coulombus.wire.frame_batches import Block

__all__ = ["Event", "Live", "NodeRow", "PdoRow", "Snapshot", "Value", "values_of"]

WINDOW_NS = 1_000_000_000
SYNC_SILENT_NS = 100_000_000
STATUSWORD = 0x6041
CALLS = (CobId.HEARTBEAT, CobId.EMCY, CobId.SDO_TX)
"""Services that reveal a node outside the rig."""
SENT_BY_NODES = (*CALLS, *TPDOS)
"""Services sent by nodes, including the four TPDOs of the predefined connection set (CiA 301, section 7.3.5)."""
BITS = np.array([worst_case_bits(n) for n in range(9)])
"""Bits of a frame by its bytes, with the worst stuffing."""
TOGETHER = 20_000
"""Maximum number of pending frames."""


@dataclass
class _IdentifierFrames:
    """Frames of one identifier."""

    length: int = -1  # expected, -1: any
    last_length: int = 0
    count: int = 0
    malformed: int = 0
    t_ns: int = 0
    data: bytes = b""
    looked_at: bytes = b""
    """Data at the last snapshot."""
    least_ns: int = NEVER_NS
    most_ns: int = -1


@dataclass
class _Node:
    name: str
    node_id: int
    timeout_ns: int
    state: int = -1
    power: int = -1
    silent: bool = False
    emergency: str | None = None
    known: bool = True
    services: int = 0
    """Number of its frames other than those with a line."""
    heartbeat: _IdentifierFrames = field(default_factory=_IdentifierFrames)
    sdo: SdoChannel = field(default_factory=lambda: SdoChannel(None))


class Live:
    """The state of a bus; `take` frames, look at `snapshot`.

    Parameters
    ----------
    known
        Rig with names, PDOs and expected values. Without one: nodes are numbers, PDOs are learned from the frames.
    assumed
        The rig is a guess: PDOs are learned, too, and used when the bus turns out to be another rig's.
    """

    def __init__(self, bus: KnownBus, *, assumed: bool = False) -> None:
        rig = self.rig = bus.rig
        self._learned = LogMaps(bus.eds) if rig is None or assumed else None
        self._pdos: tuple[RigPdo, ...] = () if rig is None else rig.pdos()
        self._lines: dict[int, _IdentifierFrames] = {}
        self._sync = self._lines[CobId.SYNC] = _IdentifierFrames()
        self._nodes: list[_Node] = []
        if rig is not None:
            self._nodes = [_Node(n.name, n.node_id, round(n.part.heartbeat_timeout_s * 1e9)) for n in rig.nodes]
            self._nodes.append(_Node("host", rig.host.node_id, round(3e9 * rig.host.heartbeat_s)))
        self._by_id = {node.node_id: node for node in self._nodes}
        self._emergencies = {node.emcy_id: self._by_id[node.node_id] for node in (() if rig is None else rig.nodes)}
        self._sends: dict[int, list[int]] = {}
        self._statuswords: dict[int, tuple[_Node, int]] = {}
        self._arrange()
        self._waiting: list[Block] = []
        self._waiting_frames = 0
        self._row = 0  # of the present frame
        self._events: list[tuple[int, Event]] = []  # with the row of their frames
        self._history: deque[tuple[int, dict[int, int], dict[int, int], int, int]] = deque()
        self._sync_silent = False
        self._error_class = 0
        self.frames = self.bits = self.error_frames = self.unknown = 0
        self._foreign: set[int] = set()

    def _arrange(self) -> None:
        """Set the line, the sender and the statusword of each PDO."""
        for pdo in self._pdos:
            line = self._lines.setdefault(pdo.layout.cob_id, _IdentifierFrames())
            line.length = pdo.layout.length if pdo.layout.entries else -1
        tpdos = [pdo for pdo in self._pdos if pdo.layout.direction == "tpdo"]
        self._sends = {n.node_id: [p.layout.cob_id for p in tpdos if p.node_id == n.node_id] for n in self._nodes}
        if self.rig is not None:
            rpdos = [p.layout.cob_id for p in self._pdos if p.layout.direction == "rpdo"]
            self._sends[self.rig.host.node_id] = [int(CobId.SYNC), *rpdos]
        self._statuswords = {
            pdo.layout.cob_id: (self._by_id[pdo.node_id], start // 8)
            for pdo in self._pdos
            for entry, start in zip(pdo.layout.entries, pdo.layout.starts, strict=True)
            if first_axis_object(entry.index) == STATUSWORD and start % 8 == 0 and pdo.node_id in self._by_id
        }

    def _learn(self, block: Block) -> None:
        """Learn PDOs; without a rig these are shown."""
        if self._learned is not None and self._learned.add_frames(block.records) and self.rig is None:
            self._show_learned(self._learned.received_pdos())

    def _show_learned(self, pdos: tuple[RigPdo, ...]) -> None:
        self._pdos = pdos
        for pdo in pdos:
            if pdo.layout.direction == "tpdo" and pdo.node_id not in self._by_id:
                self._stranger(pdo.node_id)
        self._arrange()

    def _is_another(self) -> bool:
        """Return whether the bus is not the assumed rig's."""
        if self._learned is None or self.rig is None:
            return False
        heard = {n.node_id for n in self._nodes if n.known and n.state >= 0} - {self.rig.host.node_id}
        heard |= {p.node_id for p in self._pdos if p.layout.direction == "tpdo" and self._lines[p.layout.cob_id].count}
        strangers = any(not node.known for node in self._nodes)
        foreign = any(can_id & 0x7F not in heard for can_id in self._foreign)
        unfit = any(line.malformed and not line.count for line in self._lines.values())
        return unfit or foreign or (strangers and not heard) or self._learned.other_devices(self.rig)

    def _leave_rig(self, t_ns: int) -> None:
        """Continue without the rig: nodes are numbers."""
        if self.rig is None or self._learned is None:
            return
        self._note(t_ns, f"this is not rig {self.rig.name}: nodes are numbers here; --rig says which rig it is")
        self.rig, self._lines = None, {int(CobId.SYNC): self._sync}
        self._nodes = [node for node in self._nodes if node.state >= 0 or node.services]
        for node in self._nodes:
            node.name, node.timeout_ns, node.known = str(node.node_id), NEVER_NS, True
        self._by_id, self._emergencies = {node.node_id: node for node in self._nodes}, {}
        self._show_learned(self._learned.received_pdos())

    def add_frames(self, received: Block | Sequence[Received]) -> None:
        """Add frames; no content raises.

        They are processed together, on a snapshot or when there are `TOGETHER`.
        """
        block = received if isinstance(received, Block) else Block.from_frames(received)
        self._waiting.append(block)
        self._waiting_frames += len(block)
        if self._waiting_frames >= TOGETHER:
            self._catch_up()

    def _catch_up(self) -> None:
        """Process the pending frames by identifier; their events are in the order of the frames."""
        block, self._waiting, self._waiting_frames = Block.joined(self._waiting), [], 0
        if not len(block):
            return
        self._learn(block)
        self.frames += len(block)
        real = block.lengths[block.can_ids & CAN_ERR_FLAG == 0]
        self.bits += int(BITS[real].sum())
        before, others = len(self._events), []
        for can_id, rows in block.rows.items():
            line = self._lines.get(can_id)
            if line is None:
                others.append(rows)
            else:
                self._take_line(line, can_id, block, rows)
        if others:
            rows = np.sort(np.concatenate(others))
            for self._row, (t_ns, can_id, length, data) in zip(rows.tolist(), block.frames(rows), strict=True):
                self._other(t_ns, can_id, data[:length])
        self._events[before:] = sorted(self._events[before:], key=itemgetter(0))

    def _take_line(self, line: _IdentifierFrames, can_id: int, block: Block, rows: npt.NDArray[np.int64]) -> None:
        """Process the rows of a block that belong to one line."""
        if line.length != -1:
            right = block.lengths[rows] == line.length
            if not right.all():
                unfit, rows = rows[~right], rows[right]
                self._row = int(unfit[0])
                if not line.malformed:
                    length = block.lengths[unfit[0]]
                    expected = (
                        f"its map {line.length}" if self.rig is None else f"the rig's has {line.length}: another rig?"
                    )
                    self._note(int(block.t_ns[unfit[0]]), f"{can_id:03X}h has {length} bytes, {expected}", grave=True)
                line.malformed += len(unfit)
                if not len(rows):
                    return
        t_ns = block.t_ns[rows]
        if line.count:
            t_ns = np.concatenate(([line.t_ns], t_ns))
        gaps = t_ns[1:] - t_ns[:-1]
        if len(gaps):
            line.least_ns, line.most_ns = min(line.least_ns, int(gaps.min())), max(line.most_ns, int(gaps.max()))
        line.count += len(rows)
        line.t_ns = int(t_ns[-1])
        if can_id in self._statuswords:
            motor, start = self._statuswords[can_id]
            words = block.words[rows] >> 8 * start & 0x7F
            for k in (0, *(np.flatnonzero(words[1:] != words[:-1]) + 1).tolist()):
                self._row = row = int(rows[k])
                self._power_state(int(block.t_ns[row]), motor, start, block.data(row))
        line.data, line.last_length = block.data(rows[-1]), int(block.lengths[rows[-1]])

    def add_event(self, t_ns: int, text: str, grave: bool = False) -> None:
        """Add an event detected elsewhere, such as a closed bus, after those of the frames so far."""
        self._catch_up()
        self._note(t_ns, text, grave)

    def _note(self, t_ns: int, text: str, grave: bool = False) -> None:
        self._events.append((self._row, Event(t_ns, text, grave)))

    def _power_state(self, t_ns: int, motor: _Node, start: int, data: bytes) -> None:
        state = int(STATE_OF_STATUSWORD[data[start] & 0x7F])
        if state == motor.power:
            return
        fault = state in (PowerState.FAULT, PowerState.FAULT_REACTION_ACTIVE)
        if motor.power >= 0 or fault:
            self._note(t_ns, f"{motor.name}: {_power_text(motor.power)} -> {_power_text(state)}", fault)
        motor.power = state

    def _other(self, t_ns: int, can_id: int, data: bytes) -> None:
        if can_id & CAN_ERR_FLAG:
            self._error(t_ns, can_id, data)
            return
        if can_id & (CAN_RTR_FLAG | CAN_EFF_FLAG):
            self.unknown += 1
            return
        if can_id == CobId.NMT:
            row = nmt(data, lambda number: self._by_id[number].name if number in self._by_id else str(number))
            if "command" in row:
                self._note(t_ns, f"NMT: {row['command']}, to {row['node']}")
            return
        if can_id in (CobId.LSS_TX, CobId.LSS_RX):
            row = lss(data, can_id == CobId.LSS_TX)
            if "command" in row and row["command"] != "fastscan":
                content = ", ".join(
                    f"{key.replace('_', ' ')} {value}" for key, value in row.items() if key != "command"
                )
                self._note(t_ns, f"LSS: {row['command']}" + (f", {content}" if content else ""))
            return
        function, node = can_id & 0x780, self._by_id.get(can_id & 0x7F)
        if can_id in self._emergencies:
            function, node = CobId.EMCY, self._emergencies[can_id]
        if function in TPDOS and node is not None and node.known and can_id not in self._foreign:
            self._foreign.add(can_id)
            self._note(t_ns, f"{node.name}: {can_id:03X}h comes, which the rig does not have", grave=True)
        if node is None and function in CALLS and can_id & 0x7F:
            node = self._stranger(can_id & 0x7F)
            if self.rig is not None:
                self._note(t_ns, f"{node.name}: a node that the rig does not have; --rig says which rig it is")
        if node is not None and function in SENT_BY_NODES:
            node.services += 1
        if function == CobId.HEARTBEAT and node is not None and len(data) == 1:
            self._heartbeat(t_ns, node, data[0] & 0x7F)
        elif function == CobId.EMCY and node is not None:
            self._emergency(t_ns, node, data)
        elif function in (CobId.SDO_TX, CobId.SDO_RX) and node is not None and len(data) == 8:
            row = node.sdo.row(data, function == CobId.SDO_TX)
            if "code" in row:
                place = where(row["index"], row["subindex"])
                self._note(t_ns, f"{node.name}: {row['service']} {place} aborted: {row['text']}")
        elif node is None or node.known or function not in SENT_BY_NODES:
            self.unknown += 1

    def _emergency(self, t_ns: int, node: _Node, data: bytes) -> None:
        row = emcy(data)
        grave = bool(row.get("code", True))  # no code: also grave
        node.emergency = row.get("text", "without a code") if grave else None
        register = f" (register {row['register']:02X}h)" if "register" in row else ""
        length = f", {row['malformed']}" if "malformed" in row else ""
        self._note(
            t_ns, f"{node.name}: EMCY {node.emergency or 'error reset or no error'}{register}{length}", grave=grave
        )

    def _stranger(self, node_id: int) -> _Node:
        """Add a node that the rig does not have.

        Its heartbeat period is unknown, so it is not monitored.
        """
        node = self._by_id[node_id] = _Node(str(node_id), node_id, timeout_ns=NEVER_NS, known=self.rig is None)
        self._sends[node_id] = []
        self._nodes.append(node)
        self._nodes.sort(key=lambda entry: (not entry.known, entry.node_id if not entry.known else 0))
        return node

    def _heartbeat(self, t_ns: int, node: _Node, state: int) -> None:
        name = _nmt_text(state)
        if node.silent:
            self._note(t_ns, f"{node.name}: heard again, {name}")
        elif state == NmtState.INITIALISING:
            self._note(t_ns, f"{node.name}: {name}")
        elif node.state >= 0 and state != node.state:
            self._note(t_ns, f"{node.name}: {_nmt_text(node.state)} -> {name}")
        node.state, node.silent = state, False
        node.heartbeat.count += 1
        node.heartbeat.t_ns = t_ns

    def _error(self, t_ns: int, can_id: int, data: bytes) -> None:
        self.error_frames += 1
        kind = can_id & 0x1FF
        if kind != self._error_class:  # a bad cable causes thousands of them per second
            self._note(t_ns, f"error frame: {error_frame(can_id, data)['text']}", grave=bool(kind & BUS_OFF))
        self._error_class = kind

    def snapshot(self, t_ns: int) -> Snapshot:
        """Return the state at `t_ns`, with the events since the last call."""
        self._catch_up()
        if self._is_another():
            self._leave_rig(t_ns)
        self._watch(t_ns)
        counts = {can_id: line.count for can_id, line in self._lines.items()}
        sent = {n.node_id: n.services + sum(counts[can_id] for can_id in self._sends[n.node_id]) for n in self._nodes}
        self._history.append((t_ns, counts, sent, self.frames, self.bits))
        while len(self._history) > 2 and self._history[1][0] <= t_ns - WINDOW_NS:
            self._history.popleft()
        before_ns, before, sent_before, frames, bits = self._history[0]
        seconds = (t_ns - before_ns) / 1e9

        def rate(now: int, then: int) -> float:
            return (now - then) / seconds if seconds > 0 else 0.0

        events, self._events = tuple(event for _, event in self._events), []
        return Snapshot(
            t_ns=t_ns,
            frames=self.frames,
            frames_per_s=rate(self.frames, frames),
            sync_per_s=rate(self._sync.count, before[CobId.SYNC]),
            error_frames=self.error_frames,
            unknown=self.unknown,
            bits_per_s=rate(self.bits, bits),
            pdos=tuple(
                self._pdo_row(pdo, t_ns, rate(counts[pdo.layout.cob_id], before.get(pdo.layout.cob_id, 0)))
                for pdo in self._pdos
            ),
            nodes=tuple(
                _node_row(node, t_ns, sent[node.node_id], rate(sent[node.node_id], sent_before.get(node.node_id, 0)))
                for node in self._nodes
            ),
            events=events,
        )

    def _watch(self, t_ns: int) -> None:
        """Note missing frames."""
        for node in self._nodes:
            age_ns = t_ns - node.heartbeat.t_ns
            if node.state >= 0 and node.known and not node.silent and age_ns > node.timeout_ns:
                node.silent = True
                self._note(t_ns, f"{node.name}: no heartbeat for {node.timeout_ns / 1e9:g} s", grave=True)
        silent = self._sync.count > 0 and t_ns - self._sync.t_ns > SYNC_SILENT_NS
        if silent != self._sync_silent:
            self._note(t_ns if silent else self._sync.t_ns, "SYNC stopped" if silent else "SYNC again", grave=silent)
        self._sync_silent = silent

    def _pdo_row(self, pdo: RigPdo, t_ns: int, rate_per_s: float) -> PdoRow:
        layout = pdo.layout
        line = self._lines[layout.cob_id]
        least_ns, most_ns = line.least_ns, line.most_ns
        line.least_ns, line.most_ns = NEVER_NS, -1
        changed = frozenset(n for n, (a, b) in enumerate(zip(line.data, line.looked_at, strict=False)) if a != b)
        line.looked_at = line.data
        values = values_of(pdo, line.data) if line.count else {}
        return PdoRow(
            name=f"{pdo.node}.{pdo.name}",
            can_id=layout.cob_id,
            count=line.count,
            rate_per_s=rate_per_s,
            age_s=max(0.0, (t_ns - line.t_ns) / 1e9) if line.count else None,
            malformed=line.malformed,
            values=tuple(Value(signal.name, values.get(signal.name), signal.unit) for signal in pdo.signals),
            least_s=None if most_ns < 0 else least_ns / 1e9,
            most_s=None if most_ns < 0 else most_ns / 1e9,
            data=line.data[: line.last_length],
            changed=changed,
        )


def values_of(pdo: RigPdo, data: bytes) -> dict[str, float | None]:
    """Return the signals of a frame's 8 bytes: name -> value in SI, bit fields raw, None if not finite."""
    word = int.from_bytes(data, "little")
    values = ((signal.name, pdo.value(place, word)) for place, signal in enumerate(pdo.signals))
    return {name: value if math.isfinite(value) else None for name, value in values}


def _node_row(node: _Node, t_ns: int, frames: int, rate_per_s: float) -> NodeRow:
    heard = node.state >= 0
    return NodeRow(
        name=node.name,
        node_id=node.node_id,
        state=_nmt_text(node.state) if heard else None,
        age_s=max(0.0, (t_ns - node.heartbeat.t_ns) / 1e9) if heard else None,
        silent=node.silent,
        power_state=_power_text(node.power) if node.power >= 0 else None,
        emergency=node.emergency,
        known=node.known,
        frames=frames,
        rate_per_s=rate_per_s,
    )


def _nmt_text(state: int) -> str:
    return STATES.get(state, f"unknown state {state}")


def _power_text(state: int) -> str:
    return "unknown state" if state < 0 else PowerState(state).name.lower().replace("_", " ")
