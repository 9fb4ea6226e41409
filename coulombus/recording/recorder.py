"""Record a run: frames as received; rig, EDS files and law attached; markers as comments of the next frames.

Markers that no frame follows are an attachment at the end (`recording.file_content.LATE`).

Each bus has an interface of the file. The host's telemetry (`recording.host_telemetry`) goes to the last one.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType, TracebackType

import numpy as np
import numpy.typing as npt

from coulombus.kernels.records import Records
from coulombus.recording.file_content import LATE, pack_late
from coulombus.recording.host_telemetry import HOST_INTERFACE, SOURCE_INSIDE, inside_attachment
from coulombus.recording.pcapng_writer import PcapngWriter, SectionTexts
from coulombus.recording.trace import MODELS, NAME, SENT, pack, pack_models, pack_sent
from coulombus.rigs.rig import Rig
from coulombus.wire.frame import buses_of

__all__ = ["PACED", "About", "Markers", "Recorder", "project_version"]

NO_LAW: Mapping[str, bytes] = MappingProxyType({})
"""Attachments of a bus, which has no law."""

PACED = "paced"
"""Attachment ``bus`` of a real-time recording made by the bus itself, without a host in its process."""

TRACE_BATCH = 2000
"""Rows, and frames, per attachment of the trace: some tenths of a second at 1 kHz."""


def project_version() -> str:
    """Return the version of this project."""
    try:
        return version("coulombus")
    except PackageNotFoundError:
        return "0+unknown"


class Markers:
    """Pending markers: each becomes the comment of the first frame at or after its time."""

    def __init__(self) -> None:
        self._waiting: list[tuple[int, int, str]] = []
        self._added = 0

    def add(self, t_ns: int, text: str) -> None:
        """Add a marker."""
        heapq.heappush(self._waiting, (t_ns, self._added, text))
        self._added += 1

    def on(self, stamps: npt.NDArray[np.int64]) -> dict[int, str]:
        """Return the comments of a batch of frames with these rising stamps, by their rows."""
        comments: dict[int, str] = {}
        if not len(stamps):
            return comments
        due = []
        while self._waiting and self._waiting[0][0] <= stamps[-1]:
            due.append(heapq.heappop(self._waiting))
        rows = np.searchsorted(stamps, [t_ns for t_ns, _, _ in due]).tolist()
        for row, (_, _, text) in zip(rows, due, strict=True):
            comments[row] = f"{comments[row]}\n{text}" if row in comments else text
        return comments

    def rest(self) -> list[tuple[int, str]]:
        """Return time and text of the pending markers, in their order; none is pending then."""
        waiting, self._waiting = sorted(self._waiting), []
        return [(t_ns, text) for t_ns, _, text in waiting]


@dataclass(frozen=True)
class About:
    """Description of a run in its recording, besides the rig and its EDS files."""

    law: Mapping[str, bytes] = field(default_factory=lambda: NO_LAW)
    law_state: Sequence[tuple[str, int]] | None = None
    """Names and number of the law's state values; if given, frames of `SOURCE_INSIDE` are recorded, too."""
    bus: str = ""
    more: Mapping[str, bytes] = field(default_factory=lambda: NO_LAW)
    """Further attachments."""
    comment: str = ""
    """Comment of the file."""
    started_ns: int = 0
    """CLOCK_REALTIME at time 0; 0: none, as in virtual time."""


NOTHING_MORE = About()


class Recorder:
    """Writes frames to a pcapng file, a new one unless `force` is given; a marker is the comment of
    the first frame at or after its time.

    Raises
    ------
    coulombus.recording.pcapng_blocks.RecordingError
        the file cannot be written (from the constructor, `write` and `close`); the part already written stays readable
    """

    def __init__(
        self,
        path: Path,
        rig: Rig,
        mode: str,
        seed: int | None = None,
        *,
        about: About = NOTHING_MORE,
        force: bool = False,
    ) -> None:
        attachments = {
            "rig.toml": rig.effective().encode(),
            "mode": mode.encode(),
            "version": project_version().encode(),
        }
        if seed is not None:
            attachments["seed"] = str(seed).encode()
        if about.bus:
            attachments["bus"] = about.bus.encode()
        attachments |= {name: text.encode() for name, text in rig.eds_texts.items()}
        attachments |= about.law
        self._inside = about.law_state is not None
        if about.law_state is not None:
            attachments |= inside_attachment(about.law_state)
        self._attachments, self._texts = {**attachments, **about.more}, SectionTexts(about.comment)
        self._started_ns = about.started_ns
        self._interfaces = tuple(channel or "can0" for channel in rig.channels) if rig.one_cycle else ("can0",)
        self._open(path, force=force)
        self._markers = Markers()
        self._traces = self._sents = self._model_parts = 0
        self._models: list[bytes] = []
        self._own: list[Records] = []
        self._rows: list[Records] = []
        self._sent: list[Records] = []

    def _open(self, path: Path, *, force: bool = False) -> None:
        """Begin a file with all attachments, so that it is self-contained."""
        several = len(self._interfaces) > 1
        inside = HOST_INTERFACE if self._inside else ""
        self._writer = PcapngWriter(
            path,
            attachments=self._attachments,
            texts=self._texts,
            started_ns=self._started_ns,
            force=force,
            interface=None if several else self._interfaces[0],
            second="" if several else inside,
        )
        for name in (*self._interfaces, inside) if several else ():
            if name:
                self._writer.add_interface(name)

    def attach(self, name: str, content: bytes) -> None:
        """Add an attachment that is known only now."""
        self._writer.attach(name, content)

    def mark(self, t_ns: int, text: str) -> None:
        """Attach the comment `text` to the first frame at or after `t_ns`; without such a frame `close` writes it."""
        self._markers.add(t_ns, text)

    def write(self, frames: Records) -> None:
        """Append a batch of frames with rising stamps, each to the interface of its bus, and those of
        `SOURCE_INSIDE` to the last interface.
        """
        of_bus = np.flatnonzero(frames["source"] != SOURCE_INSIDE) if self._inside else np.arange(len(frames))
        comments = self._markers.on(frames["t_ns"][of_bus])
        places = of_bus[list(comments)].tolist()
        if len(self._interfaces) > 1:
            buses, frames = buses_of(frames), frames.copy()
            frames["source"] = np.where(buses < 0, len(self._interfaces), buses)
        self._writer.write(frames, dict(zip(places, comments.values(), strict=True)))

    def trace(self, unreceived: Records, rows: Records, sent: Records | None = None) -> None:
        """Keep the data of `recording.trace`: for each frame of the batch just written, whether the
        host did not receive it; rows; requested frames.
        """
        self._own.append(unreceived)
        self._rows.append(rows)
        if sent is not None and len(sent):
            self._sent.append(sent.copy())
        if sum(map(len, (*self._own, *self._rows, *self._sent))) >= TRACE_BATCH:
            self._write_trace()

    def keep_models(self, rows: bytes) -> None:
        """Keep models that a world has sent (`host.world.recorded`), for the next attachment."""
        if rows:
            self._models.append(rows)

    def _write_trace(self) -> None:
        unreceived, rows, sent = np.concatenate(self._own), np.concatenate(self._rows), self._sent
        self._own, self._rows, self._sent = [], [], []
        self._writer.attach(f"{NAME}{self._traces}", pack(unreceived, rows))
        self._traces += 1
        if sent:
            self._writer.attach(f"{SENT}{self._sents}", pack_sent(np.concatenate(sent)))
            self._sents += 1
        if self._models:
            self._writer.attach(f"{MODELS}{self._model_parts}", pack_models(b"".join(self._models)))
            self._models = []
            self._model_parts += 1

    def _flush_trace(self) -> None:
        """Write the rest of the trace."""
        if self._rows:
            self._write_trace()

    def _write_rest(self) -> None:
        """Write the rest of the trace, and the markers that no frame follows."""
        self._flush_trace()
        if (late := self._markers.rest()) and not self._writer.failed:
            self._writer.attach(LATE, pack_late(late))

    def close(self) -> None:
        """Write the rest and close the file; idempotent."""
        if self._writer.fileno() < 0:
            return
        try:
            self._write_rest()
        finally:
            self._writer.close()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
