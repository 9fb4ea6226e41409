"""Friction laws: the paper's equations, stick entry, saturation, loading a law by its name."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cases import thorough
from coulombus.host.laws.law import LawRecord, LawStateRecord, MotionRecord
from coulombus.host.laws.laws import BUILTIN_LAWS, LawError, coulomb, karnopp, load_law
from coulombus.kernels.decorator import CACHE_DIR, JIT_DISABLED
from coulombus.kernels.records import new_records

K_P, F_S, F_D = 100.0, 1.2, 1.0
OLD = "host.laws" + ":"  # how rig files named the laws at first


def records(**parameters):
    motion, law, state = new_records(MotionRecord)[0], new_records(LawRecord)[0], new_records(LawStateRecord)[0]
    law.K_p, law.F_s, law.F_d, law.velocity_band_counts = K_P, F_S, F_D, 2.0
    for name, value in parameters.items():
        setattr(law, name, value)
    return motion, law, state


def ask(law_function, motion, law, state, x, counts):
    motion.x_rad, motion.v_counts = x, counts
    state.psi_Nm = law_function(motion, law, state)
    return state.psi_Nm


@given(st.floats(2.01, 1e4), st.sampled_from([-1, 1]))
def test_karnopp_slips_with_f_d_against_the_motion(counts, sign):
    motion, law, state = records()
    assert ask(karnopp, motion, law, state, 0.0, sign * counts) == sign * F_D
    assert state.stuck == 0
    assert state.brake_Nm == F_D


def test_karnopp_sticks_within_two_counts_and_springs_against_the_motion():
    motion, law, state = records()
    state.stuck, state.x_stuck = 1, 0.5
    assert ask(karnopp, motion, law, state, 0.503, 2.0) == pytest.approx(K_P * 0.003)
    assert ask(karnopp, motion, law, state, 0.497, -2.0) == pytest.approx(-K_P * 0.003)
    assert state.brake_Nm == F_S


def test_karnopp_saturates_at_f_s_and_drags_its_anchor_along():
    motion, law, state = records()
    state.stuck, state.x_stuck = 1, 0.0
    assert ask(karnopp, motion, law, state, 0.1, 1.0) == F_S
    assert state.x_stuck == pytest.approx(0.1 - F_S / K_P)
    # a step back unloads the spring from F_s instead of winding it up
    assert ask(karnopp, motion, law, state, 0.099, -1.0) == pytest.approx(F_S - K_P * 0.001)


def test_stick_entry_is_continuous_or_the_papers():
    motion, law, state = records()
    ask(karnopp, motion, law, state, 0.2, 50.0)
    assert ask(karnopp, motion, law, state, 0.2, 1.0) == pytest.approx(F_D)
    motion, law, state = records(paper_entry=1)
    ask(karnopp, motion, law, state, 0.2, 50.0)
    assert ask(karnopp, motion, law, state, 0.2, 1.0) == 0.0


def test_brake_spring_is_for_study_and_unsigned():
    motion, law, state = records(brake_spring=1)
    state.stuck, state.x_stuck = 1, 0.0
    ask(karnopp, motion, law, state, -0.005, -1.0)
    assert state.brake_Nm == pytest.approx(0.5)


@given(st.floats(-5, 5), st.floats(-100, 100))
def test_karnopp_is_odd_and_bounded(x, counts):
    motion, law, state = records()
    mirrored = records()
    state.stuck = mirrored[2].stuck = 1
    psi = ask(karnopp, motion, law, state, x, counts)
    assert abs(psi) <= F_S
    assert ask(karnopp, *mirrored, -x, -counts) == -psi
    assert state.brake_Nm >= 0


def test_coulomb_is_equation_4():
    motion, law, state = records(velocity_band_counts=0.0)
    assert [ask(coulomb, motion, law, state, 0.0, v) for v in (-3.0, 0.0, 3.0)] == [-F_D, 0.0, F_D]
    assert state.brake_Nm == F_D


@pytest.mark.parametrize("paper", [0, 1])
@pytest.mark.parametrize("name", ["karnopp", "coulomb"])
def test_compiled_law_gives_what_the_plain_one_gives(name, paper):
    compiled, plain = load_law(name), BUILTIN_LAWS[name].function
    assert compiled is not plain
    ours, theirs = records(paper_entry=paper, brake_spring=paper), records(paper_entry=paper, brake_spring=paper)
    draw, x, shown = random.Random(3), 0.5, set()
    for _ in range(400):
        counts = draw.choice((-40.0, -2.5, -2.0, -1.0, 0.0, 1.0, 2.0, 2.5, 40.0))
        x += 1e-3 * counts
        assert ask(compiled, *ours, x, counts) == pytest.approx(ask(plain, *theirs, x, counts), rel=1e-12, abs=1e-12)
        for field in ("stuck", "x_stuck", "brake_Nm"):
            assert ours[2][field] == pytest.approx(theirs[2][field], rel=1e-12, abs=1e-12)
        shown.add(round(theirs[2].psi_Nm, 6))
    assert {F_D, -F_D} < shown


def test_a_law_of_ones_own_is_one_function_in_a_file(tmp_path):
    (tmp_path / "own.py").write_text(
        "def thick(motion, law, state):\n    state.brake_Nm = law.user[0]\n    return law.F_d * motion.v_rad_s\n"
    )
    own = load_law("own.py:thick", tmp_path)
    motion, law, state = records()
    law.user[0] = 0.25
    motion.v_rad_s = 3.0
    assert own(motion, law, state) == 3.0 * F_D
    assert state.brake_Nm == 0.25


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("stickiness", "expected 'karnopp', 'coulomb', .*, 'file.py:function' or 'module:function'$"),
        ("karnop", "did you mean 'karnopp'"),
        ("math:karnop", "no function 'karnop'; it has"),
        (OLD + "karnopp", "is an old name; the law is called 'karnopp' now"),
        (OLD + "friction", "cannot be imported"),
        ("no.such.module:f", "cannot be imported"),
        ("missing.py:f", "there is no file missing.py"),
        ("broken.py:f", "cannot be imported"),
    ],
)
def test_a_law_that_cannot_be_had_says_why(tmp_path, name, text):
    (tmp_path / "broken.py").write_text("def f(:\n")
    with pytest.raises(LawError, match=text):
        load_law(name, tmp_path)


def test_a_law_that_raises_gives_no_number_and_one_is_not_cached(tmp_path):
    """What a law imports may change without the law's file changing: it is compiled anew in each
    process.
    """
    (tmp_path / "own.py").write_text(
        "def f(motion, law, state):\n    if motion.x_rad > 1.0:\n        raise ValueError('far')\n    return 0.5\n"
    )
    own = load_law("own.py:f", tmp_path)
    motion, law, state = records()
    assert own(motion, law, state) == 0.5
    motion.x_rad = 2.0
    assert math.isnan(own(motion, law, state))
    if CACHE_DIR is not None and not JIT_DISABLED:
        load_law("karnopp")
        assert list(CACHE_DIR.rglob("karnopp.karnopp-*.nbi"))
        assert not list(CACHE_DIR.rglob("own.f-*"))
        assert not list(CACHE_DIR.rglob("*guarded*"))


@pytest.mark.parametrize("index", [15, -16, *thorough(-1, 0)])
@pytest.mark.parametrize("where", ["here", "in a helper", "in an eager helper"])
def test_a_law_may_use_all_of_user(tmp_path, index, where):
    assert index_law(tmp_path, where, index) == 0.5


@pytest.mark.parametrize("index", [16, -17, *thorough(17, 40, -40)])
@pytest.mark.parametrize("where", ["here", "in a helper", "in an eager helper"])
def test_a_law_that_writes_beyond_its_records_raises_and_touches_nothing(tmp_path, index, where):
    """It wrote into the memory behind: no number is what trips."""
    assert math.isnan(index_law(tmp_path, where, index))


def index_law(tmp_path, where, index):
    """Write state.user[index] in a law, and look at the memory around its state.

    Return what the law gives.
    """
    decorator = {"here": "", "in a helper": "@numba.njit\n", "in an eager helper": "@numba.njit('f8(f8[:], i8)')\n"}[
        where
    ]
    helper = f"import numba\n{decorator}def put(user, index):\n    user[index] = 1.0\n    return 0.5\n"
    body = (
        "return put(state.user, int(motion.x_rad))" if decorator else "state.user[int(motion.x_rad)] = 1.0; return 0.5"
    )
    (tmp_path / "own.py").write_text(f"{helper}\ndef law(motion, law, state):\n    {body}\n")
    motion, law, _ = records()
    state = new_records(LawStateRecord, 5)
    motion.x_rad = index
    found = load_law("own.py:law", tmp_path)(motion, law, state[2])
    assert not (state[:2].tobytes() + state[3:].tobytes()).strip(b"\0")
    return found


@pytest.mark.skipif(JIT_DISABLED, reason="a plain function is not compiled")
@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("def f(motion, law, state):\n    return law.F_x\n", 2, "law has no field 'F_x'; it has K_p, F_s"),
        (
            "def f(motion, law):\n    return 0.0\n",
            1,
            r"three arguments, \(motion, law, state\); .* takes \(motion, law\)",
        ),
        ("def f(motion, law, state):\n    return Fd\n", 2, "name 'Fd' is not defined; see"),
        ("def f(motion, law, state):\n    state.brake_Nm = 1.0\n", 1, "returns a number, .* is none; see"),
        (
            "def f(motion, law, state):\n    if law.F_s > 1:\n        return 1.0\n",
            1,
            "on every path; .* is OptionalType; see",
        ),
        (
            "def g(x):\n    return x\n\ndef f(motion, law, state):\n    return g(1.0)\n",
            5,
            "'g'.* needs numba.njit's decorator",
        ),
        ("def f(motion, law, state):\n    return law.user.F\n", 2, "Unknown attribute 'F' of type"),
    ],
)
def test_a_law_that_does_not_compile_is_told_by_its_line(tmp_path, text, line, said):
    (tmp_path / "own.py").write_text(text)
    with pytest.raises(LawError, match=rf"own\.py:{line}: .*{said}") as error:
        load_law("own.py:f", tmp_path)
    assert len(str(error.value).splitlines()) == 1


def test_a_laws_place_is_beside_the_rig_file_then_the_current_folder(tmp_path, monkeypatch):
    for folder, psi in (("rigs", 1.0), ("here", 2.0)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "own.py").write_text(f"def f(motion, law, state):\n    return {psi}\n")
    (tmp_path / "here" / "mine.py").write_text("def f(motion, law, state):\n    return 3.0\n")
    monkeypatch.chdir(tmp_path / "here")
    assert load_law("own.py:f", tmp_path / "rigs")(*records()) == 1.0
    assert load_law("mine.py:f", tmp_path / "rigs")(*records()) == 3.0
