"""Rules of a rig in the plane: its phases, its bus, its law, and a joint alone."""

from __future__ import annotations

import pytest

from coulombus.host.cycle.controllers import Controllers
from coulombus.rigs.rig import RigError, load_rig
from plane_buses import ONE_CYCLE

HOLD = '{kind = "hold", duration_s = 1.0, push_F_s = 0.5, frequency_Hz = 1.0}'


def test_the_hand_of_an_arm_moves_the_tip():
    with pytest.raises(
        RigError, match=r"phase\.0\.kind: got '\"hold\"', expected rest, tip_hold, tip_line, tip_circle, tip_eight"
    ):
        load_rig("plane", (f"phase=[{HOLD}]",))


def test_an_axis_has_no_tip():
    with pytest.raises(RigError, match=r"phase\.0\.kind: got '\"tip_eight\"', expected a phase of one axis"):
        load_rig(
            "bench",
            ('phase=[{kind = "tip_eight", duration_s = 1.0, width_m = 0.1, height_m = 0.1, frequency_Hz = 1.0}]',),
        )


def test_one_host_serves_the_buses_of_an_arm():
    rig = load_rig("plane", ONE_CYCLE)
    assert (rig.channels, rig.one_cycle, rig.bus.period_s) == (("a", "b"), True, 0.001)
    assert [node.channel for node in rig.nodes] == ["a", "a", "b", "b"]
    assert Controllers(rig, "hybrid").bus_of[[0x080, 0x000, 0x201, 0x603, 0x184]].tolist() == [-1, -1, 0, 1, 1]
    assert not load_rig("two_axes", ("axis.left.bus.channel=a", "axis.right.bus.channel=b")).one_cycle
    alone = rig.on("b")
    assert (alone.in_plane, [axis.name for axis in alone.axes], alone.bus.channel) == (None, ["elbow"], "b")


def test_the_buses_of_an_arm_have_different_node_ids_and_one_bit_rate():
    where = "another id than the motor's of axis shoulder, whose bus the same host serves in the same cycle"
    with pytest.raises(RigError, match=rf"axis\.elbow\.motor\.node_id: got '1', expected {where}"):
        load_rig("plane", (*ONE_CYCLE, "axis.elbow.motor.node_id=1"))
    with pytest.raises(RigError, match="expected the same, because one host serves both buses in one cycle"):
        load_rig("plane", (*ONE_CYCLE, "axis.elbow.bus.bitrate_bit_s=500_000"))


def test_the_law_fits_the_rig():
    with pytest.raises(RigError, match=r"law\.function: got '\"lugre\"', expected a law in the plane"):
        Controllers(load_rig("plane", ('law.function="lugre"',)), "hybrid")
    with pytest.raises(RigError, match=r"law\.function: got '\"plane_dahl\"', expected a law of one axis"):
        Controllers(load_rig("bench", ('law.function="plane_dahl"',)), "hybrid")


def test_a_joint_alone_is_an_axis_with_a_law_of_its_own():
    rig = load_rig("plane")
    alone = rig.alone("elbow")
    assert all(axis.joint for axis in rig.axes)
    assert not alone.axes[0].joint
    assert alone.kinematics is None
    assert alone.law_function == "karnopp"
    assert [phase.kind for phase in alone.axes[0].phases] == ["rest"] * len(rig.axes[0].phases)
    assert alone.axes[0].phase_starts_s == rig.axes[0].phase_starts_s
    assert Controllers(alone, "hybrid").arm is None
