"""The stuck spring with damping and hand, against eigenvalues of a step that scipy makes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import eigvals, expm

from coulombus.analysis.theory.operators import Operator
from coulombus.analysis.theory.parameters import ParameterError, Parameters
from coulombus.analysis.theory.stuck_spring import (
    critical_mass,
    largest_stiffness,
    largest_stiffness_damped,
    mass_critical,
    mass_radius,
    mass_stiffness,
    spectral_radius,
    unstable_poles,
)

T = 1e-3
HAND = Operator(numerator=(0.5, 20.0), denominator=(1.0,))  # 0.5 s + 20: mass and damper


def poles(mass, damping, spring, K, B, cycles=0):
    """Return the eigenvalues of a sample's step of m v' + d v + k x = -psi, psi = K x + B (x - x_before)/T."""
    A = np.array([[0.0, 1.0, 0.0], [-spring / mass, -damping / mass, -1.0 / mass], [0.0, 0.0, 0.0]])
    step = expm(A * T)
    size = 3 + cycles  # x, v, x before, psi under way
    loop, demand = np.zeros((size, size)), np.zeros(size)
    demand[0], demand[2] = K + B / T, -B / T
    loop[:2, :2] = step[:2, :2]
    loop[:2] += np.outer(step[:2, 2], np.eye(size)[-1] if cycles else demand)
    loop[2, 0] = 1.0
    if cycles:
        loop[3] = demand
        for k in range(4, size):
            loop[k, k - 1] = 1.0
    return np.abs(eigvals(loop))


def parameters(mass, damping=0.0, cycles=0, operator=None):
    operator = Operator(numerator=(0.0,), denominator=(1.0,)) if operator is None else operator
    return Parameters(mass_kg=mass, damping_Ns_m=damping, delay_s=cycles * T, operator=operator)


@pytest.mark.parametrize("cycles", [0, 1, 2])
@pytest.mark.parametrize("K", [50.0, 5e3, 6e4, 4e5])
@pytest.mark.parametrize("B", [0.0, 2.0, 90.0, 700.0])
def test_rho_and_the_unstable_poles_are_those_of_scipy(K, B, cycles):
    expected = poles(0.1 + 0.5, 0.5 + 20.0, 0.0, K, B, cycles)
    loop = parameters(0.1, 0.5, cycles, HAND)
    assert spectral_radius(loop, K, B) == pytest.approx(expected.max(), rel=1e-9)
    assert unstable_poles(loop, K, B) == np.sum(expected > 1.0)


@pytest.mark.parametrize("cycles", [0, 1])
@pytest.mark.parametrize("B", [5.0, 80.0])
def test_K_max_with_damping_is_where_an_eigenvalue_leaves_the_circle(B, cycles):
    loop = parameters(0.1, 0.5, cycles, HAND)
    K = largest_stiffness_damped(loop, B)
    assert poles(0.6, 20.5, 0.0, 0.9999 * K, B, cycles).max() < 1.0 < poles(0.6, 20.5, 0.0, 1.0001 * K, B, cycles).max()


def test_K_max_without_damping_is_that_of_the_locus():
    loop = Parameters()
    assert largest_stiffness_damped(loop, 0.0) == pytest.approx(largest_stiffness(loop), rel=1e-6)


def test_a_damping_that_oscillates_itself_bears_no_spring():
    assert largest_stiffness_damped(parameters(0.1, 0.5, 1), 500.0) == 0.0


@pytest.mark.parametrize("K", [10.0, 4e4, 1.5e6])
def test_the_radius_of_a_pure_mass(K):
    assert mass_radius(0.1, K, T) == pytest.approx(poles(0.1, 0.0, 0.0, K, 0.0).max(), rel=1e-9)
    assert mass_radius(0.1, K, T) > 1.0


def test_a_pure_mass_without_conjugate_poles_is_refused():
    with pytest.raises(ParameterError, match="spectral_radius"):
        mass_radius(0.1, 2e6, T)


@pytest.mark.parametrize("B", [1.0, 30.0, 150.0])
def test_K_max_and_critical_mass_of_a_pure_mass(B):
    K = mass_stiffness(0.1, B, T)
    assert poles(0.1, 0.0, 0.0, 0.999 * K, B).max() < 1.0 < poles(0.1, 0.0, 0.0, 1.001 * K, B).max()
    assert mass_critical(K, B, T) == pytest.approx(0.1, rel=1e-9)
    assert largest_stiffness_damped(parameters(0.1), B) == pytest.approx(K, rel=1e-6)
    assert critical_mass(parameters(0.1), K, B) == pytest.approx(0.1, rel=1e-6)


def test_the_ends_of_the_pure_mass_forms():
    assert mass_stiffness(0.1, 200.0, T) == 0.0
    assert mass_critical(2000.0, 1.0, T) == math.inf
    assert mass_critical(10.0, 0.0, T) == math.inf
    assert critical_mass(parameters(0.1), 10.0) == math.inf


@pytest.mark.parametrize("K", [8e3, 2e4])
def test_the_critical_mass_parts_the_handles_with_a_hand_and_a_delay(K):
    heavy, B = critical_mass(parameters(0.1, 0.5, 1, HAND), K, 800.0), 800.0
    assert 0.3 < heavy < 1.0
    assert poles(0.5 + 0.999 * heavy, 20.5, 0.0, K, B, 1).max() > 1.0
    assert poles(0.5 + 1.001 * heavy, 20.5, 0.0, K, B, 1).max() < 1.0


def test_a_spring_that_settles_with_every_mass_has_the_critical_mass_0():
    assert critical_mass(Parameters(), 1e4) == 0.0


@pytest.mark.parametrize(("K", "B"), [(50.0, 0.0), (6e4, 0.0), (6.1e4, 5.0), (1e4, 100.0)])
def test_the_place_between_the_hands_rest_and_the_sticks_is_no_pole(K, B):
    expected = poles(0.1 + 1.287, 0.5 + 29.33, 178.0, K, B)
    assert spectral_radius(Parameters(), K, B) == pytest.approx(expected.max(), rel=1e-9)
    assert unstable_poles(Parameters(), K, B) == np.sum(expected > 1.0)
