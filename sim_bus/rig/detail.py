"""What a plant has beyond one rigid body: the record of `[plant.cable]`, `[plant.handle]`,
`[plant.friction]`, `[plant.fluid]`, `[plant.iron]`, `[plant.ripple]` and `[plant.heat]`.

The bodies stand in a row, the motor first and the handle last, all seen at the handle. Between two
of them is a coupling. A rig without a coupling is one body, with a cable two (motor; drum and
handle), with an elastic handle two (motor and drum; handle), with both three. The encoder is on the
first body, the brake on the drum, the hand on the last.
"""

from __future__ import annotations

import math

import numpy as np

from coulombus.kernels.records import Record
from coulombus.rigs.plant import Plant
from coulombus.rigs.plant_detail import MOST_ELEMENTS, Cable, Handle
from coulombus.sim_bus.rig.wave import WAVE

__all__ = ["BODIES", "DETAIL", "DETAIL_COLUMNS", "DRY", "ELEMENTS", "LUGRE", "detail_of"]

BODIES = 3
PLAYS = 8
DRY, LUGRE, ELEMENTS = 0, 1, 2
"""What gives the device's own friction: a level, bristles, `sim_bus.rig.elements`."""
LAWS = {"coulomb": DRY, "lugre": LUGRE, "gms": ELEMENTS, "leuven": ELEMENTS}

DETAIL = np.dtype(
    [
        ("on", np.int64),  # 1: the plant needs `sim_bus.rig.plant_step.advance_detailed`
        ("count", np.int64),  # of bodies
        ("drum", np.int64),  # the body with the brake
        # bodies: parameters and state
        ("mass", np.float64, (BODIES,)),  # inertia of the device's bodies, without the hand
        ("total", np.float64, (BODIES,)),  # with the hand
        ("viscous", np.float64, (BODIES,)),
        ("share", np.float64, (BODIES,)),  # of the device's own friction
        ("q", np.float64, (BODIES,)),
        ("v", np.float64, (BODIES,)),
        # couplings
        ("k", np.float64, (BODIES - 1,)),
        ("d", np.float64, (BODIES - 1,)),
        ("gap", np.float64, (BODIES - 1,)),  # half of the backlash
        ("contact", np.int64, (BODIES - 1,)),  # 1, -1: on one side, the other; 0: within the backlash
        # the device's own friction
        ("bristles", np.int64),  # `DRY`, `LUGRE`, `ELEMENTS`
        ("sigma_0", np.float64),
        ("sigma_1", np.float64),
        ("z", np.float64, (BODIES,)),
        ("elements", np.int64),
        ("element_k", np.float64, (MOST_ELEMENTS,)),
        ("element_w", np.float64, (MOST_ELEMENTS,)),  # together 1
        ("slip_rate", np.float64),  # C of the generalised Maxwell-slip friction; 0: Leuven's
        ("element_Nm", np.float64, (BODIES, MOST_ELEMENTS)),
        ("element_slips", np.float64, (BODIES, MOST_ELEMENTS)),  # 1, -1: it slips in this sense; 0: it winds
        ("waves", WAVE, (BODIES + 2,)),  # sines: of each body's friction, of ripple and cogging
        ("angle_share", np.float64),
        ("angle_rad", np.float64),  # periods in one revolution of the handle
        ("angle_phase", np.float64),
        ("friction_K", np.float64),  # share for one kelvin
        ("friction_s", np.float64),  # share for one second
        ("exponent", np.float64),
        # motor
        ("ripple", np.float64),
        ("ripple_rad", np.float64),
        ("ripple_phase", np.float64),
        # fluid and iron of the brake
        ("fluid_viscous", np.float64),
        ("viscous_K", np.float64),
        ("torque_K", np.float64),
        ("rise", np.float64),  # step / lag; negative: no lag
        ("fall", np.float64),
        ("rise_decay", np.float64),
        ("fall_decay", np.float64),
        ("shear", np.float64),  # s/rad: the lag is divided by 1 + shear |v|
        ("plays", np.int64),
        ("play_r", np.float64, (PLAYS,)),
        ("play_w", np.float64, (PLAYS,)),
        ("play_y", np.float64, (PLAYS,)),
        ("direct", np.float64),
        # heat
        ("heat_1_JK", np.float64),  # step / capacity; 0: the temperature is constant
        ("cooling", np.float64),  # step / (resistance capacity)
        ("reference", np.float64),
        ("degC", np.float64),
        ("coil_ohm", np.float64),
        # transducer
        ("crosstalk", np.float64),
        # a step's own
        ("weak", np.float64),  # what is left of the fluid's torque at its temperature
        ("wet", np.float64),  # the fluid's viscous friction at its temperature
        ("level", np.float64, (BODIES,)),
        ("dry", np.float64, (BODIES,)),  # the brake's part of the level
        ("side", np.int64, (BODIES,)),  # direction of slip; 0: stuck
        ("u", np.float64, (BODIES,)),  # mean speed
        ("main", np.float64, (BODIES,)),  # the system's diagonal
        ("load", np.float64, (BODIES,)),
        ("react", np.float64, (BODIES,)),  # dry friction
        ("tied", np.float64, (BODIES - 1,)),  # a coupling's torque at the step's begin ...
        ("stiff", np.float64, (BODIES - 1,)),  # ... and for each rad/s of mean speed between its bodies
        ("alpha", np.float64, (BODIES,)),
        ("bears", np.float64, (BODIES,)),  # the level of the bristles, or of all elements
        ("rate_Nm_s", np.float64, (BODIES,)),  # how fast the speed winds stiff bristles
        ("kept", np.float64, (BODIES,)),  # of the bristles' deflection behind the step ...
        ("taken", np.float64, (BODIES,)),  # ... and for each rad/s of mean speed
        ("winds", np.int64, (BODIES,)),  # 1: how z goes cannot be foretold
        ("follows", np.float64, (BODIES,)),  # how fast a slipping one follows it [1/s]
        ("bristle_damping", np.float64, (BODIES,)),
        ("way", np.float64, (BODIES,)),  # of z, as foretold
        ("borne", np.float64, (BODIES,)),  # what the elements bear on the mean if z stands still ...
        ("rises", np.float64, (BODIES,)),  # ... and for each rad of z
        ("held", np.float64, (BODIES,)),  # the torque of bristles or elements at rest ...
        ("given", np.float64, (BODIES,)),  # ... and for each rad/s of mean speed
        ("events", np.int64),  # since power-on
        ("missed_events", np.int64),  # steps with more of them than `chain.MOST_EVENTS`
        ("stored", np.float64),  # energy in springs and bristles
    ],
    align=True,
)

DETAIL_COLUMNS = (
    "motor_angle_rad",
    "motor_speed_rad_s",
    "drum_angle_rad",
    "drum_speed_rad_s",
    "stored_energy_J",
    "device_degC",
)
"""Further columns of the true course of a plant in detail."""


def _rate(step_s: float, lag_s: float) -> float:
    return step_s / lag_s if lag_s > 0 else -1.0


def detail_of(p: Plant, hand_inertia: float) -> Record:
    """Return the record of what a plant has beyond one rigid body; `on` is 0 for a plant that has
    nothing of it.
    """
    d: Record = np.zeros(1, DETAIL)[0]
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
