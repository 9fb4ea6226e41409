"""Describing functions of the laws, crossings, absolute stability."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm

from coulombus.analysis.theory.absolute import (
    Verdict,
    absolute_stability,
    circle_slope,
    passive_set_slope,
    tsypkin_slope,
)
from coulombus.analysis.theory.crossings import crossings
from coulombus.analysis.theory.describing import ANALYTIC, LawParameters, analytic, numeric, regularised
from coulombus.analysis.theory.linear import frequency_response
from coulombus.analysis.theory.operators import Operator, ParameterError
from coulombus.analysis.theory.parameters import Parameters
from coulombus.analysis.theory.zames_falb import multiplier_response
from coulombus.host.laws.laws import coulomb, karnopp

PAPER = Parameters()
LAWS = [
    LawParameters(band_v=0.01),
    LawParameters(band_v=0.02, F_s=12.0, K_p=3e4),
    LawParameters(band_v=0.02, F_s=12.0, K_p=100.0),
    LawParameters(band_v=0.02, F_s=12.0, K_p=3e6),
]


@pytest.mark.parametrize("function", list(ANALYTIC))
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("a", [0.03, 0.1])
def test_analytic_and_numeric_agree(function, law, a):
    found, known = numeric(function, a, 3.0, law, samples=4000), analytic(function, a, 3.0, law)
    assert abs(found - known) < 1e-3 * abs(
        known
    )  # achieved: 4e-4 with 4000 samples, 8e-5 with 20,000: a jump falls between two


def test_every_law_of_the_host_has_an_analytic_function():
    assert {coulomb, karnopp} <= set(ANALYTIC)


def test_coulomb_is_eq_5():
    law = LawParameters(F_d=10.0)
    assert analytic(coulomb, 0.2, 1.0, law) == pytest.approx(40 / (math.pi * 0.2))
    assert numeric(coulomb, 0.2, 1.0, law) == pytest.approx(40 / (math.pi * 0.2), rel=1e-6)


def test_any_law_numerically():
    """A law of one's own, against eq. (2) by quadrature."""

    def viscous_and_cubic(motion, law, state):
        return law.user[0] * motion.v_rad_s + law.user[1] * motion.v_rad_s**3

    found = numeric(viscous_and_cubic, 0.5, 2.0, LawParameters(user=(3.0, 8.0)), periods=1)
    expected = (
        2
        / (math.pi * 0.5)
        * quad(lambda x: (3 * 0.5 * math.sin(x) + 8 * (0.5 * math.sin(x)) ** 3) * math.sin(x), 0, math.pi)[0]
    )
    assert found == pytest.approx(expected, rel=1e-9)
    with pytest.raises(ParameterError, match="no analytic"):
        analytic(viscous_and_cubic, 0.5, 2.0, LawParameters())


def test_regularised_slope_is_its_gain_at_small_amplitude():
    law = LawParameters(F_d=10.0, band_v=0.02)
    assert analytic(regularised, 0.01, 1.0, law) == pytest.approx(500.0)


def test_the_papers_crossing():
    """252.3 Hz, known from the project's notes; H* there is real, and the amplitude is 4 c
    |H|/pi.
    """
    found = crossings(PAPER).found
    assert len(found) == 1
    assert found[0].frequency_Hz == pytest.approx(252.3, abs=0.05)
    h = frequency_response(np.array([found[0].frequency_Hz]), PAPER)[0]
    assert abs(h.imag) < 1e-12
    assert found[0].h_real == pytest.approx(h.real)
    assert found[0].amplitude_m_s == pytest.approx(4 * 10 * abs(h) / math.pi)
    assert found[0].stable


@pytest.mark.parametrize(("delay_s", "count"), [(0.0, 1), (1e-3, 1), (2e-3, 2), (0.5e-3, 1)])
def test_crossings_are_all_sign_changes_of_a_fine_locus(delay_s, count):
    parameters = replace(PAPER, delay_s=delay_s)
    f = np.linspace(0.005, 499.995, 400_001)
    h = frequency_response(f, parameters)
    places = f[:-1][(h.imag[:-1] * h.imag[1:] < 0) & (h.real[:-1] < 0)]
    found = crossings(parameters).found
    assert len(found) == len(places) == count
    assert [c.frequency_Hz for c in found] == pytest.approx(places, abs=0.0013)
    assert [c.stable for c in found] == [
        c is crossings(parameters).largest or c == crossings(parameters).largest for c in found
    ]


def test_a_loop_without_a_crossing_says_so():
    """A pure damper with little mass at a slow rate never lags by half a turn below fs/2."""
    loop = Parameters(mass_kg=1e-6, damping_Ns_m=50.0, operator=Operator.mass_damper_spring(0.0, 1.0, 0.0))
    found = crossings(loop)
    assert found.found == ()
    assert found.largest is None
    assert "no crossing" in found.text


def test_passive_set_certifies_b():
    assert passive_set_slope(PAPER) == pytest.approx(0.5, rel=1e-12)
    assert passive_set_slope(replace(PAPER, delay_s=3e-3)) == pytest.approx(0.5, rel=1e-12)
    f = np.linspace(0, 500, 200_001)
    r = (0.6 + 0.4 * np.exp(-2j * np.pi * f * 1e-3)) * np.exp(-2j * np.pi * f * 1e-3)
    assert passive_set_slope(replace(PAPER, delay_s=0.4e-3)) == pytest.approx(1.0 / (1 - r.real.min()), rel=1e-6)
    assert passive_set_slope(replace(PAPER, damping_Ns_m=0.0)) == 0.0


def test_tsypkin_slope_is_the_least_real_part():
    f = np.linspace(0.005, 500, 400_000)
    assert tsypkin_slope(PAPER) == pytest.approx(-1 / frequency_response(f, PAPER).real.min(), rel=1e-8)


def test_brake_is_certified_for_every_slope():
    assert circle_slope(PAPER) is None


@pytest.mark.thorough
@pytest.mark.parametrize("delay_s", [pytest.param(0.0, marks=pytest.mark.long), 1e-3])
def test_zames_falb_beats_tsypkin_and_respects_nyquist(delay_s):
    parameters = replace(PAPER, delay_s=delay_s)
    found = absolute_stability(parameters)
    assert found.tsypkin < found.zames_falb < found.nyquist
    certificate = found.certificate
    taps = np.array(certificate.taps)
    assert np.sum(np.abs(taps)) < 1
    # verified here on a grid of its own, with another formula for M
    f = np.concatenate((np.geomspace(1e-4, 1, 20_001), np.linspace(1, 500, 300_001)))
    z = np.exp(2j * np.pi * f * 1e-3)
    half = len(taps) // 2
    M = 1 - sum(h * z**-i for h, i in zip(taps, [*range(-half, 0), *range(1, half + 1)], strict=True))
    assert pytest.approx(M) == multiplier_response(taps, 2 * np.pi * f * 1e-3)
    assert np.min((M * (1 + certificate.slope_Ns_m * frequency_response(f, parameters))).real) > 0


def test_nyquists_limit_is_the_linear_loops_edge():
    """A linear damper k on the motor: the sampled loop's largest eigenvalue is 1 at k = nyquist."""
    found = absolute_stability(PAPER)
    M, B, K, T = 1.387, 29.83, 178.0, 1e-3

    block = expm(np.array([[0, 1, 0], [-K / M, -B / M, 1 / M], [0, 0, 0]]) * T)
    for factor, stable in ((0.999, True), (1.001, False)):
        k = found.nyquist * factor
        # state x, v, x before: u = -k (x - before)/T
        loop = np.zeros((3, 3))
        loop[:2, :2] = block[:2, :2]
        loop[:2, 0] -= k / T * block[:2, 2]
        loop[:2, 2] += k / T * block[:2, 2]
        loop[2, 0] = 1
        assert bool(np.max(np.abs(np.linalg.eigvals(loop))) < 1) is stable


def test_words_are_careful():
    assert absolute_stability(PAPER).ideal is Verdict.LIMIT_CYCLE
    assert {v.value for v in Verdict} == {"certified", "not certified", "limit cycle shown"}
