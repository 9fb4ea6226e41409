r"""The most friction, and the stiffest wall, that a motor alone may display on a device without chatter.

Whoever displays friction with a motor, on a wheel, a knob or a handle, knows the rattle: the law changes the
sign of its torque a sample late, and the handle swings for ever. How much friction is quiet depends on what
the device itself dissipates, on the encoder and on the delay. Between two samples a torque :math:`F` changes
the speed by :math:`F T / J`; what then moves the handle by a count before the device's own friction and damping
stop it changes the torque's sign again.

The answer is a simulation, not a formula: `analysis.theory.sampled_loop` with the law, after taps of 32 speeds
(`analysis.rig.maps`). Whether a level chatters depends on the tap, because what decides is where between two
counts the handle comes to rest. So two levels are told, each enclosed to 1.5 %: the most at which fewer than half of
the taps start a limit cycle, and the sure one, at which none does.

The wall is a spring without damping, on both sides. Its loop is linear, so its bound is exact: the stiffness at which
an eigenvalue of a sample's step leaves the unit circle. The device's own friction and its encoder are not in it.

A brake displays friction without a limit cycle, because it can only dissipate: with a brake of N Nm the quiet
level is N, plus the motor's own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from scipy.linalg import expm

from coulombus.analysis.rig.maps import Floats, LoopParameters, oscillation_map
from coulombus.analysis.theory.bounds import Bounds, bounds

__all__ = ["Chatter", "Quiet", "QuietCurve", "chatter", "device"]

TAPS, SLOWEST_COUNTS, FASTEST_COUNTS = 32, 1.5, 60.0
"""Taps, and the speed after the slowest and the fastest of them, in counts a sample of the device."""
SETTLE_S, WINDOW_S = 2.0, 1.0
COARSE, FINE = 65, 25
ENCODERS = (("this encoder", 1.0), ("4 times the counts", 4.0), ("16 times the counts", 16.0))
RATES = np.geomspace(0.25, 4.0, 9)
REMEDIES: tuple[tuple[str, dict[str, float]], ...] = (
    ("twice the rate", {"rate_Hz": 2.0}),
    ("4 times the rate", {"rate_Hz": 4.0}),
    ("4 times the counts", {"count_rad": 1 / 4}),
    ("16 times the counts", {"count_rad": 1 / 16}),
    ("half the delay", {"delay_s": 0.5}),
    ("twice the damping", {"viscous_Nms_rad": 2.0}),
    ("twice the own friction", {"coulomb_Nm": 2.0}),
)
"""What helps: its name, and the factors of the fields of `LoopParameters`."""


@dataclass(frozen=True)
class Quiet:
    """What is quiet on a device.

    A level is 0 if already the smallest that was tried chatters, and infinite if none does. A frequency is that of the
    limit cycle just above, NaN if there is none.
    """

    friction_Nm: float
    """Of the law c sgn(v): at most so much, and fewer than half of the taps start a limit cycle."""
    sure_Nm: float
    """At most so much, and none does."""
    frequency_Hz: float
    stiffness_Nm_rad: float
    """Of a wall on both sides, without damping."""
    wall_frequency_Hz: float


@dataclass(frozen=True)
class QuietCurve:
    """Quiet friction [Nm] over the rate [Hz], for one encoder."""

    name: str
    rate_Hz: Floats
    friction_Nm: Floats


@dataclass(frozen=True)
class Chatter:
    """What a motor alone may display on a device, and what each remedy buys."""

    loop: LoopParameters
    quiet: Quiet
    remedies: dict[str, Quiet]
    bounds: Bounds
    """Of the literature, for the wall of `quiet`."""
    brake_Nm: float
    curves: tuple[QuietCurve, ...]
    """Empty unless they were asked for."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; what has no bound is null."""

        def level(value: float) -> float | None:
            return value if math.isfinite(value) else None

        def plain(quiet: Quiet) -> dict[str, float | None]:
            return {
                "friction_max_Nm": level(quiet.friction_Nm),
                "friction_sure_Nm": level(quiet.sure_Nm),
                "frequency_Hz": level(quiet.frequency_Hz),
                "stiffness_max_Nm_rad": level(quiet.stiffness_Nm_rad),
                "wall_frequency_Hz": level(quiet.wall_frequency_Hz),
            }

        return {
            **plain(self.quiet),
            "with_brake_friction_max_Nm": level(self.brake_Nm + self.quiet.friction_Nm) if self.brake_Nm else None,
            "remedies": {name: plain(quiet) for name, quiet in self.remedies.items()},
            "certified_stiffness_Nm_rad": {
                "colgate": level(self.bounds.colgate_Nm_rad),
                "abbott_okamura": level(self.bounds.abbott_okamura_Nm_rad),
                "diolaiti": level(self.bounds.diolaiti_Nm_rad),
            },
            "device": {f.name: getattr(self.loop, f.name) for f in fields(self.loop)},
        }

    def lines(self) -> list[str]:
        """Return the text of a terminal."""
        rows = [("this device", self.quiet), *self.remedies.items()]
        text = [f"{'':22}{'friction':>13}{'sure':>13}{'at':>8}{'wall':>16}{'at':>8}"]
        for name, quiet in rows:
            text.append(
                f"{name:22}{_quantity(quiet.friction_Nm, 'Nm'):>13}{_quantity(quiet.sure_Nm, 'Nm'):>13}"
                f"{_quantity(quiet.frequency_Hz, 'Hz', 3):>8}{_quantity(quiet.stiffness_Nm_rad, 'Nm/rad'):>16}"
                f"{_quantity(quiet.wall_frequency_Hz, 'Hz', 3):>8}"
            )
        if self.brake_Nm:
            name = f"a brake of {self.brake_Nm:g} Nm"
            text.append(f"{name:22}{_quantity(self.brake_Nm + self.quiet.friction_Nm, 'Nm'):>13}")
        b = self.bounds
        text += [
            "",
            "friction: the most that the motor alone displays before half of the taps start a limit cycle;",
            "sure: before any of them does; wall: a spring that is stable, exactly; at: frequency just above",
            f"certified for any passive hand: a wall of {_quantity(min(b.colgate_Nm_rad, b.diolaiti_Nm_rad), 'Nm/rad')} (Colgate, Diolaiti)",
        ]
        return text


def _quantity(value: float, unit: str, digits: int = 4) -> str:
    if math.isnan(value):
        return "-"
    return "no bound" if math.isinf(value) else f"{value:.{digits}g} {unit}"


def device(
    inertia_kg_m2: float,
    rate_Hz: float,
    counts: float,
    delay_s: float = 0.0,
    *,
    damping_Nms_rad: float = 0.0,
    friction_Nm: float = 0.0,
    lag_s: float = 0.0,
    limit_Nm: float = math.inf,
    hand: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> LoopParameters:
    """Return the loop of a device.

    Parameters
    ----------
    inertia_kg_m2, damping_Nms_rad, friction_Nm : of the device, at the handle
    rate_Hz : of the samples
    counts : of the encoder for a turn of the handle, all edges counted
    delay_s : from sampling to actuation
    lag_s, limit_Nm : of the motor
    hand : inertia [kg m2], damping [Nms/rad] and stiffness [Nm/rad] of the hand that holds it

    Raises
    ------
    ValueError
        a number is not finite, is negative, or is 0 where it may not be; the text has its name
    """
    for name, value in (("inertia_kg_m2", inertia_kg_m2), ("rate_Hz", rate_Hz), ("counts", counts)):
        if not 0 < value < math.inf:
            raise ValueError(f"{name} = {value!r}: expected a finite number above 0")
    return LoopParameters(
        inertia_kg_m2=inertia_kg_m2,
        viscous_Nms_rad=damping_Nms_rad,
        coulomb_Nm=friction_Nm,
        operator_inertia_kg_m2=hand[0],
        operator_damping_Nms_rad=hand[1],
        operator_stiffness_Nm_rad=hand[2],
        rate_Hz=rate_Hz,
        delay_s=delay_s,
        motor_lag_s=lag_s,
        motor_limit_Nm=min(limit_Nm, 1e9),
        torque_step_Nm=0.0,
        count_rad=2 * math.pi / counts,
        velocity_band_counts=0.0,
        compensation_Nm=0.0,
        tap_rad_s=FASTEST_COUNTS * 2 * math.pi / counts * rate_Hz,
        settle_s=SETTLE_S,
        window_s=WINDOW_S,
    )


def chatter(
    loop: LoopParameters,
    *,
    brake_Nm: float = 0.0,
    curves: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Chatter:
    """Find what is quiet on a device, and with each remedy.

    Parameters
    ----------
    loop : the device, as from `device`; its law is not looked at, and its tap is the fastest
    brake_Nm : of a brake beside the motor; 0: none
    curves : find the quiet friction over the rate, too, for three encoders
    progress : called with the finished share of the work, 0 to 1

    Raises
    ------
    ValueError
        a parameter is out of range; the text has its name
    """
    if not 0 <= brake_Nm < math.inf:
        raise ValueError(f"brake_Nm = {brake_Nm!r}: expected a finite number of at least 0")
    useful = [(name, factors) for name, factors in REMEDIES if all(getattr(loop, key) > 0 for key in factors)]
    encoders = ENCODERS if curves else ()
    steps, done = 1 + len(useful) + len(encoders) * len(RATES), 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done / steps)

    quiet = _quiet(loop)
    step()
    remedies = {}
    for name, factors in useful:
        remedies[name] = _quiet(replace(loop, **{key: getattr(loop, key) * f for key, f in factors.items()}))
        step()
    by_encoder = []
    for name, finer in encoders:
        levels = []
        for factor in RATES:
            other = replace(loop, rate_Hz=loop.rate_Hz * factor, count_rad=loop.count_rad / finer)
            levels.append(_friction(other)[0])
            step()
        by_encoder.append(QuietCurve(name, loop.rate_Hz * RATES, np.array(levels)))
    literature = bounds(
        quiet.stiffness_Nm_rad if math.isfinite(quiet.stiffness_Nm_rad) else 0.0,
        loop.viscous_Nms_rad,
        loop.coulomb_Nm,
        1.0 / loop.rate_Hz,
        loop.delay_s + loop.motor_lag_s,
        loop.count_rad,
    )
    return Chatter(loop, quiet, remedies, literature, brake_Nm, tuple(by_encoder))


def _quiet(loop: LoopParameters) -> Quiet:
    return Quiet(*_friction(loop), *_wall(loop))


def _friction(loop: LoopParameters) -> tuple[float, float, float]:
    """Return the quiet friction of the law c sgn(v), the sure one [Nm], and the frequency above the first [Hz]."""
    inertia = loop.inertia_kg_m2 + loop.operator_inertia_kg_m2
    one_count = inertia * loop.count_rad * loop.rate_Hz**2  # changes the speed by a count a sample, in a sample
    relay = replace(loop, relay=True, friction_level=1.0)
    low, high = 1e-5 * min(one_count, 1.0), min(1e4 * (one_count + loop.coulomb_Nm), loop.motor_limit_Nm)
    (friction_Nm, frequency_Hz), (sure, _) = _enclosed(relay, "F_d_Nm", (low, max(high, 2 * low)), (0.5, 0.0))
    return friction_Nm, min(friction_Nm, sure), frequency_Hz


def _wall(loop: LoopParameters) -> tuple[float, float]:
    """Return the stiffness [Nm/rad] at which the wall's largest eigenvalue meets the unit circle, and its frequency [Hz]."""
    low, high = 0.0, 4.0 * (loop.inertia_kg_m2 + loop.operator_inertia_kg_m2) * loop.rate_Hz**2
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.abs(_eigenvalues(loop, middle)).max() < 1.0 else (low, middle)
    values = _eigenvalues(loop, high)
    first = values[np.argmax(np.abs(values))]
    return low, float(abs(np.angle(first))) * loop.rate_Hz / (2 * math.pi)


def _eigenvalues(loop: LoopParameters, K_Nm_rad: float) -> Floats:
    """Return the eigenvalues of a sample's step with a wall: (x, v, motor's torque, torques under way)."""
    inertia = loop.inertia_kg_m2 + loop.operator_inertia_kg_m2
    damping = loop.viscous_Nms_rad + loop.operator_damping_Nms_rad
    plant = np.zeros((4, 4))  # x, v, the motor's torque, the set-point
    plant[0, 1] = 1.0
    plant[1, :3] = -loop.operator_stiffness_Nm_rad / inertia, -damping / inertia, 1.0 / inertia
    if loop.motor_lag_s > 0:
        plant[2, 2:] = -1.0 / loop.motor_lag_s, 1.0 / loop.motor_lag_s

    def over(seconds: float) -> Floats:
        """The step with a set-point that acts for `seconds`."""
        at_once = np.eye(4)
        if not loop.motor_lag_s > 0:
            at_once[2] = 0.0, 0.0, 0.0, 1.0
        return np.asarray(expm(plant * seconds) @ at_once)

    period, whole = 1.0 / loop.rate_Hz, math.floor(loop.delay_s * loop.rate_Hz + 1e-9)
    early = max(loop.delay_s - whole * period, 0.0)  # so long the older of two set-points still acts
    one = np.eye(5 + whole)  # x, v, the torque, and the set-points: of this sample, ..., of whole + 1 samples ago
    sampled = np.vstack([one[:3, :-1], -K_Nm_rad * one[0, :-1], one[3:-1, :-1]])
    moved = over(early) @ np.vstack([one[:3], one[-1]])
    moved = over(period - early) @ np.vstack([moved[:3], one[-2]])
    return np.asarray(np.linalg.eigvals(np.vstack([moved[:3], one[3:-1]]) @ sampled))


def _enclosed(
    loop: LoopParameters, name: str, ends: tuple[float, float], shares: tuple[float, ...]
) -> list[tuple[float, float]]:
    """Return, for each share of the taps, the level of a parameter from which on more start a limit cycle, and the
    frequency there.
    """
    slowest = SLOWEST_COUNTS * loop.count_rad * loop.rate_Hz
    taps = np.geomspace(slowest, max(loop.tap_rad_s, 2 * slowest), TAPS).tolist()
    levels = np.geomspace(*ends, COARSE)
    coarse = oscillation_map({name: levels}, base=loop, taps_rad_s=taps)
    thresholds = []
    for share in shares:
        above = coarse.share > share
        k = int(np.argmax(above))
        if not above.any():
            thresholds.append((math.inf, math.nan))
        elif k == 0:
            thresholds.append((0.0, float(coarse.frequency_Hz[0])))
        else:
            within = np.geomspace(levels[k - 1], levels[k], FINE)
            fine = oscillation_map({name: within}, base=loop, taps_rad_s=taps)
            k = max(1, int(np.argmax(fine.share > share)))
            thresholds.append((float(within[k - 1]), float(fine.frequency_Hz[k])))
    return thresholds
