"""Cases 9.1 to 10.4 and N.1 to N.4: NMT states, transitions and commands (CiA 301, section 7.3.2)."""

from __future__ import annotations

from coulombus.conformance.tester.objects import READ_ONLY, volatile
from coulombus.conformance.tester.pdo_setup import NO_SYNC_TPDO, TPDO, Unsupported, arm, enter, sync
from coulombus.conformance.tester.pdo_stimuli import candidates
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.sdo_checks import reads_back, text_object
from coulombus.conformance.tester.unit import OPERATIONAL, PRE_OPERATIONAL, STOPPED, Unit, encode
from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable, where
from coulombus.eds.cia301 import CobId, NmtCommand, NmtState

__all__: list[str] = []

ALL_STATES = (PRE_OPERATIONAL, OPERATIONAL, STOPPED)
RESETS = (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION)
HEARTBEAT_MS = 20


def boot_up(unit: Unit, command: int = NmtCommand.RESET_NODE) -> None:
    """Reset, and check the boot-up message."""
    frame = unit.reset(command, must=True)
    if frame is None or frame.length != 1 or frame.data != b"\0":
        raise CaseFailed(f"the boot-up message is {frame.data.hex(' ') if frame else 'missing'}, expected one byte 00h")


def produce_heartbeats(unit: Unit) -> None:
    """Switch on heartbeats, if available, to learn the device's state.

    Call it in PRE-OPERATIONAL.
    """
    if unit.has(0x1017) and unit.variable(0x1017).access == "rw":
        unit.write(0x1017, 0, HEARTBEAT_MS)


def nmt_state(unit: Unit) -> int | None:
    """Return the state by heartbeat or guarding; None without either."""
    identifier = CobId.HEARTBEAT + unit.node_id
    if unit.has(0x1017) and unit.variable(0x1017).access == "rw":
        unit.pause(HEARTBEAT_MS * 1_000_000)  # one already under way
        unit.flush()
        frame = unit.expect(identifier, "heartbeat")
        return frame.data[0] & 0x7F if frame.data else None
    return unit.state() if unit.has(0x100C) else None


def serves_sdo(unit: Unit) -> bool:
    """Return whether an upload of 1000h gets a response."""
    unit.flush()
    unit.send(unit.sdo_rx, b"\x40\x00\x10\x00\0\0\0\0")
    answered = unit.wait(unit.sdo_tx, unit.timing.quiet_ns) is not None
    if not answered:
        unit.pause(unit.timing.quiet_ns)
    return answered


def synchronous_tpdo(unit: Unit) -> int | None:
    """Set a TPDO up for every SYNC and return its identifier, or None."""
    try:
        numbers = candidates(unit)
    except NotApplicable:
        return None
    for k in numbers:
        try:
            return arm(unit, k, 1)
        except Unsupported:
            continue
    return None


def sends_pdo(unit: Unit, can_id: int, *, patient: bool) -> bool:
    """Return whether a SYNC triggers the TPDO."""
    unit.flush()
    sync(unit)
    if not patient:
        return unit.wait(can_id, unit.timing.quiet_ns) is not None
    if unit.wait(can_id, unit.timing.quiet_ns) is not None:
        return True
    sync(unit)  # the device may have missed the first one
    return unit.wait(can_id) is not None


def check_state(unit: Unit, state: NmtState, can_id: int | None = None) -> None:
    """Fail unless the device behaves as in `state`: reported state, SDO, and a TPDO."""
    if not unit.until(lambda: nmt_state(unit) in (None, state)):
        raise CaseFailed(f"the device tells NMT state {nmt_state(unit)}, expected {int(state)} ({state.name})")
    if state == STOPPED:
        if not unit.until(lambda: not serves_sdo(unit)):
            raise CaseFailed("SDO is served in STOPPED")
    else:
        unit.read(0x1000, 0)
    if can_id is None:
        return
    if state == OPERATIONAL:
        if not sends_pdo(unit, can_id, patient=True):
            raise CaseFailed("no PDO in OPERATIONAL", cause=NO_SYNC_TPDO)
    elif not unit.until(lambda: not sends_pdo(unit, can_id, patient=False)):
        raise CaseFailed(f"a PDO in {state.name}")


@case("9.1")
def initialisation(unit: Unit) -> str | None:
    """Change a parameter, reset: boot-up message of one byte 00h, and the parameter as before."""
    boot_up(unit)
    try:
        index, subindex, value = volatile(unit)
    except NotApplicable as reason:
        return str(reason)
    before = unit.read(index, subindex)
    unit.put(index, subindex, encode(unit.variable(index, subindex), value))
    boot_up(unit)
    after = unit.read(index, subindex)
    if after != before:
        raise CaseFailed(f"{where(index, subindex)} is {after.hex()} after a reset, expected {before.hex()}")
    return where(index, subindex)


@case("9.2")
def pre_operational(unit: Unit) -> None:
    """Reset: the boot-up comes before anything else; then SDO works, PDOs do not."""
    boot_up(unit)
    if unit.has(0x1F80) and not unit.number(0x1F80) & 0x4:
        unit.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    can_id = synchronous_tpdo(unit)
    produce_heartbeats(unit)
    check_state(unit, PRE_OPERATIONAL, can_id)


@case("9.3", state=OPERATIONAL)
@case("9.4", state=STOPPED)
def state_after_command(unit: Unit, state: NmtState) -> None:
    """Enter the state by its command, and check the reported state and the services."""
    can_id = synchronous_tpdo(unit)
    produce_heartbeats(unit)
    enter(unit, state)
    check_state(unit, state, can_id)
    enter(unit, PRE_OPERATIONAL)  # NMT works in every state
    check_state(unit, PRE_OPERATIONAL, can_id)


@case("10.1")
def resets(unit: Unit) -> str:
    """Both resets from each state: a boot-up message each time, then PRE-OPERATIONAL."""
    for command in RESETS:
        for state in ALL_STATES:
            enter(unit, state)
            try:
                boot_up(unit, command)
            except NoAnswer as failure:
                raise NoAnswer(f"{failure}, out of {state.name}") from None
            unit.read(0x1000, 0)
    return "2 resets out of 3 states"


@case("10.2", target=PRE_OPERATIONAL)
@case("10.3", target=OPERATIONAL)
@case("10.4", target=STOPPED)
def transition(unit: Unit, target: NmtState) -> str:
    """Send the command in each state: the state follows, even from itself."""
    can_id = synchronous_tpdo(unit)
    produce_heartbeats(unit)
    for state in (*ALL_STATES, target):
        enter(unit, state)
        check_state(unit, state, can_id)
        enter(unit, target)
        check_state(unit, target, can_id)
    return "out of every state"


@case("N.1")
def for_another(unit: Unit) -> str:
    """Start an unused node-id: the device stays in PRE-OPERATIONAL."""
    produce_heartbeats(unit)
    other = next(n for n in range(127, 0, -1) if n != unit.node_id)
    unit.flush()
    unit.send(CobId.HEARTBEAT + other | 0x40000000, length=1)
    if unit.wait(CobId.HEARTBEAT + other, unit.timing.quiet_ns) is not None:
        raise NotApplicable(f"node {other} is on the bus, too")
    unit.dirty = True
    unit.send(CobId.NMT, bytes((NmtCommand.START, other)))
    check_state(unit, PRE_OPERATIONAL)
    return f"node {other}"


@case("N.2")
def short_command(unit: Unit) -> None:
    """Send an NMT frame of one byte: the device stays in PRE-OPERATIONAL."""
    produce_heartbeats(unit)
    unit.dirty = True
    unit.send(CobId.NMT, bytes((NmtCommand.START,)))
    check_state(unit, PRE_OPERATIONAL)


@case("N.3")
def reserved_commands(unit: Unit) -> None:
    """Send undefined NMT commands: the device stays in PRE-OPERATIONAL, and does not boot."""
    produce_heartbeats(unit)
    for command in (0, 3, 5, 127, 131, 255):
        unit.flush()
        unit.nmt(command)
        unit.pause(unit.timing.quiet_ns)
        if any(frame.data == b"\0" for frame in unit.pop_frames(CobId.HEARTBEAT + unit.node_id)):
            raise CaseFailed(f"NMT command {command} resets the device")
        state = nmt_state(unit)
        if state not in (None, NmtState.PRE_OPERATIONAL):
            raise CaseFailed(f"NMT command {command} leads to state {state}")


@case("N.4")
def reset_communication(unit: Unit) -> str:
    """Change a TPDO's parameter and a text of the manufacturer's, and reset the communication: the
    first has its default, the text stays.
    """
    places = [(k, sub, value) for k in candidates(unit) for sub, value in ((2, 7), (5, 700)) if unit.has(TPDO + k, sub)]
    places = [(k, sub, value) for k, sub, value in places if unit.variable(TPDO + k, sub).access not in READ_ONLY]
    if not places:
        raise NotApplicable("no TPDO's parameter can be written")
    k, subindex, value = places[-1]
    index = TPDO + k
    default = unit.read(index, subindex)
    try:
        text: tuple[int, int, bytes, bytes] | None = text_object(unit)
    except NotApplicable:
        text = None
    unit.put(index, subindex, encode(unit.variable(index, subindex), value))
    if text:
        unit.put(text[0], text[1], text[3])
    unit.reset(NmtCommand.RESET_COMMUNICATION)
    if unit.read(index, subindex) != default:
        raise CaseFailed(f"{where(index, subindex)} is {unit.read(index, subindex).hex()} after reset communication")
    if text:
        reads_back(unit, text[0], text[1], text[3], " after reset communication, which is for 1000h to 1FFFh")
    return where(index, subindex)
