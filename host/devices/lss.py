"""LSS master (CiA 305): find devices without a node id, and assign node ids and bit rates.

Fastscan is a binary search for an identity, bit by bit from the highest. All devices that match the bits
so far answer with the same frame. No answer means that the bit is 1. A found device is in LSS
configuration and takes no part in the next scan, so all devices are found one after the other. A late
answer of a slow device could be taken for an answer to the next step. So each step also waits for
further answers after the first, each number is confirmed at its end, and a scan without confirmation is
repeated with longer waits.

A slow device misses a message that follows the previous one within a few ms. So there is a pause between
messages, and an unanswered message is repeated with longer pauses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

from coulombus.eds.cia301 import CobId
from coulombus.eds.cia305 import BIT_RATES, FASTSCAN_START, UNCONFIGURED, LssService, LssState
from coulombus.host.errors import AnswerUntrusted, HostError, NodeMissing
from coulombus.wire.bus_link import FrameLink

__all__ = ["Identity", "LssMaster", "LssRefused", "rate_index"]

S = LssService
SELECTIVE = (S.SWITCH_VENDOR, S.SWITCH_PRODUCT, S.SWITCH_REVISION, S.SWITCH_SERIAL)
INQUIRE = (S.INQUIRE_VENDOR, S.INQUIRE_PRODUCT, S.INQUIRE_REVISION, S.INQUIRE_SERIAL)
SERIAL = 3
LENGTH = 8
ANSWER_S, STORE_S, START_S, INQUIRE_S = 1.0, 10.0, 0.5, 0.2
"""Time-outs of an answer: in general; to a store, which writes flash; to the fastscan's start; to an
inquiry to several devices.
"""
LATE_S = 2.0
"""Time of listening after a time-out, to distinguish a late answer from none."""
PAUSES_S = (0.005, 0.02, 0.1)
"""Pause between two messages of the master, for each attempt."""


class _Patience(NamedTuple):
    """Time for which a step of a fastscan waits for the first answer, and for further answers [s]."""

    first_s: float
    behind_s: float


PATIENCE = (_Patience(0.02, 0.002), _Patience(0.04, 0.012), _Patience(0.08, 0.06), _Patience(0.16, 0.16))
"""Waits of each attempt."""
MOST_DEVICES = 127
REASONS = {
    (S.CONFIGURE_NODE_ID, 1): "the node id is out of range",
    (S.CONFIGURE_BIT_TIMING, 1): "it does not support this bit rate",
    (S.STORE_CONFIGURATION, 1): "it cannot store",
    (S.STORE_CONFIGURATION, 2): "its storage failed",
}


class LssRefused(HostError):
    """A device refused a setting; the text names the setting and the reason."""

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
        """Return the identity of ``VENDOR:PRODUCT:REVISION:SERIAL``, each in hexadecimal.

        Raises
        ------
        ValueError
            the text is not of this form
        """
        try:
            parts = [int(part, 16) for part in text.split(":")]
        except ValueError:
            parts = []
        if len(parts) != 4 or not all(0 <= part < 1 << 32 for part in parts):
            raise ValueError(f"{text!r}: expected VENDOR:PRODUCT:REVISION:SERIAL in hexadecimal, as 4C0:402:10000:7")
        return cls(*parts)


def rate_index(bit_s: int) -> int:
    """Return the index of a bit rate [bit/s] in CiA 305's table.

    Raises
    ------
    ValueError
        the table does not have this bit rate
    """
    for index, rate in BIT_RATES.items():
        if rate == bit_s:
            return index
    rates = ", ".join(map(str, BIT_RATES.values()))
    raise ValueError(f"{bit_s} bit/s is not in CiA 305's table; expected one of {rates}")


class LssMaster:
    """The LSS master on a link.

    At the end of its context all devices are in LSS waiting, the state of normal use.

    Parameters
    ----------
    timeout_s : time-out of an answer [s]; None: `ANSWER_S`, and `STORE_S` for a store
    """

    def __init__(self, link: FrameLink, timeout_s: float | None = None) -> None:
        self._link = link
        self._answer_s, self._store_s = timeout_s or ANSWER_S, timeout_s or STORE_S
        self._pause_s, self._free_ns = PAUSES_S[0], 0  # pause between messages; earliest time of the next one
        self._odd = b""  # last frame that is no valid answer to the last message

    def __enter__(self) -> LssMaster:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.wait_state()
            return
        with suppress(OSError):  # the bus itself may have failed
            for self._pause_s in PAUSES_S[1:]:
                self.wait_state()

    # messages

    def _send(self, service: int, data: bytes = b"") -> None:
        """Send a message, after the pause since the last one; frames received before are discarded."""
        while self._link.receive(max(self._link.now_ns(), self._free_ns)) is not None:
            pass
        self._odd = b""
        self._link.send(CobId.LSS_RX, bytes((service,)) + data.ljust(7, b"\0"))
        self._free_ns = self._link.now_ns() + round(self._pause_s * 1e9)

    def _answer(self, service: int, timeout_s: float) -> bytes | None:
        """Return the data of the next answer, without its service byte; None at the time-out."""
        until_ns = self._link.now_ns() + round(timeout_s * 1e9)
        while (frame := self._link.receive(until_ns)) is not None:
            if frame.can_id != CobId.LSS_TX:
                continue
            if frame.length == LENGTH and frame.data[0] == service:
                return frame.data[1:]
            self._odd = frame.data
        return None

    def _ask(self, service: LssService, data: bytes, timeout_s: float, attempts: int) -> bytes | None:
        """Send a message up to `attempts` times, and return the answer; None without one."""
        for _ in range(attempts):
            self._send(service, data)
            answer = self._answer(service, timeout_s)
            if answer is not None:
                return answer
            self._pause_s = PAUSES_S[-1]
        return None

    def _no_answer(self, service: LssService, what: str, timeout_s: float) -> HostError:
        """Return the error for a missing answer: late, invalid, or none."""
        odd = self._odd
        if self._answer(service, LATE_S) is not None:
            return NodeMissing(
                f"the device answers LSS ({what}) late, {timeout_s:g} s are allowed: --timeout gives it longer"
            )
        if odd:
            defect = "another service's answer" if len(odd) == LENGTH else f"{len(odd)} bytes, and {LENGTH} are right"
            return AnswerUntrusted(f"the device answers LSS ({what}) with {odd.hex(' ').upper()}: {defect} (CiA 305)")
        return NodeMissing(f"the device does not answer LSS ({what}) within {timeout_s:g} s (--timeout)")

    # finding

    def wait_state(self) -> None:
        """Switch all devices to LSS waiting; a device with its first node id boots then."""
        self._send(S.SWITCH_STATE_GLOBAL, bytes((LssState.WAITING,)))

    def unconfigured(self, progress: Callable[[int], None] = lambda count: None) -> list[Identity]:
        """Return the identities of all devices without a node id, and leave these in LSS configuration.

        Parameters
        ----------
        progress : called with the number of devices so far

        Raises
        ------
        NodeMissing
            a device answers, but its identity is not found: two devices have the same identity, the bus
            loses frames, or the device leaves the scan before its end
        """
        identities: list[Identity] = []
        while len(identities) < MOST_DEVICES:
            identity = None
            for patience in PATIENCE:
                if not self._step(0, FASTSCAN_START, 0, 0, patience._replace(first_s=START_S)):
                    if patience is PATIENCE[0]:
                        return identities
                    raise NodeMissing(
                        "a device without a node id answers fastscan, and leaves it before the end; "
                        "name it by --device, with its 1018h:01 to :04"
                    )
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

    def _scan(self, patience: _Patience, identities: Sequence[Identity]) -> Identity | None:
        """Scan one device's identity; return None if a number is not confirmed.

        Devices often have the same vendor, so the numbers of the `identities` are tried first.
        """
        numbers: list[int] = []
        for part in range(4):
            number = 0
            likely = (
                {identity[part] for identity in identities if list(identity[:part]) == numbers}
                if part < SERIAL
                else set()
            )
            guess = next((n for n in likely if self._step(n, 0, part, part + 1, patience)), None)
            if guess is not None:
                numbers.append(guess)
                continue
            for bit in reversed(range(32)):
                if not self._step(number, bit, part, part, patience):
                    number |= 1 << bit
            if not self._step(number, 0, part, (part + 1) % 4, patience):
                return self._early(Identity(*(*numbers, number))) if part == SERIAL else None
            numbers.append(number)
        return Identity(*numbers)

    def _early(self, identity: Identity) -> Identity | None:
        """Return the identity if a device in LSS configuration has it, else None.

        A device may enter this state at the last bit, and then no longer answers the scan.
        """
        for service, number in zip(INQUIRE, identity, strict=True):
            self._send(service)
            answers, wait_s = set(), INQUIRE_S
            while (answer := self._answer(service, wait_s)) is not None:
                answers.add(int.from_bytes(answer[:4], "little"))
                wait_s = PATIENCE[-1].behind_s
            if number not in answers:
                return None
        return identity

    def select(self, identity: Identity) -> None:
        """Switch one device to LSS configuration, and all others to LSS waiting.

        Raises
        ------
        NodeMissing
            no device has this identity
        AnswerUntrusted
            the device's answer is not valid
        """
        for self._pause_s in PAUSES_S:  # the pause that the device needs is kept for its settings
            self.wait_state()
            for service, part in zip(SELECTIVE, identity, strict=True):
                self._send(service, part.to_bytes(4, "little"))
            if self._answer(S.SWITCH_ANSWER, self._answer_s) is not None:
                return
        if self._odd:
            raise self._no_answer(S.SWITCH_ANSWER, "its selection", self._answer_s)
        raise NodeMissing(
            f"no device with LSS has the identity {identity}: none answered {len(PAUSES_S)} times within "
            f"{self._answer_s:g} s (--timeout)"
        )

    # settings of the selected device

    def node_id(self) -> int | None:
        """Return the node id of the selected device; None without a node id, or without this service."""
        answer = self._ask(S.INQUIRE_NODE_ID, b"", self._answer_s, 2)
        return None if answer is None or answer[0] == UNCONFIGURED else answer[0]

    def set_node_id(self, node_id: int) -> None:
        """Set the node id of the selected device. Raises `LssRefused`.

        It takes effect at the next reset of communication; for a device without a node id, in `wait_state`.
        """
        self._configure(S.CONFIGURE_NODE_ID, bytes((node_id,)), f"the node id {node_id}")

    def set_bit_rate(self, bit_s: int) -> None:
        """Set the bit rate [bit/s] of the selected device. Raises `LssRefused`.

        It takes effect at the next power-on after `store`.
        """
        self._configure(S.CONFIGURE_BIT_TIMING, bytes((0, rate_index(bit_s))), f"{bit_s} bit/s")

    def store(self) -> None:
        """Store node id and bit rate in the selected device. Raises `LssRefused`."""
        self._configure(S.STORE_CONFIGURATION, b"", "store", self._store_s, 1)  # one attempt: flash wears out

    def _configure(
        self, service: LssService, data: bytes, what: str, timeout_s: float | None = None, attempts: int = 2
    ) -> None:
        timeout_s = timeout_s or self._answer_s
        answer = self._ask(service, data, timeout_s, attempts)
        if answer is None:
            raise self._no_answer(service, what, timeout_s)
        if answer[0]:
            reason = f"error {answer[0]}" + (f", its own {answer[1]}" if answer[0] == 0xFF else "")
            raise LssRefused(f"the device refused {what}: {REASONS.get((service, answer[0]), reason)}")
