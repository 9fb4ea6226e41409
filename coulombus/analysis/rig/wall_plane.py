r"""The K-B plane of a virtual wall through bus, nodes and PDOs.

A hand modelled as a damper leans on the wall with a constant torque, so that the handle oscillates
about :math:`p = f/K` inside it. The motor displays K and B (active), or the motor K and the brake B
(hybrid). The rig is the given one without inherent friction, off-state torque and the motor's lag:
the rest is `analysis.theory.z_width.Handle`. The display is compared with its prediction for a
two-sided wall, and with the same hand at a one-sided wall (`stable_leaning`), which is independent
code without bus and PDOs.

A point is stable if nothing trips and the speed decays (`dies_out`). For each B the largest stable
K is found by bisection; hybrid's gain is the ratio of the areas below the boundaries.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.analysis.rig.runs import need_modes
from coulombus.analysis.theory.z_width import Handle, Lean, dies_out, stable_leaning, stable_predicted
from coulombus.lab.simulate import simulate
from coulombus.rigs.rig import Rig, load_rig

__all__ = ["WallPlane", "WallRow", "handle_of", "stable_through_bus", "wall_plane"]

MODES = "active", "hybrid"
DAMPINGS_NMS_RAD = (0.1, 0.5, 1.0, 1.8)
REST_S, PART_S = 2.0, 0.25
SOFTEST_NM_RAD, STIFFEST_NM_RAD = 2.0, 2000.0
HALVINGS = 6
LEAN = Lean()
"""The wall is beyond the sign check's travel."""
HAND_NMS_RAD = 0.1
"""The hand's damping, needed by the sign check."""


@dataclass(frozen=True)
class WallRow:
    """The largest stable stiffness at one damping, in one mode; 0: none."""

    mode: str
    B_Nms_rad: float
    predicted_Nm_rad: float
    leaning_Nm_rad: float
    bus_Nm_rad: float


@dataclass(frozen=True)
class WallPlane:
    """The boundary of the stable walls over B."""

    rig: str
    rows: tuple[WallRow, ...]

    def ratio(self, which: str) -> float:
        """Return hybrid's area as a multiple of active's: ``predicted``, ``leaning`` or ``bus``."""
        area = {}
        for mode in MODES:
            rows = [row for row in self.rows if row.mode == mode]
            K = [getattr(row, f"{which}_Nm_rad") for row in rows]
            area[mode] = float(np.trapezoid(K, [row.B_Nms_rad for row in rows]))
        return area["hybrid"] / area["active"] if area["active"] > 0 else math.inf

    def as_dict(self) -> dict[str, Any]:
        """Return plain values."""
        ratios = {which: self.ratio(which) for which in ("predicted", "leaning", "bus")}
        return {"rig": self.rig, "rows": [asdict(row) for row in self.rows], "hybrid_to_active": ratios}

    def lines(self) -> Iterator[str]:
        """Yield the boundary as text."""
        yield f"rig {self.rig}: the stiffest stable wall [Nm/rad]"
        yield f"{'mode':<8} {'B [Nms/rad]':>12} {'predicted':>10} {'leaning':>10} {'bus':>10}"
        for row in self.rows:
            stiffnesses = row.predicted_Nm_rad, row.leaning_Nm_rad, row.bus_Nm_rad
            yield f"{row.mode:<8} {row.B_Nms_rad:>12.3g} " + " ".join(f"{K:>10.4g}" for K in stiffnesses)
        ratios = ", ".join(f"{which} {self.ratio(which):.3g}" for which in ("predicted", "leaning", "bus"))
        yield f"hybrid's area to active's: {ratios}"
        yield "predicted: the wall holds from both sides; leaning: it has one side, without bus and PDOs"


def handle_of(rig: Rig) -> Handle:
    """Return the rig's handle with the hand on it, for the prediction."""
    axis = rig.one_axis()
    plant = axis.simulation.plant
    return Handle(
        plant.inertia_kg_m2,
        plant.viscous_Nms_rad + HAND_NMS_RAD,
        rig.bus.period_s,
        rig.bus.cycles_to_actuation,
        2 * math.pi / (plant.encoder_counts_rev * plant.ratio),
        plant.brake_coil_lag_s,
        plant.brake_fluid_lag_s,
    )


def stable_through_bus(rig: Rig, K_Nm_rad: float, B_Nms_rad: float, mode: str, *, seed: int = 0) -> bool:
    """Return whether the wall (K, B) is stable under a leaning hand, by simulation."""
    nothing = ("inertia_kg_m2", "stiffness_Nm_rad", "tremor_Nm")
    leaning = rig.variant(
        "law.function=wall",
        *(
            f"law.wall.{key}"
            for key in (
                f"K_Nm_rad={K_Nm_rad}",
                f"B_Nms_rad={B_Nms_rad}",
                f"most_Nm={LEAN.most_Nm}",
                f"x_wall_rad={LEAN.way_rad}",
            )
        ),
        "law.gain_ramp_s=0.01",
        f"mode.{mode}.motor_limit_Nm={LEAN.most_Nm}",
        f"mode.{mode}.compensation=0.0",
        f"limits.brake_torque_Nm={rig.one_axis().brake.rated_torque_Nm}",
        "limits.torque_rate_Nm_s=1e6",
        "mechanics.friction_Nm=0.0",
        *(f"plant.{key}=0.0" for key in ("coulomb_Nm", "brake_off_state_Nm", "motor_lag_s")),
        *(f"operator.{key}=0.0" for key in nothing),
        f"operator.damping_Nms_rad={HAND_NMS_RAD}",
        f'phase=[{{kind="rest", duration_s={REST_S}}}, {{kind="file", duration_s={LEAN.seconds}, '
        f"t_s=[0.0, 0.001, {LEAN.seconds}], torque_Nm=[0.0, {LEAN.torque_Nm}, {LEAN.torque_Nm}]}}]",
    )
    with tempfile.TemporaryDirectory(prefix="coulombus-") as directory:
        path = Path(directory) / "truth.npz"
        result = simulate(leaning, mode, REST_S + LEAN.seconds, truth=path, seed=seed, force=True)
        if result.trip is not None:
            return False
        with np.load(path) as truth:
            t, speed = truth["t_s"], truth["speed_rad_s"]
            leans = np.abs(truth["operator_Nm"]) > 0.5 * LEAN.torque_Nm
    begin, end = t[leans][0], t[leans][-1]
    first = speed[(t >= begin) & (t < begin + PART_S)]
    last = speed[(t > end - PART_S) & (t <= end)]
    return dies_out(first, last)


def _stiffest(stable: Callable[[float], bool]) -> float:
    """Return the largest stable stiffness by bisection of its logarithm; 0 if even the softest is unstable."""
    low, high = SOFTEST_NM_RAD, STIFFEST_NM_RAD
    if not stable(low):
        return 0.0
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return math.sqrt(low * high)


def wall_plane(
    rig: Rig | None = None,
    dampings: Sequence[float] = DAMPINGS_NMS_RAD,
    *,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> WallPlane:
    """Return the boundary of the stable walls: predicted, for a one-sided wall, and through PDOs.

    Parameters
    ----------
    rig : default is the bench rig; its own law and schedule are not used
    dampings : values of B [Nms/rad], rising

    Raises
    ------
    coulombus.rigs.rig.RigError
        the rig lacks a mode, or has no wall of this size
    """
    rig = load_rig("bench") if rig is None else rig
    need_modes(rig, *MODES)
    handle, rows = handle_of(rig), []
    for mode in MODES:
        for B in dampings:
            predicted = _stiffest(partial(stable_predicted, handle, B_Nms_rad=B, mode=mode))
            leaning = _stiffest(partial(stable_leaning, handle, B_Nms_rad=B, mode=mode, lean=LEAN))
            bus = _stiffest(partial(stable_through_bus, rig, B_Nms_rad=B, mode=mode, seed=seed))
            rows.append(WallRow(mode, B, predicted, leaning, bus))
            if progress is not None:
                progress(len(rows) / (len(MODES) * len(dampings)))
    return WallPlane(rig.name, tuple(rows))
