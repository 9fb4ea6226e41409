"""Cases 7.1 to 7.6: node guarding (CiA 301, section 7.2.8.2.2)."""

from __future__ import annotations

from coulombus.conformance.tester.deviations import judge_deviations
from coulombus.conformance.tester.provoke import GUARD_MS, emcy_id, must_be_noticed
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import MS, Unit
from coulombus.conformance.tester.verdict import CaseFailed
from coulombus.eds.cia301 import CobId, NmtCommand, NmtState
from coulombus.wire.bus_link import RTR, BusFrame

__all__ = ["alternating", "error_id", "guard", "need_guarding"]


def need_guarding(unit: Unit) -> None:
    """Require both guarding objects; a default heartbeat has precedence, so it is switched off."""
    unit.need(0x100C)
    unit.need(0x100D)
    no_heartbeat(unit)


def no_heartbeat(unit: Unit) -> None:
    """Switch off a default heartbeat."""
    if unit.has(0x1017) and unit.number(0x1017):
        unit.write(0x1017, 0, 0)


def error_id(unit: Unit) -> int:
    """Return the identifier of heartbeat and guarding."""
    return CobId.HEARTBEAT + unit.node_id


def guard(unit: Unit) -> BusFrame:
    """Send a remote frame, and return the response."""
    unit.pause(2 * MS)
    unit.pop_frames(error_id(unit))
    unit.send(error_id(unit) | RTR, length=1)
    frame = unit.expect(error_id(unit), "answer to the guarding's remote frame")
    if frame.length != 1:
        raise CaseFailed(f"the guarding's answer has {frame.length} bytes, expected 1")
    return frame


def alternating(unit: Unit, state: NmtState, count: int = 6, toggle: int = 0) -> None:
    """Guard this many times: the state is reported, and the toggle bit alternates from `toggle`."""
    for k in range(count):
        expected = state | 0x80 * (toggle ^ (k & 1))
        value = guard(unit).data[0]
        if value != expected:
            raise CaseFailed(f"guarding answer {k + 1} is {value:02X}h, expected {expected:02X}h")


@case("7.1", defaults=True)
def guarding_objects(unit: Unit) -> str:
    """Read 100Ch and 100Dh and compare them with the EDS."""
    need_guarding(unit)
    values = [unit.number(0x100C), unit.number(0x100D)]
    defaults = [unit.default(unit.variable(index)) for index in (0x100C, 0x100D)]
    for index, value, default in zip((0x100C, 0x100D), values, defaults, strict=True):
        if isinstance(default, int) and value != default:
            judge_deviations(unit, {(index, 0): f"{index:04X}h is {value}; the EDS says {default}"})
    return f"{values[0]} ms, factor {values[1]}"


@case("7.2")
def guarding_answer(unit: Unit) -> None:
    """Guard once in PRE-OPERATIONAL and OPERATIONAL."""
    need_guarding(unit)
    for command, state in ((NmtCommand.ENTER_PRE_OPERATIONAL, 127), (NmtCommand.START, 5), (NmtCommand.STOP, 4)):
        unit.nmt(command)
        value = guard(unit).data[0] & 0x7F
        if value != state:
            raise CaseFailed(f"the guarding's answer tells state {value}, expected {state}")


@case("7.3")
def guarding_toggle(unit: Unit) -> None:
    """Reset the communication, and guard six times: 0, 1, 0, 1, 0, 1.

    After another reset 0 again.
    """
    need_guarding(unit)
    for count in (5, 2):
        unit.reset(NmtCommand.RESET_COMMUNICATION)
        no_heartbeat(unit)
        alternating(unit, NmtState.PRE_OPERATIONAL, count)


@case("7.4")
def guarding_identifiers(unit: Unit) -> None:
    """Send remote frames with all 127 identifiers: the device responds only to its own."""
    need_guarding(unit)
    unit.flush()
    for node_id in range(1, 128):
        if node_id == unit.node_id:
            continue
        unit.send(CobId.HEARTBEAT + node_id | RTR, length=1)
        unit.pause(MS)
    unit.pause(unit.timing.quiet_ns)
    if unit.pop_frames(error_id(unit)):
        raise CaseFailed("the device answers to a remote frame with another node's identifier")
    alternating(unit, NmtState.PRE_OPERATIONAL, 1)


@case("7.5")
def guarding_parameters(unit: Unit) -> None:
    """Write 100Ch and 100Dh and read them back."""
    need_guarding(unit)
    for index, value in ((0x100C, 500), (0x100D, 3)):
        unit.need_writable(index)
        unit.write(index, 0, value)
        if unit.number(index) != value:
            raise CaseFailed(f"{index:04X}h is {unit.number(index)} after {value} was written")


def _lose(unit: Unit) -> None:
    guard(unit)
    unit.pause(5 * GUARD_MS * MS)


@case("7.6")
def life_guarding(unit: Unit) -> str:
    """Guard in time: no EMCY. Then stop: EMCY after the life time, not before half of it."""
    need_guarding(unit)
    can_id = emcy_id(unit)
    for index, value in ((0x100C, GUARD_MS), (0x100D, 4)):
        unit.need_writable(index)
        unit.write(index, 0, value)
    unit.flush()
    for _ in range(8):
        guard(unit)
        unit.pause(GUARD_MS * MS)
    if unit.pop_frames(can_id):
        raise CaseFailed("an EMCY although the guarding is in time")
    last_ns = unit.link.now_ns()
    guard(unit)
    frame = unit.wait(can_id, 4 * GUARD_MS * MS + unit.timing.answer_ns)
    if frame is None:
        must_be_noticed(unit, "the life time", lambda: _lose(unit))
        return ""
    after_ms = (frame.t_ns - last_ns) / 1e6
    if after_ms < 2 * GUARD_MS:
        raise CaseFailed(f"EMCY after {after_ms:.0f} ms; the life time is {4 * GUARD_MS} ms")
    return f"{int.from_bytes(frame.data[:2], 'little'):04X}h after {after_ms:.0f} ms"
