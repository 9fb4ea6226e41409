r"""Uncertainties of earlier steps, for the intervals of later steps.

A step computes with figures of the rig file, each of which is a factor of its result. So their intervals
contribute to its own: by the delta method, the squares of relative 95 % reaches add,

.. math:: \Bigl(\frac{r}{x}\Bigr)^2 = \Bigl(\frac{r_0}{x}\Bigr)^2 + \sum_i s_i^2

(JCGM 100:2008, GUM, 5.1.6). If a measured figure was not written because its difference was not
significant, this difference is added to its reach: the file has the old value.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

__all__ = ["ANGLE", "HANDLE_TORQUE", "INERTIA", "SCALE", "TABLE", "rounded", "shares"]

SCALE = "role.handle_torque.scale_Nm"
HANDLE_TORQUE = "torque at the handle at 1000 per mille"
"""The motor's torque times the ratio; it is measured as a product, so the ratio's interval has no part in it."""
ANGLE = ("mechanics.ratio", "role.position.scale_rad")
TABLE = "role.brake_setpoint.table"
"""The brake's; its reach is relative to the largest torque, and holds both branches of a hysteresis."""
INERTIA = "mechanics.inertia_kg_m2"


def shares(steps: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Return the relative 95 % reach of each figure of the rig file that the steps have measured.

    `steps`: `Progress.steps`
    """
    reaches: dict[str, float] = {}
    for step in steps.values():
        for finding in step["findings"]:
            old, new, reach = finding["old"], finding["new"], finding["uncertainty"]
            name = finding["key"] or finding["name"]
            if reach is None:
                continue
            if name == TABLE and new:
                reaches[name] = reach / max(abs(torque) for _, torque in new)
            if not isinstance(new, int | float):
                continue
            value = new if finding["changed"] else old
            if isinstance(value, int | float) and value:
                reaches[name] = (reach + abs(new - value)) / abs(value)
    return reaches


def rounded(value: float, reach: float) -> float:
    """Return a value rounded to the digits that its 95 % reach justifies."""
    if not reach > 0.0:
        return float(f"{value:.6g}")
    return round(value, math.ceil(-math.log10(reach)) + 1)
