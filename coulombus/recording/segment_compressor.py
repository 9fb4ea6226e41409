"""Compress finished segments with zstd, in a process of its own with the lowest priority.

The recorder sends the process the paths of finished segments. A segment is compressed under a
hidden name, synced to the disk, and renamed to ``000001.pcapng.zst``; then the plain file is
removed. A process that is killed therefore leaves the plain or the whole compressed file. If it
leaves both, readers take the compressed one, and the next run removes the plain one.

The process ignores the signals that end the host. It ends when the recorder has closed its pipe and
the last segment is compressed.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from coulombus.recording.folders import INDEX, PACKED, files_of, runs
from coulombus.system.stop_signals import SIGNALS
from coulombus.system.unfinished_file import remove_unfinished, unfinished

__all__ = ["SegmentCompressor", "compress", "main"]

LEVEL = 1
MOST_WAITING_S = 2.0
"""Longest wait for the last segment at the recorder's end; a longer one is compressed afterwards."""
ENDING = tuple(number for number in SIGNALS if signal.Signals(number).name != "SIGQUIT")


def compress(segment: Path) -> int | None:
    """Replace a segment by its compressed file; return its bytes, None if the segment is gone.

    Raises
    ------
    OSError
        The compressed file cannot be written; the segment stays as it is.
    """
    from zstandard import ZstdCompressor

    place, packed = unfinished(segment.with_name(segment.name + PACKED)), segment.with_name(segment.name + PACKED)
    try:
        with segment.open("rb") as plain, place.open("xb") as file:
            size = os.fstat(plain.fileno()).st_size
            ZstdCompressor(LEVEL, write_checksum=True).copy_stream(plain, file, size=size)
            file.flush()
            os.fsync(file.fileno())
        if not segment.exists():  # removed meanwhile by --keep
            return None
        os.replace(place, packed)
        _sync(segment.parent)
        segment.unlink(missing_ok=True)
        return packed.stat().st_size
    except FileNotFoundError:
        return None
    finally:
        with suppress(OSError):
            place.unlink()


def _sync(folder: Path) -> None:
    """Sync the names of a folder to the disk."""
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def tidy(folder: Path) -> None:
    """Remove what killed compressors have left in the runs of a folder: unfinished files, plain
    segments that are compressed already.
    """
    for run in runs(folder):
        remove_unfinished(run)
        names = {path.name for path in files_of(run)}
        for name in names:
            if name + PACKED in names:
                with suppress(OSError):
                    (run / name).unlink()


class SegmentCompressor:
    """The recorder's side: starts the process and sends it segments; never waits for it but in `close`.

    A process that does not start or has ended leaves the segments plain.
    """

    def __init__(self, folder: Path) -> None:
        root = str(Path(__file__).parents[__name__.count(".")])
        path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
        self._process: subprocess.Popen[bytes] | None = None
        with suppress(OSError):
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__, str(folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,  # a reader of the host's output does not wait for this process
                start_new_session=True,  # Ctrl-C of the terminal goes to the host only
                env={**os.environ, "PYTHONPATH": path},
            )
            assert self._process.stdin is not None
            os.set_blocking(self._process.stdin.fileno(), False)

    def add(self, segment: Path) -> None:
        """Have a finished segment compressed."""
        if self._process is not None and self._process.stdin is not None:
            with suppress(OSError):
                os.write(self._process.stdin.fileno(), json.dumps(str(segment.absolute())).encode() + b"\n")

    def close(self) -> None:
        """Let the process end after its last segment, and wait for it for a short time."""
        if self._process is not None and self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(MOST_WAITING_S)


def _give_way() -> None:
    """Take the lowest priority, SCHED_IDLE, and nice 19 where there is none; the signals that end the host do not
    end this process.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    with suppress(OSError):
        os.nice(19)


def main(folder: str) -> None:
    """Compress the segments whose paths arrive on stdin, until its end; `folder` has the runs."""
    tidy(Path(folder))
    for line in sys.stdin:
        segment = Path(json.loads(line))
        try:
            size = compress(segment)
            event = None if size is None else {"event": "compressed", "segment": segment.name + PACKED, "bytes": size}
        except OSError as error:
            event = {"event": "not compressed", "segment": segment.name, "reason": str(error.strerror)}
        if event is not None:
            with suppress(OSError), (segment.parent / INDEX).open("ab") as index:
                index.write(json.dumps(event).encode() + b"\n")


if __name__ == "__main__":
    _give_way()
    main(sys.argv[1])
