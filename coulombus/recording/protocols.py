"""Protocols that tables and plots need of a recording (breaks an import circle)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.recording.file_content import Capture
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo, Signal
from coulombus.wire.frame import Records

__all__ = ["Block", "Readable"]

Array: TypeAlias = npt.NDArray[Any]
Floats: TypeAlias = npt.NDArray[np.float64]
Integers: TypeAlias = npt.NDArray[np.int64]


class _Series(Protocol):
    @property
    def t_s(self) -> Floats: ...
    @property
    def values(self) -> Array: ...


class _Table(Protocol):
    @property
    def pdo(self) -> RigPdo: ...
    @property
    def name(self) -> str: ...
    @property
    def rows(self) -> Integers: ...
    @property
    def t_ns(self) -> Integers: ...
    @property
    def order(self) -> Integers: ...
    def column(self, signal: Signal) -> Array: ...


class Block(Protocol):
    """Some seconds of a recording (`recording.signals.Recording`)."""

    @property
    def capture(self) -> Capture:
        """The file's raw content."""

    @property
    def frames(self) -> Records:
        """All frames."""

    @property
    def epoch_ns(self) -> int:
        """Time 0 of all `t_s`."""

    @property
    def t_s(self) -> Floats:
        """Time of each frame [s]."""

    @property
    def tables(self) -> Sequence[_Table]:
        """The frames of each PDO."""

    @property
    def markers(self) -> list[tuple[float, str]]:
        """Time [s] and text of each."""

    @property
    def signals(self) -> Mapping[str, _Series]:
        """By name."""


class Readable(Protocol):
    """A recording, of one block or of many (`recording.signals.Source`)."""

    @property
    def path(self) -> str:
        """The file."""

    @property
    def known_rig(self) -> Rig | None:
        """The rig of these PDOs, or None."""

    @property
    def pdos(self) -> tuple[RigPdo, ...]:
        """All PDOs with signals: the rig's, and the host's telemetry."""

    def __iter__(self) -> Iterator[Block]:
        """Yield the blocks."""

    def within(self, begin_s: float, end_s: float) -> Readable:
        """Return a source with all of this stretch of time, and perhaps more."""

    def extent(self) -> tuple[float, float] | None:
        """Return the times of the first and the last frame [s]; None without a frame."""

    def signal(self, name: str) -> Signal:
        """Return the rig's definition of a signal."""
