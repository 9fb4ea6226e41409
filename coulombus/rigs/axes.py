"""Several axes in one rig file: values of each in ``[axis.NAME]``, and the keys that all must share.

::

    [axis.x]                 # keys that are absent here come from the file's plain sections
    motor.node_id = 1
    brake.node_id = 2

    [axis.y]
    bus.channel = "b"        # on another bus
    motor.node_id = 3
    mode.hybrid.F_s_Nm = 2.0
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from copy import deepcopy
from itertools import combinations
from typing import Any

from coulombus.rigs.errors import Source
from coulombus.rigs.toml_lines import Key, Table, value_at

__all__ = ["MAX_AXES", "TAKEN", "check_axes", "device_keys", "split_axes"]

MAX_AXES = 16
NAME = re.compile(r"[a-z][a-z0-9_]{0,15}")
TAKEN = frozenset(("motor", "brake", "host", "axis"))

SHARED: tuple[tuple[Key, str], ...] = (
    (("rig",), "a rig has one name"),
    (("bus", "period_s"), "one cycle drives all axes"),
    (("bus", "actuation"), "one cycle drives all axes"),
    (("bus", "tpdo_window_s"), "one cycle drives all axes"),
    (("host",), "one host drives all axes"),
    (("law", "function"), "one compiled law drives all axes; its parameters may differ"),
    (("plant", "step_s"), "the axes are simulated together"),
)
"""Keys that must be equal on all axes, with the reason."""

BIT_RATE: Key = ("bus", "bitrate_bit_s")


def split_axes(values: dict[str, Any], source: Source) -> dict[str, dict[str, Any]] | None:
    """Return each axis' values, the shared ones included; None for a file without ``[axis.NAME]``.

    `values` is not changed; errors in the axes' names are noted in `source`.
    """
    if "axis" not in values:
        return None
    axes, shared = values["axis"], {key: value for key, value in values.items() if key != "axis"}
    if not isinstance(axes, dict) or not all(isinstance(part, dict) for part in axes.values()):
        source.say(("axis",), "is not a table of axes; expected [axis.NAME], once for each axis")
        return {}
    if not 1 <= len(axes) <= MAX_AXES:
        source.say(("axis",), f"got {len(axes)} axes, expected 1 to {MAX_AXES}")
    merged: dict[str, dict[str, Any]] = {}
    for name, part in axes.items():
        if not NAME.fullmatch(name) or name in TAKEN:
            expected = "a name of small letters, digits and _, which begins with a letter and is not " + ", ".join(
                TAKEN
            )
            source.say(("axis", name), f"'{name}' names an axis; expected {expected}")
        merged[name] = _merge(shared, part)
    return merged


def _merge(shared: Table, part: Table) -> dict[str, Any]:
    """Return `shared` overridden by `part`; a list is replaced as a whole."""
    merged = deepcopy(dict(shared))
    for key, value in part.items():
        both = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = _merge(merged[key], value) if both else deepcopy(value)
    return merged


def device_keys(values: Table) -> list[Key]:
    """Return the keys of an axis' devices: motor, brake, sensors."""
    sensors = values.get("sensor")
    return [("motor",), ("brake",), *(("sensor", name) for name in (sensors if isinstance(sensors, Mapping) else ()))]


def check_axes(axes: Mapping[str, Table], sources: Mapping[str, Source], *, one_cycle: bool = False) -> None:
    """Note shared keys that differ between axes, and duplicate node ids on one bus.

    With `one_cycle` one host serves the buses of all axes, and they count as one bus.
    """
    for first, second in combinations(axes, 2):
        earlier, later, source = axes[first], axes[second], sources[second]
        names = {first: second, second: first}
        same_bus = value_at(earlier, ("bus", "channel")) == value_at(later, ("bus", "channel"))
        as_one = same_bus or one_cycle
        together = "both hang on one bus" if same_bus else "one host serves both buses in one cycle"
        for key, why in (*SHARED, *([(BIT_RATE, together)] if as_one else [])):
            if value_at(earlier, key) != value_at(later, key) and not source.is_wrong(key):
                odd = next((name for name in (second, first) if sources[name].full(key) != key), second)
                sources[odd].say(key, f"differs from that of axis {names[odd]}; expected the same, because {why}")
        modes = [set(value_at(axis, ("mode",)) or ()) for axis in (earlier, later)]
        if modes[0] != modes[1]:
            source.say(("mode",), f"the modes are not those of axis {first}; expected {', '.join(sorted(modes[0]))}")
        if as_one:
            where = "on the same bus" if same_bus else "whose bus the same host serves in the same cycle"
            for key, device in _ids(earlier, later):
                if not source.is_wrong(key):
                    source.stands(key, value_at(later, key), f"another id than the {device}'s of axis {first}, {where}")


def _ids(earlier: Table, later: Table) -> Iterator[tuple[Key, str]]:
    node_ids = {value_at(earlier, (*device, "node_id")): device[-1] for device in reversed(device_keys(earlier))}
    for device in device_keys(later):
        key: Key = (*device, "node_id")
        node_id = value_at(later, key)
        if node_id is not None and node_id in node_ids:
            yield key, str(node_ids[node_id])
