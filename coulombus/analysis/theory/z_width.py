r"""Z-width: stable stiffness K and damping B of a virtual wall at a free handle.

K and B are displayed by the motor (active), or K by the motor and B by the brake (hybrid, the paper's Fig. 8).

The wall is two-sided, :math:`\psi = K x + B v`, sampled with period T and held, after a delay
of q cycles; without damping by a hand, the worst passive operator for a spring. Handle:
:math:`J\dot v + b v = -\psi`.

*Predicted*, exactly between samples: with :math:`\hat v_k = (x_k - x_{k-1})/T` the active loop is
linear, and stable if all eigenvalues of a sample's step are within the unit circle. In hybrid the
motor displays only K. The brake's level :math:`B|\hat v|` lags behind: for an oscillation of
amplitude :math:`V` it is its mean :math:`2BV/\pi`, and Coulomb friction of this level damps as
:math:`4/(\pi V)` times it, so the handle's damping is :math:`b + (8/\pi^2) B`.

*Simulated*: encoder in counts, and the brake as a set-valued element behind its lags, from a start at
1 rad/s. A point is stable if the second half of the motion is smaller than the first, and it stays within 1 rad.

*Leaning* (`stable_leaning`): the same motion at a one-sided wall, against which the hand moves and
leans. Outside, the brake's level is 0, so after each entry it must build up again: compared with a
two-sided wall, hybrid permits less, and active, whose stiffness acts only in contact, more.

Sources: J. E. Colgate, J. M. Brown, Factors affecting the Z-width of a haptic display, IEEE ICRA 1994,
doi:10.1109/ROBOT.1994.351077; the paper, Fig. 8.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

__all__ = [
    "Handle",
    "Lean",
    "ZWidth",
    "dies_out",
    "hulin_stiffness",
    "stable_leaning",
    "stable_predicted",
    "stable_simulated",
    "z_width",
]

Floats: TypeAlias = npt.NDArray[np.float64]
Bools: TypeAlias = npt.NDArray[np.bool_]

STEPS = 10
SECONDS = 1.0
START_RAD_S = 1.0
FAR_RAD = 1.0
MEAN_LEVEL = 8 / math.pi**2


@dataclass(frozen=True)
class Handle:
    """The handle and its loop; defaults are the bench's."""

    inertia_kg_m2: float = 2.5e-3
    viscous_Nms_rad: float = 0.005
    period_s: float = 1e-3
    delay_cycles: int = 1
    count_rad: float = 2 * math.pi / (8192 * 9.587)
    coil_lag_s: float = 3e-3
    fluid_lag_s: float = 15e-3


@dataclass(frozen=True)
class Lean:
    """A hand's push against a one-sided wall: at rest, then pushed for `seconds`."""

    torque_Nm: float = 0.3
    way_rad: float = 0.1
    most_Nm: float = 4.0
    """Torque limit of the motor and the brake."""
    seconds: float = 1.0


@dataclass(frozen=True)
class ZWidth:
    """Stable points over a grid, [B, K], of active and hybrid, predicted and simulated."""

    K_Nm_rad: Floats
    B_Nms_rad: Floats
    predicted: dict[str, Bools]
    simulated: dict[str, Bools]

    def ratio(self, which: str) -> float:
        """Return hybrid's stable area as a multiple of active's, ``predicted`` or ``simulated``."""
        stable: dict[str, Bools] = getattr(self, which)
        return float(stable["hybrid"].sum() / max(int(stable["active"].sum()), 1))

    def agreement(self, mode: str) -> float:
        """Return the share of points at which simulation and prediction agree."""
        return float(np.mean(self.predicted[mode] == self.simulated[mode]))


def stable_predicted(handle: Handle, K_Nm_rad: float, B_Nms_rad: float, mode: str) -> bool:
    """Return whether the sampled linear loop is stable at (K, B)."""
    T, q = handle.period_s, handle.delay_cycles
    hybrid = mode == "hybrid"
    damping = handle.viscous_Nms_rad + (MEAN_LEVEL * B_Nms_rad if hybrid else 0.0)
    sampled = 0.0 if hybrid else B_Nms_rad
    free = np.zeros((3, 3))  # x, v, and the held torque
    free[0, 1], free[1, 1], free[1, 2] = 1.0, -damping / handle.inertia_kg_m2, -1 / handle.inertia_kg_m2
    step = expm(free * T)
    size = 3 + q  # x, v, the previous x, and the delayed torques, the newest first
    loop = np.zeros((size, size))
    demand = np.zeros(size)
    demand[0], demand[2] = K_Nm_rad + sampled / T, -sampled / T
    acts = np.eye(size)[-1] if q else demand
    loop[:2, :2] = step[:2, :2]
    loop[:2] += np.outer(step[:2, 2], acts)
    loop[2, 0] = 1.0
    if q:
        loop[3] = demand
        for k in range(4, size):
            loop[k, k - 1] = 1.0
    return bool(np.abs(np.linalg.eigvals(loop)).max() < 1.0)


def hulin_stiffness(handle: Handle, B_Nms_rad: float = 0.0) -> float:
    r"""Return the largest stable stiffness of the active wall for a soft loop with delay,

    .. math:: K = \frac{b + B}{T/2 + \tau}, \qquad \tau = q T

    the slope of the exact boundary at the origin: valid while :math:`K T^2 / J` and
    :math:`B T / J` are small. Source: T. Hulin, A. Albu-Schaeffer, G. Hirzinger, IEEE Trans. Control
    Systems Technology 22(4), 2014, doi:10.1109/TCST.2013.2283372.
    """
    return (handle.viscous_Nms_rad + B_Nms_rad) / ((0.5 + handle.delay_cycles) * handle.period_s)


def stable_simulated(handle: Handle, K_Nm_rad: Floats, B_Nms_rad: Floats, mode: str) -> Bools:
    """Return for which points (K, B), arrays of one shape, the simulated motion decays."""
    T, J, h = handle.period_s, handle.inertia_kg_m2, handle.period_s / STEPS
    shape = K_Nm_rad.shape
    x, v, before = np.zeros(shape), np.full(shape, START_RAD_S), np.zeros(shape)
    coil, fluid = np.zeros(shape), np.zeros(shape)
    held = [np.zeros(shape)] * handle.delay_cycles
    levels = [np.zeros(shape)] * handle.delay_cycles
    to_coil, to_fluid = 1 - math.exp(-h / handle.coil_lag_s), 1 - math.exp(-h / handle.fluid_lag_s)
    samples = round(SECONDS / T)
    first, second, gone = np.zeros(shape), np.zeros(shape), np.zeros(shape, np.bool_)
    for k in range(samples):
        shown = np.floor(x / handle.count_rad + 0.5) * handle.count_rad
        speed = (shown - before) / T if k else np.zeros(shape)
        before = shown
        hybrid = mode == "hybrid"
        held.append(K_Nm_rad * shown + (0.0 if hybrid else B_Nms_rad * speed))
        levels.append(B_Nms_rad * np.abs(speed) if hybrid else np.zeros(shape))
        torque, level = held.pop(0), levels.pop(0)
        for _ in range(STEPS):
            coil += (level - coil) * to_coil
            fluid += (coil - fluid) * to_fluid
            pushed = (v - h / J * torque) / (1 + h * handle.viscous_Nms_rad / J)
            v = np.sign(pushed) * np.maximum(np.abs(pushed) - h / J * fluid, 0.0)
            x = x + h * v
        far = np.abs(x) > FAR_RAD
        gone |= far
        x[far], v[far] = 0.0, 0.0
        if k < samples // 2:
            np.maximum(first, np.abs(x), out=first)
        else:
            np.maximum(second, np.abs(x), out=second)
    return np.asarray((second < first) & ~gone, np.bool_)


def stable_leaning(handle: Handle, K_Nm_rad: float, B_Nms_rad: float, mode: str, lean: Lean) -> bool:
    """Return whether a one-sided wall (K, B) is stable under a leaning hand (`dies_out`).

    Equations as in `stable_simulated`, except that the wall begins at angle 0 and never pulls
    (`host.laws.wall`), and torques are limited to ``lean.most_Nm``.
    """
    T, J, h = handle.period_s, handle.inertia_kg_m2, handle.period_s / STEPS
    to_coil, to_fluid = 1 - math.exp(-h / handle.coil_lag_s), 1 - math.exp(-h / handle.fluid_lag_s)
    x, v, coil, fluid = -lean.way_rad, 0.0, 0.0, 0.0
    before = round(x / handle.count_rad) * handle.count_rad
    under_way = [(0.0, 0.0)] * handle.delay_cycles
    speeds = np.empty(round(lean.seconds / T) * STEPS)
    for k in range(round(lean.seconds / T)):
        shown = round(x / handle.count_rad) * handle.count_rad
        damping, before = B_Nms_rad * (shown - before) / T, shown
        spring, demand = min(K_Nm_rad * shown, lean.most_Nm), (0.0, 0.0)
        if shown > 0.0 and mode == "hybrid":
            demand = spring, min(abs(damping), lean.most_Nm if damping >= 0.0 else spring)
        elif shown > 0.0:
            demand = min(max(K_Nm_rad * shown + damping, 0.0), lean.most_Nm), 0.0
        under_way.append(demand)
        torque, level = under_way.pop(0)
        for n in range(STEPS):
            coil += (level - coil) * to_coil
            fluid += (coil - fluid) * to_fluid
            pushed = (v + h / J * (lean.torque_Nm - torque)) / (1 + h * handle.viscous_Nms_rad / J)
            v = math.copysign(max(abs(pushed) - h / J * fluid, 0.0), pushed)
            x += h * v
            speeds[k * STEPS + n] = v
    part = len(speeds) // 4
    return dies_out(speeds[:part], speeds[-part:])


def dies_out(first: Floats, last: Floats) -> bool:
    """Return whether the speed of the last part is less than half of the first's (RMS about the mean)."""
    return bool(np.std(last) < 0.5 * np.std(first))


def z_width(handle: Handle | None = None, *, most_K: float = 1000.0, most_B: float = 3.0, points: int = 20) -> ZWidth:
    """Return the K-B plane of a virtual wall on a grid of points x points.

    Parameters
    ----------
    most_K, most_B : ends of the grid [Nm/rad], [Nms/rad]
    """
    handle = Handle() if handle is None else handle
    K, B = np.linspace(most_K / points, most_K, points), np.linspace(0.0, most_B, points)
    grid_K, grid_B = np.meshgrid(K, B)
    predicted, simulated = {}, {}
    for mode in ("active", "hybrid"):
        rows = [[stable_predicted(handle, float(k), float(b), mode) for k in K] for b in B]
        predicted[mode] = np.array(rows, np.bool_)
        simulated[mode] = stable_simulated(handle, grid_K, grid_B, mode)
    return ZWidth(K, B, predicted, simulated)
