"""The curve of a law that the page draws, against the law's equation at steady speeds."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.host.cycle.controller import Controller
from coulombus.host.run.law_curve import SPEEDS, law_curve
from coulombus.rigs.rig import RigError, load_rig

pytestmark = pytest.mark.slow  # a law is asked at some 200,000 samples


def curve_of(law, mode="active", live=None, *overrides):
    """Return velocities and friction of the bench rig's law, as arrays; None where it has no curve."""
    axis = load_rig("bench", (f"law.function={law!r}", *overrides)).one_axis()
    found = law_curve(axis, mode, live or {})
    return None if found is None else np.array(found)


def lugre(v, F_c=1.0, F_s=1.2, v_s=0.5, sigma_2=0.0):
    """Return LuGre's friction at a steady speed: its bristles have come to rest."""
    return np.sign(v) * (F_c + (F_s - F_c) * np.exp(-((v / v_s) ** 2))) + sigma_2 * v


def test_the_curve_of_lugre_is_its_steady_state():
    v, f = curve_of("lugre")
    far = load_rig("bench").one_axis().limits.speed_rad_s
    np.testing.assert_allclose(v[len(v) // 2 :], far * np.array(SPEEDS))
    np.testing.assert_array_equal(v, -v[::-1])
    assert np.all(np.diff(v) > 0)
    np.testing.assert_allclose(f, lugre(v), rtol=2e-3)


def test_live_parameters_count_and_those_that_are_not_named_are_the_rig_files():
    v, f = curve_of("lugre", "active", {"F_c_Nm": 0.4, "sigma_2_Nms_rad": 0.25}, "law.lugre.v_s_rad_s=0.7")
    np.testing.assert_allclose(f, lugre(v, F_c=0.4, v_s=0.7, sigma_2=0.25), rtol=2e-3)


def test_the_parameters_of_the_mode_count_for_a_law_of_the_mode():
    """Below the velocity band the law rests, and displays nothing."""
    axis = load_rig("bench").one_axis()
    v, f = curve_of("coulomb", "hybrid", {"F_d_Nm": 2.25, "F_s_Nm": 9.0})
    count_rad = abs(float(Controller(axis, "hybrid").control["rad_count"][0]))
    moves = abs(v) > axis.law.velocity_band_counts * count_rad / axis.bus.period_s
    np.testing.assert_allclose(f, np.where(moves, 2.25 * np.sign(v), 0.0), rtol=1e-9)
    assert 0 < np.count_nonzero(moves) < len(v)


@pytest.mark.parametrize("law", ["detent", "wall"])
def test_a_law_that_depends_on_the_place_has_no_curve(law):
    assert curve_of(law) is None


def test_a_law_that_cannot_be_loaded_is_told():
    with pytest.raises(RigError, match=r"nowhere\.py"):
        curve_of("nowhere.py:law")
