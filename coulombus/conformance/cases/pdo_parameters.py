"""Cases 3.1 to 3.20: PDO parameters, and the triggers of TPDOs in each NMT state.

Source: CiA 301, sections 7.2.2, 7.5.2.35, 7.5.2.37.
"""

from __future__ import annotations

from collections.abc import Callable

from coulombus.conformance.tester.pdo_setup import RPDO, TPDO, Unsupported, enter
from coulombus.conformance.tester.pdo_stimuli import STIMULI, Stimulus, candidates
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import PRE_OPERATIONAL, STOPPED, Unit
from coulombus.conformance.tester.verdict import CaseFailed, NotApplicable, TransferAborted, where
from coulombus.eds.cia301 import NmtState

RESERVED = {RPDO: range(241, 254), TPDO: range(241, 252)}
_EXTENDED, _INVALID = 1 << 29, 1 << 31


@case("3.1", direction=RPDO)
@case("3.2", direction=TPDO)
def scan(unit: Unit, direction: int) -> str:
    """Read all 512 communication parameters: those of the EDS exist and are valid, the others are refused."""
    present = 0
    for index in range(direction, direction + 0x200):
        if not unit.has(index):
            try:
                unit.read(index, 0)
            except TransferAborted as abort:
                unit.judge(abort)
            else:
                raise CaseFailed(f"{where(index, 0)} answers but is not in the EDS")
            continue
        present += 1
        highest = unit.number(index, 0)
        if not 2 <= highest <= 6:
            raise CaseFailed(f"{where(index, 0)} is {highest}, expected 2 to 6")
        cob_id = unit.number(index, 1)
        if not cob_id & _EXTENDED and cob_id & 0x1FFFF800:
            raise CaseFailed(f"{where(index, 1)} is {cob_id:08X}h: more than 11 bits without bit 29")
        if not cob_id & _INVALID and not cob_id & 0x1FFFFFFF:
            raise CaseFailed(f"{where(index, 1)} is {cob_id:08X}h: valid, with the identifier of NMT")
        kind = unit.number(index, 2)
        if kind in RESERVED[direction]:
            raise CaseFailed(f"{where(index, 2)} is {kind}, a reserved transmission type")
        for subindex in unit.description.objects[index].variables:
            if 2 < subindex <= highest and subindex != 4:
                unit.read(index, subindex)
        if not unit.has(index + 0x200):
            raise CaseFailed(f"{where(index, 0)} has no map {where(index + 0x200, 0)} in the EDS")
    if not present:
        raise NotApplicable(f"the EDS has no PDO from {where(direction, 0)} on")
    return f"{present} PDOs"


def each_occasion(unit: Unit, stimulus: int, check: Callable[[Stimulus], str]) -> str:
    """Set up each possible TPDO, start the node and `check` its trigger.

    Return the remarks of the checks.
    """
    reasons, done = [], []
    for k in candidates(unit):
        try:
            occasion = STIMULI[stimulus](unit, k)
            unit.flush()
            unit.start()
            done.append(check(occasion))
        except (Unsupported, NotApplicable) as reason:
            reasons.append(str(reason))
        unit.restore()
        unit.reset()
    if not done:
        raise NotApplicable(reasons[0])
    return ", ".join(done)


@case("3.3", stimulus=0)
@case("3.4", stimulus=1)
@case("3.5", stimulus=2)
@case("3.6", stimulus=3)
@case("3.7", stimulus=4)
@case("3.8", stimulus=5)
def operational(unit: Unit, stimulus: int) -> str:
    """Set up each possible TPDO, start the node, and check that it is sent when, and only when, it is due."""

    def check(occasion: Stimulus) -> str:
        remark = occasion.check()
        return occasion.name + (f" ({remark})" if remark else "")

    return each_occasion(unit, stimulus, check)


@case("3.9", stimulus=0, state=STOPPED)
@case("3.10", stimulus=1, state=STOPPED)
@case("3.11", stimulus=2, state=STOPPED)
@case("3.12", stimulus=3, state=STOPPED)
@case("3.13", stimulus=4, state=STOPPED)
@case("3.14", stimulus=5, state=STOPPED)
@case("3.15", stimulus=0, state=PRE_OPERATIONAL)
@case("3.16", stimulus=1, state=PRE_OPERATIONAL)
@case("3.17", stimulus=2, state=PRE_OPERATIONAL)
@case("3.18", stimulus=3, state=PRE_OPERATIONAL)
@case("3.19", stimulus=4, state=PRE_OPERATIONAL)
@case("3.20", stimulus=5, state=PRE_OPERATIONAL)
def silent(unit: Unit, stimulus: int, state: NmtState) -> str:
    """Show that the trigger works in OPERATIONAL, and does not work in another state."""

    def check(occasion: Stimulus) -> str:
        if not occasion.control():
            raise NotApplicable(f"{occasion.name} does not come in OPERATIONAL either: see 3.{3 + stimulus}")
        enter(unit, state)
        unit.pause(unit.timing.quiet_ns)
        unit.flush()
        occasion.poke(state)
        unit.pause(unit.timing.quiet_ns)
        frames = unit.pop_frames(occasion.can_id)
        if frames:
            raise CaseFailed(f"{occasion.name} comes {len(frames)} times in NMT state {state.name}")
        return occasion.name

    return each_occasion(unit, stimulus, check)
