"""Rules across keys of a rig file: errors, and warnings for legal but unlikely values.

Of a detailed plant, bodies need an inertia, couplings must suit the step, bristles need a stiffness, and the iron's
weights must fit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations, pairwise, permutations
from typing import Any

from coulombus.rigs.axes import TAKEN, device_keys
from coulombus.rigs.devices import SENSOR_NAME
from coulombus.rigs.errors import Problem, Source, dotted, shown
from coulombus.rigs.files import COLUMNS
from coulombus.rigs.model import CIA_301_BIT_RATES, MODES, MOST_DEVICES, WORK_WINDOW_CYCLES, to_ns
from coulombus.rigs.plant_detail import MOST_ELEMENTS
from coulombus.rigs.signals import Parts
from coulombus.rigs.toml_lines import Key, Table, value_at

__all__ = ["check", "check_roles", "remarks"]


INT16_MAX = 32767
WITNESS_SHARE = 0.05
"""Allowed relative difference between the position's scale and that measured between marks."""
NODES = ("host", "motor", "brake")
SIMULATION = ("plant", "operator")
"""Sections for the simulation; the host needs none of them."""


@dataclass(frozen=True)
class Rule:
    """`holds` over the values of `keys`.

    Otherwise the error names the first key, with `expected` formatted.
    """

    keys: tuple[Key, ...]
    holds: Callable[..., bool]
    expected: str


def _key(path: str) -> Key:
    return tuple(path.split("."))


def _rule(paths: str, holds: Callable[..., bool], expected: str) -> Rule:
    return Rule(tuple(_key(path) for path in paths.split()), holds, expected)


def _less(first: float, second: float) -> bool:
    return first < second


def _at_most(first: float, second: float) -> bool:
    return first <= second


def _zero(value: float) -> bool:
    return value == 0


RULES = (
    _rule(
        "bus.period_s plant.step_s",
        lambda period, step: to_ns(step) > 0 and to_ns(period) % to_ns(step) == 0,
        "a whole multiple of plant.step_s, which is {1}",
    ),
    _rule("bus.tpdo_window_s bus.period_s", _less, "less than bus.period_s, which is {1}"),
    _rule(
        "bus.delay_cycles bus.actuation",
        lambda cycles, actuation: cycles == 1 or actuation == "next_sync",
        "no such key, or bus.actuation = 'next_sync': only that delays by whole cycles",
    ),
    *(
        _rule(
            f"{second}.node_id {first}.node_id", lambda a, b: a != b, f"another id than {first}.node_id, which is {{1}}"
        )
        for first, second in combinations(NODES, 2)
    ),
    *(
        _rule(
            f"{beat}.heartbeat_s {watch}.heartbeat_timeout_s",
            _less,
            f"less than {watch}.heartbeat_timeout_s, which is {{1}}",
        )
        for beat, watch in (("host", "motor"), ("host", "brake"), ("motor", "motor"), ("brake", "brake"))
    ),
    *(
        _rule(
            f"{node}.{key} bus.period_s",
            lambda timeout, period: timeout > period,
            "more than bus.period_s, which is {1}",
        )
        for node in ("motor", "brake")
        for key in ("setpoint_fault_s", "sync_timeout_s")
    ),
    _rule("mode.passive.motor_limit_Nm", _zero, "0: the motor has no part in this mode"),
    _rule("mode.passive.compensation", _zero, "0: the motor has no part in this mode"),
    _rule("mode.passive.inertia_compensation", _zero, "0: the motor has no part in this mode"),
    _rule("limits.brake_torque_Nm brake.rated_torque_Nm", _at_most, "at most brake.rated_torque_Nm, which is {1}"),
    _rule(
        "limits.net_work_window_s bus.period_s",
        lambda window, period: window <= WORK_WINDOW_CYCLES * period,
        f"at most {WORK_WINDOW_CYCLES} x bus.period_s, which is {{1}}",
    ),
    _rule("plant.brake_off_state_Nm plant.brake_max_Nm", _at_most, "at most plant.brake_max_Nm, which is {1}"),
    _rule(
        "limits.sign_check_travel_rad limits.travel_rad",
        lambda check, travel: travel == "unlimited" or check < travel,
        "less than limits.travel_rad, which is {1}",
    ),
)

PER_MILLE_RULES = tuple(
    _rule(
        f"mode.{mode}.motor_limit_Nm motor.rated_torque_Nm mechanics.ratio",
        lambda limit, rated, ratio: limit <= INT16_MAX * 1e-3 * rated * ratio,
        "at most 32.767 x motor.rated_torque_Nm x mechanics.ratio, as 6071 is an INTEGER16 in per mille",
    )
    for mode in MODES
)
"""Rules for 6071h.

Type and limits of another object are checked when its limit is computed.
"""

REMARKS = (
    _rule("bus.bitrate_bit_s", lambda rate: rate in CIA_301_BIT_RATES, "one of CiA 301's bit rates for a real bus"),
    _rule("bus.delay_cycles", lambda cycles: cycles == 1,
          "no such key, unless a longer delay is studied in virtual time: coulombus run refuses it"),
    *(
        _rule(f"plant.{key} mechanics.{key}", lambda truth, belief: truth == belief,
              f"the same as mechanics.{key} ({{1}}), unless a wrong rig is to be simulated")
        for key in ("motor_polarity", "encoder_polarity", "transducer_polarity", "ratio")
    ),
    _rule("plant.encoder_counts_rev motor.encoder_counts_rev", lambda truth, belief: truth == belief,
          "the same as motor.encoder_counts_rev ({1}), unless a wrong rig is to be simulated"),
    _rule("plant.motor_rated_torque_Nm motor.rated_torque_Nm", lambda truth, belief: truth == belief,
          "the same as motor.rated_torque_Nm ({1}), unless a wrong rig is to be simulated"),
    *(
        _rule(f"mode.{mode}.motor_limit_Nm mode.{mode}.compensation mechanics.friction_Nm",
              lambda limit, share, friction: share * friction <= limit,
              "at least compensation x mechanics.friction_Nm ({1} x {2}), else it is cut off")
        for mode in MODES
    ),
)  # fmt: skip


def _check_witness(values: Table, source: Source) -> None:
    """Check the scale of the position against the counts measured between marks."""
    keys = [_key(path) for path in ("mechanics.counts_turn", "motor.encoder_counts_rev", "mechanics.ratio")]
    scale = ("role", "position", "scale_rad")
    if any(source.is_wrong(key) for key in (*keys, scale)):
        return
    measured, counts, ratio, angle = (value_at(values, key) for key in (*keys, scale))
    if measured is None or counts is None or ratio is None:
        return
    believed, by = counts * ratio, "motor.encoder_counts_rev x mechanics.ratio"
    if angle is not None:
        believed, by = 2 * math.pi / angle, "role.position.scale_rad"
    if abs(believed / measured - 1) > WITNESS_SHARE:
        expected = f"{believed:.6g}, which {by} makes, within {WITNESS_SHARE:.0%}: correct that, or measure between marks again"
        source.stands(keys[0], measured, expected)


def _rules_of_sensors(values: Table) -> Iterator[Rule]:
    """Yield for each sensor the rules of motor and brake: a unique node id, heartbeats faster than their time-outs."""
    others: list[Key] = [("host",), ("motor",), ("brake",)]
    for key in device_keys(values)[2:]:
        for other in others:
            expected = f"another id than {dotted(other)}.node_id, which is {{1}}"
            yield Rule(((*key, "node_id"), (*other, "node_id")), lambda a, b: a != b, expected)
        others.append(key)
        for beat in (("host",), key):
            expected = f"less than {dotted(key)}.heartbeat_timeout_s, which is {{1}}"
            yield Rule(((*beat, "heartbeat_s"), (*key, "heartbeat_timeout_s")), _less, expected)


def _broken_rules(rules: Iterable[Rule], values: Table, source: Source) -> Iterator[tuple[Key, Any, str]]:
    for rule in rules:
        if any(source.is_wrong(key) for key in rule.keys):
            continue
        operands = [value_at(values, key) for key in rule.keys]
        if None not in operands and not rule.holds(*operands):
            yield rule.keys[0], operands[0], rule.expected.format(*map(shown, operands))


def check(values: Table, source: Source) -> None:
    """Note conflicts between keys that are valid by themselves."""
    roles = values.get("role")
    per_mille = not (isinstance(roles, Mapping) and "torque_setpoint" in roles)
    rules = (*RULES, *(PER_MILLE_RULES if per_mille else ()), *_rules_of_sensors(values))
    for key, value, expected in list(_broken_rules(rules, values, source)):
        source.stands(key, value, expected)
    _check_witness(values, source)
    _check_detail(values, source)
    for key in device_keys(values)[2:]:
        if not re.fullmatch(SENSOR_NAME, str(key[-1])) or key[-1] in TAKEN:
            expected = "a name of small letters, digits and _, which begins with a letter and is not " + ", ".join(
                TAKEN
            )
            source.say(key, f"'{key[-1]}' names a sensor; expected {expected}")
    if len(device_keys(values)) > MOST_DEVICES:
        source.say(("sensor",), f"got {len(device_keys(values)) - 2} sensors, expected at most {MOST_DEVICES - 2}")
    for section, other in permutations(SIMULATION):
        if section in values and other not in values and not source.is_wrong((other,)):
            source.say(
                (other,),
                f"the section is missing; expected [{other}] beside [{section}], or none of them: a simulated rig needs both",
            )
    modes = values.get("mode")
    if isinstance(modes, Mapping) and not modes.keys() & set(MODES) and not source.is_wrong(("mode",)):
        expected = ", ".join(f"[mode.{mode}]" for mode in MODES)
        source.say(("mode",), f"no mode is given; expected at least one of {expected}")
    phases = values.get("phase")
    for i, phase in enumerate(phases if isinstance(phases, list) else ()):
        kind = phase.get("kind") if isinstance(phase, dict) else None
        if isinstance(kind, str) and kind in COLUMNS and not source.is_wrong(("phase", i)):
            _check_columns(phase, ("phase", i), COLUMNS[kind][1], source)


def check_roles(problems: Iterable[Problem], parts: Parts, values: Table, source: Source) -> None:
    """Note roles of an axis without an object or a place in a PDO: the problems of its `rigs.pdo_maps.allocate`."""
    for problem in problems:
        role = values.get("role", {}).get(problem.role)
        if problem.role == "deadman":
            source.stands(("host", "deadman"), parts.host.deadman, problem.text)
        elif role is not None:
            source.say(("role", problem.role), str(problem))
        else:
            node = problem.node if problem.node in parts.devices else "motor"
            device = next(key for key in device_keys(values) if key[-1] == node)
            source.say((*device, "eds"), f"got '{parts.part(node).eds}', but {problem}")
        source.problems.append(problem)


def _check_columns(phase: Table, key: Key, column: str, source: Source) -> None:
    times, torques = phase.get("t_s"), phase.get(column)
    if (
        not isinstance(times, list)
        or not isinstance(torques, list)
        or any(source.is_wrong((*key, name)) for name in ("t_s", column))
    ):
        return
    if len(times) != len(torques) or len(times) < 2:
        source.say(
            (*key, column),
            f"got {len(torques)} values where t_s has {len(times)}, expected as many, two or more",
        )
    elif times[0] < 0 or any(later <= earlier for earlier, later in pairwise(times)):
        source.stands((*key, "t_s"), times, "times that grow, from 0 on")


def remarks(values: Table, source: Source) -> tuple[str, ...]:
    """Return warnings for legal but unlikely values, with file:line."""
    texts = [
        f"{source.where(key)[1]}: {source.spelled(key)}: got '{shown(value)}', expected {source.spell_keys(expected)}"
        for key, value, expected in _broken_rules(REMARKS, values, source)
    ]
    for i, phase in enumerate(values.get("phase", ())):
        for tap in phase.get("taps_s", ()) if phase["kind"] == "hold" else ():
            if tap >= phase["duration_s"]:
                key = ("phase", i, "taps_s")
                text = f"the tap at {shown(tap)} comes after the phase's end ({shown(phase['duration_s'])} s)"
                texts.append(f"{source.where(key)[1]}: {source.spelled(key)}: {text}; expected a tap within the phase")
    return tuple(texts)


COUPLINGS = (("cable", "motor_inertia_kg_m2"), ("handle", "inertia_kg_m2"))


def _check_detail(values: Table, source: Source) -> None:
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
