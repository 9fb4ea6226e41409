"""Long recordings: a folder per run, self-contained segments, an index, and a limit on kept data.

::

    DIR/000007-20261122T200412Z/          the seventh run here, with its start time
        000001.pcapng.zst                 a whole recording: Wireshark and `read` open it alone
        000002.pcapng                     the segment in writing is never compressed
        index.jsonl                       a line for each segment that begins, ends, is compressed or removed

The numbers define the order, even if the clock is set back. A killed process leaves a readable
file, because each write consists of complete blocks. Space is pre-allocated without a change of the
file's length, so that a full disk is noticed early; the rest is freed at the segment's end. A
thread syncs the files to disk every few seconds, because a sync may take longer than the host can
wait. A process compresses finished segments (`recording.segment_compressor`).
"""

from __future__ import annotations

import ctypes
import errno
import json
import os
import queue
import re
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coulombus.kernels.records import Records
from coulombus.recording.folders import INDEX, files_of, runs, segments_of
from coulombus.recording.pcapng_blocks import RecordingError
from coulombus.recording.recorder import About, Recorder
from coulombus.recording.segment_compressor import SegmentCompressor
from coulombus.recording.wall_clock import utc
from coulombus.rigs.rig import Rig
from coulombus.system.c_library import c_library
from coulombus.system.file_lock import lock_file

__all__ = ["INDEX", "Rotation", "SegmentedRecorder", "parse_rotation", "parse_size", "reserve"]

ATTEMPTS = 100
RESERVED = 16 << 20
FLUSH_S = 5.0
END_S = 10.0
FALLOC_FL_KEEP_SIZE = 1
UNITS = {"kB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
TIMES = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86_400.0}
SMALLEST = 100_000
_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*(kB|MB|GB|TB)")
_TIME = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|h|d)")
_library = c_library()


@dataclass(frozen=True)
class Rotation:
    """Limits of a segment, and of the kept data.

    Attributes
    ----------
    most_bytes, most_s : size and duration at which a segment ends; None: unlimited
    keep_bytes : limit of all segments in the folder, as they are on the disk, beyond which the oldest are
        removed; None: unlimited
    compress : whether finished segments are compressed
    """

    most_bytes: int | None = 100 * 10**6
    most_s: float | None = None
    keep_bytes: int | None = None
    compress: bool = False


def parse_size(text: str) -> int:
    """Return the bytes of ``20GB``; ValueError for anything else."""
    match = _SIZE.fullmatch(text.strip())
    size = round(float(match[1]) * UNITS[match[2]]) if match else 0
    if size < SMALLEST:
        raise ValueError(f"got {text!r}, expected a size of at least 100kB, as in 100MB or 20GB")
    return size


def parse_rotation(text: str) -> Rotation:
    """Return the rotation of ``100MB`` or ``1h``; ValueError for anything else."""
    match = _TIME.fullmatch(text.strip())
    if match is None:
        with suppress(ValueError):
            return Rotation(most_bytes=parse_size(text))
    elif float(match[1]) * TIMES[match[2]] >= 1.0:
        return Rotation(most_bytes=None, most_s=float(match[1]) * TIMES[match[2]])
    raise ValueError(f"got {text!r}, expected a size of at least 100kB or a time of at least 1s, as in 100MB or 1h")


def reserve(fd: int, offset: int, length: int) -> None:
    """Pre-allocate space for a file without changing its length.

    Raises
    ------
    OSError
        there is no space; a file system without pre-allocation is no error
    """
    call = _library.fallocate64 if hasattr(_library, "fallocate64") else _library.fallocate
    if call(fd, FALLOC_FL_KEEP_SIZE, ctypes.c_int64(offset), ctypes.c_int64(length)) != 0:
        number = ctypes.get_errno()
        if number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise OSError(number, os.strerror(number))


class _Flusher:
    """Syncs files to disk in a separate thread."""

    def __init__(self) -> None:
        self._orders: queue.Queue[int | None] = queue.Queue(2)
        self._thread = threading.Thread(target=self._work, name="recording to disk", daemon=True)
        self._thread.start()

    def flush(self, fd: int) -> None:
        """Request a sync of a file; skipped if earlier ones are still pending."""
        duplicate_fd = -1
        try:
            duplicate_fd = os.dup(fd)
            self._orders.put_nowait(duplicate_fd)
        except (OSError, queue.Full):
            if duplicate_fd >= 0:
                os.close(duplicate_fd)

    def close(self) -> None:
        """Wait for pending requests, with a time limit."""
        with suppress(queue.Full):
            self._orders.put(None, timeout=END_S)
            self._thread.join(END_S)

    def _work(self) -> None:
        while (fd := self._orders.get()) is not None:
            with suppress(OSError):
                os.fsync(fd)
            os.close(fd)


class SegmentedRecorder(Recorder):
    """A `Recorder` that starts a new file when the present one reaches a limit.

    Parameters
    ----------
    folder : parent of the run's folder
    about : with the time `started_ns`, from which the run's folder is named

    Raises
    ------
    coulombus.recording.pcapng_blocks.RecordingError
        the folder or a segment cannot be written
    """

    def __init__(
        self,
        folder: Path,
        rig: Rig,
        mode: str,
        rotation: Rotation,
        about: About,
    ) -> None:
        self.folder, self.rotation, self._started_ns = folder, rotation, about.started_ns
        self.run = _new_run(folder, about.started_ns)
        self._number, self._begun_ns, self._last_ns, self._frames = 1, -1, 0, 0
        self._reserved, self._told_s = 0, time.monotonic()
        self._step = min(RESERVED, rotation.most_bytes or RESERVED)
        self._index, self._largest = -1, 0
        try:
            self._index = os.open(self.run / INDEX, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o666)
            with suppress(OSError):  # a file system without locks: the run cannot be detected as active
                lock_file(self._index)
            room = os.statvfs(self.run)
            if room.f_bavail * room.f_frsize < 2 * self._step:
                self._prune(2 * self._step)
            super().__init__(self.run / "000001.pcapng", rig, mode, about=about)
        except OSError as error:
            self._undo()
            if isinstance(error, RecordingError):
                raise
            raise RecordingError(f"{self.run}: the recording cannot be created ({error.strerror})") from error
        self._flusher = _Flusher()
        self._compressor = SegmentCompressor(folder) if rotation.compress else None
        self._note("begun", segment=self._segment.name)
        self._make_room()

    def _undo(self) -> None:
        """Remove the folder of a run that failed to start."""
        if self._index >= 0:
            os.close(self._index)
        for path in (self.run / INDEX, *segments_of(self.run)):
            with suppress(OSError):
                path.unlink()
        with suppress(OSError):
            self.run.rmdir()

    @property
    def _segment(self) -> Path:
        return Path(self._writer.path)

    def write(self, frames: Records) -> None:
        """Append a batch of frames with rising stamps, in a new segment if due."""
        if len(frames):
            if self._begun_ns >= 0 and self._over(int(frames["t_ns"][0])):
                self._rotate()
            if self._begun_ns < 0:
                self._begun_ns = int(frames["t_ns"][0])
            self._last_ns = int(frames["t_ns"][-1])
        super().write(frames)
        self._make_room()
        if time.monotonic() - self._told_s >= FLUSH_S:
            self._told_s = time.monotonic()
            self._flusher.flush(self._writer.fileno())

    def _over(self, t_ns: int) -> bool:
        rotation = self.rotation
        large = rotation.most_bytes is not None and self._writer.bytes >= rotation.most_bytes
        return large or (rotation.most_s is not None and t_ns - self._begun_ns >= rotation.most_s * 1e9)

    def _rotate(self) -> None:
        self._flush_trace()
        self._end_segment()
        self._prune(0)
        self._number += 1
        self._begun_ns, self._reserved = -1, 0
        self._open(self.run / f"{self._number:06d}.pcapng")
        self._note("begun", segment=self._segment.name)

    def _end_segment(self) -> None:
        """Free the pre-allocated space, and add the segment to the index."""
        writer, size = self._writer, self._writer.bytes
        with suppress(OSError):
            os.ftruncate(writer.fileno(), size)
        self._flusher.flush(writer.fileno())
        times = {} if self._begun_ns < 0 else {"first_ns": self._begun_ns, "last_ns": self._last_ns}
        name, frames = self._segment.name, writer.frames
        self._largest = max(self._largest, size)
        writer.close()
        if self._compressor is not None:
            self._compressor.add(self._segment)
        self._note("ended", segment=name, frames=frames, bytes=size, **times)

    def _note(self, event: str, **values: Any) -> None:
        """Append a line to the index; a failure does not affect the recording."""
        begun = {"utc": utc(self._started_ns + max(0, self._last_ns))}
        line = json.dumps({"event": event, **values, **begun}) + "\n"
        with suppress(OSError):
            os.write(self._index, line.encode())

    def _make_room(self) -> None:
        """Pre-allocate more space when the present one is nearly used; if the disk is full, remove old segments first."""
        while self._writer.bytes + self._step // 2 > self._reserved:
            try:
                reserve(self._writer.fileno(), self._reserved, self._step)
                self._reserved += self._step
            except OSError:
                if not self._prune(self._step):
                    return  # the remaining space is used up; then the run ends as on any full disk

    def _prune(self, more: int) -> bool:
        """Remove the oldest segments until the limit is met, at least `more` bytes of them; return
        whether any was removed.
        """
        keep = self.rotation.keep_bytes
        if keep is None:
            return False
        old = [path for run in runs(self.folder) for path in files_of(run) if path not in self._present(run)]
        sizes = [_size(path) for path in old]
        coming = self.rotation.most_bytes or max(*sizes, self._largest, 0)
        surplus = max(sum(sizes) + coming - keep, more)
        freed = 0
        for path, size in zip(old, sizes, strict=True):
            if freed >= surplus:
                break
            with suppress(OSError):
                path.unlink()
                freed += size
                self._note("removed", segment=str(path.relative_to(self.folder)), bytes=size)
                if path.parent != self.run and not files_of(path.parent):
                    (path.parent / INDEX).unlink(missing_ok=True)
                    path.parent.rmdir()
        return freed > 0

    def _present(self, run: Path) -> list[Path]:
        """Return the segment of a run that this or another host is writing now."""
        if run == self.run:
            return [self._segment] if self._writer.fileno() >= 0 else []
        return segments_of(run)[-1:] if _lives(run) else []

    def close(self) -> None:
        """Write the rest, end the segment and sync it; idempotent."""
        if self._index < 0:
            return
        try:
            self._write_rest()
        finally:
            self._end_segment()
            os.close(self._index)
            self._index = -1
            self._flusher.close()
            if self._compressor is not None:
                self._compressor.close()


def _lives(run: Path) -> bool:
    """Return whether a process still records a run: it holds the lock of its index."""
    try:
        with (run / INDEX).open("rb") as index:
            lock_file(index, shared=True)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _new_run(folder: Path, started_ns: int) -> Path:
    """Make the folder of a new run, numbered after the existing ones."""
    stamp = utc(started_ns)[:19].replace("-", "").replace(":", "") + "Z"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for _ in range(ATTEMPTS):
            last = runs(folder)
            number = int(last[-1].name[:6]) + 1 if last else 1
            run = folder / f"{number:06d}-{stamp}"
            with suppress(FileExistsError):  # another host records here, too
                run.mkdir()
                return run
    except OSError as error:
        text = f"{folder}: the recording cannot be created ({error.strerror}); choose a folder that can be written"
        raise RecordingError(text) from error
    raise RecordingError(f"{folder}: no folder for a new run can be made there; choose another one")
