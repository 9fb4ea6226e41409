"""The command line: every mistake has its text and its documented exit status, and nothing is lost."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from coulombus import main
from scope.recording import read


def call(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


@pytest.mark.parametrize("seconds", ["nan", "inf", "1e400", "-1", "0", "ten", "1e9"])
def test_a_length_that_is_none_is_a_usage_error(seconds):
    result = call("simulate", "--seconds", seconds)
    assert result.exit_code == 2
    assert "expected a number above 0" in result.output


@pytest.mark.parametrize(
    ("arguments", "status", "texts"),
    [
        (("--rig", "bnch"), 3, ["did you mean 'bench'"]),
        (("--set", "plant.inertia_kg_m=1"), 3, ["did you mean"]),
        (("--set", "law.function=host.laws:karnop"), 3, ["law.function", "did you mean 'karnopp'"]),
        (("--set", "motor.product_code=1"), 3, ["1018h", "rig file says"]),
        (("--set", "bus.bitrate_bit_s=250000"), 3, ["does not fit"]),
        (("--mode", "active", "--set", "mode.active.motor_limit_Nm=50"), 3, ["6072h", "at most 17.26"]),
        (("--set", "plant.motor_polarity=-1"), 7, ["SIGN_ENCODER"]),
        (("--record", "/nonexistent/x.pcapng"), 2, ["no directory"]),
        (("--record", "/dev/full"), 2, ["No space left"]),
        (("--truth", "/dev/full"), 2, ["No space left"]),
        (("--seconds", "1e6", "--truth", "x.npz"), 2, ["GB of truth"]),
        (("--mode", "turbo"), 2, ["turbo"]),
    ],
)
def test_mistakes(arguments, status, texts):
    result = call("simulate", "--seconds", "0.3", *arguments)
    assert result.exit_code == status, result.output
    for text in texts:
        assert text in result.output
    assert "Traceback" not in result.output


def test_json_is_all_that_stands_on_stdout(tmp_path):
    result = call("simulate", "--seconds", "0.3", "--record", tmp_path / "r.pcapng", "--json")
    assert result.exit_code == 0
    document = json.loads(result.stdout)
    for key in (
        *(
            "mode",
            "cycles",
            "period_ns",
            "missed_deadlines",
            "lost_pdos",
            "wakeup_us",
            "cpu_us_per_cycle",
            "recording",
            "trip",
        ),
        *(
            "hold_velocity_rms_rad_s",
            "hold_counts_p2p",
            "stick_velocity_rms_rad_s",
            "torque_flips_per_s",
            "recording_sha256",
        ),
    ):
        assert key in document
    assert document["cycles"] == 300


def test_an_interrupted_run_leaves_a_readable_recording(tmp_path, monkeypatch):
    from lab import world

    real = world.VirtualRig.flush
    calls = []

    def interrupted(self):
        real(self)
        calls.append(1)
        if len(calls) == 6:
            raise KeyboardInterrupt

    monkeypatch.setattr(world.VirtualRig, "flush", interrupted)
    result = call("simulate", "--seconds", "5", "--record", tmp_path / "r.pcapng")
    assert result.exit_code == 130
    assert len(read(tmp_path / "r.pcapng").frames) > 1000


def test_truth_goes_where_it_was_told(tmp_path):
    assert call("simulate", "--seconds", "0.1", "--truth", tmp_path / "truth").exit_code == 0
    assert [path.name for path in tmp_path.iterdir()] == ["truth"]


def test_decode_and_check():
    result = call("check", "--rig", "bench", "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["fits"] is True
    assert call("check", "--set", "bus.bitrate_bit_s=500000").exit_code == 1
    assert call("decode", __file__).exit_code == 2


def test_the_brake_set_point_never_wraps(tmp_path):
    """A set-point beyond what 7300h holds is cut off, not wrapped to a negative one."""
    wild = [
        f"--set={key}" for key in ("mode.hybrid.F_s_Nm=40", "limits.brake_torque_Nm=100", "brake.rated_torque_Nm=100")
    ]
    result = call("simulate", "--seconds", "2.5", "--record", tmp_path / "r.pcapng", *wild)
    assert result.exit_code == 7, result.output  # a push of 24 Nm on a brake of 5 Nm: too fast, and told so
    setpoint = read(tmp_path / "r.pcapng")["brake.setpoint_Nm"]
    assert setpoint.values.min() == 0.0
    assert setpoint.values.max() == 5.0
