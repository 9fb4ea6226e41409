"""Error frames: how many, of what kind, whose frames they destroyed, and the controllers' states
(``linux/can/error.h``).
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from coulombus.explain.bus import Bus
from coulombus.explain.frames import ERROR, Block, Integers
from coulombus.wire.can_flags import CAN_ERR_FLAG
from coulombus.wire.error_frames import (
    ACTIVE_AGAIN,
    BUS_ERROR,
    BUS_OFF,
    CONTROLLER,
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

__all__ = ["Disturbances"]

OVERFLOW, WARNING, PASSIVE = RX_OVERFLOW | TX_OVERFLOW, RX_WARNING | TX_WARNING, RX_PASSIVE | TX_PASSIVE
STATE_NS = 1_000_000_000
DENSE = 8
"""Error frames within a second that are more than a disturbed bit now and then."""
SHARE = 0.8
"""Of the destroyed frames: so many of one identifier are no accident."""


class Disturbances:
    """Counts error frames, and follows what controllers say of themselves."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self.destroyed = 0
        self.unacknowledged = 0
        self._recent: list[tuple[int, int, int, bool]] = []  # time, row, identifier that follows, no acknowledgement

    def take(self, block: Block) -> None:
        """Go through a block."""
        group = block.groups.get(ERROR)
        if group is None:
            return
        can_id = np.ascontiguousarray(block.frames["can_id"])
        local = group.rows - block.first_row
        classes = can_id[local]
        kinds = classes & (VIOLATION | BUS_ERROR | NO_ACK) != 0
        following = _following(can_id, local)
        unacknowledged = kinds & (classes & NO_ACK != 0)
        self.unacknowledged += int(unacknowledged.sum())
        self.destroyed += int(kinds.sum())
        self._dense(group.t_ns[kinds], group.rows[kinds], following[kinds], unacknowledged[kinds])
        states = np.flatnonzero(classes & (CONTROLLER | BUS_OFF | RESTARTED) != 0)
        for i in states.tolist():
            self._state(int(group.t_ns[i]), int(group.rows[i]), int(classes[i]), group.data(i))

    def _dense(self, t_ns: Integers, rows: Integers, following: Integers, alone: np.ndarray) -> None:
        """Note error frames where many come within a second."""
        for t, row, can_id, no_ack in zip(
            t_ns.tolist(), rows.tolist(), following.tolist(), alone.tolist(), strict=True
        ):
            self._recent.append((t, row, can_id, no_ack))
            if len(self._recent) > DENSE:
                self._recent.pop(0)
            if len(self._recent) < DENSE or t - self._recent[0][0] > STATE_NS:
                continue
            alone_often = sum(recent[3] for recent in self._recent) >= SHARE * DENSE
            kind = "no_ack" if alone_often else "error_frames"
            begin_ns, begin_row, _, _ = self._recent[0]
            ids = Counter(recent[2] for recent in self._recent)
            usual, times = ids.most_common(1)[0]
            node = self.bus.sender(usual) if times >= SHARE * DENSE and usual >= 0 else None
            clue = self.clues.note(kind, node, t, "", row=row)
            if clue.count == 1:
                clue.begin_ns, clue.rows, clue.count = begin_ns, [begin_row, *clue.rows], DENSE
            whose = f"; most of them hit the identifier {usual:03X}h" if node is not None else ""
            what = "frames that nobody acknowledged" if alone_often else "destroyed frames"
            clue.text = f"{clue.count} {what}{whose}"

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
    """Return the identifier of the first frame after each error frame, -1 where none follows."""
    good = np.flatnonzero(can_id & CAN_ERR_FLAG == 0)
    place = np.searchsorted(good, local)
    inside = place < len(good)
    following = np.full(len(local), -1, np.int64)
    following[inside] = can_id[good[place[inside]]] & 0x7FF
    return following
