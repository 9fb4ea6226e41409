"""Commissioning recovers the truth of a simulated rig that its rig file does not know."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from coulombus.eds.cia402 import PowerState
from coulombus.host.commission.session import STEPS, Progress, RunEnded, Session
from coulombus.host.commission.step import CommissionError, Given
from coulombus.host.cycle.output_limits import motor_limit_Nm
from coulombus.host.cycle.records import Trip
from coulombus.host.errors import SafetyTrip
from coulombus.lab.commissioning import rehearsed
from coulombus.lab.simulate import simulate
from coulombus.recording.friction.regression import Estimate
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig, packaged_rig
from coulombus.sim_bus.network.event_loop import BRAKE, MOTOR

BY_NAME = {step.name: step for step in STEPS}
AT = "2026-11-22T14:03:05Z"


@pytest.fixture
def afternoon(tmp_path):
    """Return a function that does steps on a rig whose truth is `truth`, and whose file has
    `believed`.
    """
    path = tmp_path / "my.toml"
    path.write_text(packaged_rig("bench").read_text())

    def do(*names, truth=(), believed=(), given=None, run=None, agree=lambda step, risk: True):
        true = load_rig("bench", truth)
        session = Session(path, run or rehearsed(true), given or Given(), believed, now=lambda: AT)
        return session, [session.do(BY_NAME[name], agree) for name in names]

    return do


def found(done, key):
    return next(one for one in done.outcome.findings if one.key == key or one.name == key)


# friction


TRUTH = ("plant.coulomb_Nm=0.12", "plant.viscous_Nms_rad=0.02", "plant.inertia_kg_m2=4e-3")


def test_a_belief_that_is_too_small_refuses_and_names_the_step_that_mends_it():
    trip = simulate("bench", "hybrid", 1.0, simulated=load_rig("bench", TRUTH)).trip
    assert trip is not None
    assert "SIGN_NO_MOTION" in trip
    assert "identify first: coulombus commission --step friction" in trip


def test_the_friction_step_finds_the_friction_though_the_belief_is_wrong(afternoon, tmp_path):
    session, (done,) = afternoon("friction", truth=TRUTH)
    assert found(done, "mechanics.friction_Nm").new == pytest.approx(0.20, rel=0.01)
    assert found(done, "mechanics.viscous_Nms_rad").new == pytest.approx(0.02, rel=0.05)
    assert found(done, "mechanics.inertia_kg_m2").new == pytest.approx(4e-3, rel=0.05)
    rig = load_rig(str(session.path))
    assert simulate(rig, "hybrid", 2.0, simulated=load_rig("bench", TRUTH)).trip is None
    text = session.path.read_text()
    assert f"# commission {AT}: was 0.14" in text
    assert "; 95 % on a rig as modelled: +- " in text
    assert "# identified Coulomb friction with the coil off, compensated by the motor" in text
    (copy,) = session.state.folder.glob("my.*.friction.toml")
    assert copy.read_text() == packaged_rig("bench").read_text()
    assert "friction" in Progress.load(session.state.folder).steps


@pytest.mark.thorough
def test_a_friction_that_is_too_large_in_the_belief_is_found_as_well(afternoon):
    _, (done,) = afternoon("friction", truth=("plant.coulomb_Nm=0.01", "plant.brake_off_state_Nm=0.05"))
    assert found(done, "mechanics.friction_Nm").new == pytest.approx(0.06, rel=0.02)


@pytest.mark.parametrize(
    ("amplitude_Nm", "periods"),
    [pytest.param(0.01, 12, marks=pytest.mark.thorough), (0.02, 7), pytest.param(0.03, 24, marks=pytest.mark.thorough)],
)
def test_cogging_is_told_from_friction(afternoon, amplitude_Nm, periods):
    """What depends on the angle has no part in the friction, and friction none in it."""
    cogging = (f"plant.cogging_Nm={amplitude_Nm}", f"plant.cogging_periods={periods}")
    _, (done,) = afternoon("friction", truth=(*TRUTH, *cogging))
    assert found(done, "mechanics.friction_Nm").new == pytest.approx(0.20, rel=0.01)
    assert found(done, "mechanics.inertia_kg_m2").new == pytest.approx(4e-3, rel=0.03)
    assert found(done, "mechanics.cogging_Nm").new == pytest.approx(amplitude_Nm, rel=0.05)
    assert found(done, "mechanics.cogging_periods").new == periods
    assert "Cogging by the motor's angle" in [curve.title for curve in done.outcome.curves]


@pytest.mark.thorough
def test_a_motor_without_cogging_has_none(afternoon):
    _, (done,) = afternoon("friction", truth=TRUTH)
    assert not [one for one in done.outcome.findings if "cogging" in one.key]


@pytest.mark.thorough
def test_where_the_friction_is_uneven_the_smallest_sector_is_written(afternoon, monkeypatch):
    torques = [0.20] * 4 + [0.17] + [0.22] * 3
    edges, sectors = np.linspace(-0.6, 0.6, 9), [Estimate(Nm, Nm - 0.002, Nm + 0.002) for Nm in torques]
    monkeypatch.setattr("coulombus.host.commission.friction._by_sector", lambda *_: (edges, sectors))
    _, (done,) = afternoon("friction", truth=TRUTH)
    assert found(done, "mechanics.friction_Nm").new == 0.17
    assert found(done, "mechanics.friction_Nm").uncertainty == pytest.approx(0.002)
    assert "uneven, 0.1700 to 0.2200 Nm by angle" in done.outcome.remarks[0]


# what ends a step


def test_a_trip_leaves_the_rig_file_and_tells_the_recording(afternoon, tmp_path):
    before = packaged_rig("bench").read_text()
    with pytest.raises(SafetyTrip, match=r"step friction: SIGN_ENCODER.*nothing of it was written; the recording is"):
        afternoon("friction", truth=("plant.encoder_polarity=-1",))
    assert (tmp_path / "my.toml").read_text() == before
    assert Progress.load(tmp_path / "my.commission").steps == {}


def test_a_stop_from_outside_ends_the_session_with_its_status(afternoon, tmp_path):
    class Stopped:
        stopped_by, exit_status, trip = "SIGINT", 130, None

    with pytest.raises(RunEnded, match="ended by SIGINT; nothing of this step was written") as ended:
        afternoon("friction", run=lambda one, path: Stopped)
    assert ended.value.exit_status == 130
    assert (tmp_path / "my.toml").read_text() == packaged_rig("bench").read_text()


@pytest.mark.parametrize("after_s", [0.6, 4.0], ids=["arming", "moving"])
@pytest.mark.parametrize("step", STEPS, ids=lambda step: step.name)
def test_ctrl_c_leaves_nothing_energised_and_the_file_whole(afternoon, tmp_path, step, after_s):
    """Ctrl-C asks the data plane for the safe state, as the script does here."""
    worlds = []

    def run(one, path):
        def script(world):
            worlds.append(world)
            world.at(round(after_s * 1e9), lambda world: world.ask_to_stop(Trip.NONE))

        simulated = one.rig.variant(*one.hand)
        ended = simulate(one.rig, one.mode, one.seconds, record=path, script=script, simulated=simulated)
        return replace(ended, stopped_by="SIGINT", exit_status=130)

    with pytest.raises(RunEnded, match="ended by SIGINT; nothing of this step was written") as ended:
        afternoon(step.name, given=Given(weight_Nm=1.0, marks_rad=1.5), run=run)
    assert ended.value.exit_status == 130
    (world,) = worlds
    assert not world.nodes["out_torque_pm"].any()
    assert not world.nodes["out_brake_Nm"].any()
    assert world.nodes["power_state"][MOTOR] == PowerState.SWITCH_ON_DISABLED
    assert (tmp_path / "my.toml").read_text() == packaged_rig("bench").read_text()
    assert Progress.load(tmp_path / "my.commission").steps == {}
    (recording,) = (tmp_path / "my.commission").iterdir()
    assert recording.name.startswith(step.name)


@pytest.mark.parametrize("step", ["friction", "brake"])
def test_a_disk_that_fills_up_in_a_step_ends_it_safely(afternoon, tmp_path, monkeypatch, step):
    write = PcapngWriter._write

    def full(writer, data):
        if writer.bytes > 500_000:
            raise writer._fail(OSError(28, "No space left on device"))
        write(writer, data)

    monkeypatch.setattr(PcapngWriter, "_write", full)
    with pytest.raises(SafetyTrip, match=rf"step {step}: RECORDING.*No space left on device") as tripped:
        afternoon(step)
    assert tripped.value.exit_status == 7
    assert (tmp_path / "my.toml").read_text() == packaged_rig("bench").read_text()
    assert Progress.load(tmp_path / "my.commission").steps == {}
    end = read(tmp_path / "my.commission" / f"{step}.pcapng")  # what was written stays readable
    assert end["motor.position_rad"].values.size > 1000


def test_a_disk_that_is_full_at_the_state_leaves_a_rig_file_that_loads(afternoon, monkeypatch, tmp_path):
    def full(path, content):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr("coulombus.host.commission.session.write_whole", full)
    with pytest.raises(OSError, match="No space left on device"):
        afternoon("friction", truth=TRUTH)
    assert load_rig(str(tmp_path / "my.toml")).one_axis().mechanics.friction_Nm == pytest.approx(0.2, rel=0.01)
    assert len(list((tmp_path / "my.commission").glob("my.*.toml"))) == 1


def test_a_device_that_is_lost_trips_and_leaves_the_rig_file(afternoon, tmp_path):
    def run(one, path):
        def script(world):
            world.at(3_000_000_000, lambda world: world.power_off(BRAKE))

        return simulate(
            one.rig, one.mode, one.seconds, record=path, script=script, simulated=one.rig.variant(*one.hand)
        )

    with pytest.raises(SafetyTrip, match=r"step friction: TPDO_LOST"):
        afternoon("friction", run=run)
    assert (tmp_path / "my.toml").read_text() == packaged_rig("bench").read_text()
    end = read(tmp_path / "my.commission" / "friction.pcapng")
    assert end["motor.target_torque_Nm"].values[-1] == 0.0


def test_an_operator_who_does_not_agree_is_not_pushed(afternoon):
    def never(one, path):
        raise AssertionError

    _, (done,) = afternoon("friction", run=never, agree=lambda step, risk: False)
    assert done.what == "skipped"


def test_a_foreign_state_file_is_refused_with_its_name(afternoon, tmp_path):
    (tmp_path / "my.commission").mkdir()
    (tmp_path / "my.commission" / "state.json").write_text(json.dumps({"version": 7}))
    with pytest.raises(CommissionError, match=r"state\.json: this is no state"):
        afternoon()


@pytest.mark.parametrize("step", STEPS, ids=lambda step: step.name)
def test_each_step_says_what_moves_and_keeps_below_the_limits(step):
    rig = load_rig("bench")
    axis = rig.one_axis()
    given = Given(weight_Nm=1.0, marks_rad=1.5)
    risk = step.risk(axis, given)
    assert step.lacks(axis, given) is None
    assert any("Ctrl-C" in line for line in risk.lines())
    for one in step.exercises(rig, given):
        limits = one.rig.one_axis().limits  # its exercises measure scales and signs
        assert limits.model_copy(update={"handle_mismatch_share": axis.limits.handle_mismatch_share}) == axis.limits
        assert motor_limit_Nm(one.rig.one_axis(), one.mode) <= max(risk.motor_Nm, 0.0) + 1e-9
        assert one.seconds <= risk.seconds
    assert risk.motor_Nm <= axis.limits.sign_check_torque_Nm
    assert risk.brake_Nm <= axis.limits.brake_torque_Nm
    assert risk.travel_rad <= axis.limits.travel_limit_rad
    assert risk.speed_rad_s <= 0.5 * axis.limits.speed_rad_s


# transducer


@pytest.mark.parametrize("zero_Nm", [0.12, -0.4])
def test_the_zero_is_found_even_where_it_refuses_the_arming(afternoon, zero_Nm):
    truth = ("role.handle_torque.scale_Nm=0.001", f"role.handle_torque.offset_Nm={zero_Nm}")
    session, (done,) = afternoon("zero", truth=truth)
    assert found(done, "role.handle_torque.offset_Nm").new == pytest.approx(zero_Nm, abs=0.002)
    assert found(done, "transducer's noise, RMS").new == pytest.approx(0.001, rel=0.2)
    _, (again,) = afternoon("zero", truth=truth)
    assert again.written == ()
    assert session.rig().one_axis().role.handle_torque.offset_Nm == pytest.approx(zero_Nm, abs=0.002)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_weight_tells_sign_and_scale_and_the_zero_stays(afternoon, sign):
    truth = (
        "role.handle_torque.scale_Nm=0.0012",
        "role.handle_torque.offset_Nm=0.06",
        f"plant.transducer_polarity={sign}",
    )
    session, _ = afternoon("zero", "weight", truth=truth, given=Given(weight_Nm=1.7))
    axis = session.rig().one_axis()
    assert axis.mechanics.transducer_polarity == sign
    assert axis.role.handle_torque.scale_Nm == pytest.approx(0.0012, rel=0.005)
    assert axis.role.handle_torque.offset_Nm == pytest.approx(0.06, abs=0.005)


def test_a_weight_that_did_not_hang_changes_nothing(afternoon, tmp_path):
    virtual = rehearsed(load_rig("bench"))

    def forgetful(one, path):
        return virtual(replace(one, hand=(*one.hand, "phase.1.torque_Nm=[0.0, 0.0, 0.0, 0.0]")), path)

    with pytest.raises(CommissionError, match="did the weight hang"):
        afternoon("weight", given=Given(weight_Nm=1.0), run=forgetful)
    assert (tmp_path / "my.toml").read_text() == packaged_rig("bench").read_text()


# encoder and motor


@pytest.mark.parametrize("sign", [1, -1])
def test_turning_by_hand_between_marks_tells_sign_and_ratio(afternoon, sign):
    truth = ("plant.ratio=9.2", "mechanics.ratio=9.2", f"plant.encoder_polarity={sign}")
    session, _ = afternoon("encoder", truth=truth, given=Given(marks_rad=1.5))
    mechanics = session.rig().one_axis().mechanics
    assert mechanics.encoder_polarity == sign
    assert mechanics.ratio == pytest.approx(9.2, rel=0.002)
    assert mechanics.counts_turn == pytest.approx(8192 * 9.2, rel=0.002)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_motor_step_finds_a_motor_that_turns_the_wrong_way_and_its_torque(afternoon, sign):
    truth = (f"plant.motor_polarity={sign}", "plant.motor_rated_torque_Nm=0.150")
    session, (done,) = afternoon("motor", truth=truth)
    axis = session.rig().one_axis()
    assert axis.mechanics.motor_polarity == sign
    assert axis.motor.rated_torque_Nm == pytest.approx(0.150, rel=0.01)
    assert done.what == "done"


# brake

TABLE = ((0, 0.0), (1000, 0.8), (2000, 1.9), (3000, 3.0), (5000, 5.2))


def test_the_brakes_table_is_found_within_3_percent(afternoon):
    truth = (f"role.brake_setpoint.table={[list(point) for point in TABLE]}",)
    session, (done,) = afternoon("brake", truth=truth)
    table = session.rig().one_axis().role.brake_setpoint.table
    assert table[0] == (0, 0.0)
    assert len(table) == 6
    for raw, torque in table[1:]:
        true = np.interp(raw, *zip(*TABLE, strict=True))
        assert torque == pytest.approx(true, rel=0.03), raw
    assert found(done, "brake's hysteresis, up against down").new < 0.05
    assert found(done, "brake's table").uncertainty < 0.03
    assert not any("both branches" in text for text in done.outcome.remarks)
    assert found(done, "inherent friction in the stroke, coil off").new == pytest.approx(0.145, abs=0.02)


def test_the_interval_of_a_brakes_table_holds_both_branches_of_its_iron(afternoon):
    """It was that of the mean: +-2 mNm where up and down differ by 100."""
    truth = (f"role.brake_setpoint.table={[list(point) for point in TABLE]}", "plant.brake_remanence=0.05")
    session, (done,) = afternoon("brake", truth=truth)
    table, apart = found(done, "brake's table"), found(done, "brake's hysteresis, up against down")
    assert apart.new > 5 * apart.uncertainty
    assert apart.new < table.uncertainty < apart.new + 0.05  # it remembers most with the coil off again
    assert any("the table's interval holds both branches" in text for text in done.outcome.remarks)
    for raw, torque in session.rig().one_axis().role.brake_setpoint.table[1:]:
        assert abs(torque - np.interp(raw, *zip(*TABLE, strict=True))) < table.uncertainty


def test_the_brakes_answer_to_a_step_is_found(afternoon):
    truth = ("plant.brake_coil_lag_s=4e-3", "plant.brake_fluid_lag_s=25e-3")
    _, (done,) = afternoon("response", truth=truth)
    assert found(done, "brake: slower lag (fluid)").new == pytest.approx(25, rel=0.03)
    assert found(done, "brake: faster lag (coil)").new == pytest.approx(4, rel=0.1)
    assert found(done, "brake: 63 % after").new == pytest.approx(31, abs=1.5)
    assert found(done, "brake: 95 % after").new == pytest.approx(81, rel=0.05)
    assert not any("told apart" in remark for remark in done.outcome.remarks)


@pytest.mark.thorough
def test_lags_that_are_equal_are_said_not_to_be_told_apart(afternoon):
    truth = ("plant.brake_coil_lag_s=6e-3", "plant.brake_fluid_lag_s=6e-3")
    _, (done,) = afternoon("response", truth=truth)
    assert any("told apart" in remark for remark in done.outcome.remarks)
    coil, fluid = (found(done, f"brake: {name}") for name in ("faster lag (coil)", "slower lag (fluid)"))
    assert coil.new - coil.uncertainty <= 6.0 <= fluid.new + fluid.uncertainty


# delays, limits, display


@pytest.mark.parametrize(("actuation", "delay_us"), [("next_sync", 1000.0), ("on_reception", 600.0)])
def test_the_delay_from_sync_to_torque_is_found_within_50_us(afternoon, actuation, delay_us):
    truth = ("plant.motor_lag_s=2e-3", "plant.brake_coil_lag_s=5e-3", f"bus.actuation={actuation}")
    session, (done,) = afternoon("delay", truth=truth, believed=(f"bus.actuation={actuation}",))
    if actuation == "on_reception":  # when the RPDO has come, as the recording has it
        delay_us = 1e6 * rpdo_after_sync_s(session.state.folder / "delay-motor.pcapng")
    assert found(done, "SYNC to motor's torque").new == pytest.approx(delay_us, abs=50)
    assert found(done, "time constant of the motor's torque").new == pytest.approx(2.0, rel=0.05)
    assert found(done, "time constant of the coil's current").new == pytest.approx(5.0, rel=0.05)


@pytest.mark.parametrize("friction_Nm", [0.03, 0.08])
def test_the_delay_is_found_with_little_friction(afternoon, friction_Nm):
    """The sign check pushes with more than the steps that are answered: it is no step."""
    truth = (f"plant.coulomb_Nm={friction_Nm - 0.01}", "plant.brake_off_state_Nm=0.01", "plant.motor_lag_s=2e-3")
    _, (done,) = afternoon("delay", truth=truth, believed=(f"mechanics.friction_Nm={friction_Nm}",))
    for name, value in (("SYNC to motor's torque", 1000.0), ("time constant of the motor's torque", 2.0)):
        figure = found(done, name)
        assert abs(figure.new - value) <= figure.uncertainty


def rpdo_after_sync_s(path):
    recording = read(path)
    sync = recording.t_s[recording.frames["can_id"] == 0x80]
    sent = recording["motor.target_torque_Nm"].t_s
    return float(np.median(sent - sync[np.searchsorted(sync, sent) - 1]))


def test_limits_that_contradict_the_rig_are_mended_and_others_stay(afternoon):
    session, (done,) = afternoon("limits")
    assert done.written == ()
    truth = ("plant.transducer_noise_Nm=0.02",)
    session.path.write_text(
        session.path.read_text()
        .replace("encoder_jump_counts = 500 ", "encoder_jump_counts = 120 ")
        .replace("still_handle_torque_Nm = 0.25", "still_handle_torque_Nm = 0.08")
    )
    _, (done,) = afternoon("limits", truth=truth)
    assert set(done.written) == {"limits.encoder_jump_counts", "limits.still_handle_torque_Nm"}
    limits = session.rig().one_axis().limits
    assert limits.encoder_jump_counts > limits.speed_rad_s * 1e-3 / 8e-5
    assert limits.still_handle_torque_Nm == pytest.approx(0.24, rel=0.2)


def test_the_last_step_displays_the_law_and_holds_still(afternoon):
    _, (done,) = afternoon("display")
    assert found(done, "hold: encoder peak to peak").new <= 2
    assert found(done, "hold: largest push").new == pytest.approx(1.75, rel=0.1)
    assert done.outcome.remarks == ()
