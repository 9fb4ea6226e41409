"""What a rig wants of its PC: times and the bit rate, the strictest of all its axes and buses."""

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
    window_s : how long of it the TPDOs have
    watchdog_s : after so long without a set-point, or a TPDO, somebody makes the rig safe
    loss_limit : share of cycles that may be lost
    bitrates_bit_s : bit rate of each bus by its channel
    frames : frames that all axes of a bus have in a cycle, at most
    """

    period_s: float
    window_s: float
    watchdog_s: float
    loss_limit: float
    bitrates_bit_s: dict[str, int]
    frames: int

    @classmethod
    def of(cls, rig: Rig) -> RigDemands:
        """Return what a rig wants."""
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
