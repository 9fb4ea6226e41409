r"""Hold and stroke, active and hybrid (Fig. 14), and the effect of hybrid's stick phase.

All figures come from recordings of runs through bus, nodes and PDOs. The hold and the stroke are
the rig's own schedule. A third experiment loads a stuck handle until it breaks away: a hand without
a spring gives one push, releases, and then pushes with a ramp to 1.15 F_s, slowly (1 s) and fast
(50 ms).

The stick phase of a brake has three variants. The choice matters, because the fluid lags 15 ms behind its set-point:

- entry `paper`, brake `spring`: the set-point is :math:`|K_p (x - x_{stuck})|` with x_stuck = x at
  entry, as printed. The set-point falls to 0 when the handle stops, and the handle must move again
  before the brake responds to a push: it jerks and breaks away at a fraction of F_s.
- entry `continuous`, brake `spring`: x_stuck = x - F/K_p. It starts at the slip's F_d, and the
  handle must still move before the brake responds.
- brake `hold`: F_s whenever stuck. A brake cannot push, so its set-point may exceed the load:
  nothing moves until F_s is exceeded. The entry then does not affect the brake.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.analysis.rig.runs import displayed, need_modes
from coulombus.lab.demo.traces import HANDLE, DemoTraces, traces
from coulombus.recording.measures import measure, phases, velocity
from coulombus.recording.reading import read
from coulombus.recording.signals import Recording
from coulombus.rigs.rig import Rig, RigError, load_rig

__all__ = ["STICK_VARIANTS", "Breakaway", "HoldRow", "HoldStudy", "breakaway", "hold_study"]

Floats: TypeAlias = npt.NDArray[np.float64]

STICK_VARIANTS = (("continuous", "hold"), ("continuous", "spring"), ("paper", "spring"))
SLOW_S, FAST_S = 1.0, 0.05
PUSH_F_S = 1.15
CREEP_F_S = 0.95
SLIDING_CYCLES = 5


@dataclass(frozen=True)
class Breakaway:
    """Response of a stuck handle to a ramp of the hand's push."""

    ramp_s: float
    torque_Nm: float | None
    """Hand's torque on the handle just before it slid; None: it never slid, or the torque is not measured.
    """
    share_of_F_s: float | None
    slid: bool
    crept_rad: float
    """Motion when the push reached 0.95 F_s; 0 for a perfectly stuck handle."""
    t_s: Floats
    """From the ramp's start."""
    angle_rad: Floats
    handle_Nm: Floats
    setpoint_Nm: Floats

    def verdict(self, share: str, of: str = "") -> str:
        """Return the share of F_s at which it slid, formatted as `share`; "slid" if the rig does
        not measure the hand's torque, "never" if it did not slide.
        """
        if self.share_of_F_s is not None:
            return f"{self.share_of_F_s:{share}}{of}"
        return "slid" if self.slid else "never"


@dataclass(frozen=True)
class HoldRow:
    """Figures of one display through the rig's own schedule, and of its break-away."""

    mode: str
    stick_entry: str
    brake_stick: str
    K_p_Nm_rad: float
    F_s_Nm: float
    F_d_Nm: float
    hold_velocity_rms_rad_s: float | None
    hold_counts_p2p: int | None
    hold_peak_Hz: float | None
    hold_push_Nm: float | None
    torque_flips_per_s: float | None
    stick_velocity_rms_rad_s: float | None
    slow: Breakaway | None
    fast: Breakaway | None

    def as_dict(self) -> dict[str, Any]:
        """Return plain values; for break-aways torque, share and creep."""
        values = asdict(self)
        for name in ("slow", "fast"):
            ramp: Breakaway | None = values.pop(name) and getattr(self, name)
            values[f"{name}_breakaway_Nm"] = ramp.torque_Nm if ramp else None
            values[f"{name}_breakaway_share"] = ramp.share_of_F_s if ramp else None
            values[f"{name}_slid"] = ramp.slid if ramp else None
            values[f"{name}_crept_rad"] = ramp.crept_rad if ramp else None
        return values


@dataclass(frozen=True)
class HoldStudy:
    """Active and hybrid, and hybrid in each variant of its stick phase."""

    rig: str
    rows: tuple[HoldRow, ...]
    """Active first, then hybrid in the order of `STICK_VARIANTS`."""
    traces: dict[str, DemoTraces]
    """Traces of active, and of hybrid with the rig's settings: Fig. 14."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Limitations of the figures for this rig."""
        ramps = [ramp for row in self.rows for ramp in (row.slow, row.fast) if ramp is not None]
        if not any(ramp.slid and ramp.torque_Nm is None for ramp in ramps):
            return ()
        return (
            "the rig does not measure the hand's torque ([role.handle_torque]): the torque at which it slid is not known",
        )

    def row(self, mode: str, stick_entry: str | None = None, brake_stick: str | None = None) -> HoldRow:
        """Return the first row of a mode, or of a variant of its stick phase."""
        for row in self.rows:
            if row.mode == mode and stick_entry in (None, row.stick_entry) and brake_stick in (None, row.brake_stick):
                return row
        raise KeyError(f"no row {mode}, {stick_entry}, {brake_stick}")

    def as_dict(self) -> dict[str, Any]:
        """Return the figures of all rows."""
        return {"rig": self.rig, "rows": [row.as_dict() for row in self.rows], "remarks": list(self.remarks)}


def _recorded(rig: Rig, mode: str, directory: Path, name: str, seed: int) -> Recording:
    return read(displayed(rig, mode, directory / f"{name}.pcapng", f"hold study ({name})", seed=seed))


def breakaway(recording: Recording, F_s_Nm: float, ramp_s: float) -> Breakaway:
    """Return the handle's response to the push of the recording's last phase, a ramp of `ramp_s` to 1.15 F_s."""
    ramp = phases(recording)[-1]
    period = recording.rig.bus.period_s
    angle, measured = recording["motor.position_rad"], recording.has(HANDLE)
    setpoint = recording["brake.setpoint_Nm"]
    count = abs(recording.scale("motor.position_rad"))
    t, v = velocity(angle.t_s, angle.values, period)
    inside = (t >= ramp.begin_s) & (t < ramp.end_s)
    x = angle.values[1:]
    start = float(x[inside][0])
    torque = np.full(len(t), np.nan)
    if measured:
        torque = np.interp(t, recording[HANDLE].t_s, np.abs(recording[HANDLE].values))
    slides = np.abs(v) > recording.rig.one_axis().law.velocity_band_counts * count / period
    lasting = np.convolve(slides[inside], np.ones(SLIDING_CYCLES), "valid") == SLIDING_CYCLES
    begins = int(np.argmax(lasting)) if np.any(lasting) else None
    broke = None if begins is None or not measured else float(torque[inside][max(begins - 1, 0)])
    near = np.argmax(t[inside] - ramp.begin_s >= CREEP_F_S / PUSH_F_S * ramp_s)
    return Breakaway(
        ramp_s=ramp_s,
        torque_Nm=broke,
        share_of_F_s=None if broke is None else broke / F_s_Nm,
        slid=begins is not None,
        crept_rad=float(np.max(np.abs(x[inside][: near + 1] - start))),
        t_s=t[inside] - ramp.begin_s,
        angle_rad=x[inside] - start,
        handle_Nm=torque[inside],
        setpoint_Nm=np.interp(t[inside], setpoint.t_s, setpoint.values),
    )


def _pushed(rig: Rig, ramp_s: float) -> Rig:
    push = PUSH_F_S * rig.one_axis().mode["hybrid"].F_s_Nm
    shove = f'{{kind="file", duration_s=0.6, t_s=[0.0, 0.02, 0.1, 0.12], torque_Nm=[0.0, {push}, {push}, 0.0]}}'
    ramp = f'{{kind="file", duration_s={ramp_s + 0.3}, t_s=[0.0, {ramp_s}], torque_Nm=[0.0, {push}]}}'
    return rig.variant(
        f'phase=[{{kind="rest", duration_s=1.5}}, {shove}, {ramp}]',
        "operator.stiffness_Nm_rad=0.0",
        "limits.speed_rad_s=100.0",  # the handle is fast after breakaway, which is permitted here
        "limits.net_work_J=5.0",
    )


def hold_study(
    rig: Rig | str | None = None, *, seed: int = 0, progress: Callable[[float], None] | None = None
) -> HoldStudy:
    """Run active and hybrid through the rig's schedule, and each variant of hybrid's stick phase.

    Default rig: bench.

    Raises
    ------
    coulombus.host.errors.SafetyTrip
        a run tripped; the text has the run, the reason and the remedy
    coulombus.rigs.rig.RigError
        the rig lacks a mode, or sticks with no torque
    """
    rig = load_rig(rig or "bench") if rig is None or isinstance(rig, str) else rig
    need_modes(rig, "active", "hybrid")
    axis = rig.one_axis()
    if not axis.mode["hybrid"].F_s_Nm > 0:
        raise RigError(
            [f"rig {rig.name!r}: mode.hybrid.F_s_Nm is 0; nothing sticks that could break away: set it above 0"]
        )
    rows, shown = [], {}
    runs = [("active", axis.law.stick_entry, axis.law.brake_stick)] + [("hybrid", *v) for v in STICK_VARIANTS]
    with tempfile.TemporaryDirectory(prefix="coulombus-") as directory:
        for done, (mode, entry, stick) in enumerate(runs, 1):
            variant = rig.variant(f'law.stick_entry="{entry}"', f'law.brake_stick="{stick}"')
            recording = _recorded(variant, mode, Path(directory), f"{mode}-{entry}-{stick}", seed)
            if mode not in shown:
                shown[mode] = traces(recording, mode)
            ramps: dict[str, Breakaway | None] = {"slow": None, "fast": None}
            F_s = axis.mode[mode].F_s_Nm
            if mode == "hybrid":
                for name, ramp_s in (("slow", SLOW_S), ("fast", FAST_S)):
                    pushed = _recorded(_pushed(variant, ramp_s), mode, Path(directory), f"{entry}-{stick}-{name}", seed)
                    ramps[name] = breakaway(pushed, F_s, ramp_s)
            figures = measure(recording)
            rows.append(
                HoldRow(
                    mode=mode,
                    stick_entry=entry,
                    brake_stick=stick,
                    K_p_Nm_rad=axis.mode[mode].K_p_Nm_rad,
                    F_s_Nm=F_s,
                    F_d_Nm=axis.mode[mode].F_d_Nm,
                    hold_velocity_rms_rad_s=figures.hold_velocity_rms_rad_s,
                    hold_counts_p2p=figures.hold_counts_p2p,
                    hold_peak_Hz=figures.hold_peak_Hz,
                    hold_push_Nm=figures.hold_push_Nm,
                    torque_flips_per_s=figures.torque_flips_per_s,
                    stick_velocity_rms_rad_s=figures.stick_velocity_rms_rad_s,
                    **ramps,
                )
            )
            if progress is not None:
                progress(done / len(runs))
    return HoldStudy(rig.name, tuple(rows), shown)
