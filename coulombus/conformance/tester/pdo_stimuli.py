"""Triggers of a TPDO: a remote frame, an event, a timer, the nth SYNC, a SYNC after an event, a start value.

Each `Stimulus` sets a TPDO up, and checks it in OPERATIONAL; `poke` applies the trigger in any state.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

from coulombus.conformance.tester.pdo_setup import (
    EVENT_TIMER,
    NO_RTR,
    NO_SYNC_TPDO,
    SYNC_START,
    TPDO,
    Event,
    Unsupported,
    arm,
    event_type,
    length_of,
    numbers,
    sync,
    write_overflow,
)
from coulombus.conformance.tester.unit import MS, OPERATIONAL, Unit
from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable
from coulombus.eds.cia301 import NmtState
from coulombus.wire.bus_link import RTR, BusFrame

__all__ = ["STIMULI", "Stimulus"]

TIMER_MS = 50
START_VALUE, OVERFLOW = 5, 10
_CALM_NS = 10 * MS


class Stimulus(ABC):
    """A trigger of TPDO `k` of a unit; created in PRE-OPERATIONAL."""

    kind: int | None = None

    def __init__(self, unit: Unit, k: int) -> None:
        self.unit, self.k = unit, k
        self.name = f"TPDO {k + 1}"
        self.can_id = self.set_up()
        self.length = length_of(unit, TPDO, k)

    @abstractmethod
    def set_up(self) -> int:
        """Set the TPDO up and return its identifier."""

    @abstractmethod
    def poke(self, state: NmtState) -> None:
        """Apply the trigger, in any state."""

    @abstractmethod
    def check(self) -> str | None:
        """Fail unless the TPDO behaves in OPERATIONAL, which has just been entered."""

    def control(self) -> bool:
        """Return whether the trigger works in OPERATIONAL, which has just been entered."""
        self.poke(OPERATIONAL)
        return self.unit.wait(self.can_id) is not None

    def of_length(self, frames: list[BusFrame]) -> None:
        """Fail if a frame's length differs from the map's."""
        for frame in frames:
            if frame.length != self.length or frame.can_id & RTR:
                raise CaseFailed(f"{self.name} has {frame.length} bytes; its map has {self.length}")

    def syncs(self, count: int, first: int | None = None, *, expected: int = 0) -> list[BusFrame]:
        """Send SYNCs, and return the TPDOs received; wait for `expected` ones."""
        for number in range(count):
            sync(self.unit, None if first is None else first + number)
            self.unit.pause(_CALM_NS)
        frames = self.unit.gather(self.can_id, expected)
        self.of_length(frames)
        return frames


class ByRequest(Stimulus):
    """A remote frame requests the TPDO, of type 253 if the device accepts that."""

    def set_up(self) -> int:
        cob_id = self.unit.number(TPDO + self.k, 1)
        self.promised = not cob_id & NO_RTR
        try:
            return arm(self.unit, self.k, 253, rtr=True)
        except Unsupported:
            self.unit.restore()
            return arm(self.unit, self.k, None, rtr=True)

    def poke(self, state: NmtState) -> None:
        self.unit.send(self.can_id | RTR, length=self.length)

    def check(self) -> str | None:
        for _ in range(3):
            self.unit.pause(_CALM_NS)
            self.unit.flush()
            self.poke(OPERATIONAL)
            frame = self.unit.wait(self.can_id)
            if frame is None and not self.promised:
                raise NotApplicable(f"{self.name} answers no remote frame, and bit 30 of its COB-ID says so by default")
            if frame is None:
                raise NoAnswer(f"no {self.name} ({self.can_id:03X}h) after a remote frame")
            self.of_length([frame])
        return None


class ByEvent(Stimulus):
    """A change of an object in the TPDO."""

    def set_up(self) -> int:
        self.event = Event(self.unit, self.k)
        return arm(self.unit, self.k, event_type(self.unit, self.k), words=self.event.prepare())

    def poke(self, state: NmtState) -> None:
        self.event.fire(state)

    def check(self) -> str | None:
        at_start = self.unit.wait(self.can_id, self.unit.timing.quiet_ns)
        if not self.event.possible:
            if at_start is None:
                raise NotApplicable(f"no event can be caused over the bus: {self.event.why}")
            self.of_length([at_start])
            return f"{self.name} came on entering OPERATIONAL; no other event can be caused"
        for _ in range(self.event.times):
            self.unit.pause(self.unit.timing.quiet_ns)
            self.unit.flush()
            self.event.fire_and_see()
            frame = self.unit.wait(self.can_id)
            self.event.need_frame(frame is not None, f"{self.name} after an event")
            self.of_length([frame] if frame else [])
        return None


class ByTimer(Stimulus):
    """The event timer, 1800h:05."""

    def set_up(self) -> int:
        words = Event(self.unit, self.k).prepare()  # a map that noise does not change
        return arm(self.unit, self.k, event_type(self.unit, self.k), entries={EVENT_TIMER: TIMER_MS}, words=words)

    def poke(self, state: NmtState) -> None:
        self.unit.pause(3 * TIMER_MS * MS)

    def check(self) -> str | None:
        text = ""
        for _ in range(3):  # a tester without real-time rights may itself be late
            frames = self.unit.collect(self.can_id, 12 * TIMER_MS * MS)
            self.of_length(frames)
            if len(frames) < 2:
                raise CaseFailed(f"{self.name}: {len(frames)} frames in {12 * TIMER_MS} ms, timer {TIMER_MS} ms")
            mean_ms = (frames[-1].t_ns - frames[0].t_ns) / (len(frames) - 1) / 1e6
            if 0.85 * TIMER_MS <= mean_ms <= 1.15 * TIMER_MS and len(frames) >= 10:
                return None
            text = f"{self.name} comes every {mean_ms:.1f} ms; its event timer is {TIMER_MS} ms"
        raise CaseFailed(text)


class BySync(Stimulus):
    """Every nth SYNC, n = 1 and 3."""

    def set_up(self) -> int:
        return arm(self.unit, self.k, 1)

    def poke(self, state: NmtState) -> None:
        for _ in range(3):
            sync(self.unit)
            self.unit.pause(_CALM_NS)

    def check(self) -> str | None:
        self.unit.flush()
        frames = self.syncs(4, expected=4)
        if len(frames) != 4:
            cause = "" if frames else NO_SYNC_TPDO
            raise CaseFailed(f"{self.name} of type 1: {len(frames)} frames after 4 SYNCs", cause=cause)
        for n in (3, 240):
            self.unit.nmt(128)
            try:
                arm(self.unit, self.k, n)
            except Unsupported as reason:
                return f"type {n}: {reason}"
            self.unit.start()
            if n == 240:
                continue
            self.unit.flush()
            frames = self.syncs(9, expected=3)
            if len(frames) != 3:
                raise CaseFailed(f"{self.name} of type 3: {len(frames)} frames after 9 SYNCs, expected 3")
        return None


class BySyncAfterEvent(Stimulus):
    """A SYNC after an event, transmission type 0."""

    def set_up(self) -> int:
        self.event = Event(self.unit, self.k)
        return arm(self.unit, self.k, 0, words=self.event.prepare())

    def poke(self, state: NmtState) -> None:
        self.event.fire(state)
        sync(self.unit)
        self.unit.pause(_CALM_NS)

    def check(self) -> str | None:
        self.unit.flush()
        first = self.syncs(1)
        if not self.event.possible:
            if not first:
                raise NotApplicable(f"no event can be caused over the bus: {self.event.why}")
            return f"{self.name} came with the first SYNC; no other event can be caused"
        if len(self.syncs(3)):
            raise CaseFailed(f"{self.name} of type 0 comes with a SYNC without an event")
        for _ in range(self.event.times):
            self.event.fire_and_see()
            self.unit.pause(self.unit.timing.quiet_ns)
            if self.unit.pop_frames(self.can_id):
                raise CaseFailed(f"{self.name} of type 0 comes with the event, before the SYNC")
            frames = self.syncs(2, expected=1)
            self.event.need_frame(bool(frames), f"{self.name} of type 0 with 2 SYNCs after an event")
            if len(frames) != 1:
                raise CaseFailed(f"{self.name} of type 0: {len(frames)} frames with 2 SYNCs after an event, expected 1")
        return None


class ByStartValue(Stimulus):
    """SYNCs with a counter; the SYNC with the start value is the first that counts (1800h:06)."""

    def set_up(self) -> int:
        self.unit.need_writable(0x1019)
        write_overflow(self.unit, OVERFLOW)
        return arm(self.unit, self.k, 1, entries={SYNC_START: START_VALUE})

    def poke(self, state: NmtState) -> None:
        self.syncs(OVERFLOW, 1)

    def control(self) -> bool:
        self.unit.flush()
        return bool(self.syncs(OVERFLOW, 1, expected=1))

    def check(self) -> str | None:
        self.unit.flush()
        early = self.syncs(START_VALUE - 1, 1)
        if early:
            raise CaseFailed(f"{self.name} comes before the SYNC with its start value {START_VALUE}")
        expected = OVERFLOW - START_VALUE + 1
        frames = self.syncs(expected, START_VALUE, expected=expected)
        if len(frames) != expected:
            text = f"{len(frames)} frames with the SYNCs {START_VALUE} to {OVERFLOW}"
            cause = "" if frames else NO_SYNC_TPDO
            raise CaseFailed(f"{self.name} with start value {START_VALUE}: {text}", cause=cause)
        if len(self.syncs(3, 1, expected=3)) != 3:
            raise CaseFailed(f"{self.name} waits for its start value again after the counter's overflow")
        return None


STIMULI: tuple[type[Stimulus], ...] = (ByRequest, ByEvent, ByTimer, BySync, BySyncAfterEvent, ByStartValue)
"""In the order of the cases 3.3 to 3.8, 3.9 to 3.14 and 3.15 to 3.20."""


def candidates(unit: Unit) -> list[int]:
    """Return the TPDOs of the EDS.

    Raises
    ------
    NotApplicable
        There is none.
    """
    pdo_numbers = numbers(unit, TPDO)
    if not pdo_numbers:
        raise NotApplicable("the EDS has no TPDO")
    return pdo_numbers
