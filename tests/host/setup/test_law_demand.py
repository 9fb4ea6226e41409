"""A law that a limit cuts off: refused where it is known beforehand, counted and told where it is
not.
"""

from __future__ import annotations

import json
import re

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.cli.rig_options import load_with_law
from coulombus.host.cycle.axes import safe_setpoints
from coulombus.host.cycle.controller import Controller
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.output_limits import brake_limit_raw
from coulombus.host.cycle.records import Image, Phase
from coulombus.host.setup.law_demand import check_demand, cut_off, remarks
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.rigs.rig import RigError, load_rig, load_rig_text
from coulombus.wire.frame import new_queue
from host_bench import HostBench
from places import EDS

INTERNAL_LIMIT = 0x0800
PUSHY_LAW = (
    "def law(motion, law, state):\n    state.brake_Nm = 10.0\n    return 10.0 if motion.v_counts >= 0.0 else -10.0\n"
)


def with_eds(name, *changes, overrides=()):
    """Return the bench rig with changes (section, old line, new line) in one of its EDS files."""
    texts = {file: (EDS / file).read_text() for file in ("motor.eds", "mr_brake.eds")}
    for section, old, new in changes:
        head, middle, tail = texts[name].partition(f"[{section}]\n")
        assert old in tail.split("\n[")[0]
        texts[name] = head + middle + tail.replace(old, new, 1)
    bench = load_rig("bench")
    return load_rig_text(bench.text, bench.path, texts, overrides)


@pytest.mark.parametrize("name", ["bench", "paper", "two_axes"])
def test_nothing_is_cut_off_of_the_rigs_of_the_package(name):
    rig = load_rig(name)
    assert [text for mode in rig.modes for text in cut_off(rig, mode)] == []


@pytest.mark.parametrize(
    ("overrides", "mode", "key", "limit"),
    [
        ("mode.active.F_s_Nm=1.6", "active", "F_s_Nm", "at most 1.5 Nm, not 1.6 Nm: mode.active.motor_limit_Nm"),
        ("mode.active.F_d_Nm=1.7", "active", "F_d_Nm", "at most 1.5 Nm, not 1.5642 Nm"),
        ("mode.active.motor_limit_Nm=0.1", "active", "compensation", "at most 0.1 Nm, not 0.1358 Nm"),
        ("mode.hybrid.motor_limit_Nm=0.1", "hybrid", "compensation", "at most 0.1 Nm, not 0.1358 Nm"),
        ("mode.hybrid.F_s_Nm=4.6", "hybrid", "F_s_Nm", "at most 4.5 Nm, not 4.6 Nm: limits.brake_torque_Nm"),
        ("mode.passive.F_d_Nm=4.6", "passive", "F_d_Nm", "at most 4.5 Nm, not 4.6 Nm: limits.brake_torque_Nm"),
        ("limits.brake_torque_Nm=3", "passive", "F_s_Nm", "at most 3 Nm, not 3.5 Nm: limits.brake_torque_Nm"),
    ],
)
def test_a_law_that_a_limit_cuts_off_is_refused_with_its_key(overrides, mode, key, limit):
    rig = load_rig("bench", [overrides])
    with pytest.raises(RigError) as refused:
        check_demand(rig, mode)
    (text,) = (text for text in refused.value.errors if f"mode.{mode}.{key}" in text)
    assert limit in text


@pytest.mark.parametrize("axis", ["left", "right"])
def test_every_axis_is_looked_at(axis):
    found = cut_off(load_rig("two_axes", [f"axis.{axis}.mode.hybrid.F_s_Nm=4.6"]), "hybrid")
    assert len(found) == 1
    assert f"axis.{axis}.mode.hybrid.F_s_Nm" in found[0]


def test_a_demand_that_is_the_limit_is_none_too_many():
    """6072h is rounded down to a per mille: what that takes off is no clipping."""
    rig = load_rig("bench", ["mode.active.F_s_Nm=1.5", "mode.hybrid.F_s_Nm=4.5"])
    assert [text for mode in rig.modes for text in cut_off(rig, mode)] == []


def test_the_brakes_own_limit_counts_and_is_named():
    rig = load_rig("paper", ["brake.eds=mr_brake.eds"])
    assert cut_off(rig, "active") == []
    (text,) = cut_off(rig, "passive")
    assert re.search(r"paper\.toml:\d+: mode\.passive\.F_d_Nm: got '10\.0'", text)
    assert re.search(r"at most 5 Nm, not 10 Nm: the brake's 7300h:01 \(.*mr_brake\.eds:\d+\)", text)


@pytest.mark.parametrize(
    ("data_type", "limit", "most"),
    [
        ("0x0003", "HighLimit=5000", 5000),
        ("0x0003", "", 32767),
        ("0x0003", "HighLimit=0", 32767),
        ("0x0002", "", 127),
        ("0x0005", "", 255),
        ("0x0004", "", 2**31 - 1),
        ("0x0002", "HighLimit=5000", 127),
    ],
)
def test_the_brake_takes_what_its_file_or_its_data_type_says(data_type, limit, most):
    rig = with_eds(
        "mr_brake.eds",
        ("7300sub1", "DataType=0x0003\n", f"DataType={data_type}\n"),
        ("7300sub1", "HighLimit=5000", limit),
    )
    assert brake_limit_raw(rig.one_axis()) == most
    control = Controller(rig.one_axis(), "hybrid").control[0]
    assert control["brake_limit_Nm"] == pytest.approx(min(4.5, most * 1e-3))
    assert bool(cut_off(rig, "hybrid")) is (most < 3500)


def test_a_limit_of_0_that_nobody_has_set_is_none_of_the_motors_either():
    rig = with_eds("motor.eds", ("6072", "HighLimit=10000", "HighLimit=0"), ("6071", "HighLimit=10000", "HighLimit="))
    assert Controller(rig.one_axis(), "active").control[0]["motor_limit_raw"] == 869
    rig = with_eds("motor.eds", ("6071", "HighLimit=10000", "HighLimit=0"))  # its LowLimit is -10000
    with pytest.raises(RigError, match="6071h ends at 0 per mille"):
        Controller(rig.one_axis(), "active")


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (("6072", "HighLimit=10000", "HighLimit=800"), "6072h ends at 800"),
        (("6071", "HighLimit=10000", "HighLimit=800"), "6071h ends at 800"),
        (("6071", "LowLimit=-10000", "LowLimit=-700"), "6071h ends at 700"),
    ],
)
def test_a_motor_limit_that_the_drive_would_cut_off_is_refused(change, place):
    rig = with_eds("motor.eds", change)
    with pytest.raises(RigError, match=rf"mode\.active\.motor_limit_Nm.*{place}"):
        Controllers(rig, "active")
    Controllers(rig, "hybrid")  # 97 per mille


def test_check_refuses_and_says_so():
    words = ("check", "--rig", "bench", "--set", "mode.hybrid.F_s_Nm=4.6")
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 1
    assert "FAIL: --set mode.hybrid.F_s_Nm=4.6: mode.hybrid.F_s_Nm" in done.output
    assert not re.search(r"^ok$", done.output, re.MULTILINE)
    done = CliRunner().invoke(main, [*words, "--json"])
    assert done.exit_code == 1
    assert len(json.loads(done.stdout)["cut_off"]) == 1


def test_check_tells_that_the_size_of_a_users_law_is_not_known(tmp_path):
    (tmp_path / "mine.py").write_text(PUSHY_LAW)
    done = CliRunner().invoke(main, ["check", "--rig", "bench", "--set", f"law.function={tmp_path}/mine.py:law"])
    assert done.exit_code == 0
    assert "is not known before it runs" in done.output


@pytest.mark.slow
def test_a_run_is_refused_before_its_recording_begins(tmp_path):
    record = tmp_path / "run.pcapng"
    with pytest.raises(RigError, match=r"mode\.hybrid\.F_s_Nm"):
        simulate("bench", "hybrid", 1.0, record=record, overrides=("mode.hybrid.F_s_Nm=4.6",))
    assert not record.exists()
    bus = f"coulombus:none-{tmp_path.name}"
    done = CliRunner().invoke(main, ["run", "--bus", bus, "--mode", "hybrid", "--set", "mode.hybrid.F_s_Nm=4.6"])
    assert done.exit_code == 3
    assert "mode.hybrid.F_s_Nm" in done.output


@pytest.mark.parametrize(
    ("mode", "counter", "whose"),
    [("passive", "clipped_setpoints", "limits.brake_torque_Nm"), ("active", "clipped_torque", "6072h")],
)
@pytest.mark.slow
def test_what_is_cut_off_of_a_users_law_is_counted_and_told(tmp_path, mode, counter, whose):
    (tmp_path / "mine.py").write_text(PUSHY_LAW)
    result = simulate("bench", mode, 1.5, overrides=(f"law.function={tmp_path}/mine.py:law",))
    assert result.counters[counter] > 0
    (told,) = (text for text in result.remarks if counter in text)
    assert f"in {result.counters[counter]} cycles the law asked more" in told
    assert whose in told


@pytest.mark.slow
def test_a_law_within_its_limits_is_counted_nowhere():
    result = simulate("bench", "hybrid", 1.5)
    names = ("clipped_torque", "slowed_torque", "limited_by_drive", "clipped_setpoints", "negative_setpoints")
    assert [result.counters[name] for name in names] == [0] * 5
    assert result.remarks == ()


# the step


@pytest.mark.parametrize("sense", [1, -1])
def test_torque_beyond_the_limit_is_clipped_and_counted_in_either_sense(sense):
    bench = HostBench("active", "law.gain_ramp_s=0")
    bench.arm()
    assert bench.phase is Phase.RUN
    bench.k.law["F_d"] = 3.0  # the limit is 1.5 Nm
    for _ in range(8):
        bench.counts -= 50 * sense
        bench.cycle()
    assert bench.phase is Phase.RUN
    assert bench.h.clipped_torque == 8
    assert abs(bench.motor_pm) == bench.c.motor_limit_raw
    assert bench.motor_pm * bench.c.motor_Nm_raw * sense > 0


def test_torque_that_its_rate_holds_back_is_counted():
    bench = HostBench("active", "law.gain_ramp_s=0", "limits.torque_rate_Nm_s=100")
    bench.arm()
    before = int(bench.h.slowed_torque)
    bench.counts += 100
    bench.cycle()
    assert bench.h.slowed_torque == before + 1
    assert bench.h.clipped_torque == 0


def test_a_setpoint_beyond_the_devices_limit_is_clipped_and_counted():
    rig = with_eds("mr_brake.eds", ("7300sub1", "HighLimit=5000", "HighLimit=2000"), overrides=["law.gain_ramp_s=0"])
    bench = HostBench("hybrid", rig=rig)
    bench.arm()
    bench.cycles(10)
    assert bench.h.clipped_setpoints == 10  # F_s is 3.5 Nm
    assert bench.brake_Nm == 2.0
    assert bench.h.brake_Nm == 2.0  # what the watch of the handle's torque expects, too


def test_the_last_setpoints_keep_to_the_devices_limit_too():
    k = Controllers(with_eds("mr_brake.eds", ("7300sub1", "HighLimit=5000", "HighLimit=200")), "active")
    k.host["brake_Nm"] = 4.5
    out = new_queue()
    safe_setpoints(k.axes, 0, out)
    assert int(k.host["image"][0, Image.BRAKE_SETPOINT]) == 200  # the safe state's 1 Nm would be 1000


# the paper's rig


def test_the_two_brakes_differ_in_their_range_alone():
    texts = [(EDS / name).read_text().splitlines() for name in ("mr_brake.eds", "mr_brake_20Nm.eds")]
    differing = [(a, b) for a, b in zip(*texts, strict=True) if a != b]
    values = [(a, b) for a, b in differing if not a.startswith(("FileName=", "Description=", "Line1="))]
    assert values == [(f"{key}=5000", f"{key}=20000") for key in ("HighLimit", "DefaultValue", "HighLimit")]


@pytest.mark.slow
def test_the_papers_rig_displays_its_10_N_with_the_brake(tmp_path):
    """7300h:01 of the 5 Nm brake cut them to 5, and nothing told."""
    seen = {}

    def script(world):
        seen["world"] = world
        world.at(2_000_000_000, lambda w: seen.update(brake_Nm=float(w.nodes["out_brake_Nm"][1])))

    result = simulate("paper", "passive", 3.0, record=tmp_path / "run.pcapng", script=script)
    assert (result.trip, result.remarks) == (None, ())
    assert seen["brake_Nm"] == 10.0
    assert int(seen["world"].nodes["clipped_setpoints"][1]) == 0
    assert read(tmp_path / "run.pcapng")["brake.setpoint_Nm"].values.max() == pytest.approx(10.0)


@pytest.mark.parametrize(("rest_s", "told"), [(2, False), (1, True)])
@pytest.mark.slow
def test_a_hand_that_begins_before_the_law_is_whole_is_told(rest_s, told):
    result = simulate("paper", "active", 2.2, overrides=(f"phase.0.duration_s={rest_s}",))
    assert 1.0 < result.full_gain_s < 2.0
    assert bool(result.remarks) is told
    if told:
        assert "phase paper began after 1 s" in result.remarks[0]
        assert f"whole after {result.full_gain_s:.3f} s" in result.remarks[0]


@pytest.mark.parametrize(("law", "made"), [("karnopp", True), ("coulomb", False), ("lugre", False)])
def test_a_friction_that_grows_when_it_slips_is_remarked_of_a_law_that_has_both_levels(law, made, capsys):
    rig = load_rig("paper", (f"law.function={law}", "mode.passive.F_s_Nm=1e-3"))
    (*texts,) = (text for text in remarks(rig) if "mode.passive.F_d_Nm" in text and "at most F_s_Nm (0.001)" in text)
    assert len(texts) == made
    load_with_law("paper", (f"law.function={law}", "mode.passive.F_s_Nm=1e-3"))
    assert ("this friction grows when it slips" in capsys.readouterr().err) is made


@pytest.mark.parametrize("static_Nm", [10.0, 10.5])
def test_a_static_friction_of_at_least_the_dynamic_one_is_not_remarked(static_Nm):
    assert remarks(load_rig("paper", ("law.function=karnopp", f"mode.passive.F_s_Nm={static_Nm}"))) == []
