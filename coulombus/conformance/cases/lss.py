"""Own cases L.1 to L.9: the LSS slave (CiA 305).

Only services for one slave are used: others on the bus are not affected.
"""

from __future__ import annotations

from collections.abc import Callable

from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import Unit
from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable
from coulombus.eds.cia301 import CobId, NmtCommand
from coulombus.eds.cia305 import FASTSCAN_START, UNCONFIGURED, LssService

__all__: list[str] = []

S = LssService
SELECTIVE = (S.SWITCH_VENDOR, S.SWITCH_PRODUCT, S.SWITCH_REVISION, S.SWITCH_SERIAL)
INQUIRE = (S.INQUIRE_VENDOR, S.INQUIRE_PRODUCT, S.INQUIRE_REVISION, S.INQUIRE_SERIAL)
IDENTIFY = (
    S.IDENTIFY_VENDOR,
    S.IDENTIFY_PRODUCT,
    S.IDENTIFY_REVISION_LOW,
    S.IDENTIFY_REVISION_HIGH,
    S.IDENTIFY_SERIAL_LOW,
    S.IDENTIFY_SERIAL_HIGH,
)
PARTS = ("vendor", "product", "revision", "serial number")
WAITING = 0
REFUSALS = (1, 0xFF)
"""Error codes: out of range or not supported; manufacturer-specific, with the code in the next byte."""


def address(unit: Unit) -> list[int]:
    """Return the LSS address, 1018h:01 to :04, of a device with LSS in its EDS."""
    entry = {key.lower(): value for key, value in unit.description.info.items()}.get("lss_supported", "0").strip()
    try:
        supported = int(entry, 0)
    except ValueError:
        supported = 0
    if not supported:
        raise NotApplicable("LSS_Supported is 0 in the EDS")
    for subindex in range(1, 5):
        unit.need(0x1018, subindex)
    return [unit.number(0x1018, subindex) for subindex in range(1, 5)]


def send(unit: Unit, service: int, data: bytes = b"") -> None:
    """Send a message of the master."""
    unit.dirty = True
    unit.send(CobId.LSS_RX, bytes((service,)) + data.ljust(7, b"\0"))


def words(unit: Unit, services: tuple[int, ...], values: list[int]) -> None:
    """Send a message for each part of an address."""
    for service, value in zip(services, values, strict=True):
        send(unit, service, (value & 0xFFFFFFFF).to_bytes(4, "little"))


def answer(unit: Unit, service: int, what: str) -> bytes:
    """Return the slave's response to this service."""
    frame = unit.expect(CobId.LSS_TX, f"LSS answer to {what}", cause="no LSS slave answers")
    if frame.length != 8 or frame.data[0] != service:
        raise CaseFailed(f"the LSS answer to {what} is {frame.data.hex(' ')}, expected service {service:02X}h")
    return frame.data[1:]


def optional(unit: Unit, service: int, what: str) -> bytes:
    """Return the slave's response to an optional service of CiA 305.

    Raises
    ------
    NotApplicable
        There is no response: the service is not supported.
    """
    try:
        return answer(unit, service, what)
    except NoAnswer:
        raise NotApplicable(f"the slave does not answer {what}, which is optional") from None


def silence(unit: Unit, what: str) -> None:
    """Fail if the slave responds."""
    unit.pause(unit.timing.quiet_ns)
    frames = unit.pop_frames(CobId.LSS_TX)
    if frames:
        raise CaseFailed(f"{what} is answered with {frames[0].data.hex(' ')}")


def _one_of(codes: tuple[int, ...]) -> str:
    return " or ".join(map(str, codes))


def wait_state(unit: Unit) -> None:
    """Switch every slave to LSS waiting, the state of normal use."""
    send(unit, S.SWITCH_STATE_GLOBAL, bytes((WAITING,)))


def configure(unit: Unit) -> list[int]:
    """Switch this slave alone to LSS configuration, and return its address."""
    own_address = address(unit)
    wait_state(unit)
    unit.flush()
    words(unit, SELECTIVE, own_address)
    answer(unit, S.SWITCH_ANSWER, "switch state selective")
    return own_address


def give_back(unit: Unit, own_address: list[int]) -> None:
    """Restore the node-id of the slave with this address, from any state."""
    wait_state(unit)
    words(unit, SELECTIVE, own_address)
    unit.pause(unit.timing.quiet_ns)
    send(unit, S.CONFIGURE_NODE_ID, bytes((unit.node_id,)))
    unit.pause(unit.timing.quiet_ns)
    wait_state(unit)


@case("L.1")
def inquiry(unit: Unit) -> str:
    """Switch the slave selectively by its address, and inquire each part of it and the node-id."""
    own_address = configure(unit)
    try:
        for service, value in zip(INQUIRE, own_address, strict=True):
            send(unit, service)
            number = int.from_bytes(optional(unit, service, f"inquiry {service:02X}h")[:4], "little")
            if number != value:
                raise CaseFailed(f"inquiry {service:02X}h tells {number:08X}h; 1018h has {value:08X}h")
        send(unit, S.INQUIRE_NODE_ID)
        number = optional(unit, S.INQUIRE_NODE_ID, "inquire node-id")[0]
        if number != unit.node_id:
            raise CaseFailed(f"inquire node-id tells {number}, expected {unit.node_id}")
    finally:
        wait_state(unit)
    return " ".join(f"{value:08X}h" for value in own_address)


@case("L.2")
def another_address(unit: Unit) -> None:
    """Switch selectively with another serial number, revision, product and vendor, then inquire:
    silence each time.
    """
    own_address = address(unit)
    for part in reversed(range(4)):
        wait_state(unit)
        unit.flush()
        words(unit, SELECTIVE, [value ^ 0x5A5A5A5A if k == part else value for k, value in enumerate(own_address)])
        silence(unit, f"switch state selective for another {PARTS[part]}")
        send(unit, S.INQUIRE_NODE_ID)
        silence(unit, "inquire node-id in the waiting state")
    wait_state(unit)
    words(unit, SELECTIVE[:3], own_address[:3])
    words(unit, SELECTIVE[:1], [own_address[0] ^ 0x5A5A5A5A])
    words(unit, SELECTIVE[3:], own_address[3:])
    silence(unit, "switch state selective whose last vendor is another")


@case("L.3")
def identify(unit: Unit) -> None:
    """Identify with ranges of revisions and serial numbers that include the device's, and with ranges that do not."""
    vendor, product, revision, serial = address(unit)
    wait_state(unit)
    unit.flush()
    for low, high in ((0, 0xFFFFFFFF), (serial, serial)):
        unit.flush()
        words(unit, IDENTIFY, [vendor, product, revision, revision, low, high])
        ask = optional if low == 0 else answer
        ask(unit, S.IDENTIFY_ANSWER, "identify remote slave")
    for part, value in ((4, serial), (2, revision)):  # next to the device's own, on either side
        for other in {min(value + 1, 0xFFFFFFFF), max(value - 1, 0)} - {value}:
            limits = [vendor, product, revision, revision, serial, serial]
            limits[part : part + 2] = other, other
            unit.flush()
            words(unit, IDENTIFY, limits)
            silence(unit, f"identify remote slave for another {PARTS[3 if part == 4 else 2]}")
    unit.flush()
    words(unit, IDENTIFY, [vendor ^ 1, product, 0, 0xFFFFFFFF, 0, 0xFFFFFFFF])
    silence(unit, "identify remote slave for another vendor")
    configure(unit)
    try:
        unit.flush()
        words(unit, IDENTIFY, [vendor, product, revision, revision, serial, serial])
        answer(unit, S.IDENTIFY_ANSWER, "identify remote slave in the configuration state")
    finally:
        wait_state(unit)


@case("L.4")
def node_id(unit: Unit) -> None:
    """Configure node-id 0 and 128: error 1, or the maker's own.

    The present node-id: no error, and the inquiry returns it.
    """
    configure(unit)
    try:
        for value, codes in ((0, REFUSALS), (128, REFUSALS), (unit.node_id, (0,))):
            send(unit, S.CONFIGURE_NODE_ID, bytes((value,)))
            error = answer(unit, S.CONFIGURE_NODE_ID, f"configure node-id {value}")[0]
            if error not in codes:
                raise CaseFailed(f"configure node-id {value}: error code {error}, expected {_one_of(codes)}")
    finally:
        wait_state(unit)
    unit.read(0x1000, 0)


@case("L.5")
def bit_timing(unit: Unit) -> None:
    """Configure entries of the bit timing table that do not exist, and one of a reserved table:
    error 1, or the maker's own.
    """
    configure(unit)
    try:
        for table, entry in ((0, 200), (0, 5), (1, 0)):
            send(unit, S.CONFIGURE_BIT_TIMING, bytes((table, entry)))
            error = optional(unit, S.CONFIGURE_BIT_TIMING, "configure bit timing")[0]
            if error not in REFUSALS:
                text = f"error code {error}, expected {_one_of(REFUSALS)}"
                raise CaseFailed(f"configure bit timing with entry {entry} of table {table}: {text}")
    finally:
        wait_state(unit)
    unit.read(0x1000, 0)


@case("L.6")
def fastscan(unit: Unit) -> str:
    """Perform a fastscan with the device's own address: a device with a node-id is silent, though others may respond."""
    own_address = address(unit)
    wait_state(unit)
    unit.flush()
    send(unit, S.FASTSCAN, bytes(4) + bytes((FASTSCAN_START, 0, 0)))
    unit.pause(unit.timing.quiet_ns)
    for part, value in enumerate(own_address):
        unit.flush()
        send(unit, S.FASTSCAN, value.to_bytes(4, "little") + bytes((0, part, (part + 1) % 4)))
        unit.pause(unit.timing.quiet_ns)
    send(unit, S.IDENTIFY_NON_CONFIGURED)
    unit.pause(unit.timing.quiet_ns)
    if unit.pop_frames(CobId.LSS_TX):
        raise CaseFailed("the device takes part in a fastscan although it has a node-id")
    return "silent"


@case("L.7")
def waiting(unit: Unit) -> None:
    """Leave LSS configuration, by its service and by a reset: inquiries and configuration get no response."""
    ways: tuple[Callable[[Unit], object], ...] = (wait_state, Unit.reset)
    for leave in ways:
        configure(unit)
        leave(unit)
        unit.flush()
        for service in (S.INQUIRE_VENDOR, S.INQUIRE_NODE_ID, S.CONFIGURE_NODE_ID):
            send(unit, service, b"\x7f")
            silence(unit, f"service {service:02X}h in the waiting state")


@case("L.8")
def pending(unit: Unit) -> str:
    """Configure another node-id: until the next reset communication the device keeps its own.

    It is set back before.
    """
    other = unit.node_id ^ 0x01 or 2
    own_address = configure(unit)
    try:
        send(unit, S.CONFIGURE_NODE_ID, bytes((other,)))
        error = answer(unit, S.CONFIGURE_NODE_ID, f"configure node-id {other}")[0]
        if error:
            raise CaseFailed(f"configure node-id {other}: error code {error}, expected 0")
        wait_state(unit)
        unit.read(0x1000, 0)
    finally:  # also on an interrupt: the next reset would activate it
        give_back(unit, own_address)
    unit.reset(NmtCommand.RESET_COMMUNICATION, must=True)
    unit.read(0x1000, 0)
    return f"node-id {other}"


@case("L.9")
def without_node_id(unit: Unit) -> None:
    """Configure node-id 255 and reset the communication: no boot-up and no SDO.

    The old node-id brings both back.
    """
    own_address = configure(unit)
    try:
        send(unit, S.CONFIGURE_NODE_ID, bytes((UNCONFIGURED,)))
        error = answer(unit, S.CONFIGURE_NODE_ID, "configure node-id 255")[0]
        if error:
            raise CaseFailed(f"configure node-id 255: error code {error}, expected 0")
        wait_state(unit)
        unit.flush()
        unit.nmt(NmtCommand.RESET_COMMUNICATION)
        unit.pause(unit.timing.boot_ns)
        unit.send(unit.sdo_rx, b"\x40\x00\x10" + bytes(5))
        unit.pause(unit.timing.quiet_ns)
        for can_id, what in ((CobId.HEARTBEAT + unit.node_id, "boots up"), (unit.sdo_tx, "answers an SDO request")):
            if unit.pop_frames(can_id):
                raise CaseFailed(f"the device {what} although it has no node-id")
    finally:
        give_back(unit, own_address)
    unit.reset(NmtCommand.RESET_COMMUNICATION, must=True)
    unit.read(0x1000, 0)
