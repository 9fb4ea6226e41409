"""Rules across keys of a detailed plant.

Bodies need an inertia, couplings must suit the step, bristles need a stiffness, and the iron's weights must fit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from coulombus.rigs.errors import Source, shown
from coulombus.rigs.plant_detail import MOST_ELEMENTS
from coulombus.rigs.toml_lines import Table

__all__ = ["check_detail"]

COUPLINGS = (("cable", "motor_inertia_kg_m2"), ("handle", "inertia_kg_m2"))


def check_detail(values: Table, source: Source) -> None:
    """Note conflicts between valid keys of `[plant]` and its sections, and errors in the host's model of the brake's
    iron.
    """
    for section in ("plant", "brake"):
        _check_iron(section, values.get(section), source)
    plant = values.get("plant")
    if not isinstance(plant, Mapping):
        return
    _check_bodies(plant, source)
    friction = plant.get("friction")
    if isinstance(friction, Mapping) and friction.get("law") in ("lugre", "gms", "leuven"):
        _check_friction(friction, source)
        if plant.get("coulomb_Nm") == 0:
            source.say(("plant", "coulomb_Nm"), "got '0', but bristles need a friction above 0 (plant.friction.law)")
    if isinstance(plant.get("iron"), Mapping) and (remanence := _number(source, plant, "brake_remanence")):
        text = f"got '{shown(remanence)}', expected 0 beside [plant.iron]: that is another model of the same iron"
        source.say(("plant", "brake_remanence"), text)


def _check_friction(friction: Table, source: Source) -> None:
    key, law = ("plant", "friction"), friction["law"]
    stiffness, rate = friction.get("sigma_0_Nm_rad", 0.0), friction.get("C_Nm_s", 0.0)
    if law == "lugre":
        if stiffness == 0:
            text = f"got '{shown(stiffness)}', but bristles need a stiffness above 0"
            source.say((*key, "sigma_0_Nm_rad"), text)
        return
    elements, shares = friction.get("elements_Nm_rad", []), friction.get("shares", [])
    if law == "gms" and rate == 0:
        source.say(
            (*key, "C_Nm_s"), f"got '{shown(rate)}', expected above 0: how fast a slipping element of gms follows"
        )
    if not isinstance(elements, list) or source.is_wrong((*key, "elements_Nm_rad")):
        return
    if not elements:
        text = f"got none, expected a list of 1 to {MOST_ELEMENTS} numbers above 0: {law} is made of elements"
        source.say((*key, "elements_Nm_rad"), text)
    elif isinstance(shares, list) and not source.is_wrong((*key, "shares")) and len(shares) != len(elements):
        source.say(
            (*key, "shares"), f"got {len(shares)} values where elements_Nm_rad has {len(elements)}, expected as many"
        )


def _number(source: Source, values: Any, *key: str) -> float | None:
    """Return a valid number of `[plant]`, else None."""
    for part in key:
        values = values.get(part) if isinstance(values, Mapping) else None
    right = type(values) in (int, float) and not source.is_wrong(("plant", *key))
    return float(values) if right else None


def _check_bodies(plant: Table, source: Source) -> None:
    whole, step = _number(source, plant, "inertia_kg_m2"), _number(source, plant, "step_s")
    parts = {name: _number(source, plant, name, key) for name, key in COUPLINGS if isinstance(plant.get(name), Mapping)}
    if whole is None or step is None or not parts or None in parts.values():
        return
    ends = {name: part for name, part in parts.items() if part is not None}
    inner = whole - math.fsum(ends.values())
    if inner <= 0:
        name, key = next((name, key) for name, key in COUPLINGS if name in ends)
        together = " + ".join(f"plant.{body}.{inertia_key}" for body, inertia_key in COUPLINGS if body in ends)
        expected = f"less: the drum has what {together} leaves of plant.inertia_kg_m2, which is {shown(whole)}"
        source.stands(("plant", name, key), ends[name], expected)
        return
    for name, end in ends.items():
        both = 1 / end + 1 / inner
        for key, largest, why in (
            ("stiffness_Nm_rad", 1 / (step * step * both), "a period of its vibration takes at least 2 pi steps"),
            ("damping_Nms_rad", 2 / (step * both), "its damping acts for at least half a step"),
        ):
            value = _number(source, plant, name, key)
            if value is not None and value > largest:
                expected = (
                    f"at most {largest:.4g} with plant.step_s = {shown(step)} and the inertias {end:.4g} and {inner:.4g} kg m2 "
                    f"beside it ({why}); take a shorter step, or leave the section out: then it is rigid"
                )
                source.stands(("plant", name, key), value, expected)


def _check_iron(section: str, values: Any, source: Source) -> None:
    iron = values.get("iron") if isinstance(values, Mapping) else None
    if not isinstance(iron, Mapping):
        return
    plays, weights = iron.get("play_Nm"), iron.get("weights")
    if not isinstance(plays, list) or not isinstance(weights, list):
        return
    key = (section, "iron", "weights")
    if source.is_wrong(key) or source.is_wrong((section, "iron", "play_Nm")):
        return
    if any(type(weight) not in (int, float) for weight in weights):
        return
    if len(weights) != len(plays):
        source.say(key, f"got {len(weights)} values where play_Nm has {len(plays)}, expected as many")
    elif math.fsum(weights) > 1 + 1e-12:
        source.say(key, f"got {shown(weights)}, together {math.fsum(weights):.4g}; expected at most 1")
