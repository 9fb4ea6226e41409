"""What a run came to, in virtual time or on a rig."""

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

__all__ = ["Doubts", "RunResult", "Timing", "file_sha256"]


@dataclass(frozen=True, kw_only=True)
class Timing:
    """How a run kept time. None: virtual time has no such figure."""

    period_ns: int
    missed_deadlines: int
    lost_pdos: int
    wakeup_us: dict[str, float] | None = None
    sync_to_rpdo_us: dict[str, float] | None = None
    cpu_us_per_cycle: float | None = None
    real_time: list[dict[str, Any]] | None = None
    """Each real-time right that the data plane asked for: name, granted, detail, remedy."""
    simulated_s: float


@dataclass(frozen=True, kw_only=True)
class Doubts:
    """What went wrong in a run, or was made to."""

    trip: str | None
    trip_ns: int | None = None
    """When the trip was, in the recording's time."""
    stopped_by: str | None = None
    """Who ended the run before its time without a trip: SIGINT, SIGTERM, "coulombus stop"."""
    remarks: tuple[str, ...] = ()
    """Where the display was not what the rig file says: a limit cut the law off, or the hand began
    before the law's gain was 1.
    """
    losses: list[str] | None = None
    """What bring-up left out, as a device is not ours or has no such object, and what the host
    loses by that.
    """
    opened: list[str] | None = None
    """What simulated devices have otherwise than their EDS files, as the real ones have.

    None on a rig, and where nothing was opened.
    """
    faults: list[dict[str, Any]] | None = None
    """What each fault of a fault file came to: kind, line, times, first_s, last_s."""
    controllers: dict[str, dict[str, Any]] | None = None
    """State and error counters of each node's CAN controller at the end, where there was a fault
    file.
    """


@dataclass(frozen=True, kw_only=True)
class RunResult(Doubts, Timing, Measures):
    """What a run came to: the display's figures, its timing, its doubts, and where all that is
    recorded.

    Figures of the display are None when nothing was recorded, or without the phase they belong to.
    """

    mode: str
    cycles: int
    """Cycles from Operation Enabled to the end of the display."""
    recording: str | None
    recording_sha256: str | None
    sign_check: str
    full_gain_s: float | None = None
    """When the law was shown whole, its gain at 1: from Operation Enabled, where the operator's
    schedule begins.
    """
    counters: dict[str, int]
    exit_status: int
    bus: str | None = None
    """Where the run was; None in virtual time."""
    deadman: str | None = None
    axes: dict[str, dict[str, Any]] | None = None
    """Each axis' own figures by its name; None where the rig has one axis. The figures of hold and
    dwells above are then those of the first, `cycles` and `full_gain_s` the most, `sign_check` the
    one that leaves the most doubt, and all counters sums.
    """
    buses: dict[str, dict[str, Any]] | None = None
    """Each bus' own result by its channel; None where the rig has one bus."""

    @classmethod
    def of(
        cls,
        host: Controllers,
        figures: Sequence[Measures],
        *,
        record: Path | None,
        trip: str | None,
        losses: Sequence[str],
        **own: Any,
    ) -> RunResult:
        """Return what a run came to: what is alike in virtual time and on a rig from its
        controllers, the rest as given.

        Parameters
        ----------
        figures : the display's, of each axis
        own : the fields that are left
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
            **own,
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        return asdict(self)


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file, read in blocks."""
    with naming(path), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _axis_results(controllers: Controllers, figures: Sequence[Measures]) -> dict[str, dict[str, Any]] | None:
    """Return what a run came to for each axis; None where there is only one."""
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
