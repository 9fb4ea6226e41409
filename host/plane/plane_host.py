"""The host of two joints of one arm: its law and mechanism, loaded and compiled, and its record."""

from __future__ import annotations

import math
from dataclasses import dataclass

from coulombus.host.laws.laws import BUILTIN_LAWS, LawError
from coulombus.host.laws.parameters import axis_parameters
from coulombus.host.laws.plane.plane_laws import PLANE_LAWS, PlaneLaw, load_plane_law
from coulombus.host.plane.plane_host_record import ACTIVE, HYBRID, PASSIVE, TRACK, PlaneHostRecord
from coulombus.host.plane.plane_step import PlaneFunctions
from coulombus.kernels.records import RecordArray, new_records
from coulombus.rigs.axis import Axis
from coulombus.rigs.kinematics.kinematics_section import Kinematics
from coulombus.rigs.kinematics.load_mechanism import Mechanism, MechanismMistake, load_mechanism
from coulombus.rigs.rig import Rig, RigError

__all__ = ["PLANE_MODES", "TURN_S", "PlaneModel", "load_plane", "new_plane_host"]

PLANE_MODES = {"active": ACTIVE, "passive": PASSIVE, "hybrid": HYBRID}
TURN_S = 0.08
"""Time over which the change of the speeds is computed, to predict the tip's direction."""
BEND_S = 0.02
"""Time between two of the three positions of which an acceleration is computed, to compensate the arm's inertia."""
REVERSAL_LAGS = 4.0
"""A brake is released early if its joint will come to rest within this many of its lags."""


@dataclass(frozen=True)
class PlaneModel:
    """Law and mechanism of a rig in the plane.

    Attributes
    ----------
    law : with the rig's parameters
    mechanism : compiled, with the rig's dimensions
    """

    law: PlaneLaw
    mechanism: Mechanism

    @property
    def functions(self) -> PlaneFunctions:
        """The compiled functions for the cycle."""
        return PlaneFunctions(self.law.function, self.mechanism.function)

    @property
    def peak_N(self) -> float:
        """Largest force of the law, if it names the parameters that set it; else 0 [N]."""
        law = self.law
        if law.declaration is None or law.parameters is None:
            return 0.0
        return max((float(getattr(law.parameters, name)) for name in law.declaration.extremes), default=0.0)


def load_plane(rig: Rig, mode: str) -> PlaneModel | None:
    """Return law and mechanism of a rig in the plane; None for a rig of independent axes.

    Raises
    ------
    RigError
        the law is none in the plane or cannot be loaded; a recording names a function that is not built in;
        or the rig's law has wrong parameters
    """
    kinematics = rig.kinematics
    if kinematics is None:
        _refuse_plane_law(rig)
        return None
    axis, name = rig.axes[0], rig.law_function.strip()
    if name in BUILTIN_LAWS:
        raise axis.mistake(
            "law.function", f"a law in the plane, since the rig has [kinematics]: {', '.join(PLANE_LAWS)}"
        )
    if rig.law_of_recording and name not in PLANE_LAWS:
        expected = f"{', '.join(PLANE_LAWS)}: any other law that only a recording names is a stranger's program, and is not run"
        raise axis.mistake("law.function", f"{expected}; if you trust it, name it yourself: --law FILE.py:FUNCTION")
    if rig.origin.attached and kinematics.function is not None:
        raise RigError([f"{rig.path}: kinematics.kind: '{kinematics.kind}' is of a recording, and is not run"])
    try:
        law = load_plane_law(name, directory=rig.law_directory)
        mechanism = load_mechanism(kinematics, rig.law_directory)
    except LawError as error:
        raise axis.mistake("law.function", f"a law in the plane; {error}") from error
    except MechanismMistake as error:
        raise RigError([f"{rig.path}: kinematics.kind: got '{kinematics.kind}', but {error}"]) from error
    if axis.mode[mode].inertia_compensation > 0.0 and kinematics.l1_m and not any(kinematics.link_mass_kg):
        raise axis.mistake(f"mode.{mode}.inertia_compensation", "0 without kinematics.link_mass_kg: the links' masses")
    parameters = axis_parameters(axis, law.declaration)
    return PlaneModel(PlaneLaw(law.name, law.function, law.declaration, parameters), mechanism)


def _refuse_plane_law(rig: Rig) -> None:
    """Refuse what only a rig in the plane has, for independent axes."""
    for axis in rig.axes:
        for name in axis.mode:
            if axis.mode[name].inertia_compensation > 0.0:
                raise axis.mistake(f"mode.{name}.inertia_compensation", "0, since the rig has no [kinematics]")
        if axis.law.function.strip() in PLANE_LAWS:
            raise axis.mistake(
                "law.function", f"a law of one axis, since the rig has no [kinematics]: {', '.join(BUILTIN_LAWS)}"
            )


def new_plane_host(
    rig: Rig, mode: str, model: PlaneModel, period_s: float | None = None
) -> RecordArray[PlaneHostRecord]:
    """Return the host's record of a rig in the plane at its start, as an array of one record.

    Parameters
    ----------
    model : from `load_plane`
    period_s : of the cycle; None: the bus' [s]
    """
    kinematics = rig.kinematics
    assert kinematics is not None
    T = rig.bus.period_s if period_s is None else period_s
    record = new_records(PlaneHostRecord)
    h = record[0]
    h["mechanism"], h["law"], h["mode"] = model.mechanism.record[0], model.law.record()[0], PLANE_MODES[mode]
    h["window_cycles"] = min(max(axis.law.velocity_window_cycles for axis in rig.axes), TRACK // 2 - 1)
    h["turn_cycles"] = min(round(TURN_S / T), TRACK - int(h["window_cycles"]) - 1)
    h["start_rad"], h["least_condition"] = kinematics.start_rad, kinematics.least_condition
    h["count_rad"] = [axis.allocation.bound["position"].scale for axis in rig.axes]
    for k, limits in enumerate((kinematics.x_m, kinematics.y_m)):
        h["low_m"][k], h["high_m"][k] = limits or (-math.inf, math.inf)
    h["gain"] = h["smallest_condition"] = 1.0
    c, modes = h["control"], [axis.mode[mode] for axis in rig.axes]
    brakes = 0.0 if mode == "active" else 1.0
    c["brake_limit_Nm"] = [brakes * axis.limits.brake_torque_Nm for axis in rig.axes]
    c["motor_limit_Nm"] = [0.0 if mode == "passive" else chosen.motor_limit_Nm for chosen in modes]
    c["friction_Nm"] = [axis.mechanics.friction_Nm for axis in rig.axes]
    c["compensation_Nm"] = [
        chosen.compensation * axis.mechanics.friction_Nm for chosen, axis in zip(modes, rig.axes, strict=True)
    ]
    c["period_s"], c["lead_s"] = T, T * (0.5 * int(h["window_cycles"]) + 1.5)
    c["passivity_J"] = min(axis.limits.passivity_J for axis in rig.axes)
    c["reversal_s"] = [REVERSAL_LAGS * _lag_s(axis) for axis in rig.axes]
    c["coil_step"] = [_step(axis.brake.coil_lag_s, T) for axis in rig.axes]
    c["fluid_step"] = [_step(axis.brake.fluid_lag_s, T) for axis in rig.axes]
    share = min(chosen.inertia_compensation for chosen in modes)
    if share > 0.0:
        inertia_kg_m2, tip_mass_kg = _arm(rig, kinematics)
        c["inertia_kg_m2"], c["tip_mass_kg"] = [share * part for part in inertia_kg_m2], share * tip_mass_kg
        h["bend_cycles"] = min(max(round(BEND_S / T), 1), TRACK // 2 - 1)
    return record


def _arm(rig: Rig, kinematics: Kinematics) -> tuple[tuple[float, float, float], float]:
    """Return the arm as the inertias of its joints (11, 12, 22) and a mass at the tip.

    The second link is split into a mass at the tip with the same first moment, and an inertia: for two links in
    series this is the exact matrix of inertia.
    """
    (m1, m2), (c1, c2), (i1, i2) = kinematics.link_mass_kg, kinematics.link_centre_m, kinematics.link_inertia_kg_m2
    l1, l2 = kinematics.l1_m or 0.0, kinematics.l2_m or 1.0
    joint1, joint2 = (axis.mechanics.inertia_kg_m2 for axis in rig.axes)
    tip = m2 * c2 / l2
    second = i2 + m2 * c2**2 - tip * l2**2
    first = i1 + m1 * c1**2 + (m2 - tip) * l1**2 + second
    both = kinematics.signs[0] * kinematics.signs[1] * second
    return (joint1 + first, both, joint2 + second), tip


def _lag_s(axis: Axis) -> float:
    return axis.brake.coil_lag_s + axis.brake.fluid_lag_s


def _step(lag_s: float, period_s: float) -> float:
    """Return the share of the remaining error that a lag makes up in a cycle."""
    return 1.0 - math.exp(-period_s / lag_s) if lag_s > 0.0 else 1.0
