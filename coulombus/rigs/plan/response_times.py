"""Worst-case response time of every message on a CAN bus.

Source: Davis, Burns, Bril and Lukkien 2007, doi:10.1007/s11241-007-9012-7.

A message m of period (or least interval) T, release jitter J and longest frame C waits for one frame of lower priority
already on the wire, B, and for every frame of higher priority (hp) that is released before its own start::

    t    = E(t) + B + sum over hp and m of ceil((t + J_k) / T_k) C_k             busy period; Q = ceil((t + J) / T) instances
    w(q) = E(w + C) + B + q C + sum over hp of ceil((w + J_k + tau) / T_k) C_k     q = 0 .. Q - 1, least solution
    R(q) = J + w(q) - q T + C,       R = max over q                              (their equations 10 to 13, 16 to 18)

tau is one bit. All Q instances count: transmission is non-preemptive, so the first instance can push interference on to
the second and need not be the worst. E is the share of errors::

    E(t) = n ceil(t / T_E) (31 tau + max C over hp and m)

for at most n errors in any T_E: each costs an error frame of 31 bits at most, and the frame again.
C includes the three bits of inter-frame space; R therefore ends three bits after the frame's end of frame.

All times are integer nanoseconds; durations are rounded up.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np

from coulombus.wire.bits import worst_case_bits
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_RTR_FLAG, arbitration_key

__all__ = ["NO_ERRORS", "Errors", "Message", "ResponseTime", "Stage", "bit_ns", "response_times", "utilisation"]

ERROR_FRAME_BITS = 31  # flags 6 + 6, delimiter 8, inter-frame space 3, suspended transmission 8
MAX_INSTANCES = 1000
"""A busy period of more instances counts as infinite."""
MAX_ROUNDS = 100
MAX_JITTER_PERIODS = 10
"""A jitter of more periods, and beyond the deadline, counts as divergent."""

Stage = Literal["", "sync", "tpdo", "rpdo"]


@dataclass(frozen=True)
class Message:
    """A frame that is sent repeatedly.

    Attributes
    ----------
    can_id : int
        Identifier with Linux's flags.
    length : int
        Data bytes.
    period_ns : int
        Period, or the least interval between two frames.
    deadline_ns : int
        Deadline of its end, from its release.
    jitter_ns : int
        Release jitter.
    follows : str
        Name of the message whose end releases it: its response time is added to `jitter_ns`.
    stage : str
        Its part in the cycle ("" for none).
    axis : int
        Number of the PDO's axis: the host sends an axis' RPDOs after that axis' TPDOs arrive.
    emergency : bool
        Not sent in ordinary operation: EMCY, NMT.
    """

    name: str
    can_id: int
    length: int
    period_ns: int
    deadline_ns: int
    jitter_ns: int = 0
    follows: str = ""
    stage: Stage = ""
    axis: int = 0
    emergency: bool = False

    @cached_property
    def key(self) -> int:
        """Its priority: the lower key wins arbitration."""
        return arbitration_key(self.can_id)

    @cached_property
    def bits(self) -> int:
        """Longest frame, stuffing and inter-frame space included."""
        return worst_case_bits(0 if self.can_id & CAN_RTR_FLAG else self.length, bool(self.can_id & CAN_EFF_FLAG))


@dataclass(frozen=True)
class Errors:
    """At most `count` errors in any `interval_ns`, perhaps all at once."""

    count: int = 0
    interval_ns: int = 1

    @classmethod
    def parse(cls, text: str) -> Errors:
        """Read "N/INTERVAL", as in 1/10ms, 3/ms, 20/s; "0" for none.

        Raises
        ------
        ValueError
            With the expected form.
        """
        if text.strip() == "0":
            return cls()
        match = re.fullmatch(r"\s*(\d+)\s*/\s*(\d+(?:\.\d+)?)?\s*(us|ms|s)\s*", text)
        interval = round(float(match[2] or 1) * {"us": 1e3, "ms": 1e6, "s": 1e9}[match[3]]) if match else 0
        if match is None or interval < 1:
            raise ValueError(f"{text!r}: expected N/INTERVAL in us, ms or s, as in 1/10ms (one in any 10 ms), or 0")
        return cls(int(match[1]), interval)

    def cost_ns(self, window_ns: int, each_ns: int) -> int:
        """Return E: the time lost to errors in `window_ns` if each costs `each_ns`."""
        return self.count * -(-window_ns // self.interval_ns) * each_ns


NO_ERRORS = Errors()


@dataclass(frozen=True)
class ResponseTime:
    """The result for one message; `response_ns` exceeds the deadline if there is no bound."""

    message: Message
    frame_ns: int
    blocking_ns: int
    jitter_ns: int
    response_ns: int
    bounded: bool

    @property
    def fits(self) -> bool:
        """Whether every instance meets its deadline."""
        return self.bounded and self.response_ns <= self.message.deadline_ns


def bit_ns(bits: int, bitrate_bit_s: int) -> int:
    """Return the duration of `bits` [ns], rounded up."""
    return -(-bits * 1_000_000_000 // bitrate_bit_s)


def utilisation(messages: Sequence[Message], bitrate_bit_s: int) -> float:
    """Return the bus load with the longest frames, without errors: the sum of C / T."""
    return sum(message.bits * 1e9 / (bitrate_bit_s * message.period_ns) for message in messages)


def response_times(
    messages: Sequence[Message], bitrate_bit_s: int, errors: Errors = NO_ERRORS
) -> tuple[ResponseTime, ...]:
    """Return every message's response time, the highest priority first.

    A message that `follows` another takes its response time as jitter; because this may be circular, it is iterated to
    a fixed point (jitters only grow).

    Raises
    ------
    ValueError
        Two messages have one identifier, or `follows` names no message.
    """
    by_priority = sorted(messages, key=lambda message: message.key)
    for first, second in pairwise(by_priority):
        if first.can_id == second.can_id:
            raise ValueError(
                f"{first.name} and {second.name} both have the identifier {first.can_id:X}h: give each its own"
            )
    names = {message.name for message in by_priority}
    for message in by_priority:
        if message.follows and message.follows not in names:
            raise ValueError(f"{message.name} follows {message.follows!r}, which is not among the messages")
    frames = [bit_ns(message.bits, bitrate_bit_s) for message in by_priority]
    late = list(by_priority)  # with inherited jitter
    responses: list[ResponseTime] = []
    for _ in range(MAX_ROUNDS):
        by_name = {response.message.name: response for response in responses}
        grown = len(by_priority)  # the first rank to recompute
        for rank, message in enumerate(by_priority):
            if message.follows in by_name:
                jitter = message.jitter_ns + by_name[message.follows].response_ns
                if jitter != late[rank].jitter_ns:
                    late[rank], grown = replace(message, jitter_ns=jitter), min(grown, rank)
            if rank >= min(grown, len(responses)):
                response = replace(_response(rank, late, frames, bitrate_bit_s, errors), message=message)
                by_name[message.name] = response
                responses[rank : rank + 1] = [response]
        if grown == len(by_priority) or any(
            m.jitter_ns > max(m.deadline_ns, MAX_JITTER_PERIODS * m.period_ns) for m in late
        ):
            break
    lost = {response.message.name for response in responses if not response.bounded}
    for rank, response in enumerate(responses):
        if rank >= grown or response.message.follows in lost:
            responses[rank] = replace(response, bounded=False)
    return tuple(responses)


def _response(
    rank: int, by_priority: Sequence[Message], frames: Sequence[int], bitrate_bit_s: int, errors: Errors
) -> ResponseTime:
    """Return the response of `by_priority[rank]`; all jitters are set; `frames` are the durations."""
    tau = bit_ns(1, bitrate_bit_s)
    m, duration = by_priority[rank], frames[rank]
    higher = [(k.period_ns, k.jitter_ns, c) for k, c in zip(by_priority[:rank], frames, strict=False)]
    periods, jitters, durations = np.array(higher, np.int64).reshape(-1, 3).T

    def interference(window_ns: int) -> int:
        """Return the time of higher-priority frames released within a window."""
        return int(-(-(window_ns + jitters) // periods) @ durations)

    blocking = max(frames[rank + 1 :], default=0)
    each = bit_ns(ERROR_FRAME_BITS, bitrate_bit_s) + max(frames[: rank + 1])
    load = sum(c / t for t, _, c in higher) + errors.count * each / errors.interval_ns
    bounded = load + duration / m.period_ns < 1.0
    instances = 1
    if bounded:
        everyone = [*higher, (m.period_ns, m.jitter_ns, duration)]
        free = 1.0 - load - duration / m.period_ns
        below = (blocking + sum(c * j / period for period, j, c in everyone)) / free  # lower bound of the solution
        t = max(duration, int(below * (1 - 1e-9)))
        while t <= MAX_INSTANCES * m.period_ns:
            after = errors.cost_ns(t, each) + blocking
            after += interference(t) + -(-(t + m.jitter_ns) // m.period_ns) * duration
            if after <= t:
                break
            t = after
        instances = -(-(t + m.jitter_ns) // m.period_ns)
        bounded = instances <= MAX_INSTANCES
    worst = 0 if bounded else m.deadline_ns + tau
    w = blocking
    for q in range(instances if bounded else 1):
        while True:
            after = errors.cost_ns(w + duration, each) + blocking + q * duration
            after += interference(w + tau)
            if after <= w or (not bounded and m.jitter_ns + after + duration > m.deadline_ns):
                break
            w = after
        worst = max(worst, m.jitter_ns + w - q * m.period_ns + duration)
        w += duration  # the next instance cannot be sooner
    return ResponseTime(m, duration, blocking, m.jitter_ns, worst, bounded)
