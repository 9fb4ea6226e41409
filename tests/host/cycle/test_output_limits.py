"""What motor and brake can show, at the bounds: whose limit counts."""

from __future__ import annotations

import pytest

from coulombus.host.cycle.output_limits import (
    brake_bears_motor,
    brake_end_Nm,
    brake_limit,
    brake_limit_raw,
    law_pushes,
    motor_limit,
    motor_limit_Nm,
    scale_Nm,
    torque_step_Nm,
)
from coulombus.rigs.rig import RigError, load_rig, load_rig_text
from eds_edit import edit
from places import RIGS, ROOT

BENCH = (RIGS / "bench.toml").read_text(encoding="utf-8")
MOTOR, BRAKE = ((ROOT / "eds" / name).read_text(encoding="utf-8") for name in ("motor.eds", "mr_brake.eds"))
WALL = ("law.function=wall", "law.wall.most_Nm=0.8")
MINE = "law.function=mine.py:law"


def axis_of(*overrides):
    return load_rig("bench", list(overrides)).one_axis()


def braked(table="", overrides=(), **keys):
    """Return the rig of the bench whose brake's set-point has these keys in the EDS file."""
    text = f"\n[role.brake_setpoint]\ntable = {table}\n" if table else ""
    texts = {"motor.eds": MOTOR, "mr_brake.eds": edit(BRAKE, "7300sub1", **keys)}
    return load_rig_text(BENCH + text, "r.toml", texts, overrides)


# the motor


def test_in_hybrid_the_motor_has_a_fifth_more_than_its_friction():
    axis = axis_of("mode.hybrid.motor_limit_Nm=1.0", "mechanics.friction_Nm=0.2")
    assert motor_limit_Nm(axis, "hybrid") == pytest.approx(0.24)
    limit, whose = motor_limit(axis, "hybrid")
    assert limit == pytest.approx(0.24)
    assert whose == "the motor in mode hybrid (1.2 x mechanics.friction_Nm)"


@pytest.mark.parametrize("mode", ["active", "hybrid"])
def test_the_rig_files_limit_is_the_limit_where_it_is_lower(mode):
    axis = axis_of(f"mode.{mode}.motor_limit_Nm=0.15")
    assert motor_limit(axis, mode) == (0.15, f"mode.{mode}.motor_limit_Nm (the drive's 6072h)")


@pytest.mark.parametrize(("law", "limit_Nm"), [(WALL, 1.0), ((MINE,), 0.168), (("law.function=lugre",), 0.168)])
def test_only_a_law_of_ours_that_pushes_has_the_rig_files_limit_in_hybrid(law, limit_Nm):
    assert motor_limit_Nm(axis_of("mode.hybrid.motor_limit_Nm=1.0", *law), "hybrid") == pytest.approx(limit_Nm)


@pytest.mark.parametrize(
    ("law", "pushes"),
    [("wall", True), ("karnopp", False), ("plane_wall", True), ("plane_karnopp", False), ("mine.py:law", False)],
)
def test_a_law_pushes_on_an_axis_and_in_the_plane(law, pushes):
    rig = load_rig("plane" if law.startswith("plane") else "bench", [f"law.function={law}"])
    assert law_pushes(rig.axes[0]) is pushes


@pytest.mark.parametrize("kind", ["joint", "world"])
def test_a_joint_and_a_world_have_the_rig_files_limit_in_hybrid(kind):
    world = ['world.rest="law"'] if kind == "world" else []
    axis = load_rig("plane" if kind == "joint" else "bench", ["mode.hybrid.motor_limit_Nm=1.0", *world]).axes[0]
    assert not law_pushes(axis)
    assert motor_limit_Nm(axis, "hybrid") == 1.0


@pytest.mark.parametrize("polarity", [1, -1])
def test_a_count_of_the_motors_set_point_is_a_per_mille_of_its_rated_torque(polarity):
    axis = axis_of(f"mechanics.motor_polarity={polarity}", "motor.rated_torque_Nm=0.2")
    assert torque_step_Nm(axis) == pytest.approx(0.2e-3 * axis.mechanics.ratio)
    assert torque_step_Nm(axis) == scale_Nm(axis, "motor.target_torque_Nm")


# the brake


def test_a_table_ends_the_brake_at_its_last_torque():
    axis = braked("[[0, 0.0], [1000, 2.0], [3000, 4.0]]").one_axis()
    assert brake_end_Nm(axis) == 4.0
    assert brake_limit(axis) == (4.0, "role.brake_setpoint.table")
    assert brake_limit_raw(axis) == 5000


@pytest.mark.parametrize(
    ("end_Nm", "whose"),
    [(4.499, "the brake's 7300h:01 (mr_brake.eds:"), (4.5, "limits.brake_torque_Nm"), (5.0, "limits.brake_torque_Nm")],
)
def test_the_brakes_limit_is_the_lower_and_has_its_name(end_Nm, whose):
    found, name = brake_limit(braked(HighLimit=round(end_Nm * 1000)).one_axis())
    assert found == pytest.approx(min(end_Nm, 4.5))
    assert name.startswith(whose)


@pytest.mark.parametrize(
    ("data_type", "low", "high", "good", "wrong"),
    [
        ("0x3", "0", "5000", 0, -1),
        ("0x3", "-5", "5000", -5, -6),
        ("0x3", "", "5000", -32768, -32769),
        ("0x3", "-40000", "5000", -32768, -32769),
        ("0x5", "", "", 0, -1),
    ],
)
def test_no_point_of_a_table_is_below_what_the_object_takes(data_type, low, high, good, wrong):
    keys = {"DataType": data_type, "LowLimit": low, "HighLimit": high}
    brake_limit_raw(braked(f"[[{good}, 0.0], [200, 4.0]]", **keys).one_axis())
    with pytest.raises(RigError, match=r"role\.brake_setpoint\.table.*which 7300h:01 takes"):
        brake_limit_raw(braked(f"[[{wrong}, 0.0], [200, 4.0]]", **keys).one_axis())


@pytest.mark.parametrize(("last", "taken"), [(5000, True), (5001, False)])
def test_no_point_of_a_table_is_above_what_the_object_takes(last, taken):
    axis = braked(f"[[0, 0.0], [{last}, 4.0]]").one_axis()
    if taken:
        assert brake_limit_raw(axis) == 5000
    else:
        with pytest.raises(RigError, match="raw counts from 0 to 5000, which 7300h:01 takes"):
            brake_limit_raw(axis)


@pytest.mark.parametrize(("motor_Nm", "bears"), [(1.999, True), (2.0, True), (2.001, False)])
def test_a_brake_bears_a_motor_that_is_no_stronger(motor_Nm, bears):
    axis = axis_of(f"mode.active.motor_limit_Nm={motor_Nm}", "limits.brake_torque_Nm=2.0")
    assert brake_bears_motor(axis, "active") is bears
