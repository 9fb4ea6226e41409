"""What a study may change of a rig: what is displayed, and nothing that keeps a hand from harm.

A study sets a law, its parameters, modes, the simulated plant and hand. It may make some limits
tighter. It never widens one, and it leaves alone what a torque means: devices, ratio, polarities,
the host's watches, the dead man's switch.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from coulombus.rigs.rig import Rig
from coulombus.rigs.toml_lines import read_toml

__all__ = ["widened"]

FREE = frozenset({"mode", "law", "plant", "operator", "phase"})
"""Sections of what is displayed, and of what is simulated."""
BELIEFS = frozenset({"inertia_kg_m2", "viscous_Nms_rad", "cogging_Nm", "cogging_periods"})
"""Keys of [mechanics] that a study may set; friction_Nm, too, but no larger: the motor's limit grows
with it.
"""
TIGHTER = frozenset({"torque_rate_Nm_s", "brake_torque_Nm", "speed_rad_s", "travel_rad", "net_work_J", "passivity_J"})
"""Keys of [limits] that are safe to be made smaller."""


def widened(rig: Rig, variant: Rig) -> list[str]:
    """Return what `variant` changes of `rig` that a study may not change, a sentence for each."""
    old, new = (dict(_flat(read_toml(either.effective()).values)) for either in (rig, variant))
    refusals = []
    for key in dict.fromkeys((*old, *new)):
        before, after = old.get(key), new.get(key)
        if before != after:
            why = _refusal(key[2:] if key[0] == "axis" else key, before, after)
            if why is not None:
                refusals.append(f"{'.'.join(map(str, key))}: {why}")
    return refusals


def _flat(values: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    if isinstance(values, Mapping):
        for name, value in values.items():
            yield from _flat(value, (*above, str(name)))
    elif above:
        yield above, values


def _refusal(key: tuple[str, ...], before: Any, after: Any) -> str | None:
    section, name = key[0], key[-1]
    if section == "mode" and name == "motor_limit_Nm":
        return _no_larger(before, after)
    if section in FREE or (section == "mechanics" and name in BELIEFS):
        return None
    if section == "limits" and name in TIGHTER:
        return _no_larger(before, after)
    if section == "mechanics" and name == "friction_Nm":
        return _no_larger(before, after)
    return f"is {_value_text(before)} in the rig file; a study may not change it"


def _no_larger(before: Any, after: Any) -> str | None:
    largest, number = _number(before), _number(after)
    if number <= largest:
        return None
    return (
        f"{_value_text(after)} is wider than the rig's {_value_text(before)}; a study may make it smaller, not larger"
    )


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else float("inf")


def _value_text(value: Any) -> str:
    return "nothing" if value is None else f"{value:g}" if isinstance(value, float) else f"{value!r}"
