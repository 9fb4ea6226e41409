"""The project's own laws at their edges: both senses, slow slip, and what they keep from cycle to
cycle.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from coulombus.host.laws.law import LawRecord, LawStateRecord, MotionRecord
from coulombus.host.laws.laws import LAW, coulomb, karnopp, load_law
from coulombus.host.laws.wall import wall
from coulombus.kernels.records import new_records

BOTH = pytest.mark.parametrize("sign", [1, -1])


def asked(law_function, counts, x=0.0, band=2.0, **state):
    """Return psi and the state after one cycle; K_p 4 Nm/rad, F_s 1.5 Nm, F_d 1.25 Nm."""
    motion, law, kept = new_records(MotionRecord)[0], new_records(LawRecord)[0], new_records(LawStateRecord)[0]
    law.K_p, law.F_s, law.F_d, law.velocity_band_counts = 4.0, 1.5, 1.25, band
    for name, value in state.items():
        setattr(law if name in LAW.names else kept, name, value)
    motion.x_rad, motion.v_counts = x, counts
    return law_function(motion, law, kept), kept


@BOTH
@pytest.mark.parametrize("law_function", [karnopp, coulomb])
@pytest.mark.parametrize(("counts", "band"), [(2.25, 2.0), (0.25, 0.0), (600.0, 2.0)])
def test_slip_is_f_d_against_the_motion_however_slow(law_function, sign, counts, band):
    psi, state = asked(law_function, sign * counts, band=band, stuck=1)
    assert (psi, state.stuck, state.brake_Nm) == (sign * 1.25, 0, 1.25)


@BOTH
@pytest.mark.parametrize(("counts", "band"), [(2.0, 2.0), (0.0, 0.0), (0.25, 2.0)])
@pytest.mark.parametrize("stuck", [0, 1])
def test_coulombs_law_shows_nothing_within_the_band(sign, counts, band, stuck):
    psi, state = asked(coulomb, sign * counts, band=band, stuck=stuck)
    assert (psi, state.stuck, state.brake_Nm) == (0.0, 1, 1.25)


@BOTH
def test_sticking_begins_without_a_jump_and_is_kept(sign):
    psi, state = asked(karnopp, sign * 2.0, x=sign * 3.0, stuck=0, psi_Nm=sign * 1.25)
    assert (psi, state.stuck, state.x_stuck) == (sign * 1.25, 1, sign * (3.0 - 0.3125))
    assert state.brake_Nm == 1.5
    psi, state = asked(karnopp, 0.0, x=sign * 3.0, stuck=0, psi_Nm=sign * 1.25, paper_entry=1)
    assert (psi, state.stuck, state.x_stuck) == (0.0, 1, sign * 3.0)


@BOTH
def test_a_stuck_handle_keeps_its_anchor_until_the_spring_is_at_f_s(sign):
    psi, state = asked(karnopp, 0.0, x=sign * 3.0, stuck=1, x_stuck=sign * 2.75, psi_Nm=sign * 0.5)
    assert (psi, state.x_stuck) == (sign * 1.0, sign * 2.75)
    psi, state = asked(karnopp, 0.0, x=sign * 3.0, stuck=1, x_stuck=sign * 2.5)
    assert (psi, state.x_stuck) == (sign * 1.5, sign * 2.625)


@BOTH
def test_a_weak_spring_saturates_in_its_own_sense(sign):
    psi, state = asked(karnopp, 0.0, x=sign * 3.0, stuck=1, x_stuck=sign * 2.75, F_s=0.5, brake_spring=1)
    assert (psi, state.x_stuck, state.brake_Nm) == (sign * 0.5, sign * 2.875, 0.5)
    psi, state = asked(karnopp, 0.0, x=sign * 3.0, stuck=1, x_stuck=sign * 2.8125, F_s=0.5, brake_spring=1)
    assert (psi, state.x_stuck, state.brake_Nm) == (sign * 0.5, sign * 2.875, 0.5)


def test_no_memory_left_is_no_mistake_of_the_law(tmp_path):
    (tmp_path / "hungry.py").write_text("raise MemoryError\n")
    with pytest.raises(MemoryError):
        load_law("hungry.py:law", tmp_path)


@pytest.mark.parametrize(
    ("p", "v", "torque", "brake", "motor"),
    [
        (0.0, 1.0, 0.0, 0.0, 0.0),  # it begins behind its angle
        (0.005, 0.5, 0.15, 0.05, 0.1),
        (0.005, 5.0, 0.6, 0.5, 0.1),  # on the way in all of the damping, though K p is less
        (0.005, -5.0, 0.0, 0.1, 0.1),
        (0.1, 9.0, 0.6, 0.6, 0.6),  # each part ends at most_Nm
        (0.1, -9.0, 0.6, 0.6, 0.6),
    ],
)
def test_the_walls_parts_for_brake_and_motor(p, v, torque, brake, motor):
    law = SimpleNamespace(x_wall_rad=0.2, K_Nm_rad=20.0, B_Nms_rad=0.1, most_Nm=0.6)
    state = SimpleNamespace(brake_Nm=math.nan, motor_Nm=math.nan)
    assert wall(SimpleNamespace(x_rad=0.2 + p, v_rad_s=v), law, state) == pytest.approx(torque)
    assert (state.brake_Nm, state.motor_Nm) == pytest.approx((brake, motor))
