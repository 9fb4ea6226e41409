"""Own cases P.1 to P.10: the power state machine of a drive (CiA 402, IEC 61800-7-201).

Target torque is 0 in all of them.

The power stage is switched on in P.4, P.5, P.7 and P.9, in a torque mode with target torque 0 and
the least limit that the device accepts. A device without supply stops at Ready To Switch On, and
those cases do not apply.
"""

from __future__ import annotations

from contextlib import suppress

from coulombus.conformance.tester.objects import NOT_NOW, READ_ONLY, REFUSED
from coulombus.conformance.tester.pdo_setup import HeartbeatOfTester
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import Unit
from coulombus.conformance.tester.verdict import CaseFailed, LeftOpen, NotApplicable, TransferAborted, where
from coulombus.eds.cia402 import (
    CONTROLWORD,
    NEXT_STATE,
    OPERATION_MODE_CST,
    OPERATION_MODE_PROFILE_TORQUE,
    STATE_OF_STATUSWORD,
    TRANSITIONS,
    VOLTAGE_ENABLED,
    Command,
    PowerState,
)

__all__ = ["power_state"]

C, P = Command, PowerState
ROADS = {
    P.SWITCH_ON_DISABLED: (),
    P.READY_TO_SWITCH_ON: (C.SHUTDOWN,),
    P.SWITCHED_ON: (C.SHUTDOWN, C.SWITCH_ON),
    P.OPERATION_ENABLED: (C.SHUTDOWN, C.SWITCH_ON, C.ENABLE_OPERATION),
}


def need_drive(unit: Unit) -> None:
    """Skip devices other than drives."""
    if not unit.is_drive:
        raise NotApplicable("1000h is not of CiA 402, or 6040h and 6041h are not in the EDS")


def no_fault(unit: Unit) -> None:
    """Skip a drive with a permanent fault, as without mains or encoder: it has no other state."""
    if power_state(unit) != P.FAULT:
        return
    for word in (b"\0\0", b"\x80\0", b"\0\0"):
        unit.put(0x6040, 0, word)
        unit.pause(unit.timing.quiet_ns)
    if not unit.until(lambda: power_state(unit) != P.FAULT):
        code = f" (603Fh is {unit.number(0x603F):04X}h)" if unit.has(0x603F) else ""
        raise NotApplicable(f"the drive has a fault that cannot be reset{code}")


def power_state(unit: Unit) -> PowerState | None:
    """Return the state in the statusword, or None."""
    number = int(STATE_OF_STATUSWORD[unit.number(0x6041) & 0x7F])
    return None if number < 0 else PowerState(number)


def give(unit: Unit, command: Command) -> None:
    """Send a command by the controlword."""
    unit.put(0x6040, 0, CONTROLWORD[command].to_bytes(2, "little"))


def expect_state(unit: Unit, expected: PowerState, what: str) -> None:
    """Fail unless the drive reaches the state within the response time-out."""
    if not unit.until(lambda: power_state(unit) == expected):
        state = power_state(unit)
        text = f"{state.name if state is not None else 'no state'} after {what}, expected {expected.name}"
        raise CaseFailed(text, cause=f"the drive does not get to {expected.name}")


def no_torque(unit: Unit) -> None:
    """Set target torque 0, a torque mode, and the least limit."""
    need_drive(unit)
    no_fault(unit)
    unit.need_writable(0x6071)
    modes = unit.number(0x6502) if unit.has(0x6502) else 0
    mode = next((m for m in (OPERATION_MODE_CST, OPERATION_MODE_PROFILE_TORQUE) if modes >> m - 1 & 1), None)
    if mode is None:
        raise NotApplicable("the drive has no torque mode: it is not enabled")
    unit.put(0x6071, 0, b"\0\0")
    if unit.has(0x6072):
        with suppress(TransferAborted):
            unit.put(0x6072, 0, b"\0\0")
    if unit.has(0x6060) and unit.variable(0x6060).access not in READ_ONLY:
        unit.put(0x6060, 0, bytes((mode,)))


def lead(unit: Unit, target: PowerState) -> None:
    """Lead the drive from Switch On Disabled to a state."""
    give(unit, C.DISABLE_VOLTAGE)
    expect_state(unit, P.SWITCH_ON_DISABLED, "disable voltage")
    state = P.SWITCH_ON_DISABLED
    for command in ROADS[target]:
        give(unit, command)
        state = PowerState(int(NEXT_STATE[state, command]))
        if state == P.SWITCHED_ON and not unit.number(0x6041) & VOLTAGE_ENABLED:
            raise NotApplicable("the statusword's bit 4 tells that there is no supply")
        expect_state(unit, state, f"command {command.name}")


def transitions(unit: Unit, start: PowerState) -> str:
    """Execute every transition that a controlword commands from a state."""
    done = []
    for number, state, command, following in TRANSITIONS:
        if state != start:
            continue
        if command == C.QUICK_STOP and state == P.OPERATION_ENABLED:
            continue  # P.5
        lead(unit, start)
        give(unit, command)
        expect_state(unit, following, f"{command.name} in {state.name} (transition {number})")
        done.append(str(number))
    give(unit, C.DISABLE_VOLTAGE)
    return f"transitions {', '.join(dict.fromkeys(done))}"


@case("P.1")
def after_reset(unit: Unit) -> None:
    """Reset: Switch On Disabled, and 6077h, if present, is 0."""
    need_drive(unit)
    unit.reset()
    no_fault(unit)
    expect_state(unit, P.SWITCH_ON_DISABLED, "a reset")
    if not unit.has(0x6077):
        return
    try:
        torque = unit.number(0x6077)
    except TransferAborted as abort:
        if abort.code not in NOT_NOW:
            raise
        return
    if torque:
        raise CaseFailed(f"torque actual value is {torque} without power")


@case("P.2")
def without_power(unit: Unit) -> str:
    """Transitions 2 and 7."""
    no_torque(unit)
    return f"{transitions(unit, P.SWITCH_ON_DISABLED)}; {transitions_down(unit)}"


def transitions_down(unit: Unit) -> str:
    """Execute transition 7 by both of its commands."""
    for command in (C.QUICK_STOP, C.DISABLE_VOLTAGE):
        lead(unit, P.READY_TO_SWITCH_ON)
        give(unit, command)
        expect_state(unit, P.SWITCH_ON_DISABLED, f"{command.name} in READY_TO_SWITCH_ON (transition 7)")
    return "transition 7"


@case("P.3")
def switched_on(unit: Unit) -> str:
    """Transitions 3, 6 and 10; the power stage carries no torque in Switched On."""
    no_torque(unit)
    lead(unit, P.READY_TO_SWITCH_ON)
    if not unit.number(0x6041) & VOLTAGE_ENABLED:
        raise NotApplicable("the statusword's bit 4 tells that there is no supply")
    give(unit, C.SWITCH_ON)
    expect_state(unit, P.SWITCHED_ON, "SWITCH_ON (transition 3)")
    for command, target, number in (
        (C.SHUTDOWN, P.READY_TO_SWITCH_ON, 6),
        (C.DISABLE_VOLTAGE, P.SWITCH_ON_DISABLED, 10),
    ):
        lead(unit, P.SWITCHED_ON)
        give(unit, command)
        expect_state(unit, target, f"{command.name} in SWITCHED_ON (transition {number})")
    return "transitions 3, 6, 10"


@case("P.4")
def enabled(unit: Unit) -> str:
    """Transitions 4, 5, 8 and 9, with target torque 0: 6077h stays 0."""
    no_torque(unit)
    unit.start()
    text = transitions(unit, P.OPERATION_ENABLED)
    lead(unit, P.OPERATION_ENABLED)
    torque = unit.number(0x6074) if unit.has(0x6074) else 0
    give(unit, C.DISABLE_VOLTAGE)
    if torque:
        raise CaseFailed(f"torque demand is {torque} although the target torque is 0")
    return f"transition 4, {text}"


@case("P.5")
def quick_stop(unit: Unit) -> str:
    """Quick stop from Operation Enabled: Switch On Disabled, or Quick Stop Active if 605Ah demands
    it; then disable voltage.
    """
    no_torque(unit)
    unit.start()
    lead(unit, P.OPERATION_ENABLED)
    give(unit, C.QUICK_STOP)
    unit.pause(unit.timing.quiet_ns)
    option = unit.number(0x605A) if unit.has(0x605A) else 2
    if option >= 5:
        expect_state(unit, P.QUICK_STOP_ACTIVE, f"quick stop with option {option}")
    elif option >= 0:  # transition 12, after a ramp with nothing to slow down
        expect_state(unit, P.SWITCH_ON_DISABLED, f"quick stop with option {option}")
    give(unit, C.DISABLE_VOLTAGE)
    expect_state(unit, P.SWITCH_ON_DISABLED, "disable voltage after a quick stop")
    return f"option {option}"


@case("P.6")
def out_of_turn(unit: Unit) -> None:
    """Switch on and enable in Switch On Disabled, and a fault reset in Ready To Switch On: nothing
    happens.
    """
    no_torque(unit)
    lead(unit, P.SWITCH_ON_DISABLED)
    for command in (C.SWITCH_ON, C.ENABLE_OPERATION):
        give(unit, command)
        unit.pause(unit.timing.quiet_ns)
        expect_state(unit, P.SWITCH_ON_DISABLED, f"{command.name} in SWITCH_ON_DISABLED")
        give(unit, C.DISABLE_VOLTAGE)
    lead(unit, P.READY_TO_SWITCH_ON)
    unit.put(0x6040, 0, b"\x86\0")
    unit.pause(unit.timing.quiet_ns)
    expect_state(unit, P.READY_TO_SWITCH_ON, "a fault reset without a fault")


@case("P.7")
def fault(unit: Unit) -> str:
    """Stop a consumed heartbeat with the drive enabled: fault.

    A constant bit 7 does not reset; its rising edge does.
    """
    no_torque(unit)
    heartbeat = HeartbeatOfTester(unit, 300)
    unit.start()
    lead(unit, P.OPERATION_ENABLED)
    unit.put(0x6040, 0, b"\x8f\0")
    unit.flush()
    heartbeat.lose()  # monitoring begins here, independent of the time until now
    try:
        expect_state(unit, P.FAULT, "a lost heartbeat")
    except CaseFailed:
        if not unit.has(0x6007):
            raise LeftOpen("no FAULT after a lost heartbeat, without 6007h", "CiA 402-2, object 6007h") from None
        if unit.number(0x6007) not in (1, -1):
            raise NotApplicable(f"6007h is {unit.number(0x6007)}: a lost connection is no fault") from None
        raise
    _error_code(unit)
    heartbeat.beat()
    unit.put(0x6040, 0, b"\x80\0")
    unit.pause(unit.timing.quiet_ns)
    held = power_state(unit)
    unit.put(0x6040, 0, b"\0\0")
    heartbeat.beat()
    unit.pause(unit.timing.quiet_ns)  # a drive that reads the controlword in its main loop sees the edge
    unit.put(0x6040, 0, b"\x80\0")
    expect_state(unit, P.SWITCH_ON_DISABLED, "the rising edge of bit 7")
    if held != P.FAULT:
        raise CaseFailed("the fault was reset although bit 7 was held and did not rise")
    return "fault and reset"


def _error_code(unit: Unit) -> None:
    """Fail if 603Fh differs from the EMCY's code."""
    frames = unit.pop_frames(unit.number(0x1014) & 0x7FF) if unit.has(0x1014) else []
    emcy_codes = [int.from_bytes(frame.data[:2], "little") for frame in frames]
    if unit.has(0x603F) and emcy_codes and unit.number(0x603F) not in emcy_codes:
        raise CaseFailed(f"603Fh is {unit.number(0x603F):04X}h in FAULT; the EMCY said {emcy_codes[-1]:04X}h")


@case("P.8")
def modes(unit: Unit) -> str:
    """Write every mode from -1 to 11 to 6060h: those of 6502h are accepted and shown by 6061h, the others are refused."""
    need_drive(unit)
    unit.need_writable(0x6060)
    for index in (0x6061, 0x6502):
        unit.need(index)
    supported = unit.number(0x6502)
    accepted = []
    for mode in range(1, 12):
        if supported >> mode - 1 & 1:
            unit.put(0x6060, 0, bytes((mode,)))
            if not _shows_mode(unit, mode):
                raise CaseFailed(f"6061h is {unit.number(0x6061)} after mode {mode} was written to 6060h")
            accepted.append(str(mode))
            continue
        try:
            unit.put(0x6060, 0, bytes((mode,)))
        except TransferAborted as abort:
            unit.judge(abort, REFUSED)
            continue
        unit.pause(unit.timing.quiet_ns)
        if unit.number(0x6061) == mode:
            raise CaseFailed(f"6061h shows mode {mode}, which 6502h does not have")
    return f"modes {', '.join(accepted)}"


def _shows_mode(unit: Unit, mode: int) -> bool:
    """Return whether 6061h shows a mode in time."""
    return unit.until(lambda: unit.number(0x6061) == mode)


@case("P.9")
def connection_lost(unit: Unit) -> str:
    """Leave NMT OPERATIONAL with the drive enabled: it does not stay enabled, unless 6007h is 0."""
    no_torque(unit)
    option = unit.number(0x6007) if unit.has(0x6007) else 0
    if option == 0:
        raise NotApplicable("6007h is 0 or absent: a lost connection does nothing")
    unit.start()
    lead(unit, P.OPERATION_ENABLED)
    unit.nmt(128)
    if not unit.until(lambda: power_state(unit) != P.OPERATION_ENABLED):
        raise CaseFailed(f"the drive stays enabled without NMT OPERATIONAL; 6007h is {option}")
    state = power_state(unit)
    return f"{state.name if state is not None else 'no state'} with option {option}"


@case("P.10")
def option_codes(unit: Unit) -> str:
    """Write the reserved value 99 to the option codes 605Ah to 605Eh: refused and unchanged."""
    need_drive(unit)
    done = []
    for index in range(0x605A, 0x605F):
        if unit.has(index) and unit.variable(index).access == "rw":
            before = unit.read(index)
            unit.refused(index, 0, 99, REFUSED)
            if unit.read(index) != before:
                raise CaseFailed(f"{where(index, 0)} has changed although 99 was refused")
            done.append(where(index, 0))
    if not done:
        raise NotApplicable("the EDS has no option code that can be written")
    return ", ".join(done)
