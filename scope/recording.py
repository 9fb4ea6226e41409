"""A recording as arrays: every signal of the rig's PDOs by name, in SI units.

::

    recording = read("hybrid.pcapng")
    angle = recording["motor.position_rad"]
    angle.t_s, angle.values, angle.unit          # two arrays and "rad"
    recording.markers                            # [(1.004, "phase hold"), ...]

What the bits mean comes from the rig file and the EDS files attached to the recording; of a file without them (candump's,
Wireshark's, or one that editcap has rewritten) from the rig that is given.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from eds.pdo import Entry
from eds.rig import Rig, RigError, load_rig, load_rig_text
from eds.signals import RigPdo, Signal
from wire.frame import Records
from wire.pcapng import Capture, read_pcapng

__all__ = ["PdoTable", "Recording", "Series", "decode_field", "read"]

Array: TypeAlias = npt.NDArray[Any]
Floats: TypeAlias = npt.NDArray[np.float64]
Integers: TypeAlias = npt.NDArray[np.int64]

RIG = "rig.toml"
WALL_CLOCK_NS = 10**17  # stamps beyond this (1973) are a clock's; smaller ones count from the run's start


@dataclass(frozen=True)
class Series:
    """One signal: times [s], values in `unit`. Words of bits (unit "") are integers, the rest is float64."""

    t_s: Floats
    values: Array
    unit: str

    def __len__(self) -> int:
        return len(self.t_s)


@dataclass(frozen=True)
class PdoTable:
    """The frames of one PDO: their rows in `Recording.frames`, and one column of SI values for each signal."""

    pdo: RigPdo
    name: str
    rows: Integers
    columns: tuple[Array, ...]
    malformed: int


@dataclass(frozen=True)
class Recording:
    """A recording, decoded; ``recording["motor.position_rad"]`` is a `Series`.

    Attributes
    ----------
    path
        The file.
    rig
        The rig whose PDOs these are: the attached one, or the one given.
    capture
        The file's content as it stands: frames, comments, attachments, torn bytes.
    epoch_ns
        Time 0 of all `t_s`: 0 in virtual time; the first frame's stamp where stamps come from a clock.
    signals
        Name -> `Series`, in the order of the rig's PDOs. A PDO that never came gives empty ones.
    markers
        (time [s], text) of the comments, one for each line of them, in the file's order.
    malformed
        "motor.TPDO1" -> frames of a wrong length, which are left out of the signals.
    """

    path: str
    rig: Rig
    capture: Capture
    epoch_ns: int
    tables: tuple[PdoTable, ...]
    signals: Mapping[str, Series]
    markers: list[tuple[float, str]]
    malformed: Mapping[str, int]

    @property
    def frames(self) -> Records:
        """All frames, records of `wire.frame.FRAME`."""
        return self.capture.frames

    @property
    def t_s(self) -> Floats:
        """Time of each frame [s]."""
        return (self.frames["t_ns"] - self.epoch_ns) / 1e9

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on what was left out: a torn end, damaged attachments, other packets, malformed PDOs."""
        capture = self.capture
        found = list(capture.warnings)
        if capture.torn:
            found.append(f"{self.path}: the last block is unfinished: {capture.torn} bytes were left out")
        if capture.skipped:
            found.append(f"{self.path}: {capture.skipped} packets are no classical CAN frames and were left out")
        found += [f"{self.path}: {n} frames of {name} have a wrong length" for name, n in self.malformed.items() if n]
        return tuple(found)

    def __getitem__(self, name: str) -> Series:
        """Return a signal; KeyError names the nearest ones."""
        if name not in self.signals:
            near = difflib.get_close_matches(name, self.signals, 3, 0.4) or list(self.signals)
            raise KeyError(f"no signal {name!r} in {self.path}; there is {', '.join(near)}")
        return self.signals[name]

    def scale(self, name: str) -> float:
        """Return the SI value of one raw count of a signal."""
        return self.signal(name).scale

    def signal(self, name: str) -> Signal:
        """Return what the rig says of a signal: object, scale, offset, unit."""
        _ = self[name]
        return next(signal for table in self.tables for signal in table.pdo.signals if signal.name == name)


def read(path: str | Path, rig: Rig | str | None = None) -> Recording:
    """Read a recording.

    Parameters
    ----------
    path
        A pcapng file of SocketCAN frames.
    rig
        Decode with this rig (a `Rig`, a packaged rig's name, or a rig file's path) and not with the attached one.

    Raises
    ------
    eds.rig.RigError
        No rig is attached and none is given, or the attached one cannot be read.
    wire.pcapng.PcapngError
        The file is damaged, or is of another kind.
    """
    capture = read_pcapng(path)
    if rig is None:
        rig = _attached_rig(capture)
    elif isinstance(rig, str):
        rig = load_rig(rig)
    return decode(capture, rig)


def decode(capture: Capture, rig: Rig) -> Recording:
    """Return the capture with the signals of the rig's PDOs."""
    frames = capture.frames
    epoch_ns = int(frames["t_ns"][0]) if len(frames) and frames["t_ns"][0] >= WALL_CLOCK_NS else 0
    t_s: Floats = (frames["t_ns"] - epoch_ns) / 1e9
    can_ids = np.ascontiguousarray(frames["can_id"])
    tables = tuple(_table(pdo, frames, can_ids) for pdo in rig.pdos())
    signals = {}
    for table in tables:
        at = t_s[table.rows]
        for signal, values in zip(table.pdo.signals, table.columns, strict=True):
            signals[signal.name] = Series(at, values, signal.unit)
    return Recording(
        path=capture.path,
        rig=rig,
        capture=capture,
        epoch_ns=epoch_ns,
        tables=tables,
        signals=MappingProxyType(signals),
        markers=[(float(t_s[row]), line) for row, text in capture.comments for line in text.splitlines()],
        malformed=MappingProxyType({table.name: table.malformed for table in tables}),
    )


def _attached_rig(capture: Capture) -> Rig:
    give = "give one: read(path, rig=...), or --rig on the command line"
    if RIG not in capture.attachments:
        damaged = f" ({'; '.join(capture.warnings)})" if capture.warnings else ""
        raise RigError([f"{capture.path}: no {RIG} is attached, so its PDOs have no meaning{damaged}; {give}"])
    texts = {name: content.decode(errors="replace") for name, content in capture.attachments.items()}
    try:
        return load_rig_text(texts.pop(RIG), f"{capture.path}[{RIG}]", texts)
    except RigError as error:
        remedy = f"{capture.path}: its attached rig cannot be read by this version; {give}"
        raise RigError([*error.errors, remedy]) from error


def _table(pdo: RigPdo, frames: Records, can_ids: Integers) -> PdoTable:
    layout = pdo.layout
    came = np.flatnonzero(can_ids == layout.cob_id)
    rows = came[frames["length"][came] == layout.length]
    words = frames["word"][rows]
    columns = tuple(
        _si(decode_field(words, start, entry), signal)
        for entry, start, signal in zip(layout.entries, layout.starts, pdo.signals, strict=True)
    )
    name = f"{layout.direction.upper()}{layout.number}"
    return PdoTable(pdo, f"{pdo.node}.{name}", rows, columns, len(came) - len(rows))


def _si(raw: Array, signal: Signal) -> Array:
    if not signal.unit and (signal.scale, signal.offset) == (1.0, 0.0):
        return raw
    return raw * signal.scale + signal.offset


def decode_field(words: Integers, start: int, entry: Entry) -> Array:
    """Return the field that begins at bit `start` of each data word: integers, or numbers of an IEEE 754 pattern."""
    left, right = 64 - start - entry.bits, 64 - entry.bits
    if entry.kind == "real":
        pattern = words.view(np.uint64) << np.uint64(left) >> np.uint64(right)
        return pattern.astype(f"u{entry.bits // 8}").view(f"f{entry.bits // 8}").astype(np.float64)
    if entry.signed:
        return words << left >> right
    field = words.view(np.uint64) << np.uint64(left) >> np.uint64(right)
    return field if entry.bits == 64 else field.view(np.int64)
