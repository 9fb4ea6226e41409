"""Identified friction as MJCF, MuJoCo's model file.

`frictionloss`, `damping` and `armature` of a hinge are Coulomb friction, viscous friction and inertia. The
law `lugre` is that of MuJoCo's actuator `dcmotor` (from MuJoCo 3.7 on), whose motor constant is so small
here that its coil has no torque. Its viscous part is the hinge's damping.

Source: MuJoCo's XML reference, elements joint and actuator/dcmotor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree

from coulombus.recording.friction.friction_fit import Fit
from coulombus.recording.friction.regression import Estimate

__all__ = ["LUGRE", "friction_mjcf", "lugre_mjcf"]

LUGRE = ("sigma_0_Nm_rad", "sigma_1_Nms_rad", "F_c_Nm", "F_s_Nm", "v_s_rad_s")
"""The law's parameters in the order of dcmotor's attribute `lugre`."""
VISCOUS = "sigma_2_Nms_rad"
NO_COIL = {"motorconst": "1e-6", "resistance": "1"}
JOINT = "handle"
NOTHING = 1e-9
"""Inertia of a body that has none of its own [kg m2]: all is in the joint's armature."""


def friction_mjcf(fit: Fit, source: str) -> str:
    """Return Coulomb friction, viscous friction and inertia as MJCF with one hinge."""
    figures = {"frictionloss": fit.coulomb_Nm, "damping": fit.viscous_Nms_rad, "armature": fit.inertia_kg_m2}
    notes = [f"{name}: {estimate}" for name, estimate in figures.items() if estimate is not None]
    notes += [f"{name}: the data do not tell it" for name, estimate in figures.items() if estimate is None]
    if fit.stribeck_Nm is not None:
        notes.append(f"at rest {fit.stribeck_Nm} Nm more, which frictionloss does not have: take --law lugre")
    joint = {name: max(estimate.value, 0.0) for name, estimate in figures.items() if estimate is not None}
    return _model(source, notes, joint, None)


def lugre_mjcf(
    values: Mapping[str, float],
    estimates: Mapping[str, Estimate | None],
    inertia_kg_m2: float | None,
    source: str,
) -> str:
    """Return the parameters of the law `lugre` as MJCF with one hinge.

    Parameters
    ----------
    values : of all parameters
    estimates : with intervals, of those that the data determine
    """
    notes = [f"{name}: {estimates.get(name) or f'{value:.6g}, no interval'}" for name, value in values.items()]
    joint = {"damping": values[VISCOUS]}
    if inertia_kg_m2 is not None:
        joint["armature"] = max(inertia_kg_m2, 0.0)
    return _model(source, notes, joint, [values[name] for name in LUGRE])


def _model(source: str, notes: Sequence[str], joint: Mapping[str, float], lugre: Sequence[float] | None) -> str:
    root = ElementTree.Element("mujoco", model=JOINT)
    for note in (f"from {source}; 95 % confidence intervals:", *notes):
        root.append(ElementTree.Comment(f" {note.replace('--', '- -')} "))
    body = ElementTree.SubElement(ElementTree.SubElement(root, "worldbody"), "body", name=JOINT)
    inertia = " ".join([f"{NOTHING:g}"] * 3)
    ElementTree.SubElement(body, "inertial", pos="0 0 0", mass="1e-6", diaginertia=inertia)
    figures = {name: f"{value:.6g}" for name, value in joint.items()}
    ElementTree.SubElement(body, "joint", {"name": JOINT, "type": "hinge", "axis": "0 0 1"} | figures)
    if lugre is not None:
        actuators = ElementTree.SubElement(root, "actuator")
        friction = {"name": "friction", "joint": JOINT, "lugre": " ".join(f"{value:.6g}" for value in lugre)}
        ElementTree.SubElement(actuators, "dcmotor", friction | NO_COIL)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")
