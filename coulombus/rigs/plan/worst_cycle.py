"""Worst case of the cycle: latest ends of SYNC, TPDOs and RPDOs, counted from the instant at which SYNC is queued.

`rigs.plan.response_times` treats every frame as independent, so it counts SYNC and the TPDOs against an RPDO although
they end before the host sends it. This module uses their order: a TPDO is released by SYNC's end, an axis' RPDOs by the
last of its TPDOs. From SYNC on one of them is pending all the time, so the bus is never idle and no lower frame comes
between, unless a device's or the host's computing outlasts the inter-frame space::

    F(m) = B + C + sum of C over what goes before m in the cycle + gaps + E(F)
             + sum over hp of ceil((F - C + J_k + tau) / T_k) C_k

B is the longest frame from outside the cycle that may have begun just before; the previous cycle has ended by then, or
the plan does not fit. hp are the messages outside the cycle that have a higher priority than m, or than any TPDO of m's
axis if m is an RPDO. A gap of length d > 3 tau (`node_ns` before the TPDOs, `host_ns` before the RPDOs) costs d - 3 tau
and one more frame that may begin in it; then every frame of the cycle with such a priority is assumed to go before m.
The host waits for the TPDOs no longer than `window_ns`.

`rigs.plan.gantt` plots the same instants.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from coulombus.rigs.plan.response_times import ERROR_FRAME_BITS, NO_ERRORS, Errors, Message, bit_ns

__all__ = ["Bar", "Cycle", "CycleFrame", "CycleTiming", "worst_cycle"]

INTER_FRAME_BITS = 3
HORIZON_PERIODS = 50
"""A frame that has not ended after so many periods has no bound."""


@dataclass(frozen=True)
class CycleTiming:
    """Time limits of the cycle.

    Attributes
    ----------
    window_ns : int
        The host's wait for the TPDOs after SYNC.
    node_ns, host_ns : int
        Longest computing time of a device between SYNC and its TPDOs, of the host between the last TPDO and its RPDOs.
    """

    bitrate_bit_s: int
    period_ns: int
    window_ns: int
    node_ns: int = 0
    host_ns: int = 0


@dataclass(frozen=True)
class CycleFrame:
    """One frame of the cycle: its latest end, and its deadline."""

    message: Message
    end_ns: int
    deadline_ns: int

    @property
    def fits(self) -> bool:
        """Whether it meets its deadline."""
        return self.end_ns <= self.deadline_ns


@dataclass(frozen=True)
class Bar:
    """A bar in the plot of the worst cycle; `kind` is a message's stage, "other", "gap" or "error"."""

    name: str
    kind: str
    begin_ns: int
    end_ns: int


@dataclass(frozen=True)
class Cycle:
    """The cycle's frames in sending order, and the bars of the last frame's worst case."""

    frames: tuple[CycleFrame, ...]
    bars: tuple[Bar, ...]

    def latest_ns(self, stage: str) -> int:
        """Return the latest end of all frames of a stage."""
        return max((frame.end_ns for frame in self.frames if frame.message.stage == stage), default=0)

    @property
    def fits(self) -> bool:
        """Whether all meet their deadlines."""
        return all(frame.fits for frame in self.frames)


def worst_cycle(messages: Sequence[Message], timing: CycleTiming, errors: Errors = NO_ERRORS) -> Cycle:
    """Return the worst cycle of `messages`, those with a `stage`, under the interference of the
    others.

    SYNC and the TPDOs are due within the window. An RPDO must be on the wire when the next SYNC is released: SYNC then
    follows it, and the device acts on it. SYNC would wait as long for a frame from outside, so the next cycle's bounds
    stay valid; an RPDO that is longer than any such frame is due earlier.
    """
    by_priority = sorted(messages, key=lambda message: message.key)
    chain = _in_order([m for m in by_priority if m.stage])
    others = [m for m in by_priority if not m.stage]
    cases = [_Case(m, chain, others, timing, errors) for m in chain]
    frames = tuple(CycleFrame(case.m, case.end_ns, _due_ns(case, cases[0])) for case in cases)
    last = max(cases, key=lambda case: case.end_ns, default=None)
    return Cycle(frames, tuple(last.bars()) if last else ())


def _due_ns(case: _Case, sync: _Case) -> int:
    """Return a frame's deadline, counted from SYNC's release."""
    if case.m.stage != "rpdo":
        return case.timing.window_ns
    begun = case.frame_ns - case.tau if case.frame_ns <= sync.blocking_ns else 0
    return case.timing.period_ns + begun


def _in_order(cyclic: Sequence[Message]) -> list[Message]:
    """Return the cycle's frames in sending order, without computing times; the input is ordered by priority."""
    gone = [m for m in cyclic if m.stage == "sync"]
    waiting = [m for m in cyclic if m.stage == "tpdo"]
    held = [m for m in cyclic if m.stage == "rpdo"]
    while waiting or held:
        pending = {m.axis for m in waiting if m.stage == "tpdo"}
        waiting += [m for m in held if m.axis not in pending]
        held = [m for m in held if m.axis in pending]
        gone.append(min(waiting, key=lambda m: m.key))
        waiting.remove(gone[-1])
    return gone


class _Case:
    """The worst case of one frame of the cycle."""

    def __init__(
        self, m: Message, chain: Sequence[Message], others: Sequence[Message], timing: CycleTiming, errors: Errors
    ) -> None:
        self.m, self.timing = m, timing
        rate = timing.bitrate_bit_s
        self.tau = bit_ns(1, rate)
        lowest = m.key
        if m.stage == "rpdo":
            lowest = max([lowest, *(k.key for k in chain if k.stage == "tpdo" and k.axis == m.axis)])
        self.higher = [k for k in others if k.key < lowest]
        self.blocking = self._longest(k for k in others if k.key >= lowest)
        self.before = list(chain[: chain.index(m)])
        waits = {"tpdo": timing.node_ns, "rpdo": timing.host_ns}
        stages = {"sync": (), "tpdo": ("tpdo",), "rpdo": ("tpdo", "rpdo")}[m.stage or "sync"]
        gaps = {stage: waits[stage] - INTER_FRAME_BITS * self.tau for stage in stages}
        gaps = {stage: length for stage, length in gaps.items() if length > 0}
        behind_m = chain[len(self.before) + 1 :]
        rest = [k for k in behind_m if not (k.stage == "rpdo" and k.axis == m.axis)]
        if gaps:
            self.before += [k for k in rest if k.key < lowest]
            rest = [k for k in rest if k.key >= lowest]
        behind = self._longest(k for k in [*others, *rest] if k.key >= lowest)
        self.gaps = {stage: (length, behind) for stage, length in gaps.items()}  # and a frame that may start in the gap
        self.frame_ns = self._duration(m)
        each = bit_ns(ERROR_FRAME_BITS, rate) + max(self._duration(k) for k in [*self.before, *self.higher, m])
        self.blocking_ns = self._duration(self.blocking)
        fixed = self.blocking_ns + sum(map(self._duration, self.before))
        fixed += sum(length + self._duration(frame) for length, frame in self.gaps.values())
        self.counts, self.error_ns = [0] * len(self.higher), 0
        end, after = 0, fixed + self.frame_ns
        while after > end and after <= HORIZON_PERIODS * timing.period_ns:
            end = after
            self.counts = [-(-(end - self.frame_ns + k.jitter_ns + self.tau) // k.period_ns) for k in self.higher]
            self.error_ns = errors.cost_ns(end, each)
            after = fixed + self.frame_ns + self.error_ns
            after += sum(n * self._duration(k) for n, k in zip(self.counts, self.higher, strict=True))
        self.end_ns = after

    def _duration(self, message: Message | None) -> int:
        return 0 if message is None else bit_ns(message.bits, self.timing.bitrate_bit_s)

    def _longest(self, messages: Iterable[Message]) -> Message | None:
        return max(messages, key=lambda k: k.bits, default=None)

    def bars(self) -> Iterable[Bar]:
        """Yield the bars of the worst case in sending order.

        The independent frames of higher priority come first.
        """
        t = 0

        def bar(name: str, kind: str, duration_ns: int) -> Bar:
            nonlocal t
            t += duration_ns
            return Bar(name, kind, t - duration_ns, t)

        if self.blocking is not None:
            yield bar(self.blocking.name, "other", self._duration(self.blocking))
        for n, k in zip(self.counts, self.higher, strict=True):
            for _ in range(n):
                yield bar(k.name, "other", self._duration(k))
        if self.error_ns:
            yield bar("errors", "error", self.error_ns)
        gaps = dict(self.gaps)
        for k in [*self.before, self.m]:
            if k.stage in gaps:
                length, frame = gaps.pop(k.stage)
                yield bar("computing", "gap", length)
                if frame is not None:
                    yield bar(frame.name, "other", self._duration(frame))
            yield bar(k.name, k.stage, self._duration(k))
