"""G, D*, H*: exact against the sum of aliases; the disks; what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm

from coulombus.analysis.theory.linear import (
    alias_sum,
    exponential,
    frequency_response,
    multiplier,
    passive_disk,
    plant,
    sample,
)
from coulombus.analysis.theory.operators import Operator, ParameterError
from coulombus.analysis.theory.parameters import Parameters

PAPER = Parameters()
FREQUENCIES = np.array([0.01, 1.0, 10.0, 100.0, 250.0, 252.3, 400.0, 499.0, 500.0])
MAXWELL = Operator((0.8, 44.0, 780.0), (1.0, 40.0))  # 0.8 s + 12 + 300/(s + 40): mass, damper, relaxing spring


@pytest.mark.parametrize("delay_s", [0.0, 1e-3, 2e-3, 0.25e-3, 1.7e-3, 8e-3])
@pytest.mark.parametrize("operator", [Operator(), Operator.mass_damper_spring(0.0, 3.0, 0.0), MAXWELL])
def test_exact_response_is_the_alias_sum(delay_s, operator):
    parameters = replace(PAPER, delay_s=delay_s, operator=operator)
    exact, summed = frequency_response(FREQUENCIES, parameters), alias_sum(FREQUENCIES, parameters)
    assert np.max(np.abs(exact - summed) / np.abs(exact)) < 1e-9  # achieved: 4e-12 of each value


def test_truncated_alias_sum_converges_to_the_accelerated_one():
    """Without the tail the error falls with the cube of the number of terms."""
    w, T = 2 * np.pi * 120.0, PAPER.period_s
    errors = []
    for n in (200, 400):
        s = 1j * (w + np.arange(-n, n + 1) * 2 * np.pi / T)
        naive = (1 - np.exp(-1j * w * T)) ** 2 / T**2 * np.sum(plant(s, PAPER) / s**2)
        errors.append(abs(naive - alias_sum(np.array([120.0]), PAPER)[0]))
    assert errors[0] / errors[1] > 3.5
    assert errors[1] < 1e-9


def test_response_at_rest_is_zero_with_a_spring():
    """Errata 5: H*(0) = 0, so eq. (17) cannot hold strictly."""
    assert abs(frequency_response(np.array([0.0]), PAPER)[0]) < 1e-12


def test_step_is_the_convolution_integral():
    """gamma_0, gamma_1 against the integral of the impulse response, delay of 0.3 cycles."""
    parameters = replace(PAPER, delay_s=0.3e-3)
    linear = sample(parameters)
    M, B, K = 1.387, 29.83, 178.0
    A = np.array([[0.0, 1.0], [-K / M, -B / M]])

    def impulse(t, row):
        return (expm(A * t) @ np.array([0.0, 1 / M]))[row]

    for row in (0, 1):
        now = quad(impulse, 0.0, 0.7e-3, (row,), epsabs=1e-18, epsrel=1e-12)[0]
        before = quad(impulse, 0.7e-3, 1e-3, (row,), epsabs=1e-18, epsrel=1e-12)[0]
        assert linear.gamma_0[row] == pytest.approx(now, rel=1e-10)
        assert linear.gamma_1[row] == pytest.approx(before, rel=1e-10)


def test_exponential_is_scipys():
    rng = np.random.default_rng(5)
    for scale in (1e-6, 1.0, 40.0):
        A = scale * rng.standard_normal((7, 7))
        expected = expm(A)
        assert np.max(np.abs(exponential(A) - expected)) < 1e-11 * np.max(np.abs(expected))


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0, 2.6])
def test_multiplier_is_the_alias_sum_of_eq_12(share):
    """r(jw) of eq. (12): exp(-jwT) without a delay, by brute force over 400,000 aliases."""
    T, tau = 1e-3, share * 1e-3
    f = np.array([3.0, 77.0, 250.0, 444.0])
    k = np.arange(-200_000, 200_001)
    for one, closed in zip(f, multiplier(f, replace(PAPER, delay_s=tau)), strict=True):
        s = 1j * (2 * np.pi * one + 2 * np.pi * k / T)
        brute = np.sum((1 - np.exp(-2j * np.pi * one * T)) ** 2 / (T * s) ** 2 * np.exp(-s * tau))
        assert closed == pytest.approx(brute, abs=2e-6)  # the tail of 1/k^2
    assert multiplier(f, PAPER) == pytest.approx(np.exp(-2j * np.pi * f * T), abs=1e-15)


def test_disk_holds_every_passive_operator():
    disk = passive_disk(FREQUENCIES, PAPER)
    assert disk.radius == pytest.approx(np.ones(9))  # 1/2b
    assert disk.center == pytest.approx(np.exp(-2j * np.pi * FREQUENCIES * 1e-3))
    rng = np.random.default_rng(1)
    for delay_s in (0.0, 0.4e-3, 1e-3):
        disk = passive_disk(FREQUENCIES, replace(PAPER, delay_s=delay_s))
        for _ in range(20):
            inertia, damping, stiffness = 10.0 ** rng.uniform(-4, 3, 3)
            operator = Operator.mass_damper_spring(inertia, damping, stiffness)
            h = frequency_response(FREQUENCIES, replace(PAPER, operator=operator, delay_s=delay_s))
            assert np.all(np.abs(h - disk.center) <= disk.radius * (1 + 1e-9))


def test_realisation_of_the_operator_is_its_transfer_function():
    for operator in (Operator(), MAXWELL, Operator((2.0, 5.0, 3.0, 0.5), (1.0, 2.0, 0.0))):
        parts = operator.parts()
        for s in (0.3 + 1j, 2j, 50.0 + 3j):
            states = parts.C @ np.linalg.solve(s * np.eye(len(parts.B)) - parts.A, parts.B) if len(parts.B) else 0.0
            assert parts.inertia * s + parts.damping + states == pytest.approx(complex(operator(s)), rel=1e-12)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"mass_kg": -0.1}, "mass_kg = -0.1 is negative"),
        ({"mass_kg": float("nan")}, "mass_kg = nan"),
        ({"damping_Ns_m": float("inf")}, "damping_Ns_m = inf"),
        ({"period_s": 0.0}, "must be positive"),
        ({"delay_s": 10.0}, "not shorter than window_s"),
        ({"mass_kg": 0.0, "operator": Operator.mass_damper_spring(0.0, 1.0, 1.0)}, "no inertia"),
    ],
)
def test_bad_parameters_are_refused(change, reason):
    with pytest.raises(ParameterError, match=reason):
        replace(PAPER, **change)


@pytest.mark.parametrize(
    ("numerator", "denominator", "reason"),
    [
        ((1.0, 0.0, 0.0, 0.0), (1.0,), "improper"),
        ((1.0,), (1.0, -1.0), "unstable pole"),
        ((-1.0, 1.0), (1.0,), "inertia -1 is negative"),
        ((1.0,), (1.0, 0.0, 0.0), "not simple"),
        ((-3.0,), (1.0, 0.0), "residue"),
        ((1.0, -1.0, 1.0), (1.0, 2.0, 1.0), "Re Z_o"),
        ((float("nan"), 1.0), (1.0,), "finite"),
        ((1.0,), (0.0,), "denominator is 0"),
    ],
)
def test_operators_that_are_not_passive_are_refused(numerator, denominator, reason):
    with pytest.raises(ParameterError, match=reason):
        Operator(numerator, denominator)


def test_random_networks_of_passive_parts_are_accepted():
    """Sums of masses, dampers, springs and Maxwell elements k/(s + k/b) are passive by
    construction.
    """
    rng = np.random.default_rng(3)
    for _ in range(50):
        numerator, denominator = np.array(10.0 ** rng.uniform(-2, 2, 2)), np.array([1.0])
        for _ in range(rng.integers(1, 4)):
            k, corner = 10.0 ** rng.uniform(0, 3, 2)
            numerator = np.polyadd(np.polymul(numerator, [1.0, corner]), k * denominator)
            denominator = np.polymul(denominator, [1.0, corner])
        Operator(tuple(numerator), tuple(denominator))


def test_parse():
    assert Operator.parse("1.287,29.33,178/1,0") == Operator()
    with pytest.raises(ParameterError, match="expected"):
        Operator.parse("1,2")
