"""Drives with the quirks of the field: drafted, checked and brought up, or refused with the reason that
is the quirk's.
"""

from __future__ import annotations

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.cli.init import _acknowledgements
from coulombus.eds.reader import parse_eds
from coulombus.host.cycle.controller import Controller
from coulombus.host.setup.bringup import bring_up
from coulombus.host.setup.device_plan import device_plans
from coulombus.rigs.draft.device import DraftDevice
from coulombus.rigs.draft.draft import Draft
from coulombus.rigs.errors import RigError
from coulombus.rigs.rig import load_rig, load_rig_text
from coulombus.sim_bus.network.virtual_rig import BOOT_NS, VirtualRig
from foreign_eds import BRAKE
from quirks import PLAIN, QUIRKS

FILE_AND_LINE = re.compile(r"drive\.eds(:\d+)?: ")


def drafted(text, axis, folder):
    """Return the rig that `init --rehearse` makes of a drive's file."""
    (folder / "drive.eds").write_text(text, encoding="utf-8")
    (folder / "mr_brake.eds").write_text(BRAKE, encoding="utf-8")
    motor = DraftDevice("motor", parse_eds(text.encode(), "drive.eds"), "drive.eds", 1, axis=axis)
    brake = DraftDevice("brake", parse_eds(BRAKE.encode(), "mr_brake.eds"), "mr_brake.eds", 2)
    draft = Draft((motor, brake), load_rig("bench").one_axis(), str(folder / "try.toml"), rehearse=True)
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


@pytest.mark.parametrize("name", QUIRKS)
def test_a_quirk_arms_or_is_refused_with_its_reason(name, tmp_path):
    quirk = QUIRKS[name]
    text = quirk.edit(PLAIN)
    if quirk.refused:
        with pytest.raises(RigError) as caught:
            drafted(text, quirk.axis, tmp_path)
        assert quirk.refused in str(caught.value)
        assert FILE_AND_LINE.search(str(caught.value)) or "drive.eds has no object" in str(caught.value)
        return
    rig = drafted(text, quirk.axis, tmp_path)
    assert problems(rig) == []
    assert rig.one_axis().motor.encoder_counts_rev == quirk.counts_rev
    world = brought_up(rig)
    believed = abs(rig.one_axis().allocation.bound["position"].scale)
    assert abs(float(world.plant[0]["counts_rad"])) == pytest.approx(1 / believed)


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
