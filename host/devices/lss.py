"""The master of the layer setting services (CiA 305): find devices without a node id, and give them
one.

A fastscan halves what an identity may be, bit by bit from the highest: all devices that the bits so
far fit answer, with the same frame. What has been found is in LSS configuration then, and takes no
part in the next scan; so all devices are found one after the other. Silence means "1", and an
answer that is late (of the slowest of them) would be taken for one to the next step. So each step
waits for those behind the first, each number is confirmed at its end, and all is scanned again with
more patience where it is not.

A slow device misses a message that comes some ms behind the one before: messages have a pause
between them, and what is not answered is sent again with longer ones.
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
"""How long an answer may take; to a store, which writes flash; to the fastscan's start; to an inquiry
to several devices.
"""
LATE_S = 2.0
"""For so long afterwards an answer is listened for, to tell that it is late."""
PAUSES_S = (0.005, 0.02, 0.1)
"""Between two messages of the master, of each attempt."""


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
    timeout_s : how long an answer may take [s]; None: `ANSWER_S`, of a store `STORE_S`
    """

    def __init__(self, link: FrameLink, timeout_s: float | None = None) -> None:
        self._link = link
        self._answer_s, self._store_s = timeout_s or ANSWER_S, timeout_s or STORE_S
        self._pause_s, self._free_ns = PAUSES_S[0], 0  # between two messages; the next one may go
        self._odd = b""  # the last answer that is none to the last message

    def __enter__(self) -> LssMaster:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.wait_state()
            return
        with suppress(OSError):  # the bus may be what has failed
            for self._pause_s in PAUSES_S[1:]:
                self.wait_state()

    # messages

    def _send(self, service: int, data: bytes = b"") -> None:
        """Send a message; before the next one there is a pause. What has come until then is no answer
        to it.
        """
        while self._link.receive(max(self._link.now_ns(), self._free_ns)) is not None:
            pass
        self._odd = b""
        self._link.send(CobId.LSS_RX, bytes((service,)) + data.ljust(7, b"\0"))
        self._free_ns = self._link.now_ns() + round(self._pause_s * 1e9)

    def _answer(self, service: int, timeout_s: float) -> bytes | None:
        """Return the bytes behind the service of the next answer, None without one in time."""
        until_ns = self._link.now_ns() + round(timeout_s * 1e9)
        while (frame := self._link.receive(until_ns)) is not None:
            if frame.can_id != CobId.LSS_TX:
                continue
            if frame.length == LENGTH and frame.data[0] == service:
                return frame.data[1:]
            self._odd = frame.data
        return None

    def _ask(self, service: LssService, data: bytes, timeout_s: float, attempts: int) -> bytes | None:
        """Return the answer to a message of `attempts`, None without one."""
        for _ in range(attempts):
            self._send(service, data)
            answer = self._answer(service, timeout_s)
            if answer is not None:
                return answer
            self._pause_s = PAUSES_S[-1]
        return None

    def _no_answer(self, service: LssService, what: str, timeout_s: float) -> HostError:
        """Return what it is that no answer to a message came in time."""
        odd = self._odd
        if self._answer(service, LATE_S) is not None:
            return NodeMissing(
                f"the device answers LSS ({what}) late, {timeout_s:g} s are allowed: --timeout gives it longer"
            )
        if odd:
            wrong = "another service's answer" if len(odd) == LENGTH else f"{len(odd)} bytes, and {LENGTH} are right"
            return AnswerUntrusted(f"the device answers LSS ({what}) with {odd.hex(' ').upper()}: {wrong} (CiA 305)")
        return NodeMissing(f"the device does not answer LSS ({what}) within {timeout_s:g} s (--timeout)")

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
            one answers, and its identity cannot be found: two devices have the same, the bus loses
            frames, or the device leaves the scan before its end
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
                return self._early(Identity(*(*numbers, number))) if part == SERIAL else None
            numbers.append(number)
        return Identity(*numbers)

    def _early(self, identity: Identity) -> Identity | None:
        """Return the identity, if a device in LSS configuration has it: one may go there at the last
        bit, and answers the scan no more. None else.
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
            the device's answer is none
        """
        for self._pause_s in PAUSES_S:  # what the device needs, it needs for its settings, too
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

    # settings of the device that is selected

    def node_id(self) -> int | None:
        """Return the node id of the device that is selected, None without one (or without this
        service).
        """
        answer = self._ask(S.INQUIRE_NODE_ID, b"", self._answer_s, 2)
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
        self._configure(S.STORE_CONFIGURATION, b"", "store", self._store_s, 1)  # once: its memory wears out

    def _configure(
        self, service: LssService, data: bytes, what: str, timeout_s: float | None = None, attempts: int = 2
    ) -> None:
        timeout_s = timeout_s or self._answer_s
        answer = self._ask(service, data, timeout_s, attempts)
        if answer is None:
            raise self._no_answer(service, what, timeout_s)
        if answer[0]:
            own = f"error {answer[0]}" + (f", its own {answer[1]}" if answer[0] == 0xFF else "")
            raise LssRefused(f"the device refused {what}: {REASONS.get((service, answer[0]), own)}")
