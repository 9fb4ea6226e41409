"""pcapng files for python-can's programs: ``can_logger -f run.pcapng``, ``can_player run.pcapng``, ``can_logconvert``.

python-can finds it by the entry points ``can.io.message_writer`` and ``can.io.message_reader``,
whose keys include the dot. It loads every plug-in for each file of any kind, so the compiled
modules are imported only for a pcapng file.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import can
from can.io.generic import MessageReader, SizedMessageWriter

from coulombus.wire.python_can_messages import can_id_of, is_classical, message_of, word_of

if TYPE_CHECKING:
    from coulombus.kernels.records import Records

__all__ = ["PcapngMessageReader", "PcapngMessageWriter"]

BATCH = 256
BATCH_NS = 100_000_000
_log = logging.getLogger(__name__)


class PcapngMessageReader(MessageReader):
    """The frames of a pcapng file (link type SocketCAN) as python-can's messages; `channel` is the
    interface's name if all names end in a number, as python-can's writers need, else its number.

    Raises
    ------
    coulombus.recording.pcapng_blocks.PcapngError
        The file is damaged or of another kind.
    """

    def __init__(self, file: Any, **_: Any) -> None:
        from coulombus.recording.pcapng_reader import read_pcapng

        self._capture = read_pcapng(_path(file))

    def __iter__(self) -> Iterator[can.Message]:
        frames, buses = self._capture.frames, self._capture.buses
        numbered = all(name[-1:].isdigit() for name in buses if name)
        columns = (frames[name].tolist() for name in ("t_ns", "can_id", "length", "word", "source"))
        for t_ns, can_id, length, word, source in zip(*columns, strict=True):
            data = int(word).to_bytes(8, "little", signed=True)
            yield message_of(t_ns / 1e9, can_id, length, data, channel=buses[source] if numbered else source)

    def stop(self) -> None:
        """Do nothing: the file was read as a whole."""


class PcapngMessageWriter(SizedMessageWriter):
    """Write python-can's messages to a pcapng file that Wireshark and ``coulombus decode --rig R``
    read.

    A file that exists is replaced, as python-can's own writers do. Messages are written in batches
    of 0.1 s, so a killed program loses no more than that. CAN FD frames are left out, counted
    (`skipped`) and reported at the end.

    Raises
    ------
    coulombus.recording.pcapng_blocks.RecordingError
        The file cannot be written (also raised by each message).
    ValueError
        Appending, which would need the old file's interfaces.
    """

    def __init__(self, file: Any, append: bool = False, channel: Any = None, **_: Any) -> None:
        if append:
            raise ValueError(f"{file}: a pcapng file is not appended to; record to a new one, join with mergecap")
        from coulombus.recording.pcapng_writer import PcapngWriter, SectionTexts
        from coulombus.wire.frame import frames

        self._writer = PcapngWriter(
            _path(file), attachments={}, texts=SectionTexts(application="python-can"), interface=None, force=True
        )
        self._default = str(channel) if channel else "can0"
        self._numbers: dict[str, int] = {}
        """Name of a bus -> number of its interface."""
        self._batch: Records = frames(BATCH)
        self._count = 0
        self._stopped = False
        self.skipped = 0

    def on_message_received(self, msg: can.Message) -> None:
        """Write one message."""
        if not is_classical(msg):
            self.skipped += 1
            return
        t_ns = max(0, round(msg.timestamp * 1e9))
        if self._count and (self._count == BATCH or t_ns - int(self._batch[0].t_ns) >= BATCH_NS):
            self._flush()
        self._batch[self._count] = (t_ns, can_id_of(msg), msg.dlc, word_of(msg), self._number(msg.channel))
        self._count += 1

    def _number(self, channel: Any) -> int:
        """Return the number of a bus' interface; the first message of a bus adds it."""
        name = self._default if channel is None else f"can{channel}" if str(channel).isdigit() else str(channel)
        if name not in self._numbers:
            self._numbers[name] = self._writer.add_interface(name)
        return self._numbers[name]

    def _flush(self) -> None:
        count, self._count = self._count, 0
        self._writer.write(self._batch[:count])

    def file_size(self) -> int:
        """Return the bytes written so far."""
        return self._writer.bytes

    def stop(self) -> None:
        """Write pending messages and close the file; idempotent."""
        if self._stopped:
            return
        self._stopped = True
        try:
            if self._count:
                self._flush()
            if not self._numbers:
                self._number(None)
        finally:
            self._writer.close()
        if self.skipped:
            _log.warning("%s: %d CAN FD frames were left out", self._writer.path, self.skipped)


def _path(file: Any) -> str:
    if isinstance(file, str | os.PathLike):
        return os.fspath(file)
    raise ValueError("a pcapng file is given by its path; compress it afterwards, with zstd or gzip")
