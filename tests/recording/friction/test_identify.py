"""Friction from samples: the fit's intervals hold the truth, and what does not obey the regression
is left out, counted and told.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.eds.cia402 import PowerState
from coulombus.recording.friction.equations import equations, weights
from coulombus.recording.friction.friction_fit import fit_friction
from coulombus.recording.friction.identify import identified, identify, lines
from coulombus.recording.friction.sliding import WINDOW_S, IdentifyError, Slide, Sliding, sliding
from coulombus.recording.signals import Series, Source
from coulombus.rigs.rig import load_rig

pytestmark = pytest.mark.slow

PERIOD, COUNT = 1e-3, 8e-5
ENABLED_WORD, SWITCHED_ON_WORD = 0x1637, 0x1633


def stroke_speeds(rng, strokes=12):
    """Return the speed of each stroke, sample by sample: up, along with a tremor, and down."""
    speeds = []
    for k in range(strokes):
        top = (0.5, 1.5, 3.0)[k % 3] * rng.uniform(0.8, 1.2)
        t = np.arange(int(rng.uniform(400, 900))) * PERIOD
        rise = np.minimum(1 - np.exp(-t / 0.03), 1 - np.exp(-(t[-1] - t) / 0.03))
        phase = rng.uniform(0, 2 * np.pi)
        speeds.append((-1) ** k * (top * rise * (1 + 0.1 * np.sin(2 * np.pi * 9 * t + phase)) + 0.25))
    return speeds


def strokes(rng, truth, strokes=12):
    """Return slides of a handle with the friction `truth`: exact motion, then encoder and
    transducer.
    """
    samples = []
    for v in stroke_speeds(rng, strokes):
        fine = np.interp(np.arange(len(v) * 20) / 20, np.arange(len(v)), v)  # 50 us, so that x is its integral
        x = (np.cumsum(fine) - 0.5 * fine)[::20] * PERIOD / 20 + rng.uniform(0, COUNT)
        a = np.gradient(fine, PERIOD / 20)[::20]
        v = fine[::20]
        level = truth["c"] + truth["b"] * np.abs(v) + truth["stribeck"] * np.exp(-((v / truth["v_s"]) ** 2))
        f = truth["J"] * a + np.sign(v) * level + truth["offset"] + rng.normal(0, truth["noise"], len(v))
        inner = slice(2, -2)  # the gradient is one-sided at the ends
        hand, x = np.round(f[inner], 3), np.rint(x[inner] / COUNT) * COUNT
        samples.append(Slide(np.arange(len(x)) * PERIOD, x, hand, np.zeros(len(x))))
    return tuple(samples)


def random_truth(rng, stribeck=0.0):
    return {
        "c": rng.uniform(0.05, 0.3),
        "b": rng.uniform(0.002, 0.02),
        "J": rng.uniform(1e-3, 6e-3),
        "offset": rng.uniform(-0.02, 0.02),
        "noise": rng.uniform(0.0005, 0.005),
        "stribeck": stribeck,
        "v_s": rng.uniform(0.4, 0.6),
    }


def fitted(rng, truth, **changes):
    rows = equations(strokes(rng, truth, **changes), PERIOD, COUNT)
    return fit_friction(rows, rows.hand_Nm)


@pytest.mark.thorough
def test_the_intervals_of_all_parameters_hold_the_truth_in_95_of_100():
    held = {name: [] for name in ("coulomb_Nm", "viscous_Nms_rad", "inertia_kg_m2", "offset_Nm", "stribeck_Nm")}
    for seed in range(40):
        rng = np.random.default_rng([1, seed])
        truth = random_truth(rng, stribeck=0.06)
        fit = fitted(rng, truth)
        for (name, intervals), key in zip(held.items(), ("c", "b", "J", "offset", "stribeck"), strict=True):
            estimate = getattr(fit, name)
            intervals.append(estimate.low <= truth[key] <= estimate.high)
    for name, intervals in held.items():
        assert 0.90 <= np.mean(intervals) <= 1.0, name


@pytest.mark.thorough
def test_stribeck_is_not_seen_where_there_is_none():
    fits = [fitted(rng, random_truth(rng)) for rng in map(np.random.default_rng, range(40))]
    assert [fit.stribeck_Nm for fit in fits] == [None] * 40


def test_friction_that_rises_at_low_speed_only_by_its_sign_is_no_stribeck_term():
    rng = np.random.default_rng(3)
    assert fitted(rng, random_truth(rng, stribeck=-0.06)).stribeck_Nm is None


def test_quantisation_does_not_shrink_the_inertia():
    """Errors in variables: least squares alone gives the less, the coarser the encoder."""
    rng = np.random.default_rng(5)
    truth = random_truth(rng) | {"noise": 1e-4, "J": 4e-3}
    slides = [dataclasses.replace(s, x_rad=np.rint(s.x_rad / (4 * COUNT)) * 4 * COUNT) for s in strokes(rng, truth)]
    rows = equations(tuple(slides), PERIOD, 4 * COUNT)
    estimate = fit_friction(rows, rows.hand_Nm).inertia_kg_m2
    assert estimate.value == pytest.approx(4e-3, rel=0.02)
    assert estimate.low < 4e-3 < estimate.high
    blind = fit_friction(dataclasses.replace(rows, a_variance=0.0, v_variance=0.0), rows.hand_Nm)
    assert blind.inertia_kg_m2.value < estimate.value


def test_torque_speed_and_acceleration_are_filtered_alike():
    torque, first, second = weights(61, PERIOD)
    t = (np.arange(61) - 30) * PERIOD
    for omega in (10.0, 60.0, 200.0):
        x = np.sin(omega * t + 0.3)
        assert second @ x == pytest.approx(torque @ (-(omega**2) * x), rel=1e-5)
        assert first @ x == pytest.approx(torque @ (omega * np.cos(omega * t + 0.3)), rel=5e-3)


def loaded(rng, truth, share):
    """Return slides in which the motor's torque follows the angle, as a spring's, and the hand bears it."""
    slides = []
    for slide in strokes(rng, truth, 16):
        motor_Nm = 1.2 * np.sin(2.0 * slide.x_rad + 0.3)
        friction_Nm = np.sign(np.gradient(slide.x_rad).mean()) * share * np.abs(motor_Nm)
        slides.append(dataclasses.replace(slide, hand_Nm=slide.hand_Nm + friction_Nm - motor_Nm, motor_Nm=motor_Nm))
    return tuple(slides)


@pytest.mark.thorough
@pytest.mark.parametrize("share", [0.05, 0.2])
def test_friction_that_grows_with_the_load_is_told_from_coulomb_and_viscous(share):
    held = {"c": 0, "b": 0, "share": 0}
    for seed in range(20):
        rng = np.random.default_rng([8, seed])
        truth = random_truth(rng)
        slides = loaded(rng, truth, share)
        fit = identified(Sliding(slides, PERIOD, COUNT, True, {}, ()), "", WINDOW_S, None).device
        truth |= {"share": share}
        for name, estimate in (("c", fit.coulomb_Nm), ("b", fit.viscous_Nms_rad), ("share", fit.load_share)):
            held[name] += estimate.low <= truth[name] <= estimate.high
    assert min(held.values()) >= 17, held


@pytest.mark.thorough
def test_without_such_friction_no_share_of_the_load_is_told():
    for seed in range(20):
        rng = np.random.default_rng([9, seed])
        slides = loaded(rng, random_truth(rng), 0.0)
        identification = identified(Sliding(slides, PERIOD, COUNT, True, {}, ()), "", WINDOW_S, None)
        assert identification.device.load_share is None
        assert identification.device.as_dict()["load_share"] is None
        assert not any("the fit leaves" in remark for remark in identification.remarks)


def test_a_motor_that_moves_a_free_handle_tells_no_load():
    """Its torque is the friction, so any share of it explains the motion."""
    rng = np.random.default_rng(2)
    slides = tuple(
        dataclasses.replace(s, motor_Nm=s.hand_Nm, hand_Nm=np.round(rng.normal(0, 1e-3, len(s.t_s)), 3))
        for s in strokes(rng, random_truth(rng))
    )
    assert identified(Sliding(slides, PERIOD, COUNT, True, {}, ()), "", WINDOW_S, None).device.load_share is None


def test_a_torque_that_is_not_in_the_fit_is_told():
    rng = np.random.default_rng(4)
    slides = tuple(
        dataclasses.replace(s, hand_Nm=s.hand_Nm * (1.0 + 0.3 * np.sin(3.0 * s.x_rad)))
        for s in strokes(rng, random_truth(rng))
    )
    remarks = identified(Sliding(slides, PERIOD, COUNT, True, {}, ()), "", WINDOW_S, None).remarks
    assert any("the device has a torque that is not in it" in remark for remark in remarks)


def test_what_the_data_do_not_carry_is_told():
    rng, notes = np.random.default_rng(0), []
    t = np.arange(400) * PERIOD
    slides = tuple(Slide(t, 1.0 * t, 0.2 + rng.normal(0, 0.01, 400), 0 * t) for _ in range(6))
    rows = equations(slides, PERIOD, COUNT)
    fit = fit_friction(rows, rows.hand_Nm, notes)
    assert (fit.viscous_Nms_rad, fit.inertia_kg_m2, fit.offset_Nm, fit.stribeck_Nm) == (None,) * 4
    remarks = [
        "one speed only",
        "the speed hardly changes",
        "one direction only",
        "the data do not carry Stribeck's term",
    ]
    assert [note.split(":")[0] for note in notes] == remarks
    few = equations((Slide(*(values[:150] for values in vars(slides[0]).values())),), PERIOD, COUNT)
    with pytest.raises(IdentifyError, match="separate pieces; expected at least 6"):
        fit_friction(few, few.hand_Nm)


# which samples


class Made(Source):
    """A recording made of arrays; `markers` as in a run's recording."""

    def __init__(self, t, signals, markers=()):
        self.path, self.known_rig, self.markers = "made", load_rig("bench"), list(markers)
        self.signals = {name: Series(t, np.asarray(values), "") for name, values in signals.items()}

    def __iter__(self):
        yield self

    def __getitem__(self, name):
        return self.signals[name]


def made_run(rng, *, markers=True, sign_check=True, **changes):
    """Return a run: 0.3 s not enabled, a sign check that drives the handle, still, then strokes,
    then the safe state.
    """
    scale = load_rig("bench").pdos()[0].signals[1].scale
    count = abs(next(s for p in load_rig("bench").pdos() for s in p.signals if s.name == "motor.position_rad").scale)
    truth = random_truth(rng) | {"c": 0.2, "noise": 0.002}
    v = np.concatenate([np.zeros(300), np.full(200 if sign_check else 0, 0.5), np.zeros(800)])
    target = np.zeros(len(v))
    if sign_check:
        target[300:500] = np.round(0.25 / scale) * scale
    f = np.zeros(len(v))
    f[300 : 300 + 200 * sign_check] = 0.2 - 0.25  # the hand feels the motor, too
    for stroke in stroke_speeds(rng):
        a = np.gradient(stroke, PERIOD)
        f = np.concatenate([f, truth["J"] * a + np.sign(stroke) * (0.2 + truth["b"] * np.abs(stroke)), np.zeros(100)])
        v = np.concatenate([v, stroke, np.zeros(100)])
    tail = 600
    begin, end = 300, len(v)
    v, f = np.concatenate([v, np.full(tail, 0.5)]), np.concatenate([f, np.full(tail, 0.7)])  # the safe state's brake
    n = len(v)
    t = np.arange(n) * PERIOD
    words = np.where((np.arange(n) >= begin) & (np.arange(n) < n - 10), ENABLED_WORD, SWITCHED_ON_WORD)
    signals = {
        "motor.position_rad": np.rint((np.cumsum(v) - 0.5 * v) * PERIOD / count) * count,
        "brake.handle_torque_Nm": np.round(f + rng.normal(0, truth["noise"], n), 3),
        "motor.torque_Nm": np.pad(target, (0, n - len(target))),
        "motor.target_torque_Nm": np.pad(target, (0, n - len(target))),
        "motor.statusword": words,
        "brake.setpoint_Nm": np.zeros(n),
    } | changes
    marks = [(0.29, "run hybrid"), (0.3, "phase stroke"), (end * PERIOD, "phase end")] if markers else []
    return Made(t, signals, marks)


def test_the_status_words_of_these_tests_are_what_they_say():
    from coulombus.eds.cia402 import STATE_OF_STATUSWORD

    assert STATE_OF_STATUSWORD[ENABLED_WORD & 0x7F] == PowerState.OPERATION_ENABLED
    assert STATE_OF_STATUSWORD[SWITCHED_ON_WORD & 0x7F] == PowerState.SWITCHED_ON


@pytest.mark.parametrize("markers", [True, False])
def test_sign_check_and_safe_state_are_left_out_and_counted(markers):
    """With and without markers: the wire shows Operation Enabled, the check's torque, and a handle
    that is still.
    """
    recording = made_run(np.random.default_rng(0), markers=markers)
    identification = identify(recording)
    assert identification.felt.coulomb_Nm.value == pytest.approx(0.2, abs=5e-4)
    assert identification.felt.stribeck_Nm is None
    display = next(n for reason, n in identification.left_out.items() if reason.startswith("not in the display"))
    # not enabled, sign check, still, the gain's ramp; and the end
    assert display >= 300 + 200 + 50 + 500 + 600
    assert identification.samples + sum(identification.left_out.values()) == len(recording["motor.position_rad"])
    assert f"left out {display:>8}: not in the display" in "\n".join(lines(identification))
    assert identification.as_dict()["left_out"] == identification.left_out


@pytest.mark.parametrize("reversal_rad", [0.05, 0.1])
def test_an_angle_after_a_reversal_is_left_out_where_it_is_asked(reversal_rad):
    """There a bearing's bristles still bend."""
    recording = made_run(np.random.default_rng(0))
    x = recording["motor.position_rad"].values
    part = sliding(recording, reversal_rad=reversal_rad)
    for slide in part.slides:
        first = start = round(slide.t_s[0] / PERIOD)
        sense = np.sign(slide.x_rad[-1] - slide.x_rad[0])
        while (x[start] - x[start - 1]) * sense > 0:
            start -= 1
        assert abs(x[first] - x[start]) >= reversal_rad
        assert first - start <= 25 or abs(x[first - 3] - x[start]) < reversal_rad
    assert part.samples < sliding(recording).samples
    reasons = [reason for reason in part.left_out if "reversal" in reason]
    assert reasons == [f"within 20 ms or {reversal_rad:g} rad of a stop or a reversal"]


def test_without_a_motor_there_is_no_sign_check_to_wait_for():
    recording = made_run(np.random.default_rng(0), sign_check=False)
    assert identify(recording).felt.coulomb_Nm.value == pytest.approx(0.2, abs=1e-3)


@pytest.mark.thorough
def test_not_a_number_and_missing_cycles_are_left_out():
    rng = np.random.default_rng(0)
    recording = made_run(rng)
    clean = identify(recording)
    for name in ("motor.position_rad", "brake.handle_torque_Nm", "motor.torque_Nm", "brake.setpoint_Nm"):
        values = recording[name].values.astype(float)
        broken = values.copy()
        broken[3000:3050] = np.nan
        recording.signals[name] = Series(recording[name].t_s, broken, "")
        identification = identify(recording)
        assert identification.left_out["a signal is missing in the cycle, or no number"] >= 50
        assert np.isfinite(identification.felt.coulomb_Nm.value)
        assert identification.felt.coulomb_Nm.value == pytest.approx(clean.felt.coulomb_Nm.value, abs=1e-3)
        recording.signals[name] = Series(recording[name].t_s, values, "")


@pytest.mark.parametrize(
    ("changes", "mistake"),
    [
        ({"motor.position_rad": 0.0}, "the handle does not slide"),
        ({"motor.statusword": SWITCHED_ON_WORD}, "not in the display"),
        ({"brake.handle_torque_Nm": np.nan}, "a signal is missing"),
    ],
)
def test_a_recording_that_shows_no_friction_is_refused_with_what_was_left_out(changes, mistake):
    recording = made_run(np.random.default_rng(0))
    for name, value in changes.items():
        series = recording[name]
        recording.signals[name] = Series(series.t_s, np.full(len(series), value), "")
    with pytest.raises(IdentifyError, match=r"0 of \d+ samples slide as friction is fitted; .* Left out: .*" + mistake):
        identify(recording)


def test_a_recording_without_a_signal_is_refused():
    recording = made_run(np.random.default_rng(0))
    for name in ("motor.position_rad", "brake.handle_torque_Nm"):
        kept = recording.signals[name]
        recording.signals[name] = Series(np.zeros(0), np.zeros(0), "")
        with pytest.raises(IdentifyError, match=f"no sample of {name}"):
            identify(recording)
        recording.signals[name] = kept


# the verb's refusals


@pytest.mark.parametrize(
    ("name", "content", "arguments", "status", "mistake"),
    [
        ("garbage.pcapng", b"no recording", (), 2, "not a pcapng file"),
        ("empty.pcapng", b"", (), 2, "empty"),
        ("norig.log", b"(1.0) can0 080#\n", (), 3, "no rig.toml is attached"),
        ("other.log", b"(1.0) can0 080#\n", ("--rig", "bench"), 1, "no sample of motor.position_rad"),
        ("axis.log", b"(1.0) can0 080#\n", ("--rig", "bench", "--axis", "left"), 3, "one axis, without a name"),
    ],
)
def test_what_cannot_be_identified_is_refused_with_a_status(tmp_path, name, content, arguments, status, mistake):
    path = tmp_path / name
    path.write_bytes(content)
    refused = CliRunner().invoke(main, ["identify", str(path), *arguments])
    assert refused.exit_code == status
    assert isinstance(refused.exception, SystemExit)  # no traceback
    assert mistake in refused.stderr
