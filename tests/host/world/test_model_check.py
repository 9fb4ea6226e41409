import math

import pytest

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import Trip
from coulombus.host.world.model_check import RANGES, why_not
from coulombus.host.world.model_parts import LinearField, Model, Spring, TorqueProfile, Wall, model_of
from coulombus.host.world.records import MODEL
from coulombus.rigs.arguments import WrongCall
from coulombus.rigs.rig import load_rig

WHOLE = Model(
    wall=Wall(0.5, 4.0, 0.25, side="below"),
    spring=Spring(-0.5, 2.0, 0.125, most_Nm=3.0),
    field=LinearField(1.0, -2.0, -0.5),
    profile=TorqueProfile((0.5, -0.5), sample_s=0.002),
    law=0.25,
    parameters={"F_s_Nm": 1.5},
    life_s=0.05,
)


UNUSED = {"head", "parameter", "sample", "profile_direction", *(name for name in MODEL.names if "plane" in name)}


def record(**values):
    model = WHOLE.record({"F_s_Nm": 1}, profile=7)
    for name, value in values.items():
        model[name] = value
    return model


def test_a_model_becomes_its_record():
    m = record()
    names = MODEL.names
    assert {name: m[name] for name in names if name not in UNUSED} == {
        "sequence": 0,
        "t_ns": 0,
        "life_ns": 50_000_000,
        "axis": 0,
        "parts": 31,
        "law": 0.25,
        "wall_x_rad": 0.5,
        "wall_side": -1,
        "wall_K_Nm_rad": 4.0,
        "wall_B_Nms_rad": 0.25,
        "spring_x_rad": -0.5,
        "spring_K_Nm_rad": 2.0,
        "spring_B_Nms_rad": 0.125,
        "spring_most_Nm": 3.0,
        "field_Nm": 1.0,
        "field_Nm_rad": -2.0,
        "field_Nms_rad": -0.5,
        "profile": 7,
        "samples": 2,
        "sample_ns": 2_000_000,
        "parameters": 2,
    }
    assert (m["parameter"][1], m["sample"][:3].tolist()) == (1.5, [0.5, -0.5, 0.0])
    assert why_not(m, 1, 10**9) is None


@pytest.mark.parametrize("name", RANGES)
def test_a_number_that_is_none_or_out_of_its_range_is_refused_by_its_name(name):
    low, high = RANGES[name]
    for value in (math.nan, math.inf, -math.inf, math.nextafter(high, math.inf), math.nextafter(low, -math.inf)):
        assert why_not(record(**{name: value}), 1, 10**9).startswith(f"{name} is ")
    assert why_not(record(**{name: low}), 1, 10**9) is None
    assert why_not(record(**{name: high}), 1, 10**9) is None


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("axis", (-1, 2)),
        ("life_ns", (0, -1, 10**9 + 1)),
        ("parts", (64, -1)),
        ("wall_side", (0, 2)),
        ("samples", (0, 65, -1)),
        ("sample_ns", (0, 10**9 + 1)),
        ("sample", (math.nan, math.inf, 2e4)),
    ],
)
def test_a_field_that_names_nothing_is_refused_by_its_name(name, values):
    for value in values:
        assert why_not(record(**{name: value}), 2, 10**9).startswith(name)


def test_a_refusal_names_what_is_expected():
    assert why_not(record(axis=3), 3, 10**9) == "axis is 3: expected from 0 to 2"
    assert why_not(record(axis=1), 2, 10**9, arm=True) == "axis is 1: expected from 0 to 0"
    refused = why_not(record(life_ns=0), 1, 10**9)
    assert refused == "life_ns is 0: expected from 1 to 1000000000 (world.longest_life_s)"


def test_side_and_profile_are_not_checked_where_the_model_has_none():
    assert why_not(record(parts=2, wall_side=0, samples=99), 1, 10**9) is None


@pytest.mark.parametrize(
    "call",
    [
        lambda: Wall(math.nan, 1.0),
        lambda: Wall(0.0, -1.0),
        lambda: Wall(0.0, 1.0, -1.0),
        lambda: Wall(0.0, "1"),
        lambda: Wall(0.0, 1.0, side="left"),
        lambda: Spring(0.0, 1.0, most_Nm=-1.0),
        lambda: LinearField(math.inf),
        lambda: TorqueProfile(()),
        lambda: TorqueProfile((0.0,) * 65),
        lambda: TorqueProfile((math.nan,)),
        lambda: TorqueProfile((1.0,), sample_s=0.0),
        lambda: Model(law=1.5),
        lambda: Model(life_s=math.nan),
        lambda: Model(parameters={"F_s_Nm": math.inf}),
        lambda: Model(parameters={"F_s": 1.0}).record({"F_s_Nm": 1}),
        lambda: model_of(7),
        lambda: model_of((Wall(0.0, 1.0), Wall(1.0, 1.0))),
    ],
)
def test_a_wrong_part_is_refused_where_it_is_made(call):
    with pytest.raises(WrongCall):
        call()


def test_what_a_function_returns_is_a_model_or_its_parts():
    wall, spring = Wall(0.0, 1.0), Spring(0.0, 1.0)
    assert model_of(None) is None
    assert model_of(WHOLE) is WHOLE
    assert model_of(wall) == Model(wall=wall)
    assert model_of([spring, wall]) == Model(wall=wall, spring=spring)


@pytest.mark.parametrize("outside", [False, True])
def test_a_trip_by_the_motors_energy_names_the_world_where_there_is_one(outside):
    rig = load_rig("bench")
    controller = Controllers(rig.with_world() if outside else rig, "hybrid").each[0]
    controller.host["trip"] = Trip.NET_WORK
    assert ("whether the world outside gives more energy than it takes" in controller.trip) is outside
