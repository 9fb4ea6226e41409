"""Entry points for the virtual bus to advance a plant: one rigid body, the detailed plant, two coupled joints.

All have the same signature, so that the loop of the bus takes any as a pointer and contains none. A rig
without a `[plant.X]` compiles nothing of the detailed plant, a rig without `[plane]` nothing of the joints.

    p : the `PlantRecord` of an axis
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, TypeAlias

import numpy as np

from coulombus.kernels.decorator import JIT_DISABLED, cacheable, kernel
from coulombus.kernels.records import Floats, RecordArray, Records
from coulombus.sim_bus.rig.arm_plant import advance_joints
from coulombus.sim_bus.rig.chain import move
from coulombus.sim_bus.rig.elements import stored_in_elements
from coulombus.sim_bus.rig.mr_brake import brake_capacity, heat, iron, thin
from coulombus.sim_bus.rig.plant import (
    TRUTH_COLUMNS,
    advance,
    coil_target,
    heat_coil,
    keep_truth,
    magnetise,
    motor_target,
    settled,
)
from coulombus.sim_bus.rig.records import BODIES, PLANT, PlantRecord, wave

import numba  # isort: skip  (after kernels.decorator, which sets the cache directory)

__all__ = ["CourseFunction", "advance_detailed", "course_of"]

PlantRecords: TypeAlias = RecordArray[PlantRecord]
CourseFunction: TypeAlias = Callable[[PlantRecords, int, Floats, int, int, int, Floats, int], int]
"""Advances the plant of an axis, and with it the plants that are coupled to it."""
PLAIN = len(TRUTH_COLUMNS)
RIPPLE, COGGING = BODIES, BODIES + 1
"""Rows of `waves`."""


@kernel
def _keep(p: PlantRecord, out: Floats) -> None:
    """Write a row of the true course; angle and speed are the handle's."""
    d = p.detail
    last = d.count - 1
    keep_truth(p, out)
    out[1], out[2] = d.q[last], d.v[last]
    kinetic = stored = 0.0
    for i in range(d.count):
        kinetic += 0.5 * d.mass[i] * d.v[i] * d.v[i]
        stored += 0.5 * d.share[i] * d.sigma_0 * d.z[i] * d.z[i] + stored_in_elements(d, i)
    for j in range(last):
        if d.contact[j] != 0 or d.gap[j] == 0.0:
            way = d.q[j] - d.q[j + 1] - d.contact[j] * d.gap[j]
            stored += 0.5 * d.k[j] * way * way
    out[12] = kinetic
    out[PLAIN] = d.q[0]
    out[PLAIN + 1] = d.v[0]
    out[PLAIN + 2] = d.q[d.drum]
    out[PLAIN + 3] = d.v[d.drum]
    out[PLAIN + 4] = stored
    out[PLAIN + 5] = d.degC


@kernel
def advance_detailed(
    p: PlantRecord, f_h: Floats, per_knot: int, first: int, steps: int, truth: Floats, row: int
) -> None:
    """Advance a detailed plant, like `sim_bus.rig.plant.advance` for a plain plant."""
    d = p.detail
    target, coil_wants = motor_target(p), coil_target(p)
    remembers = p.remanence > 0.0 or coil_wants < 0.0 or p.coil < 0.0
    last = d.count - 1
    thin(d)
    knot = first // per_knot
    within = first - knot * per_knot
    slope = (f_h[knot + 1] - f_h[knot]) / per_knot
    square, rate = 0.0, 1.0 / p.h
    for k in range(steps):
        motor = target + (p.motor - target) * p.motor_decay
        torque = 0.5 * (p.motor + motor)
        middle = d.q[0] + 0.5 * p.h * d.v[0]
        if d.ripple > 0.0:
            torque *= 1.0 + d.ripple * wave(d.waves[RIPPLE], d.ripple_rad * middle + d.ripple_phase)
        if p.cogging > 0.0:
            torque -= p.cogging * wave(d.waves[COGGING], p.cogging_rad * middle)
        p.motor = motor
        coil = float(coil_wants + (p.coil - coil_wants) * p.coil_decay)
        p.coil = coil
        square += coil * coil
        if d.plays > 0:
            magnetised = iron(d, coil)
        else:
            magnetised = float(magnetise(p)) if remembers else coil
        capacity = brake_capacity(p, magnetised)
        hand = f_h[knot] + slope * (within + 0.5)
        p.f_motor = torque
        before, speed = p.w_brake + p.w_friction - p.w_viscous, d.v[last]
        move(p, hand, torque, capacity)
        if d.heat_1_JK > 0.0:
            heat(p, rate * (before - (p.w_brake + p.w_friction - p.w_viscous)), coil * p.coil_A_Nm)
        seen = p.f_operator + d.crosstalk * rate * (d.v[last] - speed)
        p.transduced = seen + (p.transduced - seen) * p.transducer_decay
        p.x, p.v = d.q[0], d.v[0]
        p.t_ns += p.step_ns
        within += 1
        if within == per_knot and k + 1 < steps:
            within = 0
            knot += 1
            slope = (f_h[knot + 1] - f_h[knot]) / per_knot
        if row >= 0:
            _keep(p, truth[row + k])
    p.motor, p.coil, p.fluid = settled(p.motor), settled(p.coil), settled(p.fluid)
    if p.K_A2 > 0.0 and steps > 0:
        heat_coil(p, steps * p.h, square / steps)


def _plain(
    plants: PlantRecords, a: int, f_h: Floats, per_knot: int, first: int, steps: int, truth: Floats, row: int
) -> int:
    advance(plants[a], f_h[a], per_knot, first, steps, truth[a], row)
    return 0


def _either(
    plants: PlantRecords, a: int, f_h: Floats, per_knot: int, first: int, steps: int, truth: Floats, row: int
) -> int:
    if plants[a].detail.on != 0:
        advance_detailed(plants[a], f_h[a], per_knot, first, steps, truth[a], row)
    else:
        advance(plants[a], f_h[a], per_knot, first, steps, truth[a], row)
    return 0


def _joints(
    plants: PlantRecords, _a: int, f_h: Floats, per_knot: int, first: int, steps: int, truth: Floats, row: int
) -> int:
    advance_joints(plants, f_h, per_knot, first, steps, truth, row)
    return 0


def course_of(plants: Records) -> CourseFunction:
    """Return the function that advances these plants, in the form for kernels: compiled, or loaded from the
    cache.
    """
    plain = plants.view(np.ndarray)
    function = _joints if plain["plane"]["on"].any() else _either if plain["detail"]["on"].any() else _plain
    return function if JIT_DISABLED else _pointer(function)


@cache
def _pointer(function: CourseFunction) -> CourseFunction:
    """Return a plant's function in the form for kernels; it stores nothing, so a process loads it once."""
    dispatcher: Any = numba.njit(nogil=True, error_model="numpy", cache=cacheable(function))(function)
    i8, f8 = numba.int64, numba.float64
    signature = i8(numba.from_dtype(PLANT)[::1], i8, f8[:, ::1], i8, i8, i8, f8[:, :, ::1], i8)
    dispatcher.compile(signature.args)
    pointer: CourseFunction = numba.types.CompileResultWAP(dispatcher.overloads[dispatcher.signatures[0]])
    return pointer
