r"""Friction in the plane without a bus: host and plant in one compiled loop, a cycle of delay between them.

The loop replaces the bus: the host gets the encoder and transducer values of the cycle's beginning,
and its commands act from the beginning of the next cycle. Encoders count, transducers are exact.
The host is `host.plane.plane_step`, the plant `sim_bus.rig.plane_plant`.

    h : the `PlaneHostRecord`      p : the `PlanePlantRecord`
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from coulombus.host.laws.plane.plane_law import PlaneLawFunction
from coulombus.host.laws.plane.plane_laws import PlaneLaw, load_plane_law
from coulombus.host.plane.plane_host import TURN_S, PlaneModel, new_plane_host
from coulombus.host.plane.plane_host_record import TRACK, PlaneHostRecord
from coulombus.host.plane.plane_step import plane_step
from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import Floats, RecordArray
from coulombus.rigs.errors import RigError
from coulombus.rigs.kinematics.load_mechanism import Mechanism, load_mechanism
from coulombus.rigs.kinematics.mechanisms import MechanismFunction
from coulombus.rigs.rig import Rig
from coulombus.sim_bus.rig.arm_plant import new_plane_plant
from coulombus.sim_bus.rig.plane_plant import advance_plane, tip_force
from coulombus.sim_bus.rig.records import PlanePlantRecord

__all__ = ["COLUMNS", "PlaneCourse", "PlaneRun", "circle", "simulate_plane"]

COLUMNS = (
    *("x_m", "y_m", "vx_m_s", "vy_m_s", "shown_x_N", "shown_y_N", "hand_x_N", "hand_y_N"),
    *("brake_1_Nm", "brake_2_Nm", "motor_1_Nm", "motor_2_Nm", "stuck", "v1_rad_s", "v2_rad_s"),
)
"""Columns of a course, at the end of each cycle; all are true values except stuck, which is the law's."""


@dataclass(frozen=True)
class PlaneRun:
    """Settings of a run in the plane without a bus.

    Attributes
    ----------
    mode : "active", "passive" or "hybrid"
    law : the law in the plane
    period_s : the cycle
    window_cycles : cycles over which the joints' speeds are computed
    turn_s : time over which the change of the speeds is computed, to predict the tip's direction; 0: no prediction
    models_lag : whether the host models the lags of the brakes
    reversal_lags : a brake is released early if its joint will come to rest within this many of its lags
    """

    mode: str = "hybrid"
    law: PlaneLaw | None = None
    period_s: float = 1e-3
    window_cycles: int = 6
    turn_s: float = TURN_S
    models_lag: bool = True
    reversal_lags: float = 4.0


@dataclass(frozen=True)
class PlaneCourse:
    """A course, with the final state of plant and host.

    Attributes
    ----------
    t_s : end of each cycle
    values : shape (n, len(COLUMNS))
    host, plant : arrays of one record
    residual_J : work of all torques minus the change of the kinetic energy
    """

    t_s: npt.NDArray[np.float64]
    values: npt.NDArray[np.float64]
    host: RecordArray[PlaneHostRecord]
    plant: RecordArray[PlanePlantRecord]
    residual_J: float

    def column(self, name: str) -> npt.NDArray[np.float64]:
        """Return one of `COLUMNS`."""
        values: npt.NDArray[np.float64] = self.values[:, COLUMNS.index(name)]
        return values

    def vectors(self, x: str, y: str) -> npt.NDArray[np.float64]:
        """Return two of `COLUMNS` as vectors, shape (n, 2)."""
        return np.stack((self.column(x), self.column(y)), axis=1)

    def display_errors(self, from_s: float = 0.0, least_m_s: float = 0.05) -> dict[str, float]:
        """Return the errors of the displayed force in direction (opposite to the true velocity) and magnitude.

        Samples before `from_s` or slower than `least_m_s` are omitted. Median and 95th percentile
        of the angle [deg] and of the magnitude [N].
        """
        v, shown = self.vectors("vx_m_s", "vy_m_s"), self.vectors("shown_x_N", "shown_y_N")
        speed, size = np.hypot(*v.T), np.hypot(*shown.T)
        compared = (speed > least_m_s) & (self.t_s >= from_s)
        cross = shown[:, 0] * v[:, 1] - shown[:, 1] * v[:, 0]
        off = np.degrees(np.arctan2(np.abs(cross), -(shown * v).sum(axis=1)))[compared]
        return {
            "median_deg": float(np.median(off)),
            "p95_deg": float(np.percentile(off, 95)),
            "median_N": float(np.median(size[compared])),
            "p95_N": float(np.percentile(size[compared], 95)),
        }


@kernel
def _run(
    mechanism: MechanismFunction,
    law: PlaneLawFunction,
    h: PlaneHostRecord,
    p: PlanePlantRecord,
    hand: Floats,
    steps: int,
    rows: Floats,
) -> None:
    """Run `len(rows)` cycles of `steps` of the plant's steps; ``hand`` has the hand's goal [m] and
    its muscles' force [N] at the start of each cycle and at the end.
    """
    for k in range(len(rows)):
        motor = h.split.motor_Nm[0], h.split.motor_Nm[1]
        brake = h.split.brake_Nm[0], h.split.brake_Nm[1]
        for i in range(2):
            q = h.mechanism.sign[i] * (p.angle[i] - h.mechanism.offset_rad[i])
            h.counts[i] = math.floor((q - h.start_rad[i]) / h.count_rad[i] + 0.5)
            h.hand_Nm[i] = h.mechanism.sign[i] * p.transduced_Nm[i]
            p.motor_want[i] = h.mechanism.sign[i] * motor[i]
            p.brake_want[i] = brake[i]
            p.goal_m[i] = hand[k, i]
            p.goal_m_s[i] = (hand[k + 1, i] - hand[k, i]) / h.control.period_s
            p.push_N[i] = 0.5 * (hand[k, 2 + i] + hand[k + 1, 2 + i])
        plane_step(mechanism, law, h)
        advance_plane(p, steps)
        tip_force(p)
        row = rows[k]
        for i in range(2):
            row[i], row[2 + i], row[4 + i], row[6 + i] = p.tip_m[i], p.tip_m_s[i], p.shown_N[i], p.hand_N[i]
            row[8 + i], row[10 + i], row[13 + i] = p.brake_Nm[i], p.motor[i], p.v[i]
        row[12] = h.state.stuck


def _new_plant(rig: Rig, period_s: float) -> RecordArray[PlanePlantRecord]:
    """Return the plant of a rig of two links at rest at its start, as an array of one record, with its joints'
    lags and friction.
    """
    record = new_plane_plant(rig)
    p, joints = record[0], [axis.simulation.plant for axis in rig.axes]
    step_s = joints[0].step_s
    p["inherent"] = [joint.coulomb_Nm + joint.brake_off_state_Nm for joint in joints]
    for name, key in (("motor", "motor_lag_s"), ("coil", "brake_coil_lag_s"), ("fluid", "brake_fluid_lag_s")):
        lags = [getattr(joint, key) for joint in joints]
        p[f"{name}_decay"] = [math.exp(-step_s / lag) if lag > 0.0 else 0.0 for lag in lags]
    if abs(period_s / step_s - round(period_s / step_s)) > 1e-9:
        raise RigError([f"{rig.path}: plant.step_s: expected a whole number of steps in a cycle of {period_s:g} s"])
    return record


def _new_host(rig: Rig, run: PlaneRun, law: PlaneLaw, mechanism: Mechanism) -> RecordArray[PlaneHostRecord]:
    """Return the host's record of a rig: its model, with the changes of the run."""
    record = new_plane_host(rig, run.mode, PlaneModel(law, mechanism), run.period_s)
    h, T = record[0], run.period_s
    h["window_cycles"] = run.window_cycles
    h["turn_cycles"] = min(round(run.turn_s / T), TRACK - run.window_cycles - 1)
    c, brakes = h["control"], [axis.brake for axis in rig.axes]
    c["lead_s"] = T * (0.5 * run.window_cycles + 1.5)
    c["reversal_s"] = [run.reversal_lags * (brake.coil_lag_s + brake.fluid_lag_s) for brake in brakes]
    if not run.models_lag:
        c["coil_step"] = c["fluid_step"] = 1.0
    return record


def circle(
    centre_m: tuple[float, float], radius_m: float, frequency_Hz: float, seconds: float, period_s: float = 1e-3
) -> npt.NDArray[np.float64]:
    """Return goals on a circle [m], from its rightmost point, at the start of each cycle and at the end."""
    phase = 2 * math.pi * frequency_Hz * period_s * np.arange(round(seconds / period_s) + 1)
    return np.array(centre_m) + radius_m * np.stack((np.cos(phase), np.sin(phase)), axis=1)


def simulate_plane(
    rig: Rig, goal_m: npt.ArrayLike, run: PlaneRun | None = None, push_N: npt.ArrayLike = 0.0
) -> PlaneCourse:
    """Run a rig in the plane along a motion of the hand, without a bus.

    Parameters
    ----------
    rig : with [kinematics] of two links in series, and [plane]
    goal_m : the hand's goal at the start of each cycle and at the end, shape (cycles + 1, 2)
    run : mode, law, cycle
    push_N : the muscles' force in addition to the hand's spring and damper, at the same instants

    Raises
    ------
    RigError
        the rig is not in the plane
    """
    run = PlaneRun() if run is None else run
    plant = _new_plant(rig, run.period_s)
    assert rig.kinematics is not None
    mechanism = load_mechanism(rig.kinematics, rig.law_directory)
    law = load_plane_law("plane_karnopp") if run.law is None else run.law
    host, goals = _new_host(rig, run, law, mechanism), np.asarray(goal_m, np.float64)
    hand = np.hstack((goals, np.broadcast_to(np.asarray(push_N, np.float64), goals.shape)))
    rows = np.zeros((len(goals) - 1, len(COLUMNS)))
    steps = round(run.period_s / plant[0]["h"])
    before = _kinetic(plant[0])
    _run(mechanism.function, law.function, host[0], plant[0], hand, steps, rows)
    p = plant[0]
    works = sum(p[name].sum() for name in ("work_hand", "work_motor", "work_brake", "work_friction"))
    residual = float(works - p["work_viscous"].sum() - (_kinetic(p) - before))
    t_s: npt.NDArray[np.float64] = run.period_s * np.arange(1, len(goals), dtype=np.float64)
    return PlaneCourse(t_s, rows, host, plant, residual)


def _kinetic(p: Any) -> float:
    v1, v2 = p["v"]
    m11, m12 = p["a1"] + 2 * p["k"] * math.cos(p["angle"][1]), p["a2"] + p["k"] * math.cos(p["angle"][1])
    return float(0.5 * (m11 * v1**2 + 2 * m12 * v1 * v2 + p["a3"] * v2**2))
