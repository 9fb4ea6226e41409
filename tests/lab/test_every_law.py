"""Every law of the project in every mode on every packaged rig, with the parameters of the package."""

from __future__ import annotations

import pytest

from coulombus.host.laws.laws import BUILTIN_LAWS
from coulombus.lab.simulate import simulate
from coulombus.rigs.rig import RigError, load_rig

SECONDS = 8.0
"""Rest, hold and strokes of each rig's schedule."""


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "mode"),
    [*(("bench", mode) for mode in ("active", "passive", "hybrid")), ("paper", "hybrid"), ("two_axes", "active")],
)
@pytest.mark.parametrize("law", BUILTIN_LAWS)
def test_a_law_is_displayed_as_it_is_shipped(name, mode, law):
    rig = load_rig(name).with_law(law)
    if law == "wall" and mode == "hybrid":  # the motor's limit in this mode leaves no stiffness
        with pytest.raises(RigError, match=r"raise that limit, or lower law\.wall\.most_Nm"):
            simulate(rig, mode, SECONDS)
        axes = [f"axis.{axis}." for axis in rig.axis_names] or [""]
        limits = (f"{axis}mode.hybrid.motor_limit_Nm=1.4" for axis in axes)
        rig = load_rig(name, tuple(limits)).with_law(law)
    result = simulate(rig, mode, SECONDS)
    assert (result.trip, result.cycles, result.exit_status) == (None, round(SECONDS / rig.bus.period_s), 0)
