"""The figures of a run as the columns of a table, by the names that ``simulate --json`` prints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from functools import cache
from typing import Any, TypeAlias, get_args, get_type_hints

from coulombus.host.cycle.controller import COUNTERS
from coulombus.host.run.result import RunResult
from coulombus.rigs.rig import Rig
from coulombus.rigs.toml_lines import value_at

__all__ = ["FIGURES", "Value", "figures_of", "known_figures"]

Value: TypeAlias = float | int | str | None

_LEFT_OUT = ("mode", "recording", "recording_sha256", "stopped_by", "bus", "deadman", "cpu_us_per_cycle")
_LISTS = ("remarks", "losses", "opened")


def _scalars(owner: type) -> Iterator[tuple[str, type]]:
    hints = get_type_hints(owner)
    for member in fields(owner):
        kinds = [kind for kind in (get_args(hints[member.name]) or (hints[member.name],)) if kind is not type(None)]
        if member.name not in _LEFT_OUT and len(kinds) == 1 and kinds[0] in (float, int, str):
            yield member.name, kinds[0]


FIGURES: Mapping[str, type] = {
    **dict(_scalars(RunResult)),
    **dict.fromkeys(_LISTS, str),
    **{f"counters.{name}": int for name in COUNTERS},
}
"""Figure of a run -> the type of its value, which may be None.

Lists of sentences are joined.
"""

_OF_AXES = (
    *("cycles", "lost_pdos", "trip", "sign_check", "hold_velocity_rms_rad_s", "hold_counts_p2p", "torque_flips_per_s"),
    *("stick_velocity_rms_rad_s", "hold_peak_Hz", "hold_push_Nm"),
)


def known_figures(rig: Rig) -> dict[str, type]:
    """Return the figures of the runs of a rig; with several axes also those of each axis:
    ``axes.left.hold_counts_p2p``.
    """
    return _figure_types(rig.axis_names, rig.channels)


@cache
def _figure_types(names: tuple[str, ...], channels: tuple[str, ...]) -> dict[str, type]:
    of_axes = {f"axes.{name}.{figure}": FIGURES[figure] for name in names for figure in _OF_AXES}
    return {**FIGURES, **of_axes}


def figures_of(result: RunResult, rig: Rig) -> dict[str, Value]:
    """Return the figures of a run of `rig`, one for each name of `known_figures`."""
    values = result.as_dict()
    axes = {**(values["axes"] or {})}
    for bus_values in (values["buses"] or {}).values():
        axes |= bus_values["axes"] or {}
    return {name: _value(value_at(values | {"axes": axes}, name.split("."))) for name in known_figures(rig)}


def _value(value: Any) -> Value:
    if isinstance(value, list | tuple):
        return "\n".join(map(str, value)) or None
    return value  # type: ignore[no-any-return]
