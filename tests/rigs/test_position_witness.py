"""The counts that were measured between marks: a second witness of the position's scale."""

from __future__ import annotations

import pytest

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.setup.bringup import plans_of
from coulombus.rigs.errors import RigError
from coulombus.rigs.rig import load_rig, load_rig_text
from foreign_eds import BRAKE, MOTOR, another, without
from places import RIGS

BENCH = (RIGS / "bench.toml").read_text(encoding="utf-8")
COUNTS, RATIO = 8192, 9.587
TURN = COUNTS * RATIO


@pytest.mark.parametrize("factor", [10, 0.1, 1.06, 0.94])
@pytest.mark.parametrize("key", ["motor.encoder_counts_rev", "mechanics.ratio"])
def test_a_scale_that_contradicts_the_marks_is_refused_with_both_numbers(key, factor):
    value = round(COUNTS * factor) if key.startswith("motor") else RATIO * factor
    with pytest.raises(RigError) as caught:
        load_rig("bench", (f"mechanics.counts_turn={TURN}", f"{key}={value}"))
    believed = value * RATIO if key.startswith("motor") else value * COUNTS
    text = str(caught.value)
    assert f"got '{TURN}'" in text
    assert f"expected {believed:.6g}, which motor.encoder_counts_rev x mechanics.ratio makes" in text
    assert caught.value.exit_status == 3


@pytest.mark.parametrize("factor", [1, 1.04, 0.96])
def test_a_scale_as_the_marks_have_it_loads(factor):
    rig = load_rig("bench", (f"mechanics.counts_turn={TURN * factor}",))
    assert rig.one_axis().mechanics.counts_turn == pytest.approx(TURN * factor)


@pytest.mark.parametrize(("scale", "holds"), [(8.0e-5, True), (8.0e-4, False), (8.0e-6, False)])
def test_the_scale_of_the_role_is_held_against_the_marks(scale, holds):
    overrides = ("mechanics.counts_turn=78540", f"role.position.scale_rad={scale}", "motor.encoder_counts_rev=1")
    if holds:
        assert load_rig("bench", overrides).one_axis().role.position.scale_rad == scale
        return
    with pytest.raises(
        RigError, match=f"got '78540', expected {6.283185307179586 / scale:.6g}, which role.position.scale_rad"
    ):
        load_rig("bench", overrides)


@pytest.mark.parametrize(
    ("overrides", "said"), [((), "nothing guards"), ((f"mechanics.counts_turn={TURN}",), "guards")]
)
def test_the_check_says_whether_anything_guards_a_scale_that_the_drive_does_not_tell(overrides, said):
    files = {"motor.eds": without(another(MOTOR), "20", "608F", "6091", "6092", "60A8"), "mr_brake.eds": BRAKE}
    rig = load_rig_text(BENCH, "r.toml", files, ("motor.vendor_id=0x99", *overrides))
    losses = [loss for loss in plans_of(Controllers(rig, "hybrid"))[0].losses if "tells no scale" in loss]
    assert len(losses) == 1
    assert f"{said} motor.encoder_counts_rev" in losses[0]
    assert ("commission --step encoder" in losses[0]) == (not overrides)
