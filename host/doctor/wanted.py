"""Requirements of a rig on its PC: times and bit rates, the strictest of all its axes and buses."""

from __future__ import annotations

from dataclasses import dataclass

from coulombus.rigs.rig import Rig

__all__ = ["RigDemands"]


@dataclass(frozen=True)
class RigDemands:
    """Limits of a rig.

    Attributes
    ----------
    period_s : SYNC period
    window_s : part of the period for the TPDOs
    watchdog_s : shortest watchdog: time without a set-point or TPDO after which host or device makes the
        rig safe
    loss_limit : largest share of lost cycles
    bitrates_bit_s : bit rate of each bus by its channel
    frames : largest number of frames of all axes in a cycle
    """

    period_s: float
    window_s: float
    watchdog_s: float
    loss_limit: float
    bitrates_bit_s: dict[str, int]
    frames: int

    @classmethod
    def from_rig(cls, rig: Rig) -> RigDemands:
        """Return the requirements of a rig."""
        period_s = min(bus.period_s for bus in rig.buses)
        limits = [axis.limits.missed_tpdo_cycles * period_s for axis in rig.axes]
        for axis in rig.axes:
            limits += [
                time
                for section in (axis.motor, axis.brake)
                for time in (section.setpoint_fault_s, section.sync_timeout_s)
            ]
        return cls(
            period_s=period_s,
            window_s=max(bus.tpdo_window_s for bus in rig.buses),
            watchdog_s=min(limits),
            loss_limit=rig.host.loss_limit,
            bitrates_bit_s={bus.channel: bus.bitrate_bit_s for bus in rig.buses},
            frames=2 + len(rig.pdos()),
        )

    def __str__(self) -> str:
        rate = 1 / self.period_s
        frequency = f"{rate / 1000:g} kHz" if rate >= 1000 else f"{rate:g} Hz"
        return f"{frequency} with {self.watchdog_s * 1e3:g} ms watchdogs"
