r"""Display accuracy: torque felt by the hand compared with the law, by simulation.

The experiments are runs through bus, nodes and PDOs, judged by the plant's true course: the torque
between hand and handle, not the host's estimate.

- *breakaway*: a hand without a spring pushes a stuck handle with a torque ramp [Nm/s]. The hand's
  torque when the handle reaches `SLIDES_RAD_S` is compared with F_s.
- *sliding*: a damped hand moves the handle at a constant speed, back and forth. The mean torque
  after the brake has settled is compared with F_d; F_s is F_d, so there is no stick.
- *falling*: the same with F_d of `FALL` F_s. The hand breaks the handle loose, and then lets it
  slow down to the speed. A display that mistakes slow sliding for stick stops it: the handle is at
  rest, and the hand feels F_s to move it again.

The control ``brake`` is the law's level as the brake's set-point, with the paper's band of
velocity. The control ``felt`` subtracts the device's own friction, estimates slow velocities, and
compensates the brake's lags by a lead. The error budget is the control ``felt`` with one wrong
assumption at a time.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.analysis.rig.runs import need_modes
from coulombus.host.errors import SafetyTrip
from coulombus.lab.simulate import simulate
from coulombus.recording.measures import phases
from coulombus.recording.reading import blocks
from coulombus.rigs.rig import Rig, load_rig
from coulombus.sim_bus.rig.plant import TRUTH_COLUMNS

__all__ = ["Felt", "FeltStudy", "broke_away", "falling_rows", "felt_control", "felt_study", "iron_of", "slid"]

Floats: TypeAlias = npt.NDArray[np.float64]

EXPERIMENTS = ("breakaway", "sliding", "falling")
LEVELS_NM = (1.0, 2.0, 4.0)
RATES_NM_S = (1.0, -1.0, 30.0, -30.0)
SPEEDS_RAD_S = (0.02, 0.05, 0.2, 1.0)
BUDGET_NM = 2.0
FALL = 0.75
"""Ratio F_d / F_s of friction that falls with the speed."""
STANDS = 0.5
"""Ratio to the hand's speed below which the handle is at rest or creeps."""
LOOSE = 1.1
"""Torque that breaks the handle loose, as a multiple of F_s plus the device's own friction."""
IRON = (0.1, 0.4), (0.2, 0.2)
"""Half plays [Nm] and weights of an example of hysteresis."""
SLIDES_RAD_S = 1e-4
WINDOW_CYCLES = 32
REST_S = 1.5
HAND_NMS_RAD = 5.0
SETTLE_S, SLIDE_S = 1.0, 1.0


@dataclass(frozen=True)
class Felt:
    """One figure: the desired and the felt torque."""

    control: str
    """``brake`` or ``felt``, followed by the wrong assumption."""
    experiment: str
    of: float
    """Rate of the push [Nm/s], or speed [rad/s]; signed by direction."""
    wanted_Nm: float
    felt_Nm: float

    @property
    def error(self) -> float:
        """Relative error."""
        return self.felt_Nm / self.wanted_Nm - 1.0


@dataclass(frozen=True)
class FeltStudy:
    """Felt torques with either control, and the error budget."""

    rig: str
    rows: tuple[Felt, ...]

    def worst(self) -> dict[tuple[str, str], float]:
        """Return the largest relative error of each control and experiment, by its size."""
        largest: dict[tuple[str, str], float] = {}
        for row in self.rows:
            key = row.control, row.experiment
            largest[key] = max(largest.get(key, 0.0), abs(row.error))
        return largest

    def as_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return {"rig": self.rig, "rows": [{**asdict(row), "error": row.error} for row in self.rows]}

    def lines(self) -> Iterator[str]:
        """Yield the largest errors as text."""
        yield f"rig {self.rig}; largest error of what the hand feels, as a share of F_s or F_d"
        yield f"{'control':<34} " + " ".join(f"{name:>10}" for name in EXPERIMENTS)
        worst = self.worst()
        for control in dict.fromkeys(row.control for row in self.rows):
            yield f"{control:<34} " + " ".join(f"{worst[control, name]:>10.2%}" for name in EXPERIMENTS)
        yield f"sliding: F_d is F_s; falling: F_d is {FALL:g} F_s"


def felt_control(rig: Rig) -> Rig:
    """Return `rig` with the control ``felt``; its model of the brake's lags and iron equals the simulated rig."""
    plant = rig.one_axis().simulation.plant
    return rig.variant(
        'law.level="felt"',
        f"law.velocity_window_cycles={WINDOW_CYCLES}",
        f"brake.coil_lag_s={plant.brake_coil_lag_s}",
        f"brake.fluid_lag_s={plant.brake_fluid_lag_s}",
        *(() if plant.iron is None else iron_of("brake", plant.iron.play_Nm, plant.iron.weights)),
    )


def iron_of(section: str, play_Nm: Sequence[float], weights: Sequence[float]) -> tuple[str, str]:
    """Return the overrides that give ``[plant.iron]`` or ``[brake.iron]`` these play operators."""
    return f"{section}.iron.play_Nm={list(play_Nm)}", f"{section}.iron.weights={list(weights)}"


def _wrong_beliefs(rig: Rig) -> dict[str, tuple[str, ...]]:
    """Return the wrong assumption of each row of the error budget: the true value changes, the model stays."""
    plant = rig.one_axis().simulation.plant
    friction_Nm = 0.1 * (plant.coulomb_Nm + plant.brake_off_state_Nm)
    return {
        "friction 10 % more": (f"plant.coulomb_Nm={plant.coulomb_Nm + friction_Nm}",),
        "friction 10 % less": (f"plant.coulomb_Nm={max(plant.coulomb_Nm - friction_Nm, 0.0)}",),
        "viscous friction doubled": (f"plant.viscous_Nms_rad={2 * plant.viscous_Nms_rad}",),
        "brake 2 % stronger": (f"plant.brake_gain={1.02 * plant.brake_gain}",),
        "brake's lags 30 % longer": (
            f"plant.brake_coil_lag_s={1.3 * plant.brake_coil_lag_s}",
            f"plant.brake_fluid_lag_s={1.3 * plant.brake_fluid_lag_s}",
        ),
        "iron remembers 2 %": ("plant.brake_remanence=0.02",),
        "iron with minor loops": iron_of("plant", *IRON),
        "the same, inverted": (*iron_of("plant", *IRON), *iron_of("brake", *IRON)),
        "the same, weights believed half": (
            *iron_of("plant", *IRON),
            *iron_of("brake", IRON[0], [0.5 * value for value in IRON[1]]),
        ),
        "cogging of 0.01 Nm": ("plant.cogging_Nm=0.01",),
    }


def _truth(rig: Rig, mode: str, seconds: float, seed: int) -> dict[str, Floats]:
    """Return the plant's true course in the last phase of a run; t_s counts from its begin."""
    with tempfile.TemporaryDirectory(prefix="coulombus-") as directory:
        path, recording = Path(directory) / "truth.npz", Path(directory) / "run.pcapng"
        result = simulate(rig, mode, seconds, truth=path, record=recording, seed=seed)
        if result.trip is not None:
            raise SafetyTrip(f"rig {rig.name!r}, mode {mode}: the run tripped: {result.trip}")
        last = phases(blocks(recording))[-1]
        with np.load(path) as file:
            inside = (file["t_s"] > last.begin_s) & (file["t_s"] <= last.end_s)
            truth = {name: np.asarray(file[name][inside], np.float64) for name in TRUTH_COLUMNS}
        truth["t_s"] -= last.begin_s
        return truth


def _levels(rig: Rig, mode: str, F_s_Nm: float, F_d_Nm: float, *more: str) -> Rig:
    return rig.variant(
        f"mode.{mode}.F_s_Nm={F_s_Nm}",
        f"mode.{mode}.F_d_Nm={F_d_Nm}",
        "operator.stiffness_Nm_rad=0.0",
        "operator.tremor_Nm=0.0",
        "limits.speed_rad_s=100.0",
        "limits.net_work_J=5.0",
        "limits.still_rad=0.0",
        "limits.sign_check_counts=4",  # such a damped hand permits no larger motion
        *more,
    )


def _torque(points: Iterable[tuple[float, float]]) -> str:
    t, torque = zip(*points, strict=True)
    times, torques = ", ".join(f"{number:.9g}" for number in t), ", ".join(f"{number:.9g}" for number in torque)
    return f'{{kind="file", duration_s={t[-1]:.9g}, t_s=[{times}], torque_Nm=[{torques}]}}'


def broke_away(rig: Rig, F_s_Nm: float, rate_Nm_s: float, *, mode: str = "hybrid", seed: int = 0) -> float:
    """Return the hand's torque [Nm] at which a stuck handle starts to slide under a ramp of
    `rate_Nm_s` (signed by direction). NaN: it never slides.
    """
    ramp_s = 1.3 * F_s_Nm / abs(rate_Nm_s)
    phase = _torque([(0.0, 0.0), (ramp_s, rate_Nm_s * ramp_s)])
    pushed = _levels(rig, mode, F_s_Nm, 0.9 * F_s_Nm, f'phase=[{{kind="rest", duration_s={REST_S}}}, {phase}]')
    # the motion afterwards is irrelevant: the hand's damping keeps it within the limits
    truth = _truth(pushed.variant("operator.damping_Nms_rad=2.0"), mode, REST_S + ramp_s, seed)
    pushes = truth["operator_Nm"] * np.sign(rate_Nm_s)
    slides = (np.abs(truth["speed_rad_s"]) > SLIDES_RAD_S) & (pushes > 0.5 * F_s_Nm)
    return float(pushes[np.argmax(slides)]) if np.any(slides) else float("nan")


def slid(
    rig: Rig,
    F_d_Nm: float,
    speeds_rad_s: Iterable[float],
    *,
    F_s_Nm: float | None = None,
    mode: str = "hybrid",
    seed: int = 0,
) -> list[tuple[float, float]]:
    """Return (signed speed [rad/s], mean opposing torque [Nm]) for each speed in both directions,
    after the display has settled.

    Parameters
    ----------
    F_s_Nm : default is `F_d_Nm`; if larger, the hand first breaks the handle loose
    """
    legs = [sign * speed for speed in speeds_rad_s for sign in (1.0, -1.0)]
    plant = rig.one_axis().simulation.plant
    F_s = F_d_Nm if F_s_Nm is None else F_s_Nm
    loose = LOOSE * (F_s + plant.coulomb_Nm + plant.brake_off_state_Nm)
    points, t = [(0.0, 0.0)], 0.0
    for speed in legs:
        push = np.sign(speed) * F_d_Nm + HAND_NMS_RAD * speed
        if F_s > F_d_Nm:
            points += [(t + 0.2, np.sign(speed) * max(loose, abs(push))), (t + 0.3, push)]
        else:
            points.append((t + 0.3, push))
        points.append((t + SETTLE_S + SLIDE_S, push))
        t += SETTLE_S + SLIDE_S
    drawn = _levels(
        rig,
        mode,
        F_s,
        F_d_Nm,
        f"operator.damping_Nms_rad={HAND_NMS_RAD}",
        f'phase=[{{kind="rest", duration_s={REST_S}}}, {_torque(points)}]',
    )
    truth = _truth(drawn, mode, REST_S + t, seed)
    pairs = []
    for k, speed in enumerate(legs):
        end = (k + 1) * (SETTLE_S + SLIDE_S)
        inside = (truth["t_s"] > end - SLIDE_S) & (truth["t_s"] <= end)
        pairs.append(
            (
                float(np.mean(truth["speed_rad_s"][inside])),
                float(np.mean(truth["operator_Nm"][inside]) * np.sign(speed)),
            )
        )
    return pairs


def _rows(rig: Rig, control: str, levels_Nm: Iterable[float], seed: int) -> Iterator[Felt]:
    for level in levels_Nm:
        for rate in RATES_NM_S:
            yield Felt(control, "breakaway", rate, level, broke_away(rig, level, rate, seed=seed))
        for speed, torque in slid(rig, level, SPEEDS_RAD_S, seed=seed):
            yield Felt(control, "sliding", speed, level, torque)
        yield from falling_rows(rig, control, level, seed)


def falling_rows(rig: Rig, control: str, F_s_Nm: float, seed: int) -> Iterator[Felt]:
    """Yield the felt torque at each speed, in both directions, for a friction that falls from `F_s_Nm`."""
    F_d_Nm = FALL * F_s_Nm
    slides = slid(rig, F_d_Nm, SPEEDS_RAD_S, F_s_Nm=F_s_Nm, seed=seed)
    speeds = [sign * speed for speed in SPEEDS_RAD_S for sign in (1.0, -1.0)]
    for drawn, (speed, torque) in zip(speeds, slides, strict=True):
        stands = abs(speed) < STANDS * abs(drawn)
        yield Felt(control, "falling", drawn, F_d_Nm, max(F_s_Nm, torque) if stands else torque)


def felt_study(rig: Rig | None = None, *, seed: int = 0, progress: Callable[[float], None] | None = None) -> FeltStudy:
    """Measure the felt torque with both controls at 1, 2 and 4 Nm, and the error budget at 2 Nm.

    Parameters
    ----------
    rig : default is the bench rig; its own schedule and its own levels are not used

    Raises
    ------
    coulombus.host.errors.SafetyTrip
        a run tripped; the text has the run and the reason
    coulombus.rigs.rig.RigError
        the rig has no mode hybrid
    """
    rig = load_rig("bench") if rig is None else rig
    need_modes(rig, "hybrid")
    felt = felt_control(rig)
    runs: list[tuple[Rig, str, tuple[float, ...]]] = [(rig, "brake", LEVELS_NM), (felt, "felt", LEVELS_NM)]
    runs += [(felt.variant(*o), f"felt, {name}", (BUDGET_NM,)) for name, o in _wrong_beliefs(rig).items()]
    rows: list[Felt] = []
    for done, (variant, control, levels) in enumerate(runs, 1):
        rows += _rows(variant, control, levels, seed)
        if progress is not None:
            progress(done / len(runs))
    return FeltStudy(rig.name, tuple(rows))
