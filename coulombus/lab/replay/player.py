"""Play recorded frames onto a bus with their original timing.

Each frame has an absolute deadline, so timing does not drift: a late frame does not delay the next
one. A stamp is the end of a frame; on a bus with known bit rate a frame is sent one frame length
earlier, so that on an idle bus it ends at its recorded time.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from coulombus.kernels.records import Records
from coulombus.recording.block import epoch_of
from coulombus.recording.bus_match import BusMatch, Channel, channel_texts
from coulombus.recording.file_content import remarks_on
from coulombus.recording.log_files import EXPECTED, LogError, is_log, is_pcapng
from coulombus.recording.pcapng_reader import read_pcapng
from coulombus.recording.reading import captures
from coulombus.wire.bits import data_frame_bits
from coulombus.wire.client import BusFull, Client, pack_frame
from coulombus.wire.frame import CAN_ERR_FLAG, CAN_RTR_FLAG, data_bytes

__all__ = ["NOTHING", "Played", "Tape", "load_tape", "play"]

Integers = npt.NDArray[np.int64]

FULL_NS = 2_000_000_000
FULL_PAUSE_S = 5e-4
PROGRESS_NS = 100_000_000
LEAD_NS = 20_000_000
LONG_NS = 600_000_000_000
NOTHING = ((0x20000000, 0),)
"""A SocketCAN filter that passes nothing: all identifiers, inverted (CAN_INV_FILTER)."""


@dataclass(frozen=True)
class Tape:
    """Frames in playing order.

    `t_ns` are times from the run's start or, for wall-clock stamps, from the first frame, as in `coulombus decode`.
    """

    path: str
    frames: Records
    t_ns: Integers
    remarks: tuple[str, ...] = ()

    def select(self, mask: npt.NDArray[np.bool_]) -> Tape:
        """Return only the frames that `mask` has."""
        return Tape(self.path, self.frames[mask], self.t_ns[mask], self.remarks)


@dataclass(frozen=True)
class Played:
    """Result of playing: frames, delays [us], number of full-bus retries, and duration [s]."""

    frames: int
    loops: int
    seconds: float
    late_us: dict[str, float] | None
    full: int
    complete: bool


class Stop(Protocol):
    """Early stop of playing (`system.stop_signals.StopSignals`)."""

    def wait(self, seconds: float) -> bool:
        """Sleep for a time; return whether to stop."""


def load_tape(path: str | Path, channel: Channel = None) -> Tape:
    """Read the playable frames of one bus (`channel` if the file has several): pcapng, and other
    tools' logs (candump's .log, .asc, .blf, .trc, .csv, .mf4, .db), each also .gz or .zst.

    Error frames and CAN FD frames are omitted, with a remark.

    Raises
    ------
    coulombus.recording.bus_match.ChannelError
        The file has several buses, and none is named.
    coulombus.recording.log_files.LogError, coulombus.recording.pcapng_blocks.PcapngError
        The file is of another kind or damaged.
    """
    if is_log(path):
        capture = next(captures(path))
    elif Path(path).suffix == ".pcapng" or Path(path).is_dir() or is_pcapng(path):
        capture = read_pcapng(path)
    else:
        raise LogError(f"{path}: it cannot be read: expected {EXPECTED}")
    match = BusMatch.without_rig(capture.path, channel_texts(channel))
    capture = match.select(capture)
    left_out = Counter({"torn": capture.torn, "skipped": capture.skipped})
    frames, remarks = capture.frames, [*remarks_on(str(path), (*capture.warnings, *match.remarks()), left_out)]
    errors = frames["can_id"] & CAN_ERR_FLAG != 0
    if errors.any():
        remarks.append(f"{path}: {int(errors.sum())} error frames were left out: they belong to their own wire")
        frames = frames[~errors]
    stamps: Integers = np.ascontiguousarray(frames["t_ns"])
    epoch = epoch_of(frames)
    t_ns = np.maximum.accumulate(stamps - epoch) if len(stamps) else stamps
    return Tape(str(path), frames, t_ns, (*remarks, *_leaps(path, stamps, t_ns + epoch)))


def _leaps(path: str | Path, stamps: Integers, played_ns: Integers) -> Iterator[str]:
    """Yield remarks on stamps that do not increase steadily."""
    back = played_ns - stamps
    if back.any():
        row, count = int(np.argmax(back)), int(np.count_nonzero(back))
        yield f"{path}: {count} stamps go back, that of frame {row + 1} by {back[row] / 1e9:g} s: such frames follow the one before them at once"
    gaps = np.diff(played_ns)
    if len(gaps) and gaps.max() >= LONG_NS:
        row = int(np.argmax(gaps))
        yield f"{path}: frame {row + 2} comes {gaps[row] / 1e9:g} s after the one before it; --from-s and --to-s play a part"


def play(
    tape: Tape,
    client: Client,
    stop: Stop,
    *,
    speed: float = 1.0,
    loops: int = 1,
    progress: Callable[[float], None] = lambda seconds: None,
) -> Played:
    """Send the frames on the client's bus; return the result.

    Parameters
    ----------
    speed : 2 plays in half the time
    loops : number of repetitions; 0: until `stop`
    progress : called ten times a second with the time played [s]

    Raises
    ------
    coulombus.wire.client.BusUnavailable
        The bus closed, or accepted no frame for 2 s.
    """
    messages, due, once_ns = _plan(tape, client.bitrate_bit_s, speed)
    late: list[Integers] = []
    full = sent = done = 0
    begin = time.monotonic_ns() + LEAD_NS
    shown = begin
    running = True
    while running and (loops == 0 or done < loops):
        lates = np.zeros(len(messages), np.int64)
        at = 0
        for message, offset in zip(messages, due, strict=True):
            deadline = begin + offset
            now = time.monotonic_ns()
            if now < deadline or not at & 0xFF:  # checked now and then even if always late
                running = not _wait_until(stop, deadline, now)
                if not running:
                    break
            retries = _send(client, message)
            full += retries > 0
            now = time.monotonic_ns()
            lates[at] = now - deadline
            at += 1
            if now - shown > PROGRESS_NS:
                shown = now
                progress((now - begin) / 1e9)
        late.append(lates[:at])
        sent += at
        done += running
        begin += once_ns
    everything = np.concatenate(late) if late else np.zeros(0, np.int64)
    seconds = (time.monotonic_ns() - (begin - len(late) * once_ns)) / 1e9
    return Played(sent, done, seconds, _spread(everything), full, running)


def _plan(tape: Tape, bitrate_bit_s: int, speed: float) -> tuple[list[bytes], list[int], int]:
    """Return each frame's bytes and due time from the beginning [ns], and the duration of a loop [ns]."""
    frames = tape.frames
    columns = (frames[name].tolist() for name in ("can_id", "length", "word"))
    messages, lengths = [], np.zeros(len(frames), np.int64)
    for row, (can_id, length, word) in enumerate(zip(*columns, strict=True)):
        data = b"" if can_id & CAN_RTR_FLAG else data_bytes(word, length)
        messages.append(pack_frame(can_id, data, length))
        if bitrate_bit_s:
            lengths[row] = data_frame_bits(can_id, length, word) * 1_000_000_000 // bitrate_bit_s
    ends = np.round((tape.t_ns - tape.t_ns[:1]) / speed).astype(np.int64)
    due = np.maximum.accumulate(ends - lengths + lengths[:1]) if len(frames) else ends
    gap = int(ends[-1]) // (len(ends) - 1) if len(ends) > 1 else 1_000_000
    return messages, due.tolist(), int(ends[-1]) + gap if len(ends) else 0


def _wait_until(stop: Stop, deadline: int, now: int) -> bool:
    while True:
        if stop.wait(min((deadline - now) / 1e9, 0.25)):
            return True
        now = time.monotonic_ns()
        if now >= deadline:
            return False


def _send(client: Client, message: bytes) -> int:
    """Send; return the number of retries on a full bus."""
    retries = 0
    give_up = 0
    while True:
        try:
            client.send(message)
            return retries
        except BusFull as error:
            now = time.monotonic_ns()
            give_up = give_up or now + FULL_NS
            if now > give_up:
                from coulombus.wire.address import BusUnavailable

                raise BusUnavailable(error.errno, f"{error.strerror}: it has taken no frame for 2 s") from None
            retries += 1
            time.sleep(FULL_PAUSE_S)


def _spread(late_ns: Integers) -> dict[str, float] | None:
    if not len(late_ns):
        return None
    p50, p99 = np.percentile(late_ns, (50, 99))
    return {"p50": float(p50) / 1e3, "p99": float(p99) / 1e3, "max": float(late_ns.max()) / 1e3}
