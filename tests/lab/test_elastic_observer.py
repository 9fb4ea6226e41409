"""The observer of the compensation on elastic rigs that are believed rightly (docs/theory.md)."""

from __future__ import annotations

import pytest

from coulombus.lab.simulate import simulate
from places import ROOT

ELASTIC = ROOT / "examples" / "elastic.toml"


@pytest.mark.parametrize("cable", [900.0, 2500.0])
def test_an_elastic_rig_that_is_believed_rightly_has_nothing_withheld(cable):
    overrides = (f"plant.cable.stiffness_Nm_rad={cable}", "plant.handle.stiffness_Nm_rad=1500.0")
    result = simulate(ELASTIC, "hybrid", 9.0, overrides=overrides)
    assert (result.trip, result.counters["withheld_compensation"]) == (None, 0)


def test_a_soft_cable_that_the_compensation_drives_is_withheld():
    overrides = ("plant.cable.stiffness_Nm_rad=150.0", "plant.handle.stiffness_Nm_rad=600.0")
    result = simulate(ELASTIC, "hybrid", 9.0, overrides=overrides)
    assert result.counters["withheld_compensation"] > 500
