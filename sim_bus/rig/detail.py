"""Parts of a plant beyond one rigid body.

They are the record of `[plant.cable]`, `[plant.handle]`, `[plant.friction]`, `[plant.fluid]`,
`[plant.iron]`, `[plant.ripple]` and `[plant.heat]`.

The bodies form a row, the motor first and the handle last, all referred to the handle. A coupling
connects two of them. A rig without a coupling is one body, with a cable two (motor; drum and
handle), with an elastic handle two (motor and drum; handle), with both three. The encoder is on the
first body, the brake on the drum, the hand on the last body.
"""

from __future__ import annotations

import math

import numpy as np

from coulombus.rigs.plant import Plant
from coulombus.rigs.plant_detail import Cable, Handle
from coulombus.sim_bus.rig.records import DETAIL, DetailRecord

__all__ = ["DETAIL_COLUMNS", "DRY", "ELEMENTS", "LUGRE", "detail_of"]

DRY, LUGRE, ELEMENTS = 0, 1, 2
"""Models of the device's own friction: a level, bristles, `sim_bus.rig.elements`."""
LAWS = {"coulomb": DRY, "lugre": LUGRE, "gms": ELEMENTS, "leuven": ELEMENTS}


DETAIL_COLUMNS = (
    "motor_angle_rad",
    "motor_speed_rad_s",
    "drum_angle_rad",
    "drum_speed_rad_s",
    "stored_energy_J",
    "device_degC",
)
"""Further columns of the true course of a detailed plant."""


def _rate(step_s: float, lag_s: float) -> float:
    return step_s / lag_s if lag_s > 0 else -1.0


def detail_of(p: Plant, hand_inertia: float) -> DetailRecord:
    """Return the record of a plant's parts beyond one rigid body; `on` is 0 for a plant that is only a rigid
    body.
    """
    d: DetailRecord = np.zeros(1, DETAIL)[0]
    d["on"] = int(p.in_detail)
    bodies: list[float] = []
    couplings: list[Cable | Handle] = []
    share = 0.0 if p.cable is None else p.cable.friction_share
    inner = p.inertia_kg_m2
    if p.cable is not None:
        bodies.append(p.cable.motor_inertia_kg_m2)
        inner -= bodies[0]
        couplings.append(p.cable)
    d["drum"] = len(bodies)
    if p.handle is not None:
        bodies += [inner - p.handle.inertia_kg_m2, p.handle.inertia_kg_m2]
        couplings.append(p.handle)
    else:
        bodies.append(inner)
    n = d["count"] = len(bodies)
    d["mass"][:n] = d["total"][:n] = bodies
    d["total"][n - 1] += hand_inertia
    d["share"][d["drum"]] = 1.0 - share
    if p.cable is not None:
        d["share"][0] = share
    d["viscous"] = p.viscous_Nms_rad * d["share"]
    for j, coupling in enumerate(couplings):
        d["k"][j], d["d"][j] = coupling.stiffness_Nm_rad, coupling.damping_Nms_rad
        d["gap"][j] = coupling.backlash_rad / 2
        d["contact"][j] = int(coupling.backlash_rad == 0.0)
    f = p.friction
    d["exponent"] = 2.0
    if f is not None:
        d["bristles"] = LAWS[f.law]
        m = d["elements"] = len(f.elements_Nm_rad)
        d["element_k"][:m] = f.elements_Nm_rad
        d["element_w"][:m] = np.array(f.shares) / math.fsum(f.shares)
        d["slip_rate"] = f.C_Nm_s if f.law == "gms" else 0.0
        d["sigma_0"], d["sigma_1"] = f.sigma_0_Nm_rad, f.sigma_1_Nms_rad
        d["angle_share"], d["angle_rad"], d["angle_phase"] = f.angle_share, f.angle_periods, f.angle_phase_rad
        d["load_share"] = f.load_share
        d["friction_K"], d["friction_s"] = f.share_1_K, f.drift_1_s
        d["exponent"] = f.stribeck_exponent
    if p.ripple is not None:
        d["ripple"], d["ripple_phase"] = p.ripple.share, p.ripple.phase_rad
        d["ripple_rad"] = p.ripple.periods * p.ratio
    d["rise"] = d["fall"] = _rate(p.step_s, p.brake_fluid_lag_s)
    if p.fluid is not None:
        d["fluid_viscous"], d["viscous_K"] = p.fluid.viscous_Nms_rad, p.fluid.viscous_1_K
        d["torque_K"], d["shear"] = p.fluid.torque_1_K, p.fluid.shear_s_rad
        if p.fluid.fall_lag_s is not None:
            d["fall"] = _rate(p.step_s, p.fluid.fall_lag_s)
    d["rise_decay"], d["fall_decay"] = math.exp(-d["rise"]), math.exp(-d["fall"])
    d["direct"] = 1.0
    if p.iron is not None:
        m = d["plays"] = len(p.iron.play_Nm)
        d["play_r"][:m], d["play_w"][:m] = p.iron.play_Nm, p.iron.weights
        d["direct"] = 1.0 - math.fsum(p.iron.weights)
    d["degC"] = p.temperature_degC
    d["reference"] = p.temperature_degC
    if p.heat is not None:
        d["reference"] = p.heat.reference_degC
        d["heat_1_JK"] = p.step_s / p.heat.capacity_J_K
        d["cooling"] = p.step_s / (p.heat.resistance_K_W * p.heat.capacity_J_K)
    d["coil_ohm"] = p.coil_resistance_ohm
    d["crosstalk"] = p.transducer_inertia_kg_m2 or 0.0
    return d
