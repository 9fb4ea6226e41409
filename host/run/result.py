"""Result of a run, in virtual time or on a rig."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from coulombus.eds.regular_file import naming
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.run.schedule import display_remarks, full_gain_s
from coulombus.recording.measures import Measures

__all__ = ["Doubts", "RunResult", "RunTiming", "file_sha256"]


@dataclass(frozen=True, kw_only=True)
class RunTiming:
    """Timing of a run. None: virtual time has no such figure."""

    period_ns: int
    missed_deadlines: int
    lost_pdos: int
    wakeup_us: dict[str, float] | None = None
    sync_to_rpdo_us: dict[str, float] | None = None
    sync_skew_us: dict[str, float] | None = None
    """Time from the SYNC on the first bus to that on the last, as sent; None on one bus."""
    cpu_us_per_cycle: float | None = None
    real_time: list[dict[str, Any]] | None = None
    """Real-time rights that the data plane requested: name, granted, detail, remedy."""
    simulated_s: float


@dataclass(frozen=True, kw_only=True)
class Doubts:
    """Trips, remarks, losses and injected faults of a run."""

    trip: str | None
    trip_ns: int | None = None
    """Time of the trip, in the recording's time."""
    stopped_by: str | None = None
    """Cause of an early end without a trip: SIGINT, SIGTERM, "coulombus stop", "a key"."""
    remarks: tuple[str, ...] = ()
    """Deviations of the display from the rig file: a limit clipped the law, or the hand began before the
    law's gain was 1.
    """
    losses: list[str] | None = None
    """Settings that bring-up left out, because a device is third-party or lacks the object, each with the
    protection that the host loses.
    """
    opened: list[str] | None = None
    """Differences of simulated devices from their EDS files, as in the real devices.

    None on a rig, and if there are none.
    """
    faults: list[dict[str, Any]] | None = None
    """Effect of each fault of a fault file: kind, line, times, first_s, last_s."""
    controllers: dict[str, dict[str, Any]] | None = None
    """State and error counters of each node's CAN controller at the end, in a run with a fault file."""


@dataclass(frozen=True, kw_only=True, repr=False)
class RunResult(Doubts, RunTiming, Measures):
    """Result of a run: the display's figures, timing, `Doubts`, and the recording.

    Figures of the display are None without a recording, or without their phase of the schedule.
    """

    mode: str
    cycles: int
    """Cycles from Operation Enabled to the end of the display."""
    recording: str | None
    recording_sha256: str | None
    sign_check: str
    full_gain_s: float | None = None
    """Time from Operation Enabled, where the operator's schedule begins, to the law's gain 1."""
    counters: dict[str, int]
    exit_status: int
    bus: str | None = None
    """Address of the bus; None in virtual time."""
    deadman: str | None = None
    axes: dict[str, dict[str, Any]] | None = None
    """Figures of each axis by its name; None for a rig with one axis. With several axes, the figures of
    hold and dwells above are those of the first axis, `cycles` and `full_gain_s` the largest,
    `sign_check` the worst, and all counters sums.
    """
    buses: dict[str, dict[str, Any]] | None = None
    """Result of each bus by its channel; None for a rig with one bus."""
    plane: dict[str, Any] | None = None
    """Figures of an arm in the plane: the net work of each motor, the smallest condition of the Jacobian, and, of a
    simulated arm, how the displayed force differs from the law's. None for a rig of independent axes.
    """

    def __repr__(self) -> str:
        """Return the figures that the run has, one in a line; `as_dict` has all."""
        shown = {
            name: f"{value:.6g}" if isinstance(value, float) else value
            for name, value in (vars(self) | {"counters": {key: n for key, n in self.counters.items() if n}}).items()
            if value not in (None, (), [], {}) and name not in ("mode", "trip")
        }
        lines = (f"\n  {name}: {value}" for name, value in shown.items())
        return f"<run in mode {self.mode}: {f'trip {self.trip}' if self.trip else 'no trip'}{''.join(lines)}>"

    @classmethod
    def from_controllers(
        cls,
        host: Controllers,
        figures: Sequence[Measures],
        *,
        record: Path | None,
        trip: str | None,
        losses: Sequence[str],
        **world_fields: Any,
    ) -> RunResult:
        """Return the result of a run from its controllers.

        Parameters
        ----------
        figures : the display's figures of each axis
        world_fields : fields that differ between virtual time and a rig
        """
        return cls(
            mode=host.mode,
            cycles=int(host.host["display_cycles"].max()),
            period_ns=int(host.control["period_ns"][0]),
            lost_pdos=int(host.host["lost_pdos"].sum()),
            recording=None if record is None else str(record),
            trip=trip,
            **asdict(figures[0]),
            sign_check=host.sign_result.name.lower(),
            axes=_axis_results(host, figures),
            full_gain_s=full_gain_s(host),
            remarks=display_remarks(host),
            losses=list(losses) or None,
            **world_fields,
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        return asdict(self)


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file, read in blocks."""
    with naming(path), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _axis_results(controllers: Controllers, figures: Sequence[Measures]) -> dict[str, dict[str, Any]] | None:
    """Return the result of each axis by its name; None for a rig with one axis."""
    if not controllers.rig.axis_names:
        return None
    return {
        k.axis.name: {
            "cycles": int(k.host["display_cycles"][0]),
            "lost_pdos": int(k.host["lost_pdos"][0]),
            "trip": k.trip,
            "sign_check": k.sign_result.name.lower(),
            "counters": k.counters(),
            **asdict(measures),
        }
        for k, measures in zip(controllers, figures, strict=True)
    }
