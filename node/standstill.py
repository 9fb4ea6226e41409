"""Why a drive with a load does not move: one sentence for its user, once for each reason.

A client that waits for motion sees 6041h at most. The node knows more: a limit that is 0, a halt, an RPDO
that waits for a SYNC. `why_still` is a function of the record; `StandstillWatch` waits until a reason lasts.

    n : the `NodeRecord`
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from coulombus.eds import cia402
from coulombus.eds.cia301 import NmtState
from coulombus.eds.cia402 import PowerState
from coulombus.node import slots402
from coulombus.node.motion402 import POSITION_MODES
from coulombus.node.profile import CoreObject, Objects
from coulombus.node.record import NodeRecord

__all__ = ["LOOKS", "Reason", "StandstillWatch", "why_still"]

LOOKS = 5
"""Number of successive looks at which a reason must be present: a client may be between two of its writes."""
STILL_COUNTS_S = 1.0
_HALT = 0x0100
_ENABLING = 0x000F


class Reason(NamedTuple):
    """A reason: its name in JSON, and a sentence that says what to do."""

    name: str
    text: str


_OFFSETS: Mapping[int, int] = {
    cia402.OPERATION_MODE_CSV: slots402.VELOCITY_OFFSET,
    cia402.OPERATION_MODE_CST: slots402.TORQUE_OFFSET,
}
"""Slot of the offset that is added to a mode's set-point."""

_TORQUE_LIMITS: tuple[tuple[int, int, int], ...] = (
    (0x6072, slots402.MAX_TORQUE, 0),
    (0x6073, slots402.MAX_CURRENT, 0),
    (0x60E0, slots402.POSITIVE_LIMIT, 1),
    (0x60E1, slots402.NEGATIVE_LIMIT, -1),
)
"""Limits of the torque: object, slot, and its direction; 0: both."""


def why_still(n: NodeRecord, objects: Objects, holding_pm: float = 0.0) -> Reason | None:
    """Return why the drive rests although somebody commands it; None if it moves, or nobody does.

    `holding_pm` is the torque, in per mille of rated, that the load's friction holds; infinite: the axis is blocked.
    """
    if not n["powered"] or abs(float(n["in_velocity_counts_s"])) >= STILL_COUNTS_S:
        return None
    if n["power_state"] == PowerState.OPERATION_ENABLED:
        reasons = _enabled(n, objects, holding_pm)
    else:
        reasons = _not_enabled(n, objects)
    return next(reasons, None)


def _not_enabled(n: NodeRecord, objects: Objects) -> Iterator[Reason]:
    values, state = n["values"], PowerState(int(n["power_state"]))
    word = int(values[slots402.CONTROLWORD])
    if state == PowerState.FAULT:
        code = objects.number(0x603F)
        yield Reason("fault", f"FAULT (603Fh = {code:04X}h): remove its cause, then write a rising bit 7 of 6040h")
    if int(n["rpdo_pending"]) and n["nmt"] == NmtState.OPERATIONAL:
        yield _waits_for_sync()
    if int(n["dropped_unknown"]) and n["nmt"] != NmtState.OPERATIONAL:
        name = NmtState(int(n["nmt"])).name.replace("_", "-")
        yield Reason("nmt", f"NMT is {name}, in which no PDO acts: send NMT start")
    if word & _ENABLING == _ENABLING and not n["in_supply_ok"]:
        yield Reason("voltage", "no high-level power (6041h, bit 4)")
    if values[slots402.TARGET_VELOCITY] or values[slots402.TARGET_TORQUE]:
        name = state.name.replace("_", " ")
        yield Reason("state", f"it is in {name}, and 6040h is {word:04X}h: write 6, 7 and 15")


def _waits_for_sync() -> Reason:
    return Reason("sync", "an RPDO waits for SYNC: send SYNC, or give the RPDO the transmission type 255")


def _enabled(n: NodeRecord, objects: Objects, holding_pm: float) -> Iterator[Reason]:
    values, mode = n["values"], int(n["mode"])
    if mode == 0:
        offered = objects.number(0x6502, 0, 0)
        names = ", ".join(str(k + 1) for k in range(16) if offered >> k & 1)
        yield Reason("mode", f"6061h is 0, no mode: write 6060h (6502h offers {names or 'none'})")
    if int(n["controlword"]) & _HALT:
        yield Reason("halt", "bit 8 of 6040h, halt, is set")
    setpoint = slots402.SETPOINTS.get(mode)
    if setpoint is not None and not setpoint.acts & (slots402.ACTS_SPEED | slots402.ACTS_TORQUE):
        setpoint = None  # the drive may stand at its target
    target = 0
    if setpoint is not None:
        target = int(values[setpoint.slot]) + (int(values[_OFFSETS[mode]]) if mode in _OFFSETS else 0)
    for index, slot, direction in _TORQUE_LIMITS:
        if int(values[slot]) == 0 and target * direction >= 0 and (target or not direction):
            yield Reason("torque_limit", f"{index:04X}h limits the torque to 0: write it (1000 is the rated torque)")
    if setpoint is not None:
        yield from _no_setpoint(n, setpoint, target)
        yield from _no_slope(mode, values)
        yield from _at_limit(n, objects, target)
    holds = mode in POSITION_MODES and holding_pm < math.inf  # the little torque of a position control at its target
    if not holds and n["out_torque_pm"] and abs(float(n["out_torque_pm"])) <= holding_pm:
        torque = f"its torque of {float(n['out_torque_pm']):.0f} per mille"
        blocked = "the axis is blocked" if holding_pm == math.inf else f"friction holds {holding_pm:.0f} per mille"
        yield Reason("load", f"{torque} does not turn the load: {blocked}")


def _no_setpoint(n: NodeRecord, setpoint: CoreObject, target: int) -> Iterator[Reason]:
    if int(n["rpdo_pending"]):
        yield _waits_for_sync()
    name = f"{setpoint.index:04X}h"
    if target == 0:
        rows = range(int(n["rpdo_used"]))
        mapped = any(n["rpdo"][k]["cob_id"] >= 0 and int(n["rpdo_carries"][k]) & setpoint.acts for k in rows)
        by = "" if mapped else ", and no valid RPDO maps it"
        yield Reason("set_point", f"the set-point {name} is 0{by}")
    if n["setpoint_stale"]:
        yield Reason("stale", f"no set-point {name} has come since the mode changed, or for the time 2001h: write it")


def _no_slope(mode: int, values: Mapping[int, int]) -> Iterator[Reason]:
    index, slot = {
        cia402.OPERATION_MODE_PROFILE_VELOCITY: (0x6083, slots402.ACCELERATION),
        cia402.OPERATION_MODE_PROFILE_TORQUE: (0x6087, slots402.TORQUE_SLOPE),
    }.get(mode, (0, 0))
    if index and int(values[slot]) == 0:
        yield Reason("slope", f"the slope {index:04X}h is 0: write it")


def _at_limit(n: NodeRecord, objects: Objects, target: int) -> Iterator[Reason]:
    if not n["limited"]:
        return
    if not objects.number(0x6080, 0, 1) or not objects.number(0x607F, 0, 1):
        yield Reason("speed_limit", "6080h or 607Fh limits the speed to 0 (6041h, bit 11): write it")
    low, high = (int(n["values"][slot]) for slot in (slots402.LOWEST_POSITION, slots402.HIGHEST_POSITION))
    position = int(n["in_position_counts"])
    if position >= high if target > 0 else position <= low:
        yield Reason("limit", f"the position {position} is at its limit 607Dh, {low} to {high} (6041h, bit 11)")


class StandstillWatch:
    """Reports each reason of a drive once, when it has been present at `LOOKS` successive looks."""

    def __init__(self) -> None:
        self._last: str | None = None
        self._looks = 0
        self._reported: set[str] = set()

    def update(self, n: NodeRecord, objects: Objects, holding_pm: float = 0.0) -> Reason | None:
        """Return a reason to report now."""
        reason = why_still(n, objects, holding_pm)
        if n["power_state"] == PowerState.OPERATION_ENABLED:
            self._reported.add("state")  # its client knows how to enable it, and may disable it
        name = None if reason is None else reason.name
        self._looks = self._looks + 1 if name == self._last else 1
        self._last = name
        if reason is None or reason.name in self._reported or self._looks < LOOKS:
            return None
        self._reported.add(reason.name)
        return reason
