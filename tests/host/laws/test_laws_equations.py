"""Each law against an independent computation of its equation, and what its source says of it."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from coulombus.host.laws.along import given_law


def driven(name, t, x, **values):
    return given_law(name, [f"{key}={value}" for key, value in values.items()]).along(t, x).samples


def walk(seed, samples=300, step=3e-3):
    draw = np.random.default_rng(seed)
    t = np.cumsum(draw.uniform(2e-4, 3e-3, samples))
    x = np.cumsum(draw.normal(0, step, samples))
    x[50:60] = x[50]  # a rest
    return t, x


def euler(rates, t, x, state, steps=2000):
    """Integrate state' = rates(state, v) in small steps of the midpoint rule, v constant between
    samples; yield state and v at each sample.
    """
    state = np.array(state, float)
    yield state.copy(), 0.0
    for k in range(1, len(t)):
        v, h = (x[k] - x[k - 1]) / (t[k] - t[k - 1]), (t[k] - t[k - 1]) / steps
        for _ in range(steps if v else 0):
            state = state + h * rates(state + h / 2 * rates(state, v), v)
        yield state.copy(), v


@pytest.mark.parametrize(
    ("form", "share"),
    [
        ("gauss", lambda r: math.exp(-r * r)),
        ("tustin", lambda r: math.exp(-r)),
        ("lorentz", lambda r: 1 / (1 + r * r)),
    ],
)
def test_stribeck_has_three_forms(form, share):
    t = np.array([0.0, 1.0, 2.0, 4.0])
    x = np.array([0.0, 0.3, 0.3, -1.7])
    found = driven("stribeck", t, x, F_c_Nm=0.5, F_s_Nm=0.9, v_s_rad_s=0.4, sigma_2_Nms_rad=0.1, form=form)
    up, down = (0.5 + 0.4 * share(v / 0.4) + 0.1 * v for v in (0.3, 1.0))
    assert found["torque_Nm"] == pytest.approx([0, up, 0, -down], rel=1e-12)
    assert found["brake_Nm"] == pytest.approx([0.9, up, 0.9, down], rel=1e-12)


@pytest.mark.parametrize("form", ["saturated", "tanh", "arctan"])
def test_a_regularised_law_has_its_slope_and_its_level(form):
    t = np.arange(5) * 1.0
    x = np.array([0.0, 1e-5, 0.0, 1000.0, 0.0])
    found = driven("regularised", t, x, F_c_Nm=0.8, v_t_rad_s=0.25, form=form)["torque_Nm"]
    assert found[:3] == pytest.approx([0, 3.2e-5, -3.2e-5], rel=1e-6)
    assert found[3:] == pytest.approx([0.8, -0.8], rel=2e-4)


@pytest.mark.parametrize("F_ba", [0.2, 0.6, 0.79])
def test_elastoplastic_is_its_equation_along_any_motion(F_ba):
    F_c, F_s, v_s, s_0, s_1 = 0.8, 1.3, 0.7, 90.0, 0.15

    def share(z, v):
        y, z_ss = math.copysign(1, v) * z, (F_c + (F_s - F_c) * math.exp(-((v / v_s) ** 2))) / s_0
        z_ba = F_ba / s_0
        if y <= z_ba:
            return 0.0, z_ss
        return (1.0 if y >= z_ss else 0.5 + 0.5 * math.sin(math.pi * (y - (z_ss + z_ba) / 2) / (z_ss - z_ba))), z_ss

    def rate(z, v):
        alpha, z_ss = share(z, v)
        return v * (1 - alpha * z / z_ss * math.copysign(1, v))

    t, x = walk(4, 120)
    found = driven(
        "elastoplastic",
        t,
        x,
        F_c_Nm=F_c,
        F_s_Nm=F_s,
        F_ba_Nm=F_ba,
        v_s_rad_s=v_s,
        sigma_0_Nm_rad=s_0,
        sigma_1_Nms_rad=s_1,
        sigma_2_Nms_rad=0.02,
    )
    states = euler(lambda z, v: np.array([rate(z[0], v)]), t, x, [0.0], 600)
    expected = [s_0 * z[0] + (s_1 * rate(z[0], v) if v else 0.0) + 0.02 * v for z, v in states]
    assert found["torque_Nm"] == pytest.approx(expected, abs=3e-4)


@pytest.mark.parametrize("F_ba", [0.99, 0.999])
def test_elastoplastic_comes_to_its_level_in_one_step_as_in_many(F_ba):
    few, many = (
        driven("elastoplastic", np.linspace(0, 1e-3, n), np.linspace(0, 0.0125, n), F_s_Nm=1.0, F_ba_Nm=F_ba)
        for n in (2, 20_001)
    )
    left = 12.5 * 0.1  # sigma_1 v, of which next to nothing is left
    assert few["torque_Nm"][-1] - 1 == pytest.approx(many["torque_Nm"][-1] - 1, rel=1e-3)
    assert 1e-9 < few["torque_Nm"][-1] - 1 < 1e-3 * left


def test_elastoplastic_does_not_drift_below_break_away_where_lugre_does():
    """Dupont 2002, Fig. 4: a load with a ripple below break-away."""
    t = np.arange(40001) * 1e-4

    def drift(name, **values):
        """The offset of the loop of torque over angle after 50 shakes; 0: purely elastic."""
        x = 4e-3 + 1.5e-3 * np.sin(2 * np.pi * 25 * t)
        x *= np.minimum(t / 0.02, 1)
        torque = driven(name, t, x, sigma_0_Nm_rad=100, sigma_1_Nms_rad=0, **values)["torque_Nm"]
        return abs(torque[-1] - torque[1200]), torque[-1]

    elastic, level = drift("elastoplastic", F_ba_Nm=0.7)
    assert elastic == pytest.approx(0, abs=1e-12)
    assert level == pytest.approx(0.4, abs=1e-9)
    lost, _ = drift("lugre")
    assert lost > 0.09


def gms_by_small_steps(t, x, k, a, C, g, steps=400):
    F, slips, out = np.zeros(4), np.zeros(4), [0.0]
    for n in range(1, len(t)):
        v, h = (x[n] - x[n - 1]) / (t[n] - t[n - 1]), (t[n] - t[n - 1]) / steps
        sense = np.sign(v)
        if v == 0:
            slips[:] = 0
        slips[slips != sense] = 0
        for _ in range(steps if v else 0):
            slips[sense * F >= a * g(v)] = sense
            F = F + h * np.where(slips == sense, sense * C * (a - sense * F / g(v)), k * v)
        out.append(F.sum())
    return np.array(out)


@pytest.mark.thorough
def test_gms_is_its_equation_along_any_motion():
    t, x = walk(6, 200, 8e-3)
    k, w = np.array([80.0, 40.0, 20.0, 10.0]), np.array([1.0, 2.0, 3.0, 4.0])

    def g(v):
        return 0.8 + 0.4 * math.exp(-((v / 2.0) ** 2))

    names = {f"k_{i + 1}_Nm_rad": k[i] for i in range(4)} | {f"w_{i + 1}": w[i] for i in range(4)}
    found = driven("gms", t, x, F_c_Nm=0.8, F_s_Nm=1.2, v_s_rad_s=2.0, C_Nm_s=30.0, **names)["torque_Nm"]
    assert found == pytest.approx(gms_by_small_steps(t, x, k, w / 10, 30.0, g), abs=5e-3)


def test_gms_remembers_the_turning_points():
    """Non-local memory: behind an inner loop the torque is as if that had not been."""
    turns = (0.0, 0.03, -0.02, 0.01, -0.005, 0.01, -0.02, 0.03)
    x = np.concatenate([np.linspace(a, b, 200, endpoint=False) for a, b in itertools.pairwise(turns)] + [[0.03]])
    found = driven("gms", np.arange(len(x)) * 1e-3, x, F_s_Nm=1.0, F_c_Nm=1.0, C_Nm_s=1e9)["torque_Nm"]
    at = [200 * n for n in range(8)]
    assert found[at[5]] == pytest.approx(found[at[3]], abs=1e-12)  # the inner loop has closed
    assert found[at[6]] == pytest.approx(found[at[2]], abs=1e-12)
    assert found[at[7]] == pytest.approx(found[at[1]], abs=1e-12)
    lugre = driven("lugre", np.arange(len(x)) * 1e-3, x, F_s_Nm=1.0, F_c_Nm=1.0, sigma_1_Nms_rad=0)["torque_Nm"]
    assert abs(lugre[at[5]] - lugre[at[3]]) > 0.05  # LuGre forgets


def leuven_by_small_steps(t, x, k, level, g, steps=500):
    """z in small steps of Euler's method, the four springs clipped one by one."""
    F, found = np.zeros(4), [(0.0, 0.0)]
    for n in range(1, len(t)):
        v, h = (x[n] - x[n - 1]) / (t[n] - t[n - 1]), (t[n] - t[n - 1]) / steps
        for _ in range(steps if v else 0):
            F = np.clip(F + k * h * v * (1 - np.sign(v) * F.sum() / g(v)), -level, level)
        found.append((F.sum(), v * (1 - np.sign(v) * F.sum() / g(v))))
    return np.array(found).T


@pytest.mark.parametrize("step", [1e-3, 2e-2])
def test_leuven_is_its_equation_along_any_motion(step):
    t, x = walk(8, 120, step)
    k, w = np.array([80.0, 40.0, 20.0, 10.0]), np.array([1.0, 2.0, 3.0, 4.0])

    def g(v):
        return 0.8 + 0.4 * math.exp(-((v / 2.0) ** 2))

    names = {f"k_{i + 1}_Nm_rad": k[i] for i in range(4)} | {f"w_{i + 1}": w[i] for i in range(4)}
    values = {"F_c_Nm": 0.8, "F_s_Nm": 1.2, "v_s_rad_s": 2.0, "sigma_1_Nms_rad": 0.02, "sigma_2_Nms_rad": 0.01}
    found = driven("leuven", t, x, **values, **names)
    bears, z_rate = leuven_by_small_steps(t, x, k, 1.2 * w / 10, g)
    expected = bears + 0.02 * z_rate + 0.01 * found["v_rad_s"]
    assert found["torque_Nm"] == pytest.approx(expected, abs=5e-3)
    assert found["brake_Nm"][1:] == pytest.approx([g(v) + 0.01 * abs(v) for v in found["v_rad_s"][1:]])


def test_leuven_with_one_element_is_dahls_law():
    t, x = walk(9, 300, 8e-3)
    one = {"F_c_Nm": 1.0, "F_s_Nm": 1.0, "k_1_Nm_rad": 50.0, "w_1": 1e6, "sigma_1_Nms_rad": 0}
    others = {
        f"{key}_{i}{unit}": 1e-9 if key == "k" else 1e-6
        for i in (2, 3, 4)
        for key, unit in (("k", "_Nm_rad"), ("w", ""))
    }
    found = driven("leuven", t, x, **one, **others)["torque_Nm"]
    assert found == pytest.approx(driven("dahl", t, x, F_c_Nm=1.0, sigma_Nm_rad=50.0)["torque_Nm"], abs=1e-6)


@pytest.mark.parametrize("period_s", [1e-4, 1.0])
@pytest.mark.parametrize("k", [1e-6, 1e3, 1e9])
def test_leuven_keeps_its_bounds_at_any_stiffness_and_period(k, period_s):
    x = np.cumsum(np.random.default_rng(5).normal(0, 1.0, 500))
    names = {f"k_{i}_Nm_rad": k for i in (1, 2, 3, 4)}
    found = driven("leuven", np.arange(500) * period_s, x, sigma_1_Nms_rad=0, **names)
    assert np.abs(found["torque_Nm"]).max() <= 1.2 * (1 + 1e-12)


def test_bliman_sorine_is_its_equation_and_has_its_peak():
    t, x = walk(8, step=8e-3)
    found = driven("bliman_sorine", t, x, f_1_Nm=1.4, f_2_Nm=0.6, epsilon_f_rad=0.03, eta=0.3)["torque_Nm"]

    def rates(z, v):
        return np.array([-abs(v) * z[0] + 1.4 * v, 0.3 * (-abs(v) * z[1] - 0.6 * v)]) / (0.3 * 0.03)

    assert found == pytest.approx([z.sum() for z, _ in euler(rates, t, x, [0.0, 0.0], 300)], abs=2e-4)
    s = np.linspace(0, 0.3, 3001)
    from_rest = driven("bliman_sorine", s, s, f_1_Nm=1.4, f_2_Nm=0.6, epsilon_f_rad=0.03, eta=0.3)["torque_Nm"]
    assert from_rest == pytest.approx(1.4 * (1 - np.exp(-s / 0.009)) - 0.6 * (1 - np.exp(-s / 0.03)), abs=1e-9)
    peak = math.log(1.4 / (0.6 * 0.3)) / (1 / 0.009 - 1 / 0.03)  # where the derivative is 0
    assert s[from_rest.argmax()] == pytest.approx(peak, abs=2e-4)
    assert from_rest[-1] == pytest.approx(0.8, abs=1e-4)


def test_kikuuwe_is_coulombs_set_valued_law_behind_a_spring():
    """Without its damper the law is a play with a spring, whatever the period (Kikuuwe 2006, 3.2)."""
    t, x = walk(9, step=8e-3)
    e, expected = 0.0, [0.0]
    for dx in np.diff(x):
        e = min(max(e + dx, -0.01), 0.01)
        expected.append(100 * e)
    found = driven("kikuuwe", t, x, F_c_Nm=1.0, K_Nm_rad=100, B_Nms_rad=0)["torque_Nm"]
    assert found == pytest.approx(expected, abs=1e-9)


def test_kikuuwe_converges_with_the_period():
    def torque(rate):
        t = np.arange(round(2 * rate) + 1) / rate
        return driven("kikuuwe", t, 0.03 * np.sin(2 * np.pi * t), B_Nms_rad=0.5)["torque_Nm"][:: round(rate / 100)]

    fine = torque(100_000)
    errors = [np.abs(torque(rate) - fine).max() for rate in (100, 1000, 10000)]
    assert errors[1] < errors[0] / 5
    assert errors[2] < errors[1] / 5


def test_the_wall_pushes_out_and_never_pulls():
    t = np.arange(6) * 0.01
    x = np.array([0.0, 0.02, 0.04, 0.03, 0.011, 0.0])
    found = driven("wall", t, x, x_wall_rad=0.01, K_Nm_rad=20, B_Nms_rad=0.1, most_Nm=0.6)
    assert found["torque_Nm"] == pytest.approx([0, 0.4, 0.6, 0.3, 0, 0])
    assert found["brake_Nm"] == pytest.approx([0, 0.2, 0.2, 0.1, 0.02, 0])  # on the way out at most K p


def test_a_detent_pulls_to_its_places_and_gives_back_what_it_takes():
    x = np.linspace(0, 1.0, 20001)
    given = given_law("detent", ["A_Nm=0.5", "period_rad=0.25", "F_c_Nm=0"]).along(np.arange(20001) * 1e-3, x)
    torque = given.samples["torque_Nm"]
    assert torque == pytest.approx(0.5 * np.sin(8 * np.pi * x), abs=1e-12)
    assert torque[100] > 0  # beyond the place at 0: psi > 0 holds the handle back
    assert given.work_J[-1] == pytest.approx(0, abs=1e-9)
    assert given.work_J.max() == pytest.approx(0.5 * 0.25 / math.pi, rel=1e-4)


def test_texture_is_friction_that_a_brake_can_show():
    t = np.arange(2001) * 1e-3
    x = 0.2 * np.sin(2 * np.pi * t)
    given = given_law("texture", ["F_c_Nm=0.5", "A_Nm=0.5", "period_rad=0.05", "v_t_rad_s=0.1"]).along(t, x)
    found = given.samples
    share = np.clip(found["v_rad_s"] / 0.1, -1, 1)
    assert found["torque_Nm"] == pytest.approx((0.5 + 0.5 * np.cos(40 * np.pi * x)) * share, abs=1e-12)
    assert (found["torque_Nm"] * found["v_rad_s"] >= 0).all()


def test_viscous_and_inertia_end_at_their_torque():
    t = np.arange(4) * 0.1
    found = driven("viscous", t, np.array([0, 0.1, 0.1, -9.9]), B_Nms_rad=0.25, most_Nm=0.5)
    assert found["torque_Nm"] == pytest.approx([0, 0.25, 0, -0.5])
    t = np.arange(3001) * 1e-3
    found = driven("inertia", t, 2.0 * t * t, J_kg_m2=0.05, filter_s=0.01)["torque_Nm"]
    assert found[-1] == pytest.approx(0.05 * 4.0, rel=1e-3)  # a constant acceleration
    assert np.abs(driven("inertia", t, 1e6 * t * t, J_kg_m2=0.05)["torque_Nm"]).max() == 1.0
