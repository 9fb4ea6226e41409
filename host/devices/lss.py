"""The master of the layer setting services (CiA 305): find devices without a node id, and give them
one.

A fastscan halves what an identity may be, bit by bit from the highest: all devices that the bits so
far fit answer, with the same frame. What has been found is in LSS configuration then, and takes no
part in the next scan; so all devices are found one after the other. Silence means "1", and an
answer that is late (of the slowest of them) would be taken for one to the next step. So each step
waits for those behind the first, each number is confirmed at its end, and all is scanned again with
more patience where it is not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from coulombus.eds.cia301 import CobId
from coulombus.eds.cia305 import BIT_RATES, FASTSCAN_START, UNCONFIGURED, LssService, LssState
from coulombus.host.errors import HostError, NodeMissing
from coulombus.wire.bus_link import BusFrame, FrameLink

__all__ = ["Identity", "LssMaster", "LssRefused", "rate_index"]

S = LssService
SELECTIVE = (S.SWITCH_VENDOR, S.SWITCH_PRODUCT, S.SWITCH_REVISION, S.SWITCH_SERIAL)
SERIAL = 3
ANSWER_S, START_S = 0.5, 0.1
"""How long an answer may take; to the fastscan's start."""


class _Patience(NamedTuple):
    """How long a step of a fastscan waits for an answer, and for those behind the first [s]."""

    first_s: float
    behind_s: float


PATIENCE = (_Patience(0.02, 0.002), _Patience(0.04, 0.012), _Patience(0.08, 0.06), _Patience(0.16, 0.16))
"""Of each attempt."""
MOST_DEVICES = 127
REASONS = {
    (S.CONFIGURE_NODE_ID, 1): "the node id is out of range",
    (S.CONFIGURE_BIT_TIMING, 1): "it does not support this bit rate",
    (S.STORE_CONFIGURATION, 1): "it cannot store",
    (S.STORE_CONFIGURATION, 2): "its storage failed",
}


class LssRefused(HostError):
    """A device refused a setting; the text says which and why."""

    exit_status = 6


class Identity(NamedTuple):
    """The LSS address of a device: 1018h:01 to :04."""

    vendor_id: int
    product_code: int
    revision: int
    serial: int

    def __str__(self) -> str:
        return ":".join(f"{part:08X}" for part in self)

    @classmethod
    def parse(cls, text: str) -> Identity:
        """Return the identity that ``VENDOR:PRODUCT:REVISION:SERIAL`` spells, each in hexadecimal.

        Raises
        ------
        ValueError
            it spells none
        """
        try:
            parts = [int(part, 16) for part in text.split(":")]
        except ValueError:
            parts = []
        if len(parts) != 4 or not all(0 <= part < 1 << 32 for part in parts):
            raise ValueError(f"{text!r}: expected VENDOR:PRODUCT:REVISION:SERIAL in hexadecimal, as 4C0:402:10000:7")
        return cls(*parts)


def rate_index(bit_s: int) -> int:
    """Return the entry of CiA 305's table of a bit rate [bit/s].

    Raises
    ------
    ValueError
        it has none
    """
    for index, rate in BIT_RATES.items():
        if rate == bit_s:
            return index
    known = ", ".join(map(str, BIT_RATES.values()))
    raise ValueError(f"{bit_s} bit/s is not in CiA 305's table; expected one of {known}")


class LssMaster:
    """The master, on a link.

    As a context it leaves all devices in LSS waiting, where they are in normal use.

    Parameters
    ----------
    hear : takes the frames that are no LSS answer
    """

    def __init__(self, link: FrameLink, hear: Callable[[BusFrame], None] = lambda frame: None) -> None:
        self._link, self._hear = link, hear

    def __enter__(self) -> LssMaster:
        return self

    def __exit__(self, *_: object) -> None:
        self.wait_state()

    # messages

    def _send(self, service: int, data: bytes = b"") -> None:
        while (stale := self._link.receive(self._link.now_ns())) is not None:
            if stale.can_id != CobId.LSS_TX:
                self._hear(stale)
        self._link.send(CobId.LSS_RX, bytes((service,)) + data.ljust(7, b"\0"))

    def _answer(self, service: int, timeout_s: float) -> bytes | None:
        """Return the bytes behind the service of the next answer, None without one in time."""
        until_ns = self._link.now_ns() + round(timeout_s * 1e9)
        while (frame := self._link.receive(until_ns)) is not None:
            if frame.can_id == CobId.LSS_TX and frame.length == 8 and frame.data[0] == service:
                return frame.data[1:]
            if frame.can_id != CobId.LSS_TX:
                self._hear(frame)
        return None

    # finding

    def wait_state(self) -> None:
        """Send all devices to LSS waiting; one that has been given its first node id boots."""
        self._send(S.SWITCH_STATE_GLOBAL, bytes((LssState.WAITING,)))

    def unconfigured(self, progress: Callable[[int], None] = lambda count: None) -> list[Identity]:
        """Return the identities of all devices without a node id; they are in LSS configuration
        then.

        Parameters
        ----------
        progress : called with the number of devices so far

        Raises
        ------
        NodeMissing
            one answers, and its identity cannot be found: two devices have the same, or the bus
            loses frames
        """
        identities: list[Identity] = []
        while len(identities) < MOST_DEVICES:
            identity = None
            for patience in PATIENCE:
                if not self._step(0, FASTSCAN_START, 0, 0, patience._replace(first_s=max(START_S, patience.first_s))):
                    return identities
                identity = self._scan(patience, identities)
                if identity is not None:
                    break
            if identity is None or identity in identities:
                what = "the same identity twice" if identity else "an answer, and no identity that fits it"
                raise NodeMissing(
                    f"fastscan found {what}: two devices of one serial number (1018h:04), or frames are lost; "
                    "connect them one at a time"
                )
            identities.append(identity)
            progress(len(identities))
        return identities

    def _step(self, number: int, bit: int, part: int, following: int, patience: _Patience) -> bool:
        self._send(S.FASTSCAN, number.to_bytes(4, "little") + bytes((bit, part, following)))
        if self._answer(S.IDENTIFY_ANSWER, patience.first_s) is None:
            return False
        while self._answer(S.IDENTIFY_ANSWER, patience.behind_s) is not None:
            pass
        return True

    def _scan(self, patience: _Patience, known: Sequence[Identity]) -> Identity | None:
        """Scan one device's identity, None where a number is not confirmed.

        Devices are often of one maker: what is `known` of others is tried first.
        """
        numbers: list[int] = []
        for part in range(4):
            number = 0
            likely = (
                {identity[part] for identity in known if list(identity[:part]) == numbers} if part < SERIAL else set()
            )
            guess = next((n for n in likely if self._step(n, 0, part, part + 1, patience)), None)
            if guess is not None:
                numbers.append(guess)
                continue
            for bit in reversed(range(32)):
                if not self._step(number, bit, part, part, patience):
                    number |= 1 << bit
            if not self._step(number, 0, part, (part + 1) % 4, patience):
                return None
            numbers.append(number)
        return Identity(*numbers)

    def select(self, identity: Identity) -> None:
        """Switch one device to LSS configuration, and all others to LSS waiting.

        Raises
        ------
        NodeMissing
            no device has this identity
        """
        self.wait_state()
        for service, part in zip(SELECTIVE, identity, strict=True):
            self._send(service, part.to_bytes(4, "little"))
        if self._answer(S.SWITCH_ANSWER, ANSWER_S) is None:
            raise NodeMissing(f"no device with LSS has the identity {identity}")

    # settings of the device that is selected

    def node_id(self) -> int | None:
        """Return the node id of the device that is selected, None without one (or without this
        service).
        """
        self._send(S.INQUIRE_NODE_ID)
        answer = self._answer(S.INQUIRE_NODE_ID, ANSWER_S)
        return None if answer is None or answer[0] == UNCONFIGURED else answer[0]

    def set_node_id(self, node_id: int) -> None:
        """Give the device that is selected a node id; it takes effect with its next reset of the
        communication, without an old one in `wait_state`. Raises `LssRefused`.
        """
        self._configure(S.CONFIGURE_NODE_ID, bytes((node_id,)), f"the node id {node_id}")

    def set_bit_rate(self, bit_s: int) -> None:
        """Give the device that is selected a bit rate [bit/s]; it takes effect when it has been
        stored and the device is switched on again. Raises `LssRefused`.
        """
        self._configure(S.CONFIGURE_BIT_TIMING, bytes((0, rate_index(bit_s))), f"{bit_s} bit/s")

    def store(self) -> None:
        """Let the device that is selected keep its node id and bit rate. Raises `LssRefused`."""
        self._configure(S.STORE_CONFIGURATION, b"", "store")

    def _configure(self, service: LssService, data: bytes, what: str) -> None:
        self._send(service, data)
        answer = self._answer(service, ANSWER_S)
        if answer is None:
            raise NodeMissing(f"the device does not answer LSS ({what})")
        if answer[0]:
            own = f"error {answer[0]}" + (f", its own {answer[1]}" if answer[0] == 0xFF else "")
            raise LssRefused(f"the device refused {what}: {REASONS.get((service, answer[0]), own)}")
