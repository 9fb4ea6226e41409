"""Proof between frequencies, l1 bound, orbits between samples and of three values, the stuck spring, and
the weights of the aliases: each against a computation of another kind, written here.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from coulombus.analysis.figures.report import nyquist_lines
from coulombus.analysis.theory.absolute import absolute_stability
from coulombus.analysis.theory.crossings import crossings
from coulombus.analysis.theory.linear import alias_sum, alias_terms, alias_weights, frequency_response, sample
from coulombus.analysis.theory.operators import Operator
from coulombus.analysis.theory.orbits import orbits, pattern_of
from coulombus.analysis.theory.parameters import ParameterError, Parameters
from coulombus.analysis.theory.peak import between_samples, l1_bound, l1_norm
from coulombus.analysis.theory.stuck_spring import largest_stiffness, spectral_radius, stuck_spring
from coulombus.analysis.theory.three_valued import ZEROS, three_valued_orbits
from coulombus.analysis.theory.zames_falb import cosine_polynomial, positive, rational

PAPER = Parameters()
M, B, K, C, T = 1.387, 29.83, 178.0, 10.0, 1e-3
DELAYS = [0.0, 0.4e-3, 1e-3, 2.5e-3]


@pytest.mark.parametrize("delay_s", DELAYS)
def test_the_proof_is_about_the_condition_itself(delay_s):
    """The cosine polynomial over |D|^2 is Re{M (1 + k H*)}, by H* as a frequency response."""
    parameters = replace(PAPER, delay_s=delay_s)
    N, D = rational(sample(parameters))
    taps, k = np.array([0.1, -0.3, 0.2, 0.05]), 700.0
    p = cosine_polynomial(N, D, taps, k)
    f = np.geomspace(0.5, 499, 300)
    z = np.exp(2j * np.pi * f * T)
    multiplier = 1 - sum(h * z**-i for h, i in zip(taps, (-2, -1, 1, 2), strict=True))
    expected = (multiplier * (1 + k * frequency_response(f, parameters))).real
    size = np.abs(np.polyval(D[::-1], 1 / z)) ** 2
    found = np.cos(np.outer(2 * np.pi * f * T, np.arange(len(p)))) @ p / size
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("delay_s", DELAYS)
def test_the_certificate_is_proved_between_its_frequencies(delay_s):
    found = absolute_stability(replace(PAPER, delay_s=delay_s))
    assert found.certificate.proved
    assert found.certificate.pieces > 100
    assert found.zames_falb > found.tsypkin


@pytest.mark.parametrize("seed", range(20))
def test_positivity_is_what_the_roots_say(seed):
    """Of random cosine polynomials: positive if and only if there is no root on the unit circle."""
    draw = np.random.default_rng(seed)
    p = draw.normal(0, 1, 9)
    fine = np.cos(np.outer(np.linspace(0, np.pi, 200_001), np.arange(9))) @ p
    p[0] += draw.choice([1e-4, -1e-4]) - fine.min()  # a hair's breadth above or below
    found = positive(p)
    two_sided = np.concatenate((p[:0:-1] / 2, p[:1], p[1:] / 2))
    on_circle = np.abs(np.abs(np.roots(two_sided)) - 1) < 1e-6
    assert found.proved is not bool(on_circle.any())
    if not found.proved:
        assert np.cos(found.where_rad * np.arange(9)) @ p <= 1e-4
    assert found.lipschitz >= np.abs(np.diff(fine)).max() / (np.pi / 200_000)


def test_a_dip_between_two_points_of_a_grid_is_seen():
    """Positive on 512 points, negative between them: a narrow dip of degree 4000 at an odd place."""
    n, at = 4000, math.pi * 100.5 / 511
    order = np.arange(n + 1)
    kernel = np.where(order == 0, 1.0, 2.0 * (1 - order / (n + 1))) * np.cos(order * at)  # Fejer's, at +-at
    p = -kernel
    p[0] += 0.4 * (n + 1) / 2
    grid = np.cos(np.outer(np.linspace(0, np.pi, 512), order)) @ p
    assert grid.min() > 0
    assert not positive(p).proved


def test_the_l1_norm_is_the_sum_of_the_impulse_response():
    for delay_s in DELAYS:
        linear = sample(replace(PAPER, delay_s=delay_s))
        z = 1.0001 * np.exp(2j * np.pi * np.arange(2**16) / 2**16)
        h = np.fft.ifft(linear.response(z)).real * 1.0001 ** np.arange(2**16)
        assert l1_norm(linear) == pytest.approx(np.abs(h[:8000]).sum(), rel=1e-6)


def test_the_l1_bound_is_reached_and_never_passed():
    bound = l1_bound(PAPER)
    for orbit in orbits(PAPER, longest=8).found:
        assert orbit.velocity_peak_m_s <= bound
    step = expm(np.array([[0, 1, 0], [-K / M, -B / M, 1 / M], [0, 0, 0]]) * T)[:2]
    y, h = np.zeros(2), []
    for k in range(3000):  # impulse response of v^, by matrices of its own
        before, y = y[0], step @ np.append(y, 1.0 if k == 0 else 0.0)
        h.append((y[0] - before) / T)
    y, u = np.zeros(2), C * np.sign(h)[::-1]
    for force in u:
        before, y = y[0], step @ np.append(y, force)
    assert (y[0] - before) / T == pytest.approx(bound, rel=1e-6)


def test_no_damping_has_no_l1_norm():
    with pytest.raises(ParameterError, match="l1 norm"):
        l1_norm(sample(Parameters(damping_Ns_m=0.0, operator=Operator((0.0,), (1.0,)))))


@pytest.mark.parametrize("delay_s", DELAYS)
def test_an_orbit_between_its_samples_is_what_an_integrator_finds(delay_s):
    parameters = replace(PAPER, delay_s=delay_s)
    orbit = orbits(parameters, longest=12).found[0]
    signs = np.array([1.0 if letter == "+" else -1.0 for letter in orbit.pattern])
    found = between_samples(parameters, signs)
    period = len(signs) * T

    def force(t):
        return -C * signs[math.floor((t - delay_s) / T + 1e-9) % len(signs)]

    y, speeds, edges = np.zeros(2), [], np.unique(np.concatenate((np.arange(len(signs)) * T, [period])))
    edges = np.unique(np.round(np.concatenate((edges, (edges[:-1] + delay_s % T))), 12))
    steps = [expm(np.array([[0, 1, 0], [-K / M, -B / M, 1 / M], [0, 0, 0]]) * h) for h in np.diff(edges)]
    for turn in range(400):
        for start, end, step in zip(edges[:-1], edges[1:], steps, strict=True):
            f = force(start)
            if turn < 399:
                y = (step @ np.append(y, f))[:2]
                continue
            run = solve_ivp(
                lambda t, y, f=f: [y[1], (f - B * y[1] - K * y[0]) / M],
                (0, end - start),
                y,
                rtol=1e-10,
                atol=1e-14,
                max_step=(end - start) / 50,
            )
            speeds.append(np.abs(run.y[1]).max())
            y = run.y[:, -1]
    assert found.peak_m_s == pytest.approx(max(speeds), rel=1e-4)
    assert orbit.true_peak_m_s == found.peak_m_s
    assert found.peak_m_s > orbit.velocity_peak_m_s  # a backward difference is a mean
    assert found.t_s[-1] < period
    assert found.rms_m_s == pytest.approx(np.sqrt(np.mean(found.v_m_s**2)), rel=2e-2)


def _simulate(resolution, zero, x, v, seconds):
    step = expm(np.array([[0, 1, 0], [-K / M, -B / M, 1 / M], [0, 0, 0]]) * T)[:2]
    y, before, last, signs = np.array([x, v]), np.rint((x - v * T) / resolution), 1.0, []
    for _ in range(round(seconds / T)):
        n = np.rint(y[0] / resolution)
        sign, before = np.sign(n - before), n
        if sign == 0.0:
            sign = {"zero": 0.0, "plus": 1.0, "hold": last}[zero]
        last = sign
        y = step @ np.append(y, -C * sign)
        signs.append(sign)
    return np.array(signs)


@pytest.mark.thorough
@pytest.mark.parametrize("zero", ZEROS)
@pytest.mark.parametrize("resolution", [1e-6, 3e-6])
def test_what_a_simulation_ends_in_is_among_the_motions_of_its_choice(zero, resolution):
    found = {one.pattern: one for one in three_valued_orbits(replace(PAPER, resolution_m=resolution), zero)}
    draw, seen = np.random.default_rng(1), set()
    for _ in range(12):
        signs = _simulate(resolution, zero, draw.uniform(-3e-3, 3e-3), draw.uniform(-0.05, 0.05), 2.5)
        pattern = pattern_of(signs[-200:], 10, zeros=True)
        if pattern is not None and pattern != "0":
            seen.add(pattern)
    assert seen
    assert seen <= set(found)
    for pattern in seen:
        assert found[pattern].share > 0
        assert found[pattern].margin_m > 0


def test_zeros_are_in_the_patterns_of_the_choice_zero_alone():
    parameters = replace(PAPER, resolution_m=8e-6)
    by_choice = {zero: three_valued_orbits(parameters, zero, longest=8) for zero in ZEROS}
    assert any("0" in one.pattern for one in by_choice["zero"])
    assert not any("0" in one.pattern for zero in ("plus", "hold") for one in by_choice[zero])
    assert {one.pattern for one in by_choice["plus"]} != {one.pattern for one in by_choice["hold"]}


def test_without_an_encoder_they_are_the_two_valued_orbits():
    expected = {one.pattern for one in orbits(PAPER, longest=8).found}
    for zero in ZEROS:
        assert {one.pattern for one in three_valued_orbits(PAPER, zero, longest=8)} == expected
    with pytest.raises(ParameterError, match="expected one of zero, plus, hold"):
        three_valued_orbits(PAPER, "minus")


@pytest.mark.parametrize("delay_s", DELAYS)
@pytest.mark.parametrize("operator", [None, Operator((2.0,), (1.0,))])
def test_the_largest_stiffness_is_where_a_simulated_spring_begins_to_grow(delay_s, operator):
    parameters = replace(PAPER, delay_s=delay_s, **({} if operator is None else {"operator": operator}))
    largest = largest_stiffness(parameters)
    mass, damping, spring = (M, B, K) if operator is None else (0.1, 2.5, 0.0)
    late = delay_s % T
    whole = round((delay_s - late) / T)
    A = np.array([[0, 1, 0], [-spring / mass, -damping / mass, 1 / mass], [0, 0, 0]])
    first, rest = expm(A * late)[:2], expm(A * (T - late))[:2]
    sizes = {}
    for factor in (0.97, 1.03):
        y, queue, x = np.array([1e-3, 0.0]), [0.0] * (whole + 2), []
        for _ in range(4_000):
            queue = [largest * factor * y[0], *queue[:-1]]
            y = first @ np.append(y, -queue[whole + 1])
            y = rest @ np.append(y, -queue[whole])
            x.append(abs(y[0]))
        sizes[factor] = max(x[-300:]) / max(x[:300])
        radius = spectral_radius(parameters, largest * factor)
        measured = (max(x[3_000:3_300]) / max(x[2_000:2_300])) ** (1 / 1000)
        assert radius == pytest.approx(measured, abs=2e-5)
        assert stuck_spring(parameters, largest * factor).stable is (factor < 1)
    assert sizes[0.97] < 1 < sizes[1.03]


def test_without_a_spring_the_position_may_be_anywhere():
    assert spectral_radius(Parameters(operator=Operator((2.0,), (1.0,))), 0.0) == pytest.approx(1.0)


def test_alias_weights_are_positive_and_add_up_to_one():
    f = np.array([1e-3, 1.0, 100.0, 250.0, 499.999])
    w = alias_weights(f, PAPER, 20_000)
    assert (w >= 0).all()
    assert w.sum(axis=1) == pytest.approx(1, abs=2e-5)
    middle = 20_000
    assert w[0, middle] == pytest.approx(1)
    assert w[-1, middle] == pytest.approx(w[-1, middle - 1], rel=1e-4)
    assert w[3, middle] == pytest.approx(8 / math.pi**2, rel=1e-9)
    assert w[3, middle - 1] == pytest.approx(w[3, middle] / 9, rel=1e-9)


@pytest.mark.parametrize("delay_s", DELAYS)
def test_alias_terms_add_up_to_the_response(delay_s):
    parameters = replace(PAPER, delay_s=delay_s)
    f = np.array([3.0, 120.0, 400.0])
    total = alias_terms(f, parameters, 5000).sum(axis=1)
    assert total == pytest.approx(alias_sum(f, parameters), rel=1e-6)
    assert total == pytest.approx(frequency_response(f, parameters), rel=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("proved", "how"), [(True, "proved at every frequency"), (False, "verified at 77 frequencies")]
)
def test_the_report_says_whether_a_slope_is_proved(proved, how):
    found = absolute_stability(PAPER)
    certificate = replace(found.certificate, proved=proved, points=77)
    (line,) = (k for k in nyquist_lines(crossings(PAPER), replace(found, certificate=certificate)) if "taps" in k)
    assert how in line
