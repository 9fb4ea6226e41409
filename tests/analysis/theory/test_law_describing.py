"""Describing functions in closed form against the law itself, driven along a sine."""

from __future__ import annotations

import math

import pytest
from scipy.integrate import quad

from coulombus.analysis.theory.describing import LARGE, arctan_psi, jenkins_psi, stribeck_psi
from coulombus.analysis.theory.law_benchmarks import describing_function
from coulombus.host.laws.along import given_law


def numeric(name, a, frequency_Hz, **values):
    law = given_law(name, [f"{key}={value}" for key, value in values.items()])
    return describing_function(law, a, frequency_Hz, 4000)


@pytest.mark.parametrize("form", ["gauss", "tustin", "lorentz"])
@pytest.mark.parametrize("a", [0.02, 0.4, 3.0])
def test_stribeck(form, a):
    values = {"F_c_Nm": 0.7, "F_s_Nm": 1.5, "v_s_rad_s": 0.3, "sigma_2_Nms_rad": 0.1}
    found = numeric("stribeck", a, 2.0, **values, form=form)
    assert found == pytest.approx(stribeck_psi(a, *values.values(), form=form), rel=1e-3)


@pytest.mark.parametrize("r", [LARGE * 0.999, LARGE * 1.001, 60.0])
def test_tustin_where_its_functions_have_no_digits_left(r):
    exact = quad(lambda x: math.exp(-r * math.sin(x)) * math.sin(x), 0, math.pi, epsabs=1e-13, limit=400)[0] / 2
    found = (stribeck_psi(r, 0.0, 1.0, 1.0, form="tustin")) * math.pi * r / 4
    assert found == pytest.approx(exact, rel=2e-3)


@pytest.mark.parametrize("a", [0.02, 0.4, 3.0])
def test_arctan(a):
    found = numeric("regularised", a, 2.0, F_c_Nm=0.9, v_t_rad_s=0.2, form="arctan")
    assert found == pytest.approx(arctan_psi(a, 0.9, 0.2), rel=1e-3)


@pytest.mark.parametrize("law", ["kikuuwe", "dahl"])
@pytest.mark.parametrize("a", [0.02, 0.3, 2.0])
def test_a_spring_that_slips(law, a):
    own = {"K_Nm_rad": 100, "B_Nms_rad": 0} if law == "kikuuwe" else {"sigma_Nm_rad": 100, "alpha": 0}
    found = numeric(law, a, 1.0, F_c_Nm=1.0, **own)
    expected = jenkins_psi(a, 1.0, 1.0, 100.0)
    assert found == pytest.approx(expected, rel=2e-3)
    if a == 0.02:  # it never slips
        assert expected == pytest.approx(complex(0, -100 / (2 * math.pi)))


def test_a_form_that_is_none():
    with pytest.raises(ValueError, match="expected gauss, tustin or lorentz"):
        stribeck_psi(1.0, 1.0, 1.2, 0.5, form="gaus")
