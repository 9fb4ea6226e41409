"""The data plane: the cycle against the wall clock, on a non-blocking socket, compiled into one loop without allocation.

    sleep to t_k - drain what is late - SYNC - receive until all TPDOs or the end of the window - `host.step` - RPDOs - count

t_k are absolute times of CLOCK_MONOTONIC. Periods that have passed are skipped and counted, never caught up. The loop logs every frame, its own and
the others', into a ring that another process empties. However it ends, it sends set-points of zero torque last.

Answers to what the system says: EINTR - again; EAGAIN, ENOBUFS - the frame is lost, counted, not repeated (a frame that waits is a wrong
set-point later), and too many cycles of it trip; everything else, and the other side closing - the bus is lost.
"""

from __future__ import annotations

from typing import Any

from eds.codec import pack
from eds.compiled import kernel
from host.plane_records import BINS, PLANE, Command, Status
from host.records import Image, Phase, Trip
from host.step import SOURCE_HOST, begin, finish, on_frame
from wire.frame import CAN_ERR_FLAG, push
from wire.libc import (
    CLOCK_REALTIME,
    CLOCK_THREAD_CPUTIME_ID,
    EAGAIN,
    EINTR,
    ENOBUFS,
    MSG_DONTWAIT,
    MSG_NOSIGNAL,
    POLLIN,
    clock_ns,
    errno,
    load_acquire,
    now_ns,
    ppoll_ns,
    send,
    sleep_until,
    store_release,
)
from wire.mailbox import receive

__all__ = ["MESSAGE_FRAMES", "run_plane", "take_log"]

MESSAGE_FRAMES = 64
"""Frames that one message may bring."""

SOURCE_BUS = 0
"""Station number of everything that came from the bus, in the log."""

LISTEN, CYCLE = int(Command.LISTEN), int(Command.CYCLE)
LISTENING, CYCLING, ENDED, LOST = int(Status.LISTENING), int(Status.CYCLING), int(Status.ENDED), int(Status.LOST)
SAFE, DONE = int(Phase.SAFE), int(Phase.DONE)
TRANSMIT, BUS_LOST, SECOND_HOST = int(Trip.TRANSMIT), int(Trip.BUS_LOST), int(Trip.SECOND_HOST)
CONTROLWORD, TARGET_TORQUE = int(Image.CONTROLWORD), int(Image.TARGET_TORQUE)
BRAKE_SETPOINT = int(Image.BRAKE_SETPOINT)


def _offset(name: str) -> int:
    fields = PLANE.fields
    assert fields is not None
    return int(fields[name][1])


AT_COMMAND, AT_STATUS, AT_STOP = _offset("command"), _offset("status"), _offset("stop")
AT_DEADMAN, AT_HEAD, AT_TAIL = _offset("deadman_ns"), _offset("log_head"), _offset("log_tail")
AT_CYCLES = _offset("cycles")

LISTEN_NS = 5_000_000  # how soon a command is seen while listening
DRAIN_MESSAGES = 512  # bound of what one cycle takes from a bus that is flooded
STAMP_AGE_NS = 1_000_000_000  # an older stamp is a clock that was set
CAN_ERR_BUSOFF = 0x40
CLOSED = -1

# what `_take` found
EMPTY, TOOK, COMPLETE, GONE = 0, 1, 2, 3


@kernel
def _log(plane: Any, ring: Any, t_ns: int, can_id: int, length: int, word: int, source: int) -> None:
    """Append a frame to the ring; the parent sees it whole or not at all."""
    p = plane[0]
    head = p.log_head
    if head - load_acquire(plane.ctypes.data + AT_TAIL) >= ring.shape[0]:
        p.log_dropped += 1
        return
    f = ring[head & (ring.shape[0] - 1)]
    f.t_ns = t_ns
    f.can_id = can_id
    f.length = length
    f.word = word
    f.source = source
    store_release(plane.ctypes.data + AT_HEAD, head + 1)


@kernel
def take_log(plane: Any, ring: Any, out: Any) -> int:
    """Move frames from the ring to `out`; return how many. For the parent."""
    p = plane[0]
    tail = p.log_tail
    count = min(load_acquire(plane.ctypes.data + AT_HEAD) - tail, out.shape[0])
    for i in range(count):
        f, g = ring[(tail + i) & (ring.shape[0] - 1)], out[i]
        g.t_ns = f.t_ns
        g.can_id = f.can_id
        g.length = f.length
        g.word = f.word
        g.source = f.source
    store_release(plane.ctypes.data + AT_TAIL, tail + count)
    return count


@kernel
def _take(fd: int, plane: Any, ring: Any, box: Any, words: Any, c: Any, h: Any, tpdos: Any, live: int) -> int:
    """Receive one message if there is one; `live`: the cycle wants its frames."""
    p = plane[0]
    n = receive(fd, box, MSG_DONTWAIT)
    if n <= 0:
        error = 0 if n == 0 else errno()
        if error == EAGAIN:
            return EMPTY
        if error == EINTR:
            p.interrupted += 1
            return TOOK
        p.error = error
        return GONE
    m = box[0]
    p.rx_overflow = m.overflow
    if n % 16 != 0 or m.truncated:
        p.rx_malformed += 1
        return TOOK
    t_ns = now_ns()
    if m.stamp_ns > 0:  # the stamp is of the other clock: take its age
        age = clock_ns(CLOCK_REALTIME) - m.stamp_ns
        if 0 < age < STAMP_AGE_NS:
            t_ns -= age
    found = TOOK
    for i in range(n // 16):
        can_id = words[2 * i] & 0xFFFFFFFF
        length = (words[2 * i] >> 32) & 0xFF
        word = words[2 * i + 1]
        if length > 8:
            p.rx_malformed += 1
            continue
        if length < 8:
            word &= (1 << 8 * length) - 1
        p.rx_frames += 1
        _log(plane, ring, t_ns, can_id, length, word, SOURCE_BUS)
        if can_id & CAN_ERR_FLAG:
            p.error_frames += 1
            if live and can_id & CAN_ERR_BUSOFF and h.stop <= 1:
                h.stop = BUS_LOST
            continue
        if not live:
            continue
        if can_id == c.sync_cob_id or can_id == 0x700 + c.host_id:
            p.foreign_sync += 1
            if h.stop <= 1:
                h.stop = SECOND_HOST
        if on_frame(c, h, tpdos, t_ns, can_id, length, word) == 1:
            found = COMPLETE
    return found


@kernel
def _transmit(fd: int, plane: Any, ring: Any, tx: Any, queue: Any, header: Any) -> int:
    """Send the queue's frames; return 0, or the error of a bus that is lost."""
    p = plane[0]
    count = header[0].count
    header[0].count = 0
    for i in range(count):
        tx[2 * i] = queue[i].can_id | queue[i].length << 32
        tx[2 * i + 1] = queue[i].word
    done = 0
    while done < count:
        frames = count - done if p.packed else 1
        n = send(fd, tx.ctypes.data + 16 * done, 16 * frames, MSG_DONTWAIT | MSG_NOSIGNAL)
        if n < 0:
            error = errno()
            if error == EINTR:
                p.interrupted += 1
                continue
            if error != EAGAIN and error != ENOBUFS:
                p.error = error
                return error
            p.tx_full += frames
        else:
            t_ns = now_ns()
            for i in range(done, done + frames):
                _log(plane, ring, t_ns, queue[i].can_id, queue[i].length, queue[i].word, SOURCE_HOST)
        done += frames
    return 0


@kernel
def _count(bins: Any, t_ns: int) -> None:
    bins[min(max(t_ns, 0) // 1000, BINS - 1)] += 1


@kernel
def _safe_setpoints(
    fd: int, plane: Any, ring: Any, tx: Any, c: Any, h: Any, rpdos: Any, queue: Any, header: Any
) -> None:
    """Send the last set-points: drive disabled and without torque, the brake no stronger than the safe state's, which its driver ramps off.

    A SYNC follows, since RPDOs may act on the next SYNC only.
    """
    h.motor_Nm = 0.0
    h.brake_Nm = min(h.brake_Nm, c.safe_brake_Nm)
    h.image[CONTROLWORD] = 0
    h.image[TARGET_TORQUE] = 0
    h.image[BRAKE_SETPOINT] = round(h.brake_Nm / c.brake_Nm_raw)
    header[0].count = 0
    t_ns = now_ns()
    for i in range(c.rpdos):
        push(queue, header, SOURCE_HOST, t_ns, rpdos[i].cob_id, rpdos[i].length, pack(rpdos[i], h.image))
    push(queue, header, SOURCE_HOST, t_ns, c.sync_cob_id, 0, 0)
    _transmit(fd, plane, ring, tx, queue, header)


@kernel
def _cycle(
    fd: int,
    plane: Any,
    ring: Any,
    box: Any,
    words: Any,
    tx: Any,
    poll: Any,
    wakeup_bins: Any,
    latency_bins: Any,
    c: Any,
    h: Any,
    rpdos: Any,
    tpdos: Any,
    law_function: Any,
    motion: Any,
    law: Any,
    state: Any,
    queue: Any,
    header: Any,
) -> int:
    """Cycle until the parent commands otherwise (returns 0) or the bus is lost (returns 1)."""
    p = plane[0]
    base = plane.ctypes.data
    t = p.start_ns
    while load_acquire(base + AT_COMMAND) == CYCLE:
        if sleep_until(t) != 0:
            p.interrupted += 1
            continue
        wake = now_ns()
        _count(wakeup_bins, wake - t)
        p.wakeup_max_ns = max(p.wakeup_max_ns, wake - t)
        late = (wake - t) // c.period_ns
        if late > 0:  # periods that have passed while this process did not run
            t += late * c.period_ns
            p.missed_deadlines += late
            h.position_age += late
        full = p.tx_full

        found = TOOK
        messages = 0
        while found != EMPTY and messages < DRAIN_MESSAGES:
            found = _take(fd, plane, ring, box, words, c, h, tpdos, 1)
            messages += 1
            if found == GONE:
                return 1
        wanted = load_acquire(base + AT_STOP)
        if wanted > h.stop:
            h.stop = wanted
        if c.deadman_key:
            h.deadman_ok = 1 if now_ns() < load_acquire(base + AT_DEADMAN) else 0

        begin(c, h, t, queue, header)
        if _transmit(fd, plane, ring, tx, queue, header) != 0:
            return 1
        sync = now_ns()
        end = sync + c.window_ns
        messages = 0
        while messages < DRAIN_MESSAGES:
            left = end - now_ns()
            if left <= 0:
                break
            if ppoll_ns(poll.ctypes.data, 1, left) <= 0:  # the window is over, or a signal came
                continue
            found = _take(fd, plane, ring, box, words, c, h, tpdos, 1)
            messages += 1
            if found == COMPLETE:
                break
            if found == GONE:
                return 1
        finish(c, h, rpdos, law_function, motion, law, state, now_ns(), queue, header)
        if _transmit(fd, plane, ring, tx, queue, header) != 0:
            return 1
        done = now_ns()
        _count(latency_bins, done - sync)
        p.latency_max_ns = max(p.latency_max_ns, done - sync)
        p.full_in_a_row = p.full_in_a_row + 1 if p.tx_full > full else 0
        if p.full_in_a_row >= c.missed_cycles and h.stop <= 1:
            h.stop = TRANSMIT
        t += c.period_ns
        late = (done - t + c.period_ns - 1) // c.period_ns
        if late > 0:
            t += late * c.period_ns
            p.missed_deadlines += late
            h.position_age += late
        store_release(base + AT_CYCLES, p.cycles + 1)
    return 0


@kernel
def run_plane(
    fd: int,
    plane: Any,
    ring: Any,
    box: Any,
    words: Any,
    tx: Any,
    poll: Any,
    wakeup_bins: Any,
    latency_bins: Any,
    control: Any,
    host: Any,
    rpdos: Any,
    tpdos: Any,
    law_function: Any,
    motion: Any,
    law: Any,
    state: Any,
    queue: Any,
    header: Any,
) -> int:
    """Do what the parent commands until it commands QUIT or the bus is lost; return the `Status`."""
    p, c, h = plane[0], control[0], host[0]
    base = plane.ctypes.data
    poll[0] = fd | POLLIN << 32
    while True:
        command = load_acquire(base + AT_COMMAND)
        if command == CYCLE:
            store_release(base + AT_STATUS, CYCLING)
            cpu = clock_ns(CLOCK_THREAD_CPUTIME_ID)
            gone = _cycle(
                fd,
                plane,
                ring,
                box,
                words,
                tx,
                poll,
                wakeup_bins,
                latency_bins,
                c,
                h,
                rpdos,
                tpdos,
                law_function,
                motion[0],
                law[0],
                state[0],
                queue,
                header,
            )
            p.cpu_ns += clock_ns(CLOCK_THREAD_CPUTIME_ID) - cpu
            if gone and h.phase < SAFE:
                h.trip = BUS_LOST
                h.trip_ns = now_ns()
            error = p.error
            _safe_setpoints(fd, plane, ring, tx, c, h, rpdos, queue, header)
            p.error = error
            h.phase = DONE
            if gone:
                store_release(base + AT_STATUS, LOST)
                return LOST
        elif command == LISTEN:
            store_release(base + AT_STATUS, LISTENING)
            found = _take(fd, plane, ring, box, words, c, h, tpdos, 0)
            if found == GONE:
                store_release(base + AT_STATUS, LOST)
                return LOST
            if found == EMPTY:
                ppoll_ns(poll.ctypes.data, 1, LISTEN_NS)
        else:
            store_release(base + AT_STATUS, ENDED)
            return ENDED
