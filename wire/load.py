"""How much of a cycle the bus is busy with a rig's own cyclic frames, in the worst case of bit stuffing."""

from __future__ import annotations

from dataclasses import dataclass

from eds.rig import Rig
from wire.bits import worst_case_bits

__all__ = ["CycleLoad", "FrameLoad", "cycle_load"]


@dataclass(frozen=True)
class FrameLoad:
    """One frame of the cycle."""

    name: str
    can_id: int
    length: int
    bits: int
    """Worst case, inter-frame space included."""


@dataclass(frozen=True)
class CycleLoad:
    """All frames of one cycle: SYNC and every PDO once."""

    frames: tuple[FrameLoad, ...]
    bitrate_bit_s: int
    period_s: float

    @property
    def busy_s(self) -> float:
        """Time that the frames of a cycle take in the worst case."""
        return sum(frame.bits for frame in self.frames) / self.bitrate_bit_s

    @property
    def utilisation(self) -> float:
        """Share of the period."""
        return self.busy_s / self.period_s

    @property
    def fits(self) -> bool:
        """False when the cycle cannot be had at this bit rate."""
        return self.utilisation <= 1.0


def cycle_load(rig: Rig) -> CycleLoad:
    """Return the worst-case load of `rig`'s cycle."""
    frames = [FrameLoad("SYNC", 0x80, 0, worst_case_bits(0))]
    for pdo in rig.pdos():
        layout = pdo.layout
        name = f"{pdo.node} {layout.direction.upper()}{layout.number}"
        frames.append(FrameLoad(name, layout.cob_id, layout.length, worst_case_bits(layout.length)))
    return CycleLoad(tuple(sorted(frames, key=lambda f: f.can_id)), rig.bus.bitrate_bit_s, rig.bus.period_s)
