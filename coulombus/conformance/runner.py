"""The run: check that the device is present and idle, then execute the cases."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from coulombus.conformance.cases import (
    drive,
    emcy,
    heartbeat,
    lss,
    nmt,
    node_guarding,
    objects,
    pdo_mapping,
    pdo_parameters,
    pdo_receive,
    pdo_transmit,
    sdo,
    sdo_block,
    sdo_segmented,
    storing,
    sync,
)
from coulombus.conformance.catalogue import Case, catalogue
from coulombus.conformance.tester import storage
from coulombus.conformance.tester.registry import FUNCTIONS
from coulombus.conformance.tester.unit import Unit
from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable, where
from coulombus.eds.cia301 import NmtState
from coulombus.eds.cia402 import PowerState
from coulombus.system.errors import CoulombusError
from coulombus.wire.address import BusUnavailable
from coulombus.wire.bus_link import BusFrame

__all__ = [
    "MODULES",
    "ConformanceRefused",
    "DeviceSilent",
    "Outcome",
    "Report",
    "WrongDevice",
    "check_before",
    "run",
    "select",
]

MODULES = (
    *(objects, sdo, sdo_segmented, sdo_block, pdo_parameters, pdo_mapping, pdo_receive, pdo_transmit),
    *(emcy, sync, node_guarding, heartbeat, storing, nmt, lss, drive),
)
"""Importing them fills the registry."""

Result = Literal["pass", "fail", "not_applicable", "error"]
FRAMES = 40
_GIVE_UP = 3
SILENT = "not run: the device does not answer any more"


class DeviceSilent(CoulombusError):
    """No node responds."""

    exit_status = 5


class ConformanceRefused(CoulombusError):
    """The device is in operation: the run would interfere."""

    exit_status = 7


class WrongDevice(CoulombusError):
    """The device does not match the EDS."""

    exit_status = 3


class UnknownCase(CoulombusError, ValueError):
    """There is no such case."""

    exit_status = 2


@dataclass(frozen=True)
class Outcome:
    """Outcome of a case: result, the reason or a remark, and the last frames of a failure or an error.

    An `error` is the tester's own: it says nothing about the device.
    """

    case: Case
    result: Result
    reason: str
    frames: tuple[str, ...] = ()
    seconds: float = 0.0
    cause: str = ""
    """The fault behind a failure, identical in all affected cases."""
    clause: str = ""
    """Clause of the standard for the failed requirement."""


@dataclass(frozen=True)
class Report:
    """Outcomes of all cases."""

    eds: str
    node_id: int
    device: str
    outcomes: tuple[Outcome, ...]
    ended_by: BaseException | None = None
    """Reason for an early end of the run: an interrupt, or a closed bus."""
    remarks: tuple[str, ...] = ()
    """Remarks on the parameters at the beginning of the run, and of the device at its end."""

    def count(self, result: Result) -> int:
        """Return the number of cases with this result."""
        return sum(outcome.result == result for outcome in self.outcomes)


def select(numbers: Sequence[str]) -> list[Case]:
    """Return the cases with these numbers, in the catalogue's order; without numbers, all cases.

    Raises
    ------
    UnknownCase
        There is no such case.
    """
    cases = catalogue()
    case_ids = {case.id for case in cases}
    unknown = [number for number in numbers if number not in case_ids]
    if unknown:
        raise UnknownCase(f"--case {unknown[0]}: there is no such case; expected a number such as 2.10, 7.101 or L.1")
    return [case for case in cases if not numbers or case.id in numbers]


def check_before(unit: Unit, *, force: bool = False) -> None:
    """Check that the device responds and is not in operation.

    Raises
    ------
    DeviceSilent
        Two uploads of 1000h get no response.
    ConformanceRefused
        It is in NMT OPERATIONAL, or a drive in Operation Enabled; not with `force`.
    WrongDevice
        Its profile, vendor or product differs from the EDS; not with `force`.
    """
    for attempt in range(2):
        try:
            unit.read(0x1000, 0)
            break
        except NoAnswer:
            if attempt == 0:
                continue
            if unit.state() is None:
                text = f"no node answers as node {unit.node_id} (SDO request {unit.sdo_rx:03X}h): is it on, and is the id right?"
                raise DeviceSilent(text) from None
        except CaseFailed:
            break
    if force:
        return
    _check_identity(unit)
    if unit.state() == NmtState.OPERATIONAL:
        raise ConformanceRefused(
            f"node {unit.node_id} is in NMT OPERATIONAL: a host is using it. The run resets it and changes its objects; stop the host, or --force"
        )
    try:
        enabled = unit.is_drive and drive.power_state(unit) == PowerState.OPERATION_ENABLED
    except CaseFailed:
        enabled = False
    if enabled:
        raise ConformanceRefused(f"node {unit.node_id} is a drive in Operation Enabled: disable it first, or --force")


def _check_identity(unit: Unit) -> None:
    """Refuse a device that does not match the EDS: objects that the EDS marks harmless may move something."""
    for index, subindex, mask, name in (
        (0x1000, 0, 0xFFFF, "profile"),
        (0x1018, 1, 0xFFFFFFFF, "vendor"),
        (0x1018, 2, 0xFFFFFFFF, "product"),
    ):
        default = unit.default(unit.variable(index, subindex)) if unit.has(index, subindex) else None
        if not isinstance(default, int) or not default & mask:
            continue
        try:
            value = unit.number(index, subindex)
        except CaseFailed:
            continue
        if (value ^ default) & mask:
            text = f"{where(index, subindex)} is {value:08X}h, and {default:08X}h in {unit.description.path}"
            raise WrongDevice(
                f"node {unit.node_id} has another {name} than the EDS: {text}. Give the EDS of this device; or --force"
            )


def run(unit: Unit, cases: Sequence[Case], progress: Callable[[int, Case], None] = lambda n, case: None) -> Report:
    """Run the cases, and leave the device reset, with its defaults if something was stored.

    Cases that compare with defaults start from them if the device has 1011h; otherwise the remarks say so.

    An unexpected exception is an error of the tester in that case, and never ends the run. If the
    device stops responding, the remaining cases fail at once. An interrupt or a closed bus ends the
    run; the outcomes so far are returned, with the reason.
    """
    device = str(unit.description.info.get("ProductName", "")) or unit.description.path
    outcomes: list[Outcome] = []
    silent = 0
    ended_by: BaseException | None = None
    remarks: list[str] = []
    held: storage.Parameters = {}
    numbers = [case.id for case in cases]
    try:
        unit.learn_abilities()
        began, held = storage.begin(unit, numbers)
        remarks.append(began)
        for number, case in enumerate(cases):
            progress(number, case)
            if silent >= _GIVE_UP:
                outcomes.append(Outcome(case, "fail", SILENT, cause=SILENT, clause=case.clause))
                continue
            outcomes.append(_outcome(unit, case))
            silent = silent + 1 if outcomes[-1].result == "fail" and not _alive(unit) else 0
    except (KeyboardInterrupt, SystemExit, BusUnavailable) as why:
        ended_by = why
    try:  # also on an interrupt: a drive must not stay enabled
        _leave(unit)
        remarks.append(storage.end(unit, held))
    except (KeyboardInterrupt, SystemExit, BusUnavailable) as why:
        ended_by = ended_by or why
    return Report(unit.description.path, unit.node_id, device, tuple(outcomes), ended_by, tuple(remarks))


def _outcome(unit: Unit, case: Case) -> Outcome:
    start_ns = unit.link.now_ns()
    result: Result = "pass"
    cause = clause = ""
    try:
        unit.begin(case.codes)
        start_ns = unit.link.now_ns()
        reason = FUNCTIONS[case.id](unit) or ""
    except NotApplicable as why:
        result, reason = "not_applicable", str(why)
    except CaseFailed as why:
        result, reason, cause, clause = "fail", str(why), why.cause, why.clause
    except BusUnavailable:
        raise
    except Exception as why:  # a case must handle anything that a device sends
        result, reason = "error", _own_error(why)
    seconds = (unit.link.now_ns() - start_ns) / 1e9
    shown = result in ("fail", "error")
    frames = tuple(_lines(list(unit.trace)[-FRAMES:], start_ns)) if shown else ()
    try:
        unit.restore()
    except CaseFailed as why:
        result, reason = "fail", f"what the case changed cannot be restored: {why}"
        cause, clause = why.cause, why.clause
    except BusUnavailable:
        raise
    except Exception as why:
        result, reason = "error", _own_error(why)
    if result == "fail":
        cause, clause = cause or reason, clause or case.clause
    return Outcome(case, result, reason, frames, seconds, cause, clause)


def _lines(frames: Sequence[BusFrame], start_ns: int) -> Iterator[str]:
    """Yield a line for each frame, in the order of the trace.

    Received frames are stamped by the bus and sent ones by the tester, and their clocks differ
    slightly: no frame is shown before its predecessor.
    """
    t_ns = min((frame.t_ns for frame in frames), default=0)
    for frame in frames:
        t_ns = max(t_ns, frame.t_ns)
        yield replace(frame, t_ns=t_ns).line(start_ns)


def _own_error(why: Exception) -> str:
    place = traceback.extract_tb(why.__traceback__)[-1]
    text = f"{type(why).__name__}: {why} ({Path(place.filename).name}, line {place.lineno})"
    return f"the tester itself failed, and says nothing about the device: {text}; please report it with the frames"


def _alive(unit: Unit) -> bool:
    try:
        unit.reset()
        unit.read(0x1000, 0)
    except NoAnswer:
        return False
    except CaseFailed:
        return True
    return True


def _leave(unit: Unit) -> None:
    if unit.stored:
        unit.forget_stored()
    if unit.dirty:
        unit.reset()
