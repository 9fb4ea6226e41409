"""Rigs of several axes: the file, the host's cycle, one bus and several."""

import json
import pickle

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.host.cycle.axes import finish, on_frame
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.output_limits import motor_limit_Nm
from coulombus.host.cycle.records import Phase, SignResult, Trip
from coulombus.host.errors import SafetyTrip
from coulombus.host.run.buses import merged
from coulombus.host.run.deadman import deadman_of
from coulombus.host.setup.law_demand import check_demand
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.rigs.buses import bus_addresses, one_bus
from coulombus.rigs.rig import RigError, load_rig, load_rig_text
from coulombus.wire.address import AddressError, BusAddress, parse_address
from coulombus.wire.frame import new_queue

TWO_BUSES = ('axis.left.bus.channel="a"', 'axis.right.bus.channel="b"')


# the file


def test_an_axis_has_what_is_its_own_and_shares_the_rest():
    rig = load_rig("two_axes")
    left, right = rig.axes
    assert (left.name, right.name) == ("left", "right")
    assert (right.motor.node_id, right.brake.node_id) == (3, 4)
    assert right.simulation.plant.inertia_kg_m2 == 4e-3
    assert left.plant.inertia_kg_m2 == 2.5e-3
    assert right.mode["hybrid"].F_s_Nm == 2.5
    assert right.mode["hybrid"].K_p_Nm_rad == left.mode["hybrid"].K_p_Nm_rad
    assert rig.channels == ("",)
    assert rig.on("") is rig


def test_a_rig_of_one_axis_has_one_without_a_name():
    rig = load_rig("bench")
    assert rig.axes == (rig.one_axis(),)
    assert rig.one_axis().name == rig.one_axis().prefix == ""
    assert rig.axis_names == ()
    assert rig.alone() is rig


def test_nodes_and_signals_carry_their_axis():
    rig = load_rig("two_axes")
    assert [node.name for node in rig.nodes] == ["left.motor", "left.brake", "right.motor", "right.brake"]
    assert [node.node_id for node in rig.nodes] == [1, 2, 3, 4]
    names = {signal.name for pdo in rig.pdos() for signal in pdo.signals}
    assert {"left.motor.position_rad", "right.brake.handle_torque_Nm"} <= names
    assert {pdo.layout.cob_id for pdo in rig.pdos() if pdo.node == "right.motor"} == {0x203, 0x183}
    alone = rig.alone("right")
    assert {pdo.node for pdo in alone.pdos()} == {"motor", "brake"}
    assert alone.one_axis().motor.node_id == 3


def test_the_effective_text_gives_the_same_rig():
    rig = load_rig("two_axes", ("axis.right.mode.hybrid.F_s_Nm=1.75", "mode.hybrid.K_p_Nm_rad=5000"))
    again = load_rig_text(rig.effective(), rig.path, rig.eds_texts)
    assert again == rig
    assert again.axes[1].mode["hybrid"].F_s_Nm == 1.75
    assert [axis.mode["hybrid"].K_p_Nm_rad for axis in again.axes] == [5000.0, 5000.0]
    assert pickle.loads(pickle.dumps(rig)) == rig
    assert pickle.loads(pickle.dumps(rig.axes[1])) == rig.axes[1]
    assert rig.axes[0] != rig.axes[1]


def test_an_axis_may_have_a_schedule_of_its_own():
    text = load_rig("two_axes").effective() + '\n[[axis.right.phase]]\nkind = "rest"\nduration_s = 2.5\n'
    rig = load_rig_text(text, "own.toml")
    assert [phase.kind for phase in rig.axes[1].phases] == ["rest"]
    assert len(rig.axes[0].phases) == 3
    assert load_rig_text(rig.effective(), "own.toml") == rig


@pytest.mark.parametrize(
    ("override", "text"),
    [
        ("axis.right.motor.node_id=1", "axis.right.motor.node_id: got '1', expected another id"),
        (
            "axis.right.brake.node_id=1",
            "axis.right.brake.node_id: got '1', expected another id than the motor's",
        ),
        ("axis.right.motor.nod_id=1", "axis.right.motor.nod_id: unknown key"),
        ("axis.right.bus.period_s=0.001", "axis.right.bus.period_s"),
        ("axis.right.law.function=coulomb", "one compiled law drives all axes"),
        ("axis.right.host.node_id=100", "one host drives all axes"),
        ("axis.right.bus.period_s=0.004", "one cycle drives all axes"),
        ("axis.left.bus.period_s=0.004", "one cycle drives all axes"),
        ("axis.right.bus.tpdo_window_s=0.0007", "one cycle drives all axes"),
        ("axis.top.motor.node_id=9", "there is no such axis; the rig's axes are left, right"),
        ("plant.inertia_kg_m2=-1", "plant.inertia_kg_m2: got '-1'"),
        ("axis.right.plant.coulomb_Nm=-1", "axis.right.plant.coulomb_Nm: got '-1'"),
        ("axis.right.bus.bitrate_bit_s=500000", "both hang on one bus"),
    ],
)
def test_what_axes_must_not_be(override, text):
    with pytest.raises(RigError) as error:
        load_rig("two_axes", (override,))
    assert text in str(error.value)
    assert len(set(error.value.errors)) == len(error.value.errors)


def test_a_mistake_is_told_with_the_line_of_the_axis():
    rig = load_rig("two_axes")
    line = next(n for n, text in enumerate(rig.text.splitlines(), 1) if text == "motor.node_id = 3")
    assert str(rig.axes[1].mistake("motor.node_id", "another")) == (
        f"{rig.path}:{line}: axis.right.motor.node_id: got '3', expected another"
    )


def test_a_mistake_of_an_override_is_told_with_the_override_that_counts():
    overrides = ("axis.left.motor.heartbeat_s=0.03", "motor.heartbeat_s=0.04")
    left, right = load_rig("two_axes", overrides).axes
    place = "--set axis.left.motor.heartbeat_s=0.03: axis.left.motor.heartbeat_s: got '0.03'"
    assert str(left.mistake("motor.heartbeat_s", "another")).startswith(place)
    assert str(right.mistake("motor.heartbeat_s", "another")).startswith(
        "--set motor.heartbeat_s=0.04: motor.heartbeat_s"
    )


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("axis.left.limits.brake_torque_Nm=1", "axis.left.limits.brake_torque_Nm ends there"),
        ("axis.left.limits={brake_torque_Nm=1}", "axis.left.limits.brake_torque_Nm ends there"),
        ("axis.right.limits.brake_torque_Nm=1", "axis.right.limits.brake_torque_Nm ends there"),
        ("limits.brake_torque_Nm=1", ": limits.brake_torque_Nm ends there"),
    ],
)
def test_a_refusal_names_the_key_that_the_user_wrote(override, key):
    """It named the shared key, which has another value."""
    with pytest.raises(RigError) as refused:
        check_demand(load_rig("two_axes", (override,)), "hybrid")
    assert all(key in text for text in refused.value.errors)


def test_what_axes_must_share_is_told_of_the_axis_that_has_its_own():
    with pytest.raises(
        RigError, match=r'^--set axis\.left\.law\.function="coulomb": axis\.left\.law\.function: differs from .* right'
    ):
        load_rig("two_axes", ('axis.left.law.function="coulomb"',))
    with pytest.raises(RigError, match=r"at most 32\.767 x axis\.left\.motor\.rated_torque_Nm x mechanics\.ratio"):
        load_rig("two_axes", ("axis.left.motor.rated_torque_Nm=1e-6",))


def test_a_trip_names_the_key_of_its_axis():
    rig = load_rig("two_axes", ("axis.left.limits.speed_rad_s=14",))
    left, right = Controllers(rig, "passive").each
    for one in (left, right):
        one.host["trip"] = Trip.SPEED
    assert "faster than axis.left.limits.speed_rad_s" in left.trip
    assert "faster than limits.speed_rad_s" in right.trip


@pytest.mark.parametrize("name", ["Left", "motor", "2nd", "a.b"])
def test_names_that_no_axis_may_have(name):
    text = load_rig("bench").effective() + f'\n[axis."{name}"]\nmotor.node_id = 5\n'
    with pytest.raises(RigError, match="names an axis"):
        load_rig_text(text, "own.toml")


def test_one_axis_is_taken_out_of_several():
    rig = load_rig("two_axes")
    assert rig.one_axis("right").motor.node_id == 3
    assert load_rig("bench").one_axis() == load_rig("bench").one_axis()
    assert rig.one_axis("right") != rig.one_axis("left")
    assert load_rig("bench").alone() == load_rig("bench")
    with pytest.raises(RigError, match="left, right; this is about one axis"):
        rig.one_axis()
    with pytest.raises(RigError, match="--axis top: the rig two_axes has the axes left, right"):
        rig.one_axis("top")
    with pytest.raises(RigError, match="one axis, without a name"):
        load_rig("bench").one_axis("left")


@pytest.mark.parametrize("command", [("demo", "--virtual"), ("analyse", "hold")])
def test_what_is_about_one_axis_refuses_several(command, tmp_path):
    done = CliRunner().invoke(main, [*command, "--rig", "two_axes"])
    assert done.exit_code == 3
    assert "one axis at a time" in done.output


# the cycle


def test_the_first_axis_leads_and_every_frame_finds_its_axis():
    k = Controllers(load_rig("two_axes"), "hybrid")
    assert list(k.control["sync_cob_id"]) == [0x80, -1]
    assert (k.control["heartbeat_ns"] > 0).tolist() == [True, False]
    assert k.owner[0x183] == k.owner[0x703] == k.owner[0x084] == 1
    assert k.owner[0x181] == k.owner[0x702] == k.owner[0x333] == 0
    k.start(0)
    assert on_frame(k.axes, k.owner, 5, 0x703, 1, 4) == 2  # a state that is news
    assert list(k.host["nmt"][:, 0]) == [5, 4]
    assert on_frame(k.axes, k.owner, 5, 0x333, 1, 4) == 0
    assert list(k.host["stray_frames"]) == [1, 0]


def test_a_trip_of_one_axis_stops_all():
    k = Controllers(load_rig("two_axes"), "hybrid")
    out = new_queue()
    k.start(0)
    k.host["phase"] = Phase.STILL
    k.each[1].stop(Trip.RECORDING)
    for _ in range(2):
        k.host["waiting"] = 1
        finish(k.axes, k.law_function, 10, 1, out)
    assert k.safe
    assert k.each[0].trip.startswith("OTHER_AXIS")
    assert k.trip.startswith("axis right: RECORDING")


def test_two_axes_on_one_bus_in_virtual_time(tmp_path):
    record = tmp_path / "run.pcapng"
    result = simulate("two_axes", "hybrid", 3.0, record=record)
    assert result.exit_status == 0
    assert {name: axis["sign_check"] for name, axis in result.axes.items()} == {"left": "agreed", "right": "agreed"}
    assert {axis["lost_pdos"] for axis in result.axes.values()} == {0}
    recording = read(record)
    syncs = int((recording.frames["can_id"] == 0x80).sum())
    setpoints = [len(recording[f"{axis}.brake.setpoint_Nm"]) for axis in ("left", "right")]
    assert setpoints[0] == syncs  # one SYNC for both, and set-points for each; the run ends within a cycle
    assert syncs - setpoints[1] in (0, 1)
    one, other = recording.axes
    np.testing.assert_array_equal(
        recording.one_axis("right")["motor.position_rad"].values, recording["right.motor.position_rad"].values
    )
    with pytest.raises(RigError, match="one axis at a time"):
        recording.one_axis(None)
    assert other["motor.position_rad"].values is not one["motor.position_rad"].values
    np.testing.assert_array_equal(other["brake.setpoint_Nm"].values, recording["right.brake.setpoint_Nm"].values)
    # F_s is 3.5 and 2.5 Nm: each brake has held its own
    assert [float(axis["brake.setpoint_Nm"].values.max()) for axis in (one, other)] == pytest.approx(
        [3.5, 2.5], abs=0.01
    )


def test_a_fault_of_one_axis_makes_both_safe():
    worlds = []

    def stumble(world):
        worlds.append(world)
        world.at(2_000_000_000, lambda world: world.power_off(2))  # the right motor

    result = simulate("two_axes", "hybrid", 3.0, script=stumble)
    assert result.exit_status == 7
    assert result.trip.startswith("axis right: ")
    assert result.axes["left"]["trip"].startswith("OTHER_AXIS")
    assert list(worlds[0].nodes["out_torque_pm"][:4]) == [0.0] * 4
    assert list(worlds[0].nodes["out_brake_Nm"][:4]) == [0.0] * 4


# no axis stands for the others


@pytest.mark.parametrize("harmless", ["left", "right", "both", "none"])
def test_one_motor_with_torque_needs_the_dead_mans_switch(harmless):
    limits = [f"axis.{axis}.mode.hybrid.motor_limit_Nm=0" for axis in ("left", "right") if harmless in (axis, "both")]
    rig = load_rig("two_axes", limits)
    can = parse_address("socketcan:can0")
    if harmless == "both":
        assert deadman_of(rig, "hybrid", can) == "none"
        return
    with pytest.raises(SafetyTrip, match=r"host\.deadman") as refused:
        deadman_of(rig, "hybrid", can)
    assert ("left.motor" in str(refused.value)) is (harmless != "left")
    assert ("right.motor" in str(refused.value)) is (harmless != "right")


@pytest.mark.parametrize("name", ["bench", "two_axes"])
@pytest.mark.parametrize(
    "what", ["motor", "brake", "mechanics", "law", "mode", "limits", "plant", "operator", "phases", "phase_starts_s",
             "description", "mistake"],
)  # fmt: skip
def test_what_each_axis_answers_is_not_asked_of_the_whole(name, what):
    rig = load_rig(name)
    assert not hasattr(rig, what)
    assert all(hasattr(axis, what) for axis in rig.axes)


def test_a_rig_on_several_buses_has_no_bus_of_its_own():
    rig = load_rig("two_axes", TWO_BUSES)
    assert [bus.channel for bus in rig.buses] == ["a", "b"]
    assert rig.on("b").bus.channel == "b"
    with pytest.raises(TypeError, match=r"the buses a, b; take it on one with Rig\.on"):
        _ = rig.bus


def test_each_axis_has_its_own_motor_limit():
    rig = load_rig("two_axes")
    assert [round(motor_limit_Nm(axis, "hybrid"), 3) for axis in rig.axes] == [0.168, 0.168]


@pytest.mark.parametrize("slow", ["left", "right"])
def test_the_slowest_axis_is_waited_for(slow):
    words = ("limits.still_timeout_s=30", "limits.safe_hold_s=20", "limits.safe_ramp_s=15")
    k = Controllers(load_rig("two_axes", [f"axis.{slow}.{word}" for word in words]), "hybrid")
    assert k.arming_s == pytest.approx(31.0)
    assert k.ending_s == pytest.approx(35.0 + 0.06 + 0.05)  # the brake rises, the motor's torque falls


@pytest.mark.parametrize("outcomes", [("AGREED", "NO_HAND"), ("NO_HAND", "AGREED"), ("NOT_RUN", "NO_HAND")])
def test_the_sign_check_that_leaves_the_most_doubt_is_told(outcomes):
    k = Controllers(load_rig("two_axes"), "hybrid")
    k.host["sign_result"] = [SignResult[name] for name in outcomes]
    assert k.sign_result is SignResult.NO_HAND


@pytest.mark.parametrize("axis", ["left", "right"])
def test_the_longest_schedule_is_that_of_the_rig(axis):
    assert load_rig("two_axes", [f"axis.{axis}.phase=[{{kind='rest', duration_s=40}}]"]).schedule_s == 40.0
    assert load_rig("two_axes", [f"axis.{axis}.phase=[{{kind='rest', duration_s=4}}]"]).schedule_s == 13.0


@pytest.mark.parametrize(("slow", "fast"), [("left", "right"), ("right", "left")])
def test_a_run_waits_for_the_slowest_axis_and_marks_each_by_itself(tmp_path, slow, fast):
    """The first axis' time-out once ended a run whose second axis still armed, as if all
    were well.
    """
    overrides = (f"axis.{fast}.limits.still_timeout_s=0.4", f"axis.{slow}.limits.still_s=4")
    record = tmp_path / "run.pcapng"
    result = simulate("two_axes", "passive", 1.5, record=record, overrides=overrides)
    assert (result.trip, result.cycles > 0) == (None, True)
    recording = read(record)
    when = {text: t for t, text in recording.markers}
    assert when[f"{slow}.phase rest"] - when[f"{fast}.phase rest"] == pytest.approx(3.8, abs=0.01)
    for axis in (slow, fast):
        assert when[f"{axis}.phase hold"] - when[f"{axis}.phase rest"] == pytest.approx(1.0, abs=4e-3)
        assert when[f"{axis}.phase end"] == pytest.approx(when[f"{slow}.phase rest"] + 1.5, abs=4e-3)
    seen = dict(zip(("left", "right"), recording.axes, strict=True))[fast]
    assert {text: t for t, text in seen.markers}["phase hold"] == when[f"{fast}.phase hold"]
    assert not [text for _, text in seen.markers if slow in text]


# several buses


def test_addresses_of_several_buses():
    rig = load_rig("two_axes", TWO_BUSES)
    assert rig.channels == ("a", "b")
    found = bus_addresses(rig, ("b=socketcan:can1",))
    assert {channel: str(address) for channel, address in found.items()} == {
        "a": "coulombus:two_axes.a",
        "b": "socketcan:can1",
    }
    for given in (("socketcan:can0",), ("c=socketcan:can0",), ("a=socketcan:can0", "b=socketcan:can0")):
        with pytest.raises(AddressError, match="bus"):
            bus_addresses(rig, given)


def test_addresses_tell_how_their_buses_are_started(tmp_path):
    path = tmp_path / "my rig.toml"
    path.write_text(load_rig("two_axes", TWO_BUSES).effective())
    found = bus_addresses(load_rig(str(path)), ("b=coulombus:desk",))
    start = f"coulombus emulate --rig '{path}' --bus b=coulombus:desk"
    assert {channel: address.start for channel, address in found.items()} == {"a": start, "b": start}
    assert found["b"] == BusAddress("coulombus", "desk")


def test_one_bus_is_looked_at_at_a_time():
    rig = load_rig("two_axes", TWO_BUSES)
    there, address = one_bus(rig, None, "b")
    assert (there.axes[0].name, str(address)) == ("right", "coulombus:two_axes.b")
    assert str(one_bus(rig, "socketcan:can1", "b")[1]) == "socketcan:can1"
    with pytest.raises(AddressError, match="name one with --channel"):
        one_bus(rig, None, None)
    with pytest.raises(AddressError, match="the buses a, b"):
        one_bus(rig, None, "c")
    with pytest.raises(AddressError, match="one bus, without a name"):
        one_bus(load_rig("bench"), None, "a")
    assert str(one_bus(load_rig("bench"), None, None)[1]) == "coulombus:bench"


def test_the_rig_of_one_bus_has_the_axes_of_that_bus():
    rig = load_rig("two_axes", TWO_BUSES)
    there = rig.on("b")
    assert [axis.name for axis in there.axes] == ["right"]
    assert there.axes[0].motor.node_id == 3
    assert load_rig_text(there.effective(), there.path, there.eds_texts) == there
    with pytest.raises(KeyError, match="no bus"):
        rig.on("c")
    with pytest.raises(ValueError, match=r"Rig\.on"):
        Controllers(rig, "hybrid")


def test_node_ids_may_be_the_same_on_two_buses():
    rig = load_rig("two_axes", (*TWO_BUSES, "axis.right.motor.node_id=1", "axis.right.brake.node_id=2"))
    assert [axis.motor.node_id for axis in rig.axes] == [1, 1]


def test_two_buses_in_virtual_time(tmp_path):
    record = tmp_path / "run.pcapng"
    result = simulate("two_axes", "hybrid", 1.0, record=record, overrides=TWO_BUSES)
    assert result.exit_status == 0
    assert set(result.axes) == {"left", "right"}
    assert {axis["sign_check"] for axis in result.axes.values()} == {"agreed"}
    assert result.buses["b"]["recording"] == str(tmp_path / "run.b.pcapng")
    assert read(tmp_path / "run.b.pcapng")["right.motor.position_rad"].values.size > 400
    json.dumps(result.as_dict())


def test_a_trip_on_one_bus_stops_the_other():
    def stumble(world):
        if world.rig.axes[0].name == "right":
            world.at(1_500_000_000, lambda world: world.power_off(0))

    result = simulate("two_axes", "passive", 2.0, overrides=TWO_BUSES, script=stumble)
    assert result.exit_status == 7
    assert result.axes["left"]["trip"].startswith("OTHER_AXIS")
    assert "axis right" in result.trip
    assert abs(result.buses["a"]["trip_ns"] - result.buses["b"]["trip_ns"]) <= 4_000_000  # two cycles


def test_the_status_that_counts_is_of_the_bus_that_failed():
    good, bad = {"trip": None, "lost_pdos": 1, "axes": {}}, {"trip": "SPEED", "lost_pdos": 2, "axes": {}}
    whole = merged({"a": good, "b": bad}, {"a": 143, "b": 7})
    assert (whole["exit_status"], whole["trip"], whole["lost_pdos"]) == (7, "SPEED", 3)
    assert merged({"a": good, "b": good}, {"a": 0, "b": 0})["exit_status"] == 0
    good |= {"counters": {"clipped_torque": 1}, "sign_check": "agreed", "remarks": [], "full_gain_s": 0.8}
    bad |= {"counters": {"clipped_torque": 2}, "sign_check": "no_hand", "remarks": ["axis b: cut"], "full_gain_s": 0.5}
    for order in ({"a": good, "b": bad}, {"b": bad, "a": good}):
        whole = merged(order, {"a": 143, "b": 7})
        assert (whole["counters"], whole["sign_check"]) == ({"clipped_torque": 3}, "no_hand")
        assert (whole["remarks"], whole["full_gain_s"]) == (["axis b: cut"], 0.8)
    assert merged({"a": None}, {"a": 4})["exit_status"] == 4
    refused = {"event": "error", "error": "no bus", "exit_status": 4}
    whole = merged({"a": good, "b": refused}, {"a": 143, "b": 4})
    assert (whole["exit_status"], whole["error"], whole["lost_pdos"]) == (4, "no bus", 1)
