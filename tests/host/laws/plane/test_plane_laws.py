"""Laws in the plane: the one-axis laws along a line, turned motions, energy, and what is refused."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from coulombus.host.laws.along import given_law
from coulombus.host.laws.laws import LawError
from coulombus.host.laws.plane.limit_ellipse import gauge, slip_force
from coulombus.host.laws.plane.plane_laws import PLANE_LAWS, load_plane_law
from coulombus.rigs.errors import RigError
from places import ROOT

T = 1e-3
RATE = np.arange(1501) * T
INVARIANT = ("plane_coulomb", "plane_karnopp", "plane_viscous", "plane_lugre", "plane_dahl")
FRICTION = ("plane_coulomb", "plane_karnopp", "plane_lugre", "plane_dahl", "plane_viscous")

LINE = {
    "plane_coulomb": ("coulomb", ["F_d_N=2.5"], ["F_d_Nm=2.5"]),
    "plane_karnopp": (
        "karnopp",
        ["K_p_N_m=900", "F_s_N=2.7", "F_d_N=2.2", "band_m_s=0.02000001"],
        ["K_p_Nm_rad=900", "F_s_Nm=2.7", "F_d_Nm=2.2", "velocity_band_counts=20"],
    ),
    "plane_viscous": ("viscous", ["B_Ns_m=9", "most_N=1.2"], ["B_Nms_rad=9", "most_Nm=1.2"]),
    "plane_lugre": (
        "lugre",
        ["F_c_N=2", "F_s_N=2.6", "v_s_m_s=0.08", "sigma_0_N_m=700", "sigma_1_Ns_m=3", "sigma_2_Ns_m=0.7"],
        ["F_c_Nm=2", "F_s_Nm=2.6", "v_s_rad_s=0.08", "sigma_0_Nm_rad=700", "sigma_1_Nms_rad=3", "sigma_2_Nms_rad=0.7"],
    ),
    "plane_dahl": ("dahl", ["F_c_N=1.7", "sigma_N_m=400"], ["F_c_Nm=1.7", "sigma_Nm_rad=400", "alpha=1"]),
    "plane_wall": (
        "wall",
        ["K_N_m=150", "B_Ns_m=6", "most_N=4", "distance_m=0.02"],
        ["K_Nm_rad=150", "B_Nms_rad=6", "most_Nm=4", "x_wall_rad=0.02"],
    ),
}
"""Law in the plane -> the law of one axis, and the parameters of both."""


def wiggle():
    """A motion with reversals, stops and creeping."""
    t = RATE
    s = 0.05 * np.sin(2 * math.pi * 1.3 * t) + 0.02 * np.sin(2 * math.pi * 4.1 * t)
    s[400:520] = s[400]
    s[900:1000] = s[900] + np.linspace(0.0, 2e-4, 100)
    return s


def path():
    """A path in the plane that turns."""
    t = RATE
    return np.stack((0.05 * np.cos(6 * t) + 0.01 * np.sin(17 * t), 0.03 * np.sin(6 * t + 0.4) - 0.02 * t), axis=1)


def turned(vectors, angle):
    c, s = math.cos(angle), math.sin(angle)
    return vectors @ np.array([[c, s], [-s, c]])


def loop(law, laps=2, samples=1500, radius=0.04):
    """Forces and path of the last of several laps of a closed path."""
    phase = 2 * math.pi * np.arange(laps * samples + 1) / samples
    x = radius * np.stack((np.cos(phase), np.sin(phase) + 0.4 * np.sin(2 * phase)), axis=1)
    psi = law.along(np.arange(len(x)) * 1e-3 * 2000 / samples, x)
    return psi[-samples - 1 :], x[-samples - 1 :]


def work(psi, x):
    """The work that a law takes up: its force of a sample acts on the step that ends there."""
    return float((psi[1:] * np.diff(x, axis=0)).sum())


@pytest.mark.parametrize("name", LINE)
@pytest.mark.parametrize("angle", [0.0, 0.61, -2.2])
def test_along_a_line_it_is_the_law_of_one_axis(name, angle):
    other, ours, theirs = LINE[name]
    if name == "plane_wall":
        ours = [*ours, f"angle_rad={angle}"]
    n, s = np.array([math.cos(angle), math.sin(angle)]), wiggle()
    psi = load_plane_law(name, ours).along(RATE, s[:, None] * n)
    expected = given_law(other, theirs).along(RATE, s, count_rad=1e-6).samples["torque_Nm"]
    assert np.abs(expected).max() > 0.5
    if name == "plane_coulomb":  # a counted speed of less than half a count is 0 on one axis
        moving = np.abs(np.diff(s, prepend=s[0])) > 1e-9
        psi, expected = psi[moving], expected[moving]
    assert psi @ n == pytest.approx(expected, abs=1e-6)
    assert psi @ [-n[1], n[0]] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("name", INVARIANT)
def test_a_motion_that_is_turned_has_a_force_that_is_turned(name):
    law = load_plane_law(name)
    straight = law.along(RATE, path())
    for angle in (0.4, 2.5, -1.1):
        assert law.along(RATE, turned(path(), angle)) == pytest.approx(turned(straight, angle), abs=1e-9)


@pytest.mark.parametrize("name", INVARIANT)
def test_a_motion_that_is_mirrored_has_a_force_that_is_mirrored(name):
    law, mirror = load_plane_law(name), np.array([1.0, -1.0])
    assert law.along(RATE, path() * mirror) == pytest.approx(law.along(RATE, path()) * mirror, abs=1e-9)


@pytest.mark.parametrize("name", ["plane_coulomb", "plane_karnopp"])
def test_an_ellipse_is_not_the_same_in_all_directions(name):
    law = load_plane_law(name, ["ratio=0.5"])
    assert np.abs(law.along(RATE, turned(path(), 0.4)) - turned(law.along(RATE, path()), 0.4)).max() > 0.3


@pytest.mark.parametrize("name", FRICTION)
def test_friction_takes_energy_on_a_closed_path(name):
    psi, x = loop(load_plane_law(name))
    length = np.hypot(*np.diff(x, axis=0).T).sum()
    assert work(psi, x) > 0.1 * length


@pytest.mark.parametrize("name", ["plane_wall", "plane_line"])
def test_a_spring_gives_back_what_it_took_on_a_closed_path(name):
    law = load_plane_law(name, ["B_Ns_m=0", "most_N=1000", *(["distance_m=0.01"] if name == "plane_wall" else [])])
    psi, x = loop(law, samples=3000)
    mean = 0.5 * (psi[1:] + psi[:-1])
    stored = float(np.abs((mean * np.diff(x, axis=0)).sum(axis=1)).sum())
    assert stored > 0.05
    assert abs(float((mean * np.diff(x, axis=0)).sum())) < 1e-5 * stored


@pytest.mark.parametrize("name", ["plane_wall", "plane_line"])
def test_a_dampers_part_takes_energy_on_a_closed_path(name):
    law = load_plane_law(name, ["most_N=1000", *(["distance_m=0.01"] if name == "plane_wall" else [])])
    assert work(*loop(law)) > 0.0


def test_dahls_energy_is_never_less_than_its_spring_stores():
    psi, x = loop(load_plane_law("plane_dahl", ["F_c_N=2", "sigma_N_m=150"]), samples=3000)
    taken = np.concatenate(([0.0], np.cumsum((0.5 * (psi[1:] + psi[:-1]) * np.diff(x, axis=0)).sum(axis=1))))
    stored = (psi**2).sum(axis=1) / (2 * 150)
    assert (taken - (stored - stored[0]) > -1e-4).all()


def test_the_bristle_of_lugre_stays_within_its_level():
    law = load_plane_law("plane_lugre", ["sigma_0_N_m=1e6", "sigma_1_Ns_m=0"])
    assert np.hypot(*law.along(RATE, path()).T).max() <= 3.3 + 1e-9


def test_a_line_is_free_along_and_stiff_across():
    along = np.stack((0.2 + 0.1 * np.sin(9 * RATE), np.zeros_like(RATE)), axis=1)
    law = load_plane_law("plane_line", ["B_Ns_m=0", "most_N=100"])
    assert np.abs(law.along(RATE, along)).max() == 0.0
    assert law.along(RATE, along + np.array([0.0, 0.01]))[5:] == pytest.approx(np.tile([0.0, 5.0], (len(RATE) - 5, 1)))


def test_a_wall_never_pulls():
    away = np.stack((0.31 - 0.5 * RATE, 0.2 * RATE), axis=1)
    psi = load_plane_law("plane_wall", ["B_Ns_m=100"]).along(RATE, away)
    assert psi.min() >= 0.0
    assert np.abs(psi).max() > 0.0  # at the first sample, where the speed is 0


@pytest.mark.parametrize("ratio", [1.0, 0.4, 3.0])
def test_the_force_in_slip_is_the_one_of_the_ellipse_that_takes_most(ratio):
    angle, level = 0.7, 2.0
    phases = np.linspace(0, 2 * math.pi, 20_001)
    main = np.stack((np.cos(phases), ratio * np.sin(phases)), axis=1) * level
    ellipse = turned(main, angle)
    for heading in np.linspace(0.1, 6.0, 9):
        v = 0.3 * np.array([math.cos(heading), math.sin(heading)])
        force = slip_force(*v, level, ratio, angle)
        assert gauge(*force, level, ratio, angle) == pytest.approx(1.0)
        assert force @ v == pytest.approx((ellipse @ v).max(), rel=1e-6)


def test_stick_yields_at_the_ellipse():
    law = load_plane_law("plane_karnopp", ["ratio=0.5", "F_s_N=4", "F_d_N=3", "K_p_N_m=1000", "band_m_s=1"])
    creep = np.linspace(0.0, 0.02, len(RATE))
    for axis, level in ((0, 4.0), (1, 2.0)):
        x = np.zeros((len(RATE), 2))
        x[:, axis] = creep
        psi = law.along(RATE, x)
        assert psi[100, axis] == pytest.approx(1000 * creep[100])
        assert psi[-1, axis] == pytest.approx(level)


def test_every_law_names_its_source_and_its_levels():
    assert set(PLANE_LAWS) == {*INVARIANT, "plane_wall", "plane_line"}
    for name, law in PLANE_LAWS.items():
        assert "Source:" in law.function.__doc__ or "limit_ellipse" in law.function.__doc__, name
        assert set(law.extremes) <= set(law.names)


def test_the_page_has_every_law():
    table = (ROOT / "docs/plane.md").read_text().partition("| law | what it displays |")[2].partition("\n\n")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.M)) == set(PLANE_LAWS)


USERS = """
import math
from coulombus.host.laws.plane.plane_law import Field, Parameters, PlaneStateRecord, plane_law

def swirl(motion, law, state):
    return -2.0 * motion.v_m_s[1], 2.0 * motion.v_m_s[0]

def one_number(motion, law, state):
    return 1.0

def raises(motion, law, state):
    return motion.x_m[7], 0.0

def misspelt(motion, law, state):
    return motion.v_rad_s, 0.0

class Own(Parameters):
    F_c_N: float = Field(1.0, gt=0, le=10, description="level")

@plane_law(Own)
def own(motion, law, state):
    speed = math.hypot(motion.v_m_s[0], motion.v_m_s[1])
    share = law.F_c_N / speed if speed > 0.0 else 0.0
    return share * motion.v_m_s[0], share * motion.v_m_s[1]
"""


@pytest.fixture
def users(tmp_path):
    (tmp_path / "mine.py").write_text(USERS)
    return tmp_path


def test_a_law_of_the_users_own_has_vectors(users):
    psi = load_plane_law("mine.py:swirl", directory=users).along(RATE, path())
    v = np.diff(path(), axis=0, prepend=path()[:1]) / T
    assert psi == pytest.approx(2.0 * v[:, ::-1] * [-1, 1])


def test_a_law_of_the_users_own_has_parameters(users):
    psi = load_plane_law("mine.py:own", ["F_c_N=2.5"], users).along(RATE, path())
    assert np.hypot(*psi[1:].T) == pytest.approx(2.5)
    with pytest.raises(RigError, match="F_c_N"):
        load_plane_law("mine.py:own", ["F_c_N=11"], users)


@pytest.mark.parametrize("name", ["nothing", "mine.py:nothing", "nowhere.py:law", "coulombus.host.laws.dahl:dahl"])
def test_what_is_no_law_in_the_plane_is_refused(users, name):
    with pytest.raises(LawError):
        load_plane_law(name, directory=users)


@pytest.mark.parametrize("name", ["one_number", "raises", "misspelt"])
def test_a_law_that_gives_no_two_numbers_is_refused(users, name):
    with pytest.raises(LawError):
        load_plane_law(f"mine.py:{name}", directory=users).along(RATE, path())


def test_a_parameter_of_another_law_is_refused():
    with pytest.raises(RigError, match="K_p_N_m"):
        load_plane_law("plane_dahl", ["K_p_N_m=3"])
