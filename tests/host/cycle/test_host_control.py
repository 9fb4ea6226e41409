"""What the rig file's limits become in the compiled cycle: each key reaches its field, in the
field's unit.
"""

from __future__ import annotations

import math
import re

import pytest

from coulombus.host.cycle.controller import MOTOR_LAG_S, SIGN_HAND_NM, UNLOADED_S, Controller, _cycles
from coulombus.host.cycle.records import Image, Phase, Trip
from coulombus.rigs.rig import RigError, load_rig_text
from foreign_rigs import brake, drive
from foreign_rigs import rig_of as foreign_rig
from host_bench import rig_of
from places import EDS

RAD_COUNT = 2 * math.pi / (8192 * 9.587)
NM_PM = 0.180 * 9.587 / 1000


def control(mode="hybrid", *overrides):
    return Controller(rig_of("bench", overrides).one_axis(), mode).control[0]


FIELDS = [
    ("bus.period_s=0.002", "period_ns", 2_000_000),
    ("bus.tpdo_window_s=700e-6", "window_ns", 700_000),
    ("bus.tpdo_window_s=0.0007000019", "window_ns", 700_002),
    ("motor.heartbeat_timeout_s=1.003", "heartbeat_timeout_ns[0]", 1_003_000_000),
    ("brake.heartbeat_timeout_s=1.005", "heartbeat_timeout_ns[1]", 1_005_000_000),
    ("host.node_id=101", "host_id", 101),
    ("motor.node_id=9", "node_id[0]", 9),
    ("brake.node_id=11", "node_id[1]", 11),
    ("host.heartbeat_s=0.037", "heartbeat_ns", 37_000_000),
    ("motor.heartbeat_timeout_s=0.21", "heartbeat_timeout_ns[0]", 210_000_000),
    ("brake.heartbeat_timeout_s=0.23", "heartbeat_timeout_ns[1]", 230_000_000),
    ("mechanics.friction_Nm=0.145", "friction_Nm", 0.145),
    ("mechanics.friction_Nm=0.145", "compensation_Nm", 0.97 * 0.145),
    ("mode.hybrid.compensation=0.5", "compensation_Nm", 0.07),
    ("mechanics.viscous_Nms_rad=0.007", "viscous", 0.007),
    ("law.velocity_band_counts=3", "velocity_band_counts", 3.0),
    ("law.velocity_window_cycles=16", "slide_band_counts", 2 / 16),
    ("law.velocity_window_cycles=16", "window_cycles", 16),
    ('law.level="felt"', "level_is_felt", 1),
    ('law.level="brake"', "level_is_felt", 0),
    ("bus.delay_cycles=3", "delay_cycles", 3),
    ("mechanics.inertia_kg_m2=0.004", "inertia", 0.004),
    ("brake.coil_lag_s=0.004", "coil_step", 1 - math.exp(-0.25)),
    ("brake.coil_lag_s=0.0", "coil_step", 0.0),
    ("brake.fluid_lag_s=0.02", "fluid_step", 1 - math.exp(-0.05)),
    ("brake.fluid_lag_s=0.0", "fluid_step", 0.0),
    ("brake.coil_lag_s=0.0", "iron_direct", 1.0),
    ("law.gain_ramp_s=0.25", "gain_step", 0.004),
    ("law.gain_ramp_s=0.0", "gain_step", 1.0),
    ("limits.torque_rate_Nm_s=400.0", "motor_rate_Nm", 0.4),
    ("limits.brake_torque_Nm=4.25", "brake_limit_Nm", 4.25),
    ("limits.speed_rad_s=12.0", "speed_limit", 12.0),
    ("limits.encoder_jump_counts=400", "jump_counts", 400),
    ("limits.net_work_J=0.125", "net_work_J", 0.125),
    ("limits.net_work_window_s=0.15", "net_work_cycles", 150),
    ('limits.travel_rad="unlimited"', "travel_rad", math.inf),
    ("limits.travel_rad=1.5", "travel_rad", 1.5),
    ("limits.handle_mismatch_Nm=1.25", "mismatch_Nm", 1.25),
    ("limits.handle_mismatch_s=0.25", "mismatch_cycles", 250),
    ("limits.missed_tpdo_cycles=4", "missed_cycles", 4),
    ("brake.coil_continuous_A=0.5", "coil_limit_A2", 0.25),
    ("brake.coil_time_constant_s=8.0", "coil_decay", math.exp(-0.001 / 8.0)),
    ("bus.period_s=0.002", "brake_lag_decay", math.exp(-0.1)),
    ("limits.still_s=0.25", "still_cycles", 250),
    ("limits.still_handle_torque_Nm=0.125", "still_handle_Nm", 0.125),
    ("limits.still_timeout_s=4.0", "still_timeout_cycles", 4000),
    ("bus.period_s=0.002", "enable_timeout_cycles", 500),
    ("limits.sign_check_rate_Nm_s=0.5", "sign_step_Nm", 0.0005),
    ("limits.sign_check_counts=24", "sign_counts", 24),
    ("limits.sign_check_torque_Nm=0.375", "sign_torque_Nm", 0.375),
    ("limits.sign_check_travel_rad=0.15", "sign_travel_counts", math.ceil(0.15 / RAD_COUNT)),
    ("mechanics.encoder_polarity=-1", "sign_travel_counts", math.ceil(0.2 / RAD_COUNT)),
    ("bus.period_s=0.002", "sign_hand_cycles", 60),
    ("bus.period_s=0.002", "settle_cycles", 25),
    ("limits.safe_hold_s=0.15", "safe_longest_cycles", 1950),
    ("limits.safe_ramp_s=0.9", "safe_longest_cycles", 1000),
    ("limits.safe_ramp_s=0.9", "release_Nm", 0.005),
    ("limits.brake_torque_Nm=3.6", "unloaded_Nm", 0.036),
    ("limits.safe_speed_rad_s=0.25", "release_counts", 0.25e-3 / RAD_COUNT),
    ("limits.brake_torque_Nm=3.6", "brake_fall_Nm", 0.36),
    ("limits.brake_fall_Nm_s=200.0", "brake_fall_Nm", 0.2),
    ("limits.brake_rise_Nm_s=500.0", "brake_rise_Nm", 0.5),
    ("bus.period_s=0.002", "reversal_decay", math.exp(-0.008)),
    ('bus.actuation="next_sync"', "most_reversals", 1.15 * 2 * 0.25 / 0.008),
    ('bus.actuation="on_reception"', "most_reversals", 1.15 * 2 * 0.25 / 0.004),
    ("bus.period_s=0.002", "most_reversals", 1.15 * 2 * 0.25 / 0.016),
    ("limits.handle_mismatch_share=0.3", "mismatch_share", 0.3),
    ("bus.period_s=0.002", "smooth_step", 1 - math.exp(-0.04)),
    ("bus.period_s=0.002", "mean_step", 1 - math.exp(-0.008)),
    ('law.function="wall"', "stores", 1),
    ('law.function="coulomb"', "stores", 0),
    ('law.function="wall"', "hands_over", 1),
    ("limits.motor_mismatch_Nm=0.5", "motor_mismatch_Nm", 0.5),
    ("motor.rated_torque_Nm=0.180", "motor_mismatch_Nm", 0.2 * 0.18 * 9.587),
    ("bus.period_s=0.002", "motor_mismatch_cycles", 25),
    ("bus.period_s=0.002", "clipped_cycles", 250),
    ("mechanics.encoder_polarity=-1", "rad_count", -RAD_COUNT),
    ("mechanics.motor_polarity=-1", "motor_Nm_raw", -NM_PM),
    ("mechanics.transducer_polarity=-1", "handle_Nm_raw", -0.001),
    ("brake.coil_continuous_A=0.8", "coil_A_raw", 0.001),
    ("brake.coil_continuous_A=0.8", "brake_Nm_raw", 0.001),
    ("bus.period_s=0.001", "sync_cob_id", 0x80),
    ("bus.period_s=0.001", "rpdos", 2),
    ("bus.period_s=0.001", "tpdos", 2),
    ("bus.period_s=0.001", "position_mask", 1),
    ("bus.period_s=0.001", "sign_hand_Nm", 0.008),
    ("bus.period_s=0.001", "brake_limit_raw", 5000),
    ("bus.period_s=0.001", "deadman_slot", -1),
]


@pytest.mark.parametrize(("override", "field", "value"), FIELDS, ids=lambda value: str(value))
def test_each_key_of_the_rig_file_reaches_its_field(override, field, value):
    name, _, place = field.partition("[")
    found = control("hybrid", override)[name]
    assert (found[int(place[0])] if place else found) == pytest.approx(value, rel=1e-12)


def test_times_are_rounded_to_nanoseconds():
    """Of 1.001 s and of 1001 us the product of reals is a little less than the whole number."""
    long = ("host.heartbeat_s=1.001", "motor.heartbeat_timeout_s=1.2", "brake.heartbeat_timeout_s=1.2")
    assert control("hybrid", *long)["heartbeat_ns"] == 1_001_000_000
    assert control("hybrid", "bus.period_s=0.001001", "plant.step_s=0.000077")["period_ns"] == 1_001_000


def test_the_sign_of_a_hand_is_told_by_8_mNm():
    assert SIGN_HAND_NM == 0.008


@pytest.mark.parametrize(("seconds", "cycles"), [(0.2, 200), (0.0014, 1), (0.0016, 2), (0.0002, 1), (0.0, 1)])
def test_a_time_is_so_many_cycles_and_at_least_one(seconds, cycles):
    assert _cycles(seconds, 0.001) == cycles


@pytest.mark.parametrize(
    ("mode", "motor", "brake", "limit_pm"), [("active", 1, 0, 869), ("passive", 0, 1, 0), ("hybrid", 0, 1, 97)]
)
@pytest.mark.parametrize("polarity", [1, -1])
def test_the_mode_says_who_displays_and_how_strong_the_motor_is(mode, motor, brake, limit_pm, polarity):
    c = control(mode, f"mechanics.motor_polarity={polarity}")
    assert (c["motor_active"], c["brake_active"], c["motor_limit_raw"]) == (motor, brake, limit_pm)
    assert c["is_hybrid"] == (mode == "hybrid")
    assert c["sign_check"] == (limit_pm > 0)


@pytest.mark.parametrize("mode", ["active", "passive", "hybrid"])
@pytest.mark.parametrize("measured", [True, False])
def test_the_hand_s_port_is_observed_where_a_motor_may_push_and_the_hand_is_measured(mode, measured):
    without = () if measured else ("role.handle_torque.object=none",)
    found = control(mode, "limits.passivity_J=0.0625", *without)["passivity_J"]
    assert found == (0.0625 if measured and mode != "passive" else math.inf)


def test_the_motor_s_torque_follows_its_command_with_a_lag():
    assert control("hybrid", "bus.period_s=0.002")["motor_lag_decay"] == math.exp(-0.002 / MOTOR_LAG_S)


@pytest.mark.parametrize("encoder", [1, -1])
def test_the_speed_at_which_the_release_pauses_has_no_sense(encoder):
    found = control("hybrid", f"mechanics.encoder_polarity={encoder}", "limits.safe_speed_rad_s=0.25")
    assert found["release_counts"] == pytest.approx(0.25e-3 / RAD_COUNT)


@pytest.mark.parametrize(("ramp_s", "unloaded_s"), [(1.8, UNLOADED_S), (0.05, 0.05)])
def test_a_brake_without_a_load_is_released_in_its_own_time_or_sooner(ramp_s, unloaded_s):
    c = control("hybrid", f"limits.safe_ramp_s={ramp_s}", "limits.safe_hold_s=0.0996")
    assert c["safe_longest_cycles"] == round(ramp_s * 1000) + 100
    assert c["release_Nm"] == pytest.approx(4.5e-3 / ramp_s)
    assert c["unloaded_Nm"] == pytest.approx(4.5e-3 / unloaded_s)
    assert 0.05 < UNLOADED_S < 1.8


def test_what_a_law_keeps_is_counted():
    axis = rig_of("bench", ("law.function=dahl",)).one_axis()
    controller = Controller(axis, "hybrid")
    assert controller.control[0]["law_keeps"] == sum(size for _, size in controller.law_state) > 0


@pytest.mark.parametrize(
    ("key", "coarse", "fine"),
    [("speed_rad_s", RAD_COUNT / 0.001 * 0.999, RAD_COUNT / 0.001 * 1.001), ("sign_check_travel_rad", 0.0015, 0.0017)],
)
def test_a_limit_that_the_encoder_is_too_coarse_for_is_refused(key, coarse, fine):
    """20 counts of the sign check are 0.0016 rad, one in a cycle is 0.08 rad/s."""
    with pytest.raises(RigError, match=r"limits\.(speed_rad_s|sign_check_counts)"):
        control("hybrid", f"limits.{key}={coarse}")
    assert control("hybrid", f"limits.{key}={fine}")["period_ns"] == 1_000_000


def test_the_iron_s_plays_and_what_follows_directly():
    c = control("hybrid", "brake.iron.play_Nm=[0.125, 0.5]", "brake.iron.weights=[0.25, 0.125]")
    assert c["iron_plays"] == 2
    assert c["iron_r"][:3].tolist() == [0.125, 0.5, 0.0]
    assert c["iron_w"][:3].tolist() == [0.25, 0.125, 0.0]
    assert c["iron_direct"] == 0.625


def test_a_motor_of_one_per_mille_is_checked_too():
    assert control("active", "mode.active.motor_limit_Nm=0.002")["motor_limit_raw"] == 1
    assert control("active", "mode.active.motor_limit_Nm=0.002")["sign_check"] == 1


@pytest.mark.parametrize("polarity", [1, -1])
def test_the_motors_limit_is_rounded_down_but_not_by_a_rounding_error(polarity):
    controller = Controller(rig_of("bench", ("mode.active.motor_limit_Nm=1.5",)).one_axis(), "active")
    assert controller.motor_limit_raw(polarity * 0.25) == 6
    assert controller.motor_limit_raw(polarity * 0.26) == 5
    assert controller.motor_limit_raw(polarity * 0.1) == 15  # 1.5 / 0.1 is 14.999999999999998 or 15
    assert controller.motor_limit_raw(polarity * 1.5 / 7) == 7


@pytest.mark.parametrize("polarity", [1, -1])
def test_a_limit_that_6072h_cannot_hold_is_refused_with_the_most(polarity):
    controller = Controller(rig_of("bench").one_axis(), "active")
    high = controller.axis.description("motor").variable(0x6072, 0).high
    assert controller.motor_limit_raw(polarity * 1.5 / high) == high
    with pytest.raises(RigError, match=f"at most {high * 1.4 / high:.4g}: the drive's 6072h ends at {high} per mille"):
        controller.motor_limit_raw(polarity * 1.4 / high)


def own_files(motor=None, brake=None, *overrides):
    """The bench with its EDS files edited by `motor` and `brake`."""
    bench, folder = rig_of("bench"), EDS
    texts = {}
    for name, edit in (("motor.eds", motor), ("mr_brake.eds", brake)):
        text = (folder / name).read_text()
        texts[name] = edit(text) if edit else text
    return load_rig_text(bench.text, bench.path, texts, overrides)


def high_limit(section, line):
    """Return an edit that puts `line` in the place of the section's high limit."""
    return lambda text: re.sub(rf"(\[{section}\]\n(?:\w+=.*\n)*?)HighLimit=\d+\n", rf"\g<1>{line}", text)


def with_inputs(text):
    count = int(re.search(r"\[OptionalObjects\]\nSupportedObjects=(\d+)", text)[1])
    listed = text.replace(
        f"[OptionalObjects]\nSupportedObjects={count}\n",
        f"[OptionalObjects]\nSupportedObjects={count + 1}\n{count + 1}=0x60FD\n",
    )
    return listed + "\n[60FD]\nParameterName=Inputs\nObjectType=0x7\nDataType=0x0007\nAccessType=ro\nPDOMapping=1\n"


def test_a_switch_in_a_tpdo_has_its_slot():
    rig = own_files(with_inputs, None, "host.deadman=object:60FD:0:0x00010000")
    c = Controller(rig.one_axis(), "hybrid").control[0]
    assert (c["deadman_slot"], c["deadman_mask"]) == (Image.DEADMAN, 0x10000)
    assert (c["rpdos"], c["tpdos"]) == (2, len([pdo for pdo in rig.pdos() if pdo.layout.direction == "tpdo"]))


def test_the_limit_of_6072h_is_its_own_and_may_be_absent():
    assert (
        Controller(own_files(high_limit("6072", "HighLimit=869\n")).one_axis(), "active").control[0]["motor_limit_raw"]
        == 869
    )
    with pytest.raises(RigError, match="6072h ends at 868 per mille"):
        Controller(own_files(high_limit("6072", "HighLimit=868\n")).one_axis(), "active")
    assert Controller(own_files(high_limit("6072", "")).one_axis(), "active").control[0]["motor_limit_raw"] == 869


TARGET = "LowLimit=-10000\nHighLimit=10000\n"


@pytest.mark.parametrize(
    ("lines", "most"),
    [
        ("HighLimit=869\n", 869),
        ("LowLimit=-869\nHighLimit=10000\n", 869),
        ("LowLimit=-868\nHighLimit=10000\n", None),
        ("LowLimit=-10000\nHighLimit=868\n", None),
        ("LowLimit=-1\nHighLimit=10000\n", None),
        ("LowLimit=0\nHighLimit=10000\n", 869),
        ("LowLimit=1\nHighLimit=10000\n", 869),
        ("", 869),
    ],
)
def test_the_motors_limit_fits_the_set_points_object_in_both_senses(lines, most):
    rig = own_files(lambda text: text.replace(TARGET, lines, 1))
    assert TARGET in (EDS / "motor.eds").read_text()
    if most is None:
        with pytest.raises(RigError, match=r"the drive's 6071h ends at \d+ per mille"):
            Controller(rig.one_axis(), "active")
    else:
        assert Controller(rig.one_axis(), "active").control[0]["motor_limit_raw"] == most


@pytest.mark.parametrize(("line", "most"), [("HighLimit=4100\n", 4100), ("HighLimit=40000\n", 32767), ("", 32767)])
def test_the_brakes_set_point_ends_at_its_objects_limit_and_at_16_bits(line, most):
    rig = own_files(None, high_limit("7300sub1", line))
    control = Controller(rig.one_axis(), "hybrid").control[0]
    assert control["brake_limit_raw"] == most
    assert control["brake_limit_Nm"] == pytest.approx(min(4.5, most * 1e-3))


def test_without_6072h_the_set_points_object_alone_bounds_the_limit():
    rig = own_files(lambda text: text.replace("[6072]", "[2F72]", 1)).one_axis()
    assert not rig.description("motor").has(0x6072, 0)
    assert Controller(rig, "active").control[0]["motor_limit_raw"] == 869


def test_a_set_point_without_a_sign_ends_at_its_own_limit():
    wide = lambda text: text.replace(  # noqa: E731
        "DataType=0x0003\nLowLimit=0\nHighLimit=5000\n", "DataType=0x0006\nLowLimit=0\nHighLimit=40000\n"
    )
    rig = own_files(None, wide)
    assert Controller(rig.one_axis(), "hybrid").control[0]["brake_limit_raw"] == 40000


def test_the_positions_bit_is_that_of_its_tpdo():
    controller = Controller(rig_of("bench").one_axis(), "hybrid")
    pdos = controller.axis.pdos()
    tpdos = [pdo for pdo in pdos if pdo.layout.direction == "tpdo"][::-1]
    at = [any(signal.key == "motor.position_rad" for signal in pdo.signals) for pdo in tpdos].index(True)
    assert at > 0
    assert (
        controller._new_control(tuple(tpdos) + tuple(p for p in pdos if p not in tpdos))[0]["position_mask"] == 1 << at
    )


def test_a_run_begins_still_with_both_nodes_just_heard():
    controller = Controller(rig_of("bench").one_axis(), "hybrid")
    assert controller.phase is Phase.OFF
    h = controller.host[0]
    h["nmt"] = 4
    controller.start(77)
    assert (h["next_ns"], h["heartbeat_due_ns"], *h["heard_ns"][:2]) == (77,) * 4
    assert (*h["nmt"][:2], h["phase"]) == (5, 5, Phase.STILL)


@pytest.mark.parametrize("trip", [Trip.NONE, Trip.SPEED, Trip.RECORDING])
def test_a_wish_to_stop_is_1_or_the_trip(trip):
    controller = Controller(rig_of("bench").one_axis(), "hybrid")
    controller.stop(trip)
    assert controller.host[0]["stop"] == (int(trip) or 1)
    assert int(Trip.SPEED) == 1


def test_only_our_own_brakes_driver_ramps_by_itself():
    rigs = [foreign_rig(drive("own"), brake(kind)) for kind in ("own", "404", "401", "402")]
    found = [int(Controller(rig.one_axis(), "hybrid").control["brake_ramps"][0]) for rig in rigs]
    assert found == [1, 0, 0, 0]
