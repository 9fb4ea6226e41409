"""The device under test for the cases: its services, and the restoration of its state."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from coulombus.conformance.tester.described_device import DescribedDevice, is_signed
from coulombus.conformance.tester.sdo_client import SdoClient
from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable, TransferAborted, where
from coulombus.eds.cia301 import Abort, CobId, NmtCommand, NmtState, abort_text
from coulombus.eds.data import encode
from coulombus.eds.reader import Description, Value
from coulombus.wire.bus_link import RTR, BusFrame, FrameLink

__all__ = ["MS", "STORE_IS_LOST", "Timing", "Unit", "encode"]

MS = 1_000_000
_INBOX = 20_000
_TRACE = 400
STORE_IS_LOST = "what was stored is not there after a reset"
ON_COMMAND = 0x1
"""Bit 0 of 1010h and 1011h: works on command."""


@dataclass(frozen=True)
class Timing:
    """Time limits of the tester: for a response, for the absence of a frame, for a boot-up, for a whole case."""

    answer_ns: int = 1000 * MS
    quiet_ns: int = 60 * MS
    settle_ns: int = 20 * MS
    """Pause after an NMT command: a device may process it in its main loop, and lose earlier frames."""
    boot_ns: int = 5000 * MS
    case_ns: int = 60_000 * MS

    @classmethod
    def from_timeout(cls, timeout_s: float) -> Timing:
        """Return the time limits derived from the response time-out."""
        answer_ns = int(timeout_s * 1e9)
        quiet_ns, settle_ns = min(60 * MS, answer_ns), min(20 * MS, answer_ns)
        return cls(answer_ns, quiet_ns, settle_ns, 5 * answer_ns, 60 * answer_ns)


class Unit(DescribedDevice):
    """One device on a link.

    All sent and received frames go into the trace of the running case.
    """

    def __init__(self, link: FrameLink, description: Description, node_id: int, timing: Timing, seed: int = 0) -> None:
        super().__init__(description, node_id)
        self.link, self.timing = link, timing
        self.random = random.Random(seed)
        self.codes: tuple[int, ...] = ()
        self.trace: deque[BusFrame] = deque(maxlen=_TRACE)
        self.boots = True
        self.sync_id = self.default_sync_id()
        self._inbox: list[BusFrame] = []
        self._undo: list[tuple[int, int, bytes]] = []
        self._deadline_ns = link.now_ns() + timing.case_ns
        self.dirty = True
        self.stored = self._late = self._changed_state = self._patient = False
        self._again: bytes | None = None
        self.rooms: dict[tuple[int, int], int] = {}
        """Measured capacity [bytes] of writable texts."""
        self.abilities: dict[tuple[int, int], int] = {}
        self.running: set[tuple[int, int]] = set()
        """Objects observed to change by themselves."""
        self.from_defaults = self.ever_stored = False
        self.stays_stored = ""
        """Reason why the device keeps the stored parameters."""
        self.channel(self.default_sdo_id(1, CobId.SDO_RX), self.default_sdo_id(2, CobId.SDO_TX))

    def channel(self, request_id: int, response_id: int) -> None:
        """Use these identifiers for SDO."""
        self.sdo_rx, self.sdo_tx = request_id, response_id
        self.sdo = SdoClient(self._send_sdo, self._wait_sdo, self._stream_sdo, self.width)

    # frames

    def send(self, can_id: int, data: bytes = b"", length: int | None = None) -> None:
        """Send a frame, after adding all received frames to the trace, which is in time order."""
        while self._next(self.link.now_ns()) is not None:
            pass
        size = len(data) if length is None else length
        self.trace.append(BusFrame(self.link.now_ns(), can_id, data, size, sent=True))
        self.link.send(can_id, data, length)

    def _next(self, until_ns: int) -> BusFrame | None:
        if self.link.now_ns() > self._deadline_ns:
            raise CaseFailed(f"the case lasts longer than {self.timing.case_ns // 1_000_000_000} s")
        frame = self.link.receive(min(until_ns, self._deadline_ns + MS))
        if frame is not None:
            self.trace.append(frame)
            self._inbox.append(frame)
            del self._inbox[:-_INBOX]
        return frame

    def pause(self, duration_ns: int) -> None:
        """Let time pass; received frames are kept for `take` and `wait`."""
        until_ns = self.link.now_ns() + duration_ns
        while self._next(until_ns) is not None or self.link.now_ns() < until_ns:
            pass

    def pop_frames(self, can_id: int) -> list[BusFrame]:
        """Take the received frames with this identifier."""
        frames = [frame for frame in self._inbox if frame.can_id == can_id]
        self._inbox = [frame for frame in self._inbox if frame.can_id != can_id]
        return frames

    def flush(self) -> None:
        """Discard all received frames."""
        while self._next(self.link.now_ns()) is not None:
            pass
        self._inbox.clear()

    def collect(self, can_id: int, duration_ns: int) -> list[BusFrame]:
        """Return the frames with this identifier received within `duration_ns` from now."""
        self.flush()
        self.pause(duration_ns)
        return self.pop_frames(can_id)

    def until(self, done: Callable[[], bool]) -> bool:
        """Call `done` repeatedly until it is true, at most for the response time-out; return its last result."""
        until_ns = self.link.now_ns() + self.timing.answer_ns
        while not (result := done()) and self.link.now_ns() < until_ns:
            self.pause(2 * MS)
        return result

    def gather(self, can_id: int, count: int) -> list[BusFrame]:
        """Return the frames with this identifier: `count` frames within the time limit, and those
        in the quiet time after them.
        """
        until_ns = self.link.now_ns() + self.timing.answer_ns
        while sum(frame.can_id == can_id for frame in self._inbox) < count and self.link.now_ns() < until_ns:
            self._next(until_ns)
        self.pause(self.timing.quiet_ns)
        return self.pop_frames(can_id)

    def wait(self, can_id: int, timeout_ns: int | None = None) -> BusFrame | None:
        """Return the first frame with this identifier, already received or within the time limit."""
        until_ns = self.link.now_ns() + (self.timing.answer_ns if timeout_ns is None else timeout_ns)
        while True:
            for k, frame in enumerate(self._inbox):
                if frame.can_id == can_id:
                    return self._inbox.pop(k)
            if self._next(until_ns) is None and self.link.now_ns() >= until_ns:
                return None

    def expect(self, can_id: int, what: str, timeout_ns: int | None = None, *, cause: str = "") -> BusFrame:
        """Return the expected frame; `cause` names the fault if there is none."""
        frame = self.wait(can_id, timeout_ns)
        if frame is None:
            limit_ns = self.timing.answer_ns if timeout_ns is None else timeout_ns
            text = f"no {what} ({can_id & 0x7FF:03X}h) within {limit_ns / 1e6:.0f} ms"
            raise NoAnswer(text, cause=cause or f"no {what}")
        return frame

    # SDO

    def _send_sdo(self, data: bytes) -> None:
        if self._late:  # a late response does not belong to the next request
            self._late = False
            self.pause(self.timing.quiet_ns)
        while self._next(self.link.now_ns()) is not None:
            pass
        self.pop_frames(self.sdo_tx)
        self._again, self._changed_state = data if self._changed_state else None, False
        self.send(self.sdo_rx, data)

    def _stream_sdo(self, data: bytes) -> None:
        """Send a segment of a block.

        Messages of the server meanwhile are kept.
        """
        self.send(self.sdo_rx, data)
        self._late = True

    def _wait_sdo(self) -> bytes | None:
        frame = self.wait(self.sdo_tx, self.timing.boot_ns if self._patient else None)
        if frame is None and self._again is not None:  # the first request after a change of the NMT state
            again, self._again, self._late = self._again, None, True
            self._send_sdo(again)
            frame = self.wait(self.sdo_tx)
        self._late |= frame is None
        return None if frame is None else frame.data

    def read(self, index: int, subindex: int = 0) -> bytes:
        """Read an object."""
        return self.sdo.upload(index, subindex)

    def number(self, index: int, subindex: int = 0) -> int:
        """Read an integer object, signed according to the EDS."""
        signed = self.has(index, subindex) and is_signed(self.variable(index, subindex))
        return int.from_bytes(self.read(index, subindex), "little", signed=signed)

    def write(self, index: int, subindex: int, value: Value) -> None:
        """Write an object, and keep its old value for `restore`."""
        variable = self.variable(index, subindex)
        if variable.access != "wo":
            self._undo.append((index, subindex, self.read(index, subindex)))
        self.dirty = True
        self.sdo.download(index, subindex, encode(variable, value))

    def put(self, index: int, subindex: int, data: bytes) -> None:
        """Write raw bytes to an object; nothing is kept for `restore`."""
        self.dirty = True
        self.sdo.download(index, subindex, data)

    def undo_later(self, index: int, subindex: int, data: bytes) -> None:
        """Make `restore` write `data` before all values registered so far."""
        self._undo.append((index, subindex, data))

    def refused(self, index: int, subindex: int, value: Value | bytes, codes: Sequence[int] | None = None) -> int:
        """Write a value that the device must refuse.

        Return its abort code, which must be one of `codes` (empty: any), or report an exceeded limit of the EDS.
        """
        data = value if isinstance(value, bytes) else encode(self.variable(index, subindex), value)
        try:
            self.write_raw(index, subindex, data)
        except TransferAborted as abort:
            accepted = self.codes if codes is None else tuple(codes)
            return self.judge(abort, accepted and (*accepted, *self.range_codes(index, subindex, data)))
        cause = "a value outside of the EDS's limits is taken" if self.range_codes(index, subindex, data) else ""
        text = f"{where(index, subindex)} took {data.hex(' ').upper()}, which it has to refuse"
        raise CaseFailed(text, cause=cause)

    def range_codes(self, index: int, subindex: int, data: bytes) -> tuple[int, ...]:
        """Return the abort codes for bytes that exceed a limit of the EDS; empty if they do not."""
        if not self.has(index, subindex):
            return ()
        variable = self.variable(index, subindex)
        number = int.from_bytes(data, "little", signed=is_signed(variable))
        if isinstance(variable.high, int) and number > variable.high:
            return Abort.VALUE, Abort.VALUE_HIGH
        if isinstance(variable.low, int) and number < variable.low:
            return Abort.VALUE, Abort.VALUE_LOW
        return ()

    def write_raw(self, index: int, subindex: int, data: bytes) -> None:
        """Write bytes; if accepted, the old value is kept for `restore`."""
        before = None
        if self.has(index, subindex) and self.variable(index, subindex).access != "wo":
            try:
                before = self.sdo.upload_up_to(index, subindex, 2000)
            except TransferAborted:
                before = None
        self.sdo.download(index, subindex, data)
        self.dirty = True
        if before is not None:
            self._undo.append((index, subindex, before))

    def judge(self, abort: TransferAborted, codes: Sequence[int] | None = None) -> int:
        """Return an expected abort's code, or fail if it is not accepted."""
        accepted = self.codes if codes is None else tuple(codes)
        if accepted and abort.code not in accepted:
            expected = ", ".join(f"{code:08X}h" for code in accepted)
            text = f"{where(abort.index, abort.subindex)}: {abort_text(abort.code)}; expected {expected}"
            raise CaseFailed(text, clause="CiA 301, table 22")
        return abort.code

    # NMT

    def nmt(self, command: int) -> None:
        """Send an NMT command to the device alone, and wait until it can follow.

        The first SDO request afterwards may be sent twice.
        """
        self.dirty = True
        self.send(CobId.NMT, bytes((command, self.node_id)))
        self._changed_state = command != NmtCommand.STOP
        self.pause(self.timing.settle_ns)

    def start(self) -> None:
        """Make it OPERATIONAL, and wait until it handles PDOs and SYNC."""
        self.nmt(NmtCommand.START)
        self.pause(self.timing.quiet_ns)

    def reset(self, command: int = NmtCommand.RESET_NODE, *, must: bool = False) -> BusFrame | None:
        """Reset the device and return its boot-up message; PRE-OPERATIONAL follows.

        For a device that never sent a boot-up message, only `must` waits for it and fails;
        otherwise its SDO server is polled.
        """
        self.flush()
        self.nmt(command)
        wait_ns = self.timing.boot_ns if self.boots or must else 3 * self.timing.quiet_ns
        boot = self._boot_up(wait_ns)
        self.boots = boot is not None
        if boot is None and must:
            text = f"no boot-up message ({CobId.HEARTBEAT + self.node_id:03X}h) after NMT command {command}"
            raise NoAnswer(text, cause="no boot-up message", clause="CiA 301, 7.2.8.3.3")
        self.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)  # 1F80h may have started it
        self.dirty = False
        return boot

    def _boot_up(self, wait_ns: int) -> BusFrame | None:
        """Return the boot-up message, past a last heartbeat.

        Without one, return another frame on its identifier.
        """
        until_ns, other = self.link.now_ns() + wait_ns, None
        while (frame := self.wait(CobId.HEARTBEAT + self.node_id, until_ns - self.link.now_ns())) is not None:
            if frame.data == b"\0":
                return frame
            other = other or frame
            if self.link.now_ns() >= until_ns:
                break
        return other

    def state(self) -> int | None:
        """Return the NMT state by heartbeat or guarding; None if the device has neither."""
        identifier = CobId.HEARTBEAT + self.node_id
        if self.has(0x1017):
            try:
                period_ms = self.number(0x1017)
                if period_ms:
                    self.flush()
                    wait_ns = self.timing.answer_ns + 2 * period_ms * MS
                    self._deadline_ns = max(self._deadline_ns, self.link.now_ns() + wait_ns)
                    frame = self.wait(identifier, wait_ns)
                    return frame.data[0] & 0x7F if frame and frame.data else None
            except (CaseFailed, TransferAborted):
                pass  # STOPPED: no SDO
        if self.has(0x100C):
            self.flush()
            self.send(identifier | RTR, length=1)
            frame = self.wait(identifier)
            return frame.data[0] & 0x7F if frame and frame.data else None
        return None

    # storing

    def learn_abilities(self) -> None:
        """Read the capabilities in 1010h and 1011h before a signature is written: a simple device
        keeps the signature as the value.
        """
        for index in (0x1010, 0x1011):
            for subindex in self.description.objects[index].variables if index in self.description.objects else ():
                if 0 < subindex < 0xFF:
                    try:
                        self.abilities[index, subindex] = self.number(index, subindex)
                    except NoAnswer:
                        return
                    except CaseFailed:
                        continue

    def able(self, index: int, subindex: int = 1) -> bool:
        """Return whether 1010h or 1011h works on command (bit 0 of its capabilities)."""
        return bool(self.abilities.get((index, subindex), 0) & ON_COMMAND)

    def need_ability(self, index: int, subindex: int = 1) -> None:
        """Require that 1010h or 1011h works on command, and that storing can be undone.

        Raises
        ------
        NotApplicable
            It does not, or is not in the EDS; or 1011h:01 does not: stored values would stay.
        """
        self.need(index, subindex)
        if (index, subindex) not in self.abilities:
            raise CaseFailed(f"{where(index, subindex)} cannot be read")
        if not self.able(index, subindex):
            raise NotApplicable(f"{where(index, subindex)} is {self.abilities[index, subindex]:08X}h: not on command")
        if not self.able(0x1011):
            raise NotApplicable("without 1011h:01 on command what is stored would stay: nothing is stored")

    def save(self, subindex: int = 1) -> None:
        """Store parameters (1010h); `restore` loads the defaults again.

        Raises
        ------
        NotApplicable
            The device does not store on command, or cannot undo it.
        """
        self.need_ability(0x1010, subindex)
        self.sign(0x1010, subindex, b"save")

    def sign(self, index: int, subindex: int, signature: bytes) -> None:
        """Write a signature to 1010h or 1011h; a flash memory may take as long as a boot-up."""
        self.stored = self.dirty = self._patient = True
        try:
            self.sdo.download(index, subindex, signature)
        finally:
            self._patient = False

    def forget_stored(self) -> None:
        """Load the device's defaults (1011h) and reset it."""
        self.ever_stored, self.stays_stored = True, ""
        try:
            self.sign(0x1011, 1, b"load")
        except CaseFailed as why:
            self.stays_stored = str(why)
        self.stored = False

    # life of a case

    def begin(self, codes: tuple[int, ...]) -> None:
        """Bring the device to a known state: reset and PRE-OPERATIONAL, if it was changed."""
        self.codes = codes
        self.trace.clear()
        self._undo.clear()
        self._deadline_ns = self.link.now_ns() + self.timing.case_ns
        if self.dirty:
            self.reset()
        self.flush()

    def restore(self) -> None:
        """Undo the changes of the case, the last first.

        Stored parameters get their defaults again.
        """
        self._deadline_ns = self.link.now_ns() + self.timing.case_ns
        try:
            if self._undo or self.stored:
                self.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
            while self._undo:
                index, subindex, data = self._undo.pop()
                try:
                    self.sdo.download(index, subindex, data)
                except NoAnswer:
                    return
                except CaseFailed:
                    continue
        finally:
            self._undo.clear()
            if self.stored:
                self.forget_stored()


PRE_OPERATIONAL, OPERATIONAL, STOPPED = NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL, NmtState.STOPPED
