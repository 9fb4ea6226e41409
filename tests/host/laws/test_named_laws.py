"""Laws with named parameters: what they declare, where they stand in a rig file, and their torque
along a motion against an independent integration of their equations.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.laws.along import given_law
from coulombus.host.laws.law import (
    Declaration,
    Field,
    LawRecord,
    LawStateRecord,
    MotionRecord,
    Parameters,
    described,
    friction_law,
)
from coulombus.host.laws.laws import BUILTIN_LAWS, load_declared
from coulombus.host.setup.law_demand import cut_off
from coulombus.kernels.records import new_records
from coulombus.rigs.field_help import unit_of
from coulombus.rigs.rig import RigError, load_rig

NAMED = [name for name, law in BUILTIN_LAWS.items() if not law.uses_mode_keys]


def walk(seed, samples=400, step=0.01):
    """A random walk of the angle over times that are not uniform."""
    draw = np.random.default_rng(seed)
    t = np.cumsum(draw.uniform(2e-4, 3e-3, samples))
    x = np.cumsum(draw.normal(0, step, samples))
    x[50:60] = x[50]  # a rest
    return t, x


def by_small_steps(rate, torque, t, x, z=0.0, steps=400):
    """Integrate z' = rate(z, v) by the classical Runge-Kutta method, v constant between samples."""
    found = [torque(z, 0.0)]
    for k in range(1, len(t)):
        v, h = (x[k] - x[k - 1]) / (t[k] - t[k - 1]), (t[k] - t[k - 1]) / steps
        for _ in range(steps):
            k1 = rate(z, v)
            k2 = rate(z + h / 2 * k1, v)
            k3 = rate(z + h / 2 * k2, v)
            k4 = rate(z + h * k3, v)
            z += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        found.append(torque(z, v))
    return np.array(found)


@pytest.mark.parametrize("alpha", [0.5, 1.0, 2.0])
def test_dahl_is_its_equation_along_any_path(alpha):
    F_c, sigma = 0.8, 60.0

    def rate(F, v):
        u = 1 - F / F_c * math.copysign(1.0, v)
        return sigma * v * max(u, 0.0) ** alpha

    t, x = walk(1)
    expected = by_small_steps(rate, lambda F, v: F, t, x)
    given = given_law("dahl", [f"F_c_Nm={F_c}", f"sigma_Nm_rad={sigma}", f"alpha={alpha}"])
    assert given.along(t, x).samples["torque_Nm"] == pytest.approx(expected, abs=2e-4 if alpha < 1 else 1e-7)


def test_dahls_loop_from_rest_is_the_closed_form():
    given = given_law("dahl", ["F_c_Nm=2.0", "sigma_Nm_rad=50.0"])
    x = np.concatenate((np.linspace(0, 0.3, 40), np.linspace(0.3, -0.3, 70)[1:]))
    torque = given.along(np.arange(len(x)) * 1e-3, x).samples["torque_Nm"]
    up = 2.0 * (1 - np.exp(-50 * x[:40] / 2.0))
    assert torque[:40] == pytest.approx(up, rel=1e-12)
    down = -2.0 + (up[-1] + 2.0) * np.exp(-50 * (0.3 - x[40:]) / 2.0)
    assert torque[40:] == pytest.approx(down, abs=1e-12)


def test_lugre_is_its_equation_along_any_motion():
    F_c, F_s, v_s, s_0, s_1, s_2 = 0.8, 1.3, 0.7, 90.0, 0.15, 0.05

    def z_rate(z, v):
        g = F_c + (F_s - F_c) * math.exp(-((v / v_s) ** 2))
        return v - s_0 * abs(v) / g * z

    t, x = walk(2, step=2e-3)
    expected = by_small_steps(z_rate, lambda z, v: s_0 * z + s_1 * z_rate(z, v) + s_2 * v, t, x)
    values = {
        "F_c_Nm": F_c,
        "F_s_Nm": F_s,
        "v_s_rad_s": v_s,
        "sigma_0_Nm_rad": s_0,
        "sigma_1_Nms_rad": s_1,
        "sigma_2_Nms_rad": s_2,
    }
    driven = given_law("lugre", [f"{key}={value}" for key, value in values.items()]).along(t, x)
    assert driven.samples["torque_Nm"] == pytest.approx(expected, abs=1e-7)
    assert driven.samples["v_rad_s"][1:] == pytest.approx(np.diff(x) / np.diff(t))
    assert driven.samples["v_rad_s"][0] == 0


@pytest.mark.parametrize("period_s", [1e-4, 1e-2, 1.0])
@pytest.mark.parametrize("sigma_0", [1.0, 1e5, 1e9])
def test_lugre_keeps_its_bounds_at_any_stiffness_and_period(sigma_0, period_s):
    given = given_law("lugre", [f"sigma_0_Nm_rad={sigma_0}", "sigma_1_Nms_rad=0"])
    x = np.cumsum(np.random.default_rng(5).normal(0, 1.0, 500))
    driven = given.along(np.arange(500) * period_s, x)
    assert driven.peak_Nm <= 1.2 * (1 + 1e-12)


@pytest.mark.parametrize("name", NAMED)
def test_compiled_and_plain_law_are_the_same(name):
    declared, t, x = BUILTIN_LAWS[name], *walk(7)
    compiled = given_law(name).along(t, x).samples
    law, state, motion, plain = (
        new_records(LawRecord)[0],
        new_records(LawStateRecord)[0],
        new_records(MotionRecord)[0],
        declared.plain(),
    )
    declared.fill(law, declared.parameters())
    state.stuck, state.x_stuck = 1, x[0]
    for k in range(len(t)):
        motion.x_rad, motion.v_rad_s = x[k], compiled["v_rad_s"][k]
        motion.dt_s = t[max(k, 1)] - t[max(k, 1) - 1]
        motion.v_counts = motion.v_rad_s * motion.dt_s * 12500
        state.psi_Nm = plain(motion, law, state)
        assert state.psi_Nm == pytest.approx(compiled["torque_Nm"][k], rel=1e-9, abs=1e-9)
        assert state.brake_Nm == pytest.approx(compiled["brake_Nm"][k], rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("name", BUILTIN_LAWS)
def test_a_law_at_rest_from_the_start_asks_for_nothing(name):
    driven = given_law(name).along(np.arange(50) * 1e-3, np.zeros(50))
    assert not driven.samples["torque_Nm"].any()
    assert (driven.samples["brake_Nm"] >= 0).all()


def mirrored(name):
    """What a law says to a motion, and to the mirrored motion."""
    t, x = walk(3)
    x -= x[0]
    return (given_law(name).along(t, sign * x).samples for sign in (1.0, -1.0))


@pytest.mark.parametrize("name", [name for name in BUILTIN_LAWS if name != "wall"])
def test_a_mirrored_motion_gives_the_mirrored_torque(name):
    ours, theirs = mirrored(name)
    assert theirs["torque_Nm"] == pytest.approx(-ours["torque_Nm"], abs=1e-9)
    assert theirs["brake_Nm"] == pytest.approx(ours["brake_Nm"], abs=1e-9)


def test_a_wall_has_one_side():
    ours, theirs = mirrored("wall")
    assert theirs["torque_Nm"] != pytest.approx(-ours["torque_Nm"], abs=1e-9)


@pytest.mark.parametrize("name", NAMED)
def test_what_a_law_declares_is_whole(name):
    law = BUILTIN_LAWS[name]
    told = described(law)
    assert told["title"]
    for one in told["parameters"]:
        assert one["meaning"], one["name"]
        assert one["accepted"], one["name"]
        assert one["unit"] == unit_of(one["name"])
    assert set(law.extremes) <= set(law.names)
    assert ":math:" in (law.function.__doc__ or "") or ".. math::" in (law.function.__doc__ or "")


class _Small(Parameters):
    F_c_Nm: float = Field(1.0, gt=0, le=10, description="level")


def test_a_declaration_that_does_not_fit_the_records_is_refused():
    def many(motion, law, state):
        return 0.0

    with pytest.raises(ValueError, match="many: 1 parameters and 17 numbers kept"):
        friction_law(_Small, state=[("z_rad", 17)])(many)

    class Taken(Parameters):
        F_s: float = Field(1.0, description="taken")

    with pytest.raises(ValueError, match="F_s: taken"):
        friction_law(Taken)(many)


OWN = """import math
from coulombus.host.laws.law import Field, Parameters, friction_law
from types import MappingProxyType

class Mine(Parameters):
    above = MappingProxyType({"high_Nm": "low_Nm"})
    low_Nm: float = Field(0.25, ge=0, le=10, description="level while it moves")
    high_Nm: float = Field(0.5, ge=0, le=10, description="level at rest")

@friction_law(Mine, state=["turns", ("kept_Nm", 3)])
def mine(motion, law, state):
    state.turns += 1.0
    state.kept_Nm[2] = law.high_Nm
    state.brake_Nm = law.high_Nm
    return law.low_Nm * math.copysign(1.0, motion.v_rad_s) + 0.001 * state.turns
"""


def test_a_law_of_ones_own_names_its_parameters_too(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    given = given_law("own.py:mine", ["low_Nm=0.125"], tmp_path)
    samples = given.along(np.arange(4.0), np.arange(4.0)).samples
    assert samples["torque_Nm"].tolist() == pytest.approx([0.126, 0.127, 0.128, 0.129])
    assert (samples["brake_Nm"] == 0.5).all()
    rig_file = tmp_path / "rig.toml"
    overrides = ["law.function=own.py:mine"]
    rig_file.write_text(load_rig("bench").effective() + "\n[law.mine]\nlow_Nm = 0.375\n")
    controllers = Controllers(load_rig(str(rig_file), overrides), "active")
    assert controllers.each[0].law["user"][0, :2].tolist() == [0.375, 0.5]
    rig_file.write_text(load_rig("bench").effective() + "\n[law.mine]\nlow_Nm = 0.75\n")
    with pytest.raises(
        RigError, match=r"rig.toml:\d+: law.mine.low_Nm: got '0.75', expected less than high_Nm, which is 0.5"
    ):
        Controllers(load_rig(str(rig_file), overrides), "active")
    load_rig(str(rig_file))  # with another law nobody knows what the table may hold


WRONG: dict[str, tuple[str, str]] = {
    "below its range": ("F_s_Nm = -1", "law.lugre.F_s_Nm: got '-1', expected a number above 0"),
    "no number": ('F_s_Nm = "much"', "law.lugre.F_s_Nm: got '\"much\"', expected a number above 0"),
    "nan": ("F_s_Nm = nan", "law.lugre.F_s_Nm: got 'nan', expected a number above 0"),
    "infinite": ("F_s_Nm = inf", "law.lugre.F_s_Nm: got 'inf', expected a number above 0"),
    "misspelt": ("F_S_Nm = 1", "law.lugre.F_S_Nm: unknown key; expected one of the keys of [law.lugre]: F_c_Nm"),
    "less than another": ("F_s_Nm = 0.5", "law.lugre.F_s_Nm: got '0.5', expected at least F_c_Nm, which is 1.0"),
    "more than another": ("F_c_Nm = 2", "law.lugre.F_c_Nm: got '2.0', expected at most F_s_Nm, which is 1.2"),
}


@pytest.mark.parametrize("function", ["lugre", "karnopp"])
@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_parameter_is_refused_with_its_line(case, function, tmp_path):
    line, told = WRONG[case]
    text = load_rig("bench").effective().replace('function = "karnopp"', f'function = "{function}"')
    path = tmp_path / "rig.toml"
    path.write_text(f"{text}\n[law.lugre]\n{line}\n")
    rig = load_rig(str(path))
    with pytest.raises(RigError) as caught:
        Controllers(rig, "active")
    assert str(caught.value).startswith(f"{path}:{text.count(chr(10)) + 3}: {told}")


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ("lugr", "law.lugr.F_s_Nm: there is no law 'lugr'; did you mean 'lugre'?"),
        ("karnopp", "law.karnopp.F_s_Nm: the law karnopp has no table: its parameters are in [mode.NAME] and [law]"),
    ],
)
def test_a_table_of_no_law_is_refused(table, told):
    rig = load_rig("bench", [f"law.{table}.F_s_Nm=1"])
    with pytest.raises(RigError, match="--set") as caught:
        Controllers(rig, "active")
    assert told in str(caught.value)


def test_what_a_limit_cuts_off_of_a_named_law_is_told_with_its_key():
    rig = load_rig("bench", ["law.function=lugre", "law.lugre.F_s_Nm=2"])
    (told,) = cut_off(rig, "active")
    assert (
        "law.lugre.F_s_Nm: got '2', expected a torque of at most 1.5 Nm, not 2 Nm: mode.active.motor_limit_Nm" in told
    )
    assert cut_off(rig, "hybrid") == []
    (told,) = cut_off(load_rig("bench", ["law.function=lugre", "limits.brake_torque_Nm=1.1"]), "hybrid")
    assert "law.lugre.F_s_Nm: by default, expected a torque of at most 1.1 Nm" in told


def test_the_parameters_go_with_the_rig():
    rig = load_rig("bench", ["law.function=lugre", "law.lugre.F_s_Nm=1.4"])
    again = rig.variant("law.lugre.F_c_Nm=0.7")
    assert again != rig
    (law,) = Controllers(again, "active").each[0].law
    assert law["user"][:3].tolist() == [0.7, 1.4, 0.5]


def test_a_choice_of_words_is_its_place():
    declared = load_declared("karnopp").declaration
    assert isinstance(declared, Declaration)
    law = new_records(LawRecord)[0]
    declared.fill(law, declared.parameters(stick_entry="paper"))
    assert (law.paper_entry, law.brake_spring, law.K_p) == (1, 0, 100.0)
