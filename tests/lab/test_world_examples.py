"""The worlds of examples/worlds, in virtual time."""

import runpy

import numpy as np
import pytest

from coulombus.host.world.records import MODEL, STATE
from places import ROOT

FOLDER = ROOT / "examples/worlds"


def outcome(name):
    return runpy.run_path(str(FOLDER / f"{name}.py"))["in_virtual_time"]()


def test_the_wheel_meets_its_detents_one_after_the_other():
    met, trip = outcome("detent_wheel")
    assert trip is None
    assert max(met) >= 2
    assert set(np.abs(np.diff(met))) == {1}


def test_the_wall_is_met_and_the_brake_resists():
    depth_rad, brake_Nm, trip = outcome("wall_with_friction")
    assert trip is None
    assert depth_rad > 0.0
    assert 1.0 < brake_Nm <= 4.5


def test_the_latch_opens():
    events, trip = outcome("latch")
    assert trip is None
    assert events[0][1] == "open"


def test_a_local_model_is_still_where_a_stream_of_torques_shakes():
    example = runpy.run_path(str(FOLDER / "stability_map.py"))
    maps = example["in_virtual_time"](rates_Hz=(30, 1000), delays_ms=(0, 20))
    assert (maps["local model"] < example["STILL_RAD_S"]).all()
    assert (maps["torque stream"] < example["STILL_RAD_S"]).tolist() == [[False, False], [True, False]]


@pytest.mark.parametrize("dtype", [MODEL, STATE])
def test_the_page_has_each_byte_of_the_record(dtype):
    kinds = {"i8": "i64", "f8": "f64", "f4": "f32"}
    lines = (ROOT / "docs/worlds.md").read_text().splitlines()
    for name in dtype.names:
        field, offset = dtype.fields[name][:2]
        kind = kinds[field.base.str[1:]] + (f" x {field.shape[0]}" if field.shape else "")
        assert any(line.startswith(f"| {offset} | {kind} | `{name}` |") for line in lines), name
