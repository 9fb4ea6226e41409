"""The command line: every mistake has its text and its documented exit status, and nothing
is lost.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from coulombus.cli.demo import next_steps
from coulombus.cli.main import FORMER, main
from coulombus.recording.measures import phases
from coulombus.recording.reading import read
from places import ROOT


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
        (("--set", "law.function=karnop"), 3, ["law.function", "did you mean 'karnopp'"]),
        (("--set", "motor.product_code=1"), 3, ["1018h", "rig file says"]),
        (("--set", "bus.bitrate_bit_s=250000"), 3, ["does not fit"]),
        (("--mode", "active", "--set", "mode.active.motor_limit_Nm=50"), 3, ["6072h", "at most 17.26"]),
        (("--set", "plant.motor_polarity=-1"), 7, ["SIGN_ENCODER"]),
        (("--record", "/proc/nonexistent/x.pcapng"), 2, ["no directory"]),
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


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        ("run --bus coulombus:nobody", 4, "no bus coulombus:nobody"),
        ("run --bus coulombus:nobody --set bus.bitrate_bit_s=500000", 3, "brake RPDO1 (202h)"),
        ("demo --set bus.bitrate_bit_s=500000", 3, "brake RPDO1 (202h)"),
        ("demo --virtual --out OUT --set bus.bitrate_bit_s=500000", 3, "brake RPDO1 (202h)"),
        ("simulate --set bus.bitrate_bit_s=500000", 3, "brake RPDO1 (202h)"),
        ("simulate --mode turbo", 2, "turbo"),
        ("emulate --rig bnch", 3, "did you mean 'bench'"),
        ("node missing.eds --node-id 1 --bus coulombus:nobody", 3, "missing.eds"),
        ("watch --bus coulombus:nobody", 4, "no bus coulombus:nobody"),
        ("bridge coulombus:nobody coulombus:none", 4, "no bus coulombus:nobody"),
        ("decode pyproject.toml", 2, "is no line of a log format that is known"),
        ("replay --host pyproject.toml", 2, "is no line of a log format that is known"),
        ("replay pyproject.toml", 2, "give one of"),
        ("check --rig bnch", 3, "did you mean 'bench'"),
        ("plan --rig bnch", 3, "did you mean 'bench'"),
        ("plan --bitrat 1", 2, "--bitrate"),
        ("eds check", 2, "FILE"),
        ("conformance --bus coulombus:nobody --node 1 --eds eds/motor.eds", 4, "no bus coulombus:nobody"),
        ("analyse --rig bnch", 3, "did you mean 'bench'"),
        ("identify pyproject.toml", 2, "is no line of a log format that is known"),
    ],
)
def test_with_json_the_reason_is_on_stdout_when_there_is_no_result(tmp_path, arguments, status, text):
    result = call(*arguments.replace("OUT", str(tmp_path)).split(), "--json")
    assert result.exit_code == status
    told = json.loads(result.stdout)
    assert (told["event"], told["exit_status"]) == ("error", status)
    assert text in told["error"]
    assert text in result.stderr  # for people
    assert call(*arguments.replace("OUT", str(tmp_path)).split()).stdout == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_a_stdout_that_takes_nothing_is_told_on_stderr():
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "coulombus", "eds", "check", "--json", str(ROOT / "eds/motor.eds")]
        done = subprocess.run(command, cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (
        2,
        "coulombus: No space left on device; free some space, or write elsewhere\n",
    )


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
    from coulombus.sim_bus.network import virtual_rig

    real = virtual_rig.VirtualRig.flush
    calls = []

    def interrupted(self):
        real(self)
        calls.append(1)
        if len(calls) == 6:
            raise KeyboardInterrupt

    monkeypatch.setattr(virtual_rig.VirtualRig, "flush", interrupted)
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
    law = tmp_path / "wild.py"
    law.write_text("def law(motion, law, state):\n    state.brake_Nm = 40.0\n    return 40.0\n")
    wild = ["limits.brake_torque_Nm=100", "brake.rated_torque_Nm=100", f"law.function={law}:law"]
    words = ["simulate", "--seconds", "2.5", "--record", tmp_path / "r.pcapng", *(f"--set={key}" for key in wild)]
    push = "--set=mode.hybrid.F_s_Nm=40"
    result = call(*words, push)
    assert result.exit_code == 7, result.output  # a push of 24 Nm on a brake of 5 Nm: too fast, and told so
    assert "clipped_setpoints" in result.output
    setpoint = read(tmp_path / "r.pcapng")["brake.setpoint_Nm"]
    assert setpoint.values.min() == 0.0
    assert setpoint.values.max() == 5.0


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("identify", __file__, "--figure", "friction.bmp"), "ends in .png, .svg, .pdf"),
        (("plan", "--gantt", "/proc/nonexistent/p.png"), "no directory /proc/nonexistent"),
        (("run", "--histogram", "h.gif"), "ends in .png, .svg, .pdf"),
        (("analyse", "--figures", "/proc/x"), "/proc/x: cannot be made"),
        (("analyse", "--figures", f"{__file__}/x"), "cannot be made: Not a directory"),
        (("demo", "--out", "/proc/x"), "/proc/x: cannot be made"),
        (("dbc", "--out", "/proc/nonexistent/x.dbc"), "no directory /proc/nonexistent"),
        (
            (
                "conformance",
                *["--bus", "coulombus:b", "--node", "1", "--eds", "x", "--report", "/proc/nonexistent/r.md"],
            ),
            "no directory",
        ),
    ],
)
def test_what_cannot_be_written_is_refused_before_anything_runs(arguments, text):
    result = call(*arguments)
    assert result.exit_code == 2, result.output
    assert text in " ".join(result.output.replace("│", " ").split())


@pytest.mark.parametrize("verb", ["check", "plan", "simulate"])
def test_ctrl_c_while_a_verb_still_loads(monkeypatch, verb):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("coulombus.rigs.rig.load_rig", interrupted)
    result = call(verb)
    assert (result.exit_code, result.output) == (130, "coulombus: interrupted\n")


def test_a_fault_file_given_as_a_script_is_told_so():
    result = call("simulate", "--script", "examples/faults.toml")
    assert result.exit_code == 3
    assert "this is a fault file (--faults FILE); expected a script (--script FILE)" in " ".join(result.output.split())


@pytest.mark.parametrize(("options", "cycles", "told"), [((), 3, True), (("--shared-machine",), 50, False)])
def test_a_trip_for_want_of_tpdos_says_what_to_do_on_a_shared_machine(monkeypatch, options, cycles, told):
    import coulombus.host.run.real_run

    def tripped(run, **_):
        assert run.rig.one_axis().limits.missed_tpdo_cycles == cycles
        return SimpleNamespace(trip="TPDO_LOST: for want of some", exit_status=7, as_dict=dict)

    monkeypatch.setattr(coulombus.host.run.real_run, "real_run", tripped)
    done = CliRunner().invoke(main, ["run", "--json", *options])
    assert done.exit_code == 7
    assert ("--shared-machine" in done.stderr) is told


def test_wider_limits_are_for_simulated_nodes_only():
    result = call("run", "--bus", "socketcan:can0", "--shared-machine")
    assert result.exit_code == 2
    assert "a motor could push unwatched" in result.output


def test_the_list_of_verbs_imports_none():
    script = (
        "import sys; from coulombus.cli.main import main; main(['--help'], standalone_mode=False); "
        "sys.exit('numpy' in sys.modules or 'coulombus.cli.simulate' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", script], stdout=subprocess.DEVNULL, timeout=60).returncode == 0


def test_a_verb_does_not_load_the_library_of_python_cans_mf4_reader(tmp_path):
    """Where asammdf is installed each start took 0.7 s of processor time longer."""
    (tmp_path / "asammdf.py").write_text("MINE = True\n")
    script = (
        "import coulombus.cli, can, sys; assert 'asammdf' not in sys.modules; "
        "import asammdf; assert asammdf.MINE; print('whoever asks gets it')"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.stdout == "whoever asks gets it\n", done.stderr


@pytest.mark.thorough
def test_a_verb_reads_an_mf4_log(tmp_path):
    """The library was left out for good: decode said that it is not installed."""
    pytest.importorskip("asammdf")
    script = (
        "import can\n"
        "with can.Logger('theirs.mf4') as log:\n"
        "    log.on_message_received(can.Message(arbitration_id=0x181, data=bytes(8), is_extended_id=False, timestamp=1))\n"
    )
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True, timeout=120)
    done = subprocess.run(
        [sys.executable, "-P", "-m", "coulombus", "decode", "--rig", "bench", "theirs.mf4"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert "position_rad" in done.stdout


def test_what_the_demo_names_next_can_be_done(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    schedule = 'phase=[{kind="rest", duration_s=1.0}, {kind="hold", duration_s=1.5, push_F_s=0.8, frequency_Hz=1.0}]'
    shown = call("demo", "--virtual", "--out", "the demo", "--set", schedule).output
    hold = next(span for span in phases(read("the demo/active.pcapng")) if span.kind == "hold")
    span = f" --span {hold.begin_s + 1.0:.1f}:{hold.begin_s + 1.2:.1f}"
    commands = [shlex.split(command)[1:] for command, _ in next_steps("bench", Path("the demo"), span)]
    assert [shlex.split(line)[1:] for line in shown.splitlines() if line.startswith("  coulombus ")] == commands
    drawn, another, live = commands
    assert call(*drawn).exit_code == 0
    assert call(*another, "--seconds", "0.5").exit_code == 0
    assert {option for option in live if option.startswith("--")} <= {
        name for parameter in main.commands[live[0]].params for name in parameter.opts
    }
    assert "--rig my-rig.toml " in next_steps("my-rig.toml", Path("out"))[1][0]


def test_the_list_of_commands_has_a_line_for_each_that_80_columns_hold():
    listed = CliRunner().invoke(main, ["help", "all"]).output.splitlines()
    assert max(map(len, listed)) <= 80
    for name, verb in main.commands.items():
        (line,) = (line for line in listed if line.startswith(f"  {name} "))
        assert line.split(None, 1)[1] == verb.short_help, name


def test_the_help_names_each_command_and_fits_a_terminal():
    shown = CliRunner().invoke(main, ["--help"], terminal_width=80).output
    assert shown.count("\n") <= 24
    assert set(main.commands) <= set(shown.partition("All commands:")[2].split())
    assert CliRunner().invoke(main, ["help"], terminal_width=80).output == shown
    assert CliRunner().invoke(main, [], terminal_width=80).output == shown


def test_help_explains_a_command_and_a_command_of_a_command():
    for words in (["run"], ["eds", "check"]):
        shown = CliRunner().invoke(main, ["help", *words], terminal_width=80).output
        assert shown == CliRunner().invoke(main, [*words, "--help"], terminal_width=80).output
        assert shown.startswith(f"Usage: main {' '.join(words)} ")


def test_a_former_name_goes_on_working_and_is_listed_nowhere():
    for name, present in FORMER.items():
        assert main.commands[name].name == present
        assert name in main.commands
        assert name not in set(main.commands)
        shown = CliRunner().invoke(main, ["help", name]).output
        assert shown == CliRunner().invoke(main, [name, "--help"]).output


def test_nmt_knows_a_node_by_the_name_that_a_rig_gives():
    done = CliRunner().invoke(main, ["nmt", "stop", "brake", "--rig", "bench", "--bus", "coulombus:none"])
    assert done.exit_code == 4, done.output
    done = CliRunner().invoke(main, ["nmt", "stop", "brak", "--rig", "bench", "--bus", "coulombus:none"])
    assert done.exit_code == 2
    assert "the rig bench has the nodes motor, brake" in done.output
