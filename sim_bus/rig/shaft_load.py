r"""Load of a drive without a rig: a free shaft with an inertia, Coulomb friction and viscous friction.

It is the plant of `sim_bus.rig.plant` at a gear ratio of 1, with a brake that is never driven and
without a hand:

.. math:: J\,\dot\omega = \tau - F_c\,\mathrm{Sgn}(\omega) - b\,\omega

The torque :math:`\tau` follows the drive's with a lag of `LAG_S`, and saturates at `PEAK` times the
rated torque. Defaults come from the rated torque :math:`\tau_R` (6076h in mNm; `RATED_Nm` if the
file states none): it brings the shaft to `RATED_rad_s` in `RISE_S` without friction,
:math:`F_c` is `COULOMB` and :math:`b\,\omega_R` is `VISCOUS` of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from coulombus.eds.drive_scale import position_scale
from coulombus.kernels.records import RecordArray
from coulombus.node.drive402 import COUNTS_REV
from coulombus.node.profile import Objects
from coulombus.rigs.plant import Operator, Plant
from coulombus.sim_bus.rig.plant import plant_at_rest
from coulombus.sim_bus.rig.records import PlantRecord

__all__ = ["Load", "holding_pm", "switch_counts"]

RATED_Nm, MOST_Nm = 1.0, 1e4
RATED_rad_s = 2 * math.pi * 50
RISE_S = 0.1
COULOMB, VISCOUS = 0.02, 0.05
PEAK = 3.0
LAG_S = 1e-3
LOW_rev, HOME_rev, HIGH_rev = -1.0, (0.25, 0.5), 20.0
STEP_S = 1e-4
NOBODY = {"inertia_kg_m2": 0.0, "damping_Nms_rad": 0.0, "stiffness_Nm_rad": 0.0}


@dataclass(frozen=True)
class Load:
    """Parameters of the load at the motor's shaft; None: by the rated torque."""

    inertia_kg_m2: float | None = None
    friction_Nm: float | None = None
    viscous_Nms_rad: float | None = None
    rated_torque_Nm: float | None = None

    def plant(self, objects: Objects) -> RecordArray[PlantRecord]:
        """Return the plant at rest, for the drive with these objects."""
        rated = min(objects.number(0x6076) * 1e-3, MOST_Nm) or RATED_Nm
        rated = rated if self.rated_torque_Nm is None else self.rated_torque_Nm
        counts_rev = _counts_rev(objects)
        settings = {
            "step_s": STEP_S,
            "inertia_kg_m2": self.inertia_kg_m2 or rated * RISE_S / RATED_rad_s,
            "viscous_Nms_rad": VISCOUS * rated / RATED_rad_s if self.viscous_Nms_rad is None else self.viscous_Nms_rad,
            "coulomb_Nm": COULOMB * rated if self.friction_Nm is None else self.friction_Nm,
            "ratio": 1.0,
            "encoder_counts_rev": min(max(1, round(counts_rev)), 0x7FFFFFFF),
            "encoder_polarity": 1,
            "motor_polarity": 1,
            "motor_rated_torque_Nm": rated,
            "motor_peak_ratio": PEAK,
            "motor_lag_s": LAG_S,
            "brake_max_Nm": 1.0,
            "brake_off_state_Nm": 0.0,
            "brake_coil_lag_s": 0.0,
            "brake_fluid_lag_s": 0.0,
            "transducer_polarity": 1,
        }
        record = plant_at_rest(Plant.model_validate(settings), Operator.model_validate(NOBODY), 1.0)
        record["counts_rad"] = counts_rev / (2 * math.pi)  # of user units, which need not be a whole number
        return record


def _counts_rev(objects: Objects) -> float:
    return position_scale(lambda index, sub: objects.number(index, sub, 0)).counts_rev or COUNTS_REV


def switch_counts(objects: Objects) -> tuple[float, float, float, float]:
    """Return the places of the switches on the axis of a drive with these objects: negative limit, home from and
    to, positive limit.
    """
    turn = _counts_rev(objects)
    return LOW_rev * turn, HOME_rev[0] * turn, HOME_rev[1] * turn, HIGH_rev * turn


def holding_pm(p: PlantRecord) -> float:
    """Return the torque that the friction of the load holds at rest, in per mille of rated; infinite: it is blocked."""
    return math.inf if p["obstacle_Nm"] > 0 else float((p["coulomb"] + p["stribeck"]) / abs(p["motor_Nm_pm"]))
