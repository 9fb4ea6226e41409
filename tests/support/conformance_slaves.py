"""Slaves for the rules of single cases: objects that run, that are kept, that lie; effects that come
late; a store without a restore.

Each changes what our simulated node sends or receives, as the mutants do.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass, replace

from conformance_bench import KIND_OF, VirtualLink, description
from conformance_foreign import ForeignLink, abort
from conformance_mutants import ok, place, written
from coulombus.conformance.catalogue import catalogue
from coulombus.conformance.runner import Report, check_before, run, select
from coulombus.conformance.tester.unit import Timing, Unit
from coulombus.eds.reader import Description, parse_eds

MS = 1_000_000
REQUEST, RESPONSE, NMT, SYNC = 0x601, 0x581, 0x000, 0x080
CLOCK = (0x1013, 0)
OPERATING_TIME = (0x2100, 0)


@dataclass(frozen=True)
class Slave:
    """What a slave does with frames, and how its EDS differs from ours."""

    name: str = ""
    takes: Callable | None = None
    sends: Callable | None = None
    eds: Callable[[str], str] | None = None
    device: str = "motor"


class SlaveLink(ForeignLink):
    """A link whose slave may take frames later than they come (`later`)."""

    def prepare(self):
        super().prepare()
        self.pending = []

    def later(self, delay_ns, can_id, data, length):
        heapq.heappush(self.pending, (self.t + delay_ns, len(self.pending), can_id, data, length))

    def until(self, t_ns):
        while self.pending and self.pending[0][0] <= t_ns:
            due_ns, _, can_id, data, length = heapq.heappop(self.pending)
            super().until(due_ns)
            self.deliver(can_id, data, length)
        super().until(t_ns)

    def receive(self, until_ns):
        while not self.sent and self.pending and self.pending[0][0] <= until_ns:
            self.until(self.pending[0][0])
        return super().receive(until_ns)


def eds_of(slave: Slave) -> Description:
    text = description(slave.device).text
    if slave.eds is None:
        return description(slave.device)
    return parse_eds(slave.eds(text).encode(), f"{slave.device}.eds")


def unit_of(slave: Slave, *, timing: Timing | None = None) -> Unit:
    eds = eds_of(slave)
    link_type = type("Link", (SlaveLink,), {"mutant": slave})
    return Unit(link_type(eds, 1, KIND_OF[slave.device]), eds, 1, timing or Timing())


def run_on(unit: Unit, *numbers: str) -> Report:
    check_before(unit)
    return run(unit, select(numbers))


def results(report: Report) -> dict[str, tuple[str, str]]:
    return {outcome.case.id: (outcome.result, outcome.reason) for outcome in report.outcomes}


def all_but(*prefixes: str) -> list[str]:
    return [case.id for case in catalogue() if not case.id.startswith(prefixes)]


# EDS


def with_object(text: str, index: int, keys: str) -> str:
    """Return an EDS with one object more."""
    return f"{text.rstrip()}\n\n[{index:04X}]\nParameterName=Added\nObjectType=0x7\nPDOMapping=0\n{keys}"


def with_clock(text: str) -> str:
    return with_object(text, 0x1013, "DataType=0x0007\nAccessType=rw\nDefaultValue=0\n")


def with_operating_time(text: str) -> str:
    return with_object(text, 0x2100, "DataType=0x0007\nAccessType=rw\nDefaultValue=0\n")


def without(index: int, text: str) -> str:
    """Return an EDS without an object."""
    sections = text.split("\n[")
    return "\n[".join(part for part in sections if not part.startswith(f"{index:04X}"))


def with_key(section: str, key: str, text: str) -> str:
    """Return an EDS in which a section has a key's line in the place of its own."""
    head, _, rest = text.partition(f"[{section}]\n")
    body, separator, tail = rest.partition("\n[")
    name = key.partition("=")[0]
    lines = [line for line in body.rstrip().splitlines() if not line.startswith(f"{name}=")]
    return f"{head}[{section}]\n" + "\n".join((*lines, key)) + "\n" + separator + tail


# objects of the slave's own


def upload(data: bytes, value: int) -> bytes:
    return b"\x43" + data[1:4] + (value & 0xFFFFFFFF).to_bytes(4, "little")


def serves(where, read: Callable, write: Callable):
    """Return a `takes` that serves one object of four bytes itself."""

    def takes(link, can_id, data, length):
        if can_id != REQUEST or length != 8 or place(data) != where:
            return can_id, data, length
        if data[0] == 0x40:
            return upload(data, read(link))
        if written(data) == where:
            return write(link, data)
        return can_id, data, length

    return takes


def running_object(where, period_ns, *, settable=True):
    """Return an object that counts every `period_ns`, from what was written to it on."""

    def value(link):
        start_ns, start = link.memory.get("count", (0, 0))
        return start + link.t // period_ns - start_ns // period_ns

    def write(link, data):
        if settable:
            link.memory["count"] = (link.t, int.from_bytes(data[4:], "little"))
        return ok(data)

    return serves(where, value, write)


def distorting_object(where, change):
    """Return an object that holds `change` of what is written to it, and does not run."""

    def write(link, data):
        link.memory["held"] = change(int.from_bytes(data[4:], "little")) & 0xFFFFFFFF
        return ok(data)

    return serves(where, lambda link: link.memory.get("held", 5), write)


def kept_object(where, first):
    """Return an object that keeps its value over resets and restores, as an operating time."""

    def write(link, data):
        link.memory["kept"] = int.from_bytes(data[4:], "little")
        return ok(data)

    return serves(where, lambda link: link.memory.get("kept", first), write)


def wrong_default(where, default):
    """Return an object that has another value than the EDS's default after each reset."""
    kept = kept_object(where, default)

    def takes(link, can_id, data, length):
        if can_id == NMT and data[0] in (129, 130):
            link.memory.pop("kept", None)
        return kept(link, can_id, data, length)

    return takes


# late effects


def late(delay_ns, *can_ids):
    """Return a `takes` by which frames with these identifiers take effect so much later."""

    def takes(link, can_id, data, length):
        if can_id in can_ids:
            link.later(delay_ns, can_id, data, length)
            return None
        return can_id, data, length

    return takes


def late_emcy(delay_ns):
    """Return a `sends` by which an EMCY comes so much later."""

    def sends(link, frame):
        return replace(frame, t_ns=frame.t_ns + delay_ns) if frame.can_id == 0x81 else frame

    return sends


def late_mode_display(delay_ns):
    """Return a `takes` by which 6061h shows a mode so long after it was written to 6060h."""

    def takes(link, can_id, data, length):
        if can_id != REQUEST or length != 8:
            return can_id, data, length
        if written(data) == (0x6060, 0):
            before = link.ask(b"\x40\x61\x60\0\0\0\0\0")
            answer = link.ask(data)
            if answer[0] == 0x60:
                link.memory["mode"] = (link.t + delay_ns, before)
            return answer
        until_ns, before = link.memory.get("mode", (0, b""))
        if place(data) == (0x6061, 0) and data[0] == 0x40 and link.t < until_ns:
            return before
        return can_id, data, length

    return takes


def without_restore(link, can_id, data, length):
    """1011h is not there; what is stored, stays."""
    if can_id == REQUEST and length == 8 and place(data)[0] == 0x1011:
        return abort(place(data), 0x06020000)
    if can_id == REQUEST and written(data) is not None and place(data)[0] == 0x1010 and data[4:] == b"save":
        link.memory["saved"] = link.memory.get("saved", 0) + 1
    return can_id, data, length


def no_emcy_of_error_control(link, frame):
    """A lost heartbeat and the life time are no EMCY; a short RPDO is."""
    return None if frame.can_id in (0x81, 0x6DA) and frame.data[:2] in (b"\x30\x81", b"\0\0") else frame


def stored_by_a_user(unit: Unit, index: int, value: bytes) -> None:
    """Store a value before the run, as a user does."""
    unit.put(index, 0, value)
    VirtualLink.send(unit.link, REQUEST, b"\x23\x10\x10\x01save")
    unit.reset()
    assert unit.read(index) == value
