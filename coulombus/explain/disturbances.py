"""Error frames: number, kind, destroyed frames, and the controllers' states (``linux/can/error.h``)."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from coulombus.explain.bus import Bus
from coulombus.explain.frames import ERROR, Block, Integers
from coulombus.kernels.records import Records
from coulombus.wire.can_flags import CAN_ERR_FLAG
from coulombus.wire.error_frames import (
    ACTIVE_AGAIN,
    BUS_ERROR,
    BUS_OFF,
    CONTROLLER,
    KINDS,
    NO_ACK,
    RESTARTED,
    RX_OVERFLOW,
    RX_PASSIVE,
    RX_WARNING,
    TX_OVERFLOW,
    TX_PASSIVE,
    TX_WARNING,
    VIOLATION,
)
from coulombus.wire.frame import FRAME

__all__ = ["Disturbances"]

OVERFLOW, WARNING, PASSIVE = RX_OVERFLOW | TX_OVERFLOW, RX_WARNING | TX_WARNING, RX_PASSIVE | TX_PASSIVE
STATE_NS = 1_000_000_000
DENSE = 8
"""Error frames within a second that are more than an occasional bit error."""
SHARE = 0.8
"""Share of destroyed frames with one identifier that is not coincidence."""


KIND_BITS = 0x3F


class _Destroyed(NamedTuple):
    """An error frame: `can_id` is that of the next frame, usually the repeated destroyed one."""

    t_ns: int
    row: int
    can_id: int
    alone: bool  # no acknowledgement
    violation: int


class Disturbances:
    """Counts error frames, and tracks the states of controllers."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._rest = np.zeros(0, FRAME)  # error frames that no other frame follows yet
        self._rest_row = 0
        self._recent: list[_Destroyed] = []
        self._told: dict[int, tuple[Counter[str], Counter[int]]] = {}  # kinds and identifiers of a clue

    def add_frames(self, block: Block) -> None:
        """Process a block."""
        group = block.groups.get(ERROR)
        if group is not None:
            classes = np.ascontiguousarray(block.frames["can_id"])[group.rows - block.first_row]
            for i in np.flatnonzero(classes & (CONTROLLER | BUS_OFF | RESTARTED) != 0).tolist():
                self._state(int(group.t_ns[i]), int(group.rows[i]), int(classes[i]), group.data(i))
        if group is not None or len(self._rest):
            self._count(np.concatenate((self._rest, block.frames)), block.first_row - len(self._rest))

    def note_overdue(self, t_ns: int) -> None:
        """Process the error frames that no frame followed until a time [ns]."""
        if len(self._rest) and t_ns > int(self._rest["t_ns"][-1]) + STATE_NS:
            self.end()

    def end(self) -> None:
        """Process the error frames that no frame follows."""
        rest, self._rest = self._rest, self._rest[:0]
        self._destroyed(rest, self._rest_row)

    def _count(self, frames: Records, first_row: int) -> None:
        """Process error frames up to the last one that a frame follows: it tells which frame was destroyed."""
        good = np.flatnonzero(frames["can_id"] & CAN_ERR_FLAG == 0)
        complete = int(good[-1]) + 1 if len(good) else 0
        self._rest, self._rest_row = frames[complete:], first_row + complete
        self._destroyed(frames[:complete], first_row)

    def _destroyed(self, frames: Records, first_row: int) -> None:
        can_id = np.ascontiguousarray(frames["can_id"])
        classes = can_id & (VIOLATION | BUS_ERROR | NO_ACK)
        local = np.flatnonzero((can_id & CAN_ERR_FLAG != 0) & (classes != 0))
        if not len(local):
            return
        unacknowledged = can_id[local] & NO_ACK != 0
        violations = np.where(can_id[local] & VIOLATION, frames["word"][local] >> 16 & KIND_BITS, 0)
        columns = (frames["t_ns"][local], first_row + local, _following(can_id, local), unacknowledged, violations)
        for values in zip(*(column.tolist() for column in columns), strict=True):
            self._dense(_Destroyed(*values))

    def _dense(self, frame: _Destroyed) -> None:
        """Note an error frame if there are many within a second."""
        recent = self._recent
        recent.append(frame)
        if len(recent) > DENSE:
            recent.pop(0)
        if len(recent) < DENSE or frame.t_ns - recent[0].t_ns > STATE_NS:
            return
        alone_often = sum(destroyed.alone for destroyed in recent) >= SHARE * DENSE
        usual, times = Counter(destroyed.can_id for destroyed in recent).most_common(1)[0]
        node = self.bus.sender(usual) if times >= SHARE * DENSE and usual >= 0 else None
        clue = self.clues.note("no_ack" if alone_often else "error_frames", node, frame.t_ns, "", row=frame.row)
        first = clue.count == 1
        if first:
            clue.begin_ns, clue.rows, clue.count = recent[0].t_ns, [recent[0].row, *clue.rows], DENSE
            self._told[id(clue)] = Counter(), Counter()
        kinds, identifiers = self._told[id(clue)]
        for destroyed in recent if first else (frame,):
            kinds.update(text for bit, text in KINDS.items() if destroyed.violation & bit)
            identifiers[destroyed.can_id] += 1
        what = "frames without acknowledgement" if alone_often else "destroyed frames"
        clue.text = f"{clue.count} {what}"
        if kinds:
            clue.text += " (" + ", ".join(f"{kind} {count}" for kind, count in kinds.most_common(3)) + ")"
        hit = [f"{can_id:03X}h {count} times" for can_id, count in identifiers.most_common(3) if can_id >= 0]
        clue.text += f"; before {', '.join(hit)}" if hit else ""

    def _state(self, t_ns: int, row: int, classes: int, data: bytes) -> None:
        data = data.ljust(8, b"\0")
        station = data[5]
        if classes & BUS_OFF:
            self.clues.begin("bus_off", None, t_ns, "a controller went bus-off", row=row, subject=station)
        if classes & RESTARTED:
            self.clues.end("bus_off", None, t_ns, "it was restarted", subject=station)
        if not classes & CONTROLLER:
            return
        if data[1] & PASSIVE:
            side = "it sends" if data[1] & TX_PASSIVE else "it receives"
            text = f"a controller became error passive: errors in what {side} (TEC {data[6]}, REC {data[7]})"
            self.clues.begin("error_passive", None, t_ns, text, row=row, subject=station)
        if data[1] & ACTIVE_AGAIN or (data[1] & WARNING and not data[1] & PASSIVE):
            self.clues.end("error_passive", None, t_ns, "it is error active again", subject=station)
            self.clues.end("bus_off", None, t_ns, "it is back", subject=station)
        if data[1] & OVERFLOW:
            self.clues.note("overrun", None, t_ns, "a receiver's buffer overflowed: frames are missing", row=row)


def _following(can_id: Integers, local: Integers) -> Integers:
    """Return the identifier of the first frame after each error frame; -1 without a next frame."""
    good = np.flatnonzero(can_id & CAN_ERR_FLAG == 0)
    place = np.searchsorted(good, local)
    inside = place < len(good)
    following = np.full(len(local), -1, np.int64)
    following[inside] = can_id[good[place[inside]]] & 0x7FF
    return following
