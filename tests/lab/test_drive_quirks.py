"""Drives with the quirks of the field: drafted, checked and brought up, or refused with the reason that
is the quirk's.
"""

from __future__ import annotations

import math
import re

import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.cli.init import _acknowledgements
from coulombus.cli.main import main
from coulombus.eds.reader import parse_eds
from coulombus.host.cycle.controller import Controller
from coulombus.host.setup.bringup import bring_up
from coulombus.host.setup.device_plan import device_plans
from coulombus.rigs.draft.device import DraftDevice
from coulombus.rigs.draft.draft import Draft
from coulombus.rigs.errors import RigError
from coulombus.rigs.rig import load_rig, load_rig_text
from coulombus.sim_bus.network.virtual_rig import BOOT_NS, VirtualRig
from eds_edit import edit, fixed, mapped
from foreign_eds import BRAKE, without
from quirks import PLAIN, QUIRKS

FILE_AND_LINE = re.compile(r"drive\.eds:\d+: ")


def drafted(text, axis, folder, like=None):
    """Return the rig that `init --rehearse` makes of a drive's file."""
    (folder / "drive.eds").write_text(text, encoding="utf-8")
    (folder / "mr_brake.eds").write_text(BRAKE, encoding="utf-8")
    motor = DraftDevice("motor", parse_eds(text.encode(), "drive.eds"), "drive.eds", 1, axis=axis)
    brake = DraftDevice("brake", parse_eds(BRAKE.encode(), "mr_brake.eds"), "mr_brake.eds", 2)
    draft = Draft((motor, brake), (like or load_rig("bench")).one_axis(), str(folder / "try.toml"), rehearse=True)
    draft.acknowledge(_acknowledgements(draft.rig))
    return load_rig_text(str(draft), str(folder / "try.toml"))


def problems(rig):
    """Return what `check` refuses."""
    return [
        str(problem)
        for mode in rig.modes
        for plan in device_plans(Controller(rig.one_axis(), mode))
        for problem in plan.problems
    ]


def brought_up(rig):
    world = VirtualRig(rig, "hybrid")
    world.power_on()
    world.wait_ns(BOOT_NS)
    bring_up(world.controllers, world)
    return world


@pytest.mark.thorough
@pytest.mark.parametrize("name", QUIRKS)
def test_a_quirk_arms_or_is_refused_with_its_reason(name, tmp_path):
    quirk = QUIRKS[name]
    text = quirk.edit(PLAIN)
    if quirk.refused:
        with pytest.raises(RigError) as caught:
            drafted(text, quirk.axis, tmp_path)
        assert quirk.refused in str(caught.value)
        absent = re.search(r"is not described|has no object", str(caught.value))
        assert bool(FILE_AND_LINE.search(str(caught.value))) != bool(absent)
        return
    rig = drafted(text, quirk.axis, tmp_path)
    assert problems(rig) == []
    assert rig.one_axis().motor.encoder_counts_rev == quirk.counts_rev
    world = brought_up(rig)
    believed = abs(rig.one_axis().allocation.bound["position"].scale)
    assert abs(float(world.plant[0]["counts_rad"])) == pytest.approx(1 / believed)


@pytest.mark.parametrize("counts", [4096, 20_000])
@pytest.mark.parametrize("name", ["608Fh:01 without a default", "608Fh is missing"])
def test_a_scale_that_the_file_does_not_tell_is_one_value_in_draft_plant_and_device(name, counts, tmp_path):
    like = load_rig("bench").variant(f"motor.encoder_counts_rev={counts}", f"plant.encoder_counts_rev={counts}")
    rig = drafted(QUIRKS[name].edit(PLAIN), 1, tmp_path, like)
    axis = rig.one_axis()
    assert (axis.motor.encoder_counts_rev, axis.plant.encoder_counts_rev) == (counts, counts)
    world = brought_up(rig)
    assert float(world.plant[0]["counts_rad"]) == pytest.approx(counts * axis.mechanics.ratio / (2 * math.pi))
    if axis.description("motor").has(0x608F):
        assert (world.motor[0x608F, 1], world.motor[0x608F, 2]) == (counts, 1)


def test_check_names_no_limit_of_a_drive_that_has_none(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rig = drafted(without(PLAIN, "6072", "6073", "60E0", "60E1"), 1, tmp_path)
    (tmp_path / "try.toml").write_text(rig.origin.text, encoding="utf-8")
    result = CliRunner().invoke(main, ("check", "--rig", "try.toml"))
    assert "mode hybrid: drive torque limit (of the host alone)" in result.stdout
    assert "torque limit 60" not in result.stdout
    assert "no torque limit of its own: 6072h, 60E0h and 60E1h, 6073h cannot be written" in result.stdout


@pytest.mark.parametrize("index", ["6071", "6072"])
def test_a_draft_keeps_to_a_limit_of_100_per_mille(index, tmp_path):
    axis = drafted(QUIRKS[f"{index}h up to 100 per mille"].edit(PLAIN), 1, tmp_path).one_axis()
    most_Nm = 0.1 * axis.motor.rated_torque_Nm * axis.mechanics.ratio
    assert 0.99 * most_Nm < axis.mode["active"].motor_limit_Nm <= most_Nm


@pytest.mark.parametrize(
    ("edits", "line_of"),
    [
        ({"1800sub2": {"AccessType": "const", "DefaultValue": 255}, "1800sub5": {"AccessType": "const", "DefaultValue": 0}}, "1800sub2"),
        ({"6064": {"DataType": "0x0015", "LowLimit": "", "HighLimit": ""}}, "6064"),
    ],
)  # fmt: skip
def test_a_refusal_of_an_object_names_its_file_and_line(edits, line_of, tmp_path):
    text = fixed(PLAIN, 0x1A00, 0x1A01, 0x1A02, 0x1A03) if "1800sub2" in edits else PLAIN
    text = mapped(text, 0x1A00, 0x60410010, 0x60640020) if "1800sub2" in edits else text
    for section, keys in edits.items():
        text = edit(text, section, **keys)
    with pytest.raises(RigError) as caught:
        drafted(text, 1, tmp_path)
    line = text[: text.index(f"[{line_of}]")].count("\n") + 1
    found = [int(number) for number in re.findall(r"drive\.eds:(\d+): ", str(caught.value))]
    assert any(line <= number < line + 10 for number in found), str(caught.value)


ARMING = sorted(name for name, quirk in QUIRKS.items() if not quirk.refused and quirk.axis == 1)
REFUSED = sorted(name for name, quirk in QUIRKS.items() if quirk.refused and quirk.axis == 1)


@settings(max_examples=12, deadline=None, derandomize=True, database=None)
@given(names=st.lists(st.sampled_from(ARMING), min_size=2, max_size=4, unique=True), dual=st.sampled_from(REFUSED))
def test_a_drive_with_several_quirks_is_refused_for_the_one_that_hurts(names, dual, tmp_path_factory):
    text = PLAIN
    try:
        for name in (*names, dual):
            text = QUIRKS[name].edit(text)
    except AssertionError:  # one takes the section away that the other changes
        return
    with pytest.raises(RigError) as caught:
        drafted(text, 1, tmp_path_factory.mktemp("drive"))
    assert QUIRKS[dual].refused in str(caught.value)
