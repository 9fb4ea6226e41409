"""Compiled clients of a bus in real time: messages from them, and frames to them.

A client is a row of `SLOT` with its mailbox, its filters and its batch. It is a station with one
FIFO: only its first frame takes part in the arbitration, and its next message is read after the
last frame of the present message was sent. A client that sends faster than the bus finds its own
socket full (EAGAIN). Frames of the bus are sent to the clients in batches; a client that does not
read loses frames, which are counted, and delays no other client.

    w : the `WorldRecord`        p : the `PaceRecord`        s : the `SlotRecord` of a client
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from coulombus.kernels.decorator import inlined, kernel
from coulombus.kernels.libc import (
    EAGAIN,
    ECONNRESET,
    EINTR,
    ENETDOWN,
    ENOBUFS,
    ENODEV,
    ENXIO,
    EPIPE,
    MSG_DONTWAIT,
    MSG_NOSIGNAL,
    errno,
    send,
)
from coulombus.kernels.records import Integers, RecordArray
from coulombus.sim_bus.can_bus.arbiter import receives
from coulombus.sim_bus.can_bus.cable_cut import divide
from coulombus.sim_bus.can_bus.frame_result import with_counters
from coulombus.sim_bus.can_bus.records import ROOM, STATION_MASK, BusRecord, Stage
from coulombus.sim_bus.can_bus.tx_queue import take_in
from coulombus.sim_bus.network.event_loop import WorldRecord
from coulombus.sim_bus.server.records import PaceRecord, SlotRecord
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, Frame, Queue, push
from coulombus.wire.recvmsg import Mailbox, receive

__all__ = ["BATCH", "MESSAGE_FRAMES", "SLOTS", "STATION", "Need", "SlotState", "flush", "hand_out", "offer_frames"]

SLOTS = 32
"""Largest number of clients at a time."""
STATION = 128
"""Station number of the client in slot 0."""
MESSAGE_FRAMES = 1024
"""Longest message from a client, in frames."""
BATCH = 64
"""Longest message to a client, in frames."""
CLOCK_STEP_NS = 1_000_000


class Need(IntEnum):
    """Reason why a client needs Python.

    The numbers begin after those of `sim_bus.network.event_loop.Exit`.
    """

    MESSAGE = 20  # it sent a message without frames
    CLOSED = 21  # it has closed its socket
    GONE = 22  # the SocketCAN interface has been removed


class SlotState(IntEnum):
    """State of a slot."""

    FREE = 0
    GREETING = 1  # connected, has not greeted yet
    OPEN = 2
    SOCKETCAN = 3  # an AF_CAN socket: the world's nodes are its stations
    JOINED = 4  # the virtual bus of another process: likewise


OWN, LISTEN_ONLY, ERRORS = 1, 2, 4  # wire.handshake.Flags
INVERTED = 0x20000000  # CAN_INV_FILTER
ECHO = 1 << 40
"""First padding byte of struct can_frame: marks the client's own frame, like MSG_CONFIRM on SocketCAN."""
BUS_ERROR = 0x080  # CAN_ERR_BUSERROR
SENDING = 0x80 << 16  # CAN_ERR_PROT_TX in data[2]


class Clients(NamedTuple):
    """Sockets of the bus and their data.

    Row `i` of each except `pollfds` is the client in slot `i`.
    """

    slots: RecordArray[SlotRecord]
    """Records of `SlotRecord`."""
    boxes: RecordArray[Mailbox]
    """Records of `wire.recvmsg.Mailbox`."""
    words: Integers
    """Message read last."""
    filters: Integers
    """Pairs of identifier and mask."""
    batches: Integers
    """Message being filled for the client."""
    pollfds: Integers
    """Array of struct pollfd, one per client and two more."""


@inlined
def _passes(slot: SlotRecord, filters: Integers, can_id: int) -> bool:
    """Tell whether SocketCAN's filters pass a frame."""
    if can_id & CAN_ERR_FLAG:
        return slot.greeted & ERRORS != 0
    if slot.filters == 0:
        return True
    for k in range(slot.filters):
        pattern, mask = filters[k, 0], filters[k, 1] & ~INVERTED
        equal = can_id & mask == pattern & ~INVERTED & mask
        if equal != (pattern & INVERTED != 0):
            return True
    return False


@kernel
def flush(slot: SlotRecord, batch: Integers) -> None:
    """Send a client its batch; frames that do not fit are lost."""
    if slot.out == 0:
        return
    while send(slot.fd, batch.ctypes.data, 16 * slot.out, MSG_DONTWAIT | MSG_NOSIGNAL) < 0:
        number = errno()
        if number != EINTR:
            if number not in (EPIPE, ECONNRESET):  # then it has gone, and its end will be read
                slot.lost += slot.out
            slot.out = 0
            return
    slot.delivered += slot.out
    slot.out = 0


@kernel
def _to_interface(slot: SlotRecord, batch: Integers) -> int:
    """Write the frame in `batch` to the bus that transmits it; a SocketCAN interface takes one frame at a time.
    Return 0, or Need.GONE.

    The end of another process's bus is detected on reading.
    """
    while send(slot.fd, batch.ctypes.data, 16, MSG_DONTWAIT | MSG_NOSIGNAL) < 0:
        number = errno()
        if number == EINTR:
            continue
        if number in (ENODEV, ENXIO):
            return Need.GONE
        if number == ENETDOWN:
            slot.net_down += 1
        elif number in (ENOBUFS, EAGAIN):
            slot.no_buffer += 1
        slot.lost += 1
        return 0
    slot.delivered += 1
    return 0


@kernel
def hand_out(
    w: WorldRecord, p: PaceRecord, bus: RecordArray[BusRecord], log: RecordArray[Frame], clients: Clients
) -> int:
    """Append the frames of the bus to the batches of their receivers."""
    slots, filters, batches = clients.slots, clients.filters, clients.batches
    for row in range(p.handed_out, w.log_count):
        f = log[row]
        head = f.can_id | f.length << 32
        sender = f.source & STATION_MASK
        error = f.can_id & CAN_ERR_FLAG != 0
        for i in range(slots.shape[0]):
            s = slots[i]
            b = bus[0]
            if b.cut != 0:  # clients in the other half, or on another bus, hear nothing of it
                half = b.stations[STATION + i].half
                if half != b.stations[sender].half:
                    continue
                b = bus[half]
            if s.state in (SlotState.SOCKETCAN, SlotState.JOINED):
                if sender < STATION:
                    batches[i, 0], batches[i, 1] = head, f.word
                    if _to_interface(s, batches[i]) != 0:
                        p.slot = i
                        return Need.GONE
            elif s.state == SlotState.OPEN:
                is_sender = sender == STATION + i
                word = f.word
                if error:  # of the bus, with the counters of the client's own controller; or of its own state
                    if not is_sender and f.can_id & BUS_ERROR == 0:
                        continue
                    word = with_counters(word, b.stations[STATION + i])
                    if not is_sender:
                        word &= ~SENDING
                elif (is_sender and s.greeted & OWN == 0) or (
                    not is_sender and b.partial_row == row and not receives(b, STATION + i)
                ):
                    continue
                if not _passes(s, filters[i], f.can_id):
                    continue
                batches[i, 2 * s.out] = head | ECHO if is_sender and not error else head
                batches[i, 2 * s.out + 1] = word
                s.out += 1
                if s.out == BATCH:
                    flush(s, batches[i])
    p.handed_out = w.log_count
    return 0


@kernel
def _read(
    p: PaceRecord, slots: RecordArray[SlotRecord], boxes: RecordArray[Mailbox], i: int, offset_ns: int, t_ns: int
) -> int:
    """Read one message of the client in slot `i`; return 0, or why Python is needed.

    `offset_ns` is world time minus CLOCK_REALTIME, `t_ns` the present time.
    """
    s = slots[i]
    n = receive(s.fd, boxes[i : i + 1], MSG_DONTWAIT)
    if n < 0:
        number = errno()
        if number in (EINTR, ECONNRESET):  # closed without reading all; its frames are still here, followed by its end
            return 0
        s.dry = 1
        if number == EAGAIN:
            return 0
        p.slot = i
        if s.state == SlotState.SOCKETCAN:
            if number == ENETDOWN:
                s.net_down += 1
                return 0
            p.error = number
            return Need.GONE
        s.gone = 1
        return 0
    box = boxes[i]
    if n == 0 and s.state != SlotState.SOCKETCAN:
        s.dry = s.gone = 1
        return 0
    if s.state == SlotState.SOCKETCAN:
        s.overflow = box.overflow
    if box.truncated or n == 0:
        s.malformed += 1
        return 0
    if s.state == SlotState.GREETING or (n % 16 == 8 and s.state != SlotState.JOINED):
        p.slot = i
        p.message_bytes = n
        return Need.MESSAGE
    if n % 16 != 0:
        s.malformed += 1
        return 0
    s.staged = n // 16
    s.next = 0
    s.ready_ns = t_ns
    if box.stamp_ns != 0 and box.stamp_ns + offset_ns < t_ns + CLOCK_STEP_NS:
        s.ready_ns = box.stamp_ns + offset_ns
    return 0


@kernel
def _offer(
    w: WorldRecord, bus: RecordArray[BusRecord], s: SlotRecord, words: Integers, station: int, out: Queue
) -> None:
    """Let a client's first pending frame take part in the arbitration, unless one of its frames does already."""
    b = bus[0]
    if b.cut != 0:
        divide(bus, out)
        b = bus[b.stations[station & STATION_MASK].half]
    else:
        take_in(b, out)
    if b.waiting_of[station & STATION_MASK] > 0 or b.held >= ROOM:
        return
    while s.next < s.staged:
        head, word = words[2 * s.next], words[2 * s.next + 1]
        s.next += 1
        length = head >> 32 & 0xFF
        can_id = head & 0xFFFFFFFF
        if can_id & CAN_ERR_FLAG:
            if s.state == SlotState.SOCKETCAN:
                s.error_frames += 1
            else:
                s.malformed += 1
            continue
        if length > 8 or s.greeted & LISTEN_ONLY:
            s.malformed += 1
            continue
        can_id &= (0x1FFFFFFF | CAN_EFF_FLAG | CAN_RTR_FLAG) if can_id & CAN_EFF_FLAG else 0x7FF | CAN_RTR_FLAG
        if can_id & CAN_RTR_FLAG:
            word = 0
        elif length < 8:
            word &= (1 << (8 * length)) - 1
        s.sent += 1
        push(out, station, max(s.ready_ns, w.t_ns), can_id, length, word)
        return


@kernel
def _under_way(bus: RecordArray[BusRecord], station: int, out: Queue) -> bool:
    """Tell whether a frame of a client is pending, or on the bus: it is sent even if its sender has gone."""
    b = bus[0]
    if b.cut != 0:
        divide(bus, out)
        b = bus[b.stations[station].half]
    elif out.count > 0:
        take_in(b, out)
    if b.waiting_of[station] > 0 or (b.stage != Stage.FREE and b.source == station):
        return True
    if b.stage >= Stage.PLAYED:
        for k in range(b.senders):
            if b.tx[k].source == station:
                return True
    return False


@kernel
def offer_frames(
    w: WorldRecord, p: PaceRecord, bus: RecordArray[BusRecord], clients: Clients, out: Queue, offset_ns: int, t_ns: int
) -> int:
    """Offer each client's next frame to the bus; read its next message after the last one was sent.

    Return 0, or why Python is needed.
    """
    slots = clients.slots
    for i in range(slots.shape[0]):
        s = slots[i]
        if s.state == SlotState.FREE:
            continue
        while s.next >= s.staged and not s.dry:
            why = _read(p, slots, clients.boxes, i, offset_ns, t_ns)
            if why != 0:
                return why
        if s.gone and s.next >= s.staged and not (s.state == SlotState.OPEN and _under_way(bus, STATION + i, out)):
            p.slot = i
            return Need.CLOSED
        if s.next < s.staged:
            _offer(w, bus, s, clients.words[i], STATION + i, out)
    return 0
