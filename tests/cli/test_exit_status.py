"""One table of exit statuses: every verb ends with the same one for the same mistake, and says what
is wrong without a traceback.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from coulombus.cli import emulate
from coulombus.cli.errors import EXIT_STATUS, FAULT, STATUSES
from coulombus.cli.main import main
from coulombus.eds.regular_file import read_regular
from coulombus.kernels.records import new_records
from coulombus.lab.simulate import simulate
from coulombus.recording.output_file import new_file
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.sim_bus.server.bridge import Result
from coulombus.wire.frame import Frame
from places import ROOT

USAGE, CONFIGURATION, BUS = 2, 3, 4

BASE = {
    "demo": "demo --virtual --out DIR/out",
    "simulate": "simulate --seconds 0.01",
    "sweep": "sweep SWEEP -o DIR/sweep",
    "experiment": "experiment STUDY -o DIR/study --subject S01 --observer 0.1 --bus coulombus:none",
    "emulate": "emulate --bus coulombus:none --seconds 0.01",
    "run": "run --bus coulombus:none",
    "stop": "stop --bus coulombus:none",
    "status": "status --bus coulombus:none",
    "mark": "mark grasp --bus coulombus:none",
    "inject": "inject noise --bus coulombus:none",
    "clear": "clear --bus coulombus:none",
    "set": "set F_s=2.0 --bus coulombus:none",
    "world": "world --seconds 0.01 --web-port 0 --bus coulombus:none",
    "watch": "watch --bus coulombus:none",
    "explain": "explain RECORDING",
    "explain --bus": "explain --bus coulombus:none",
    "decode": "decode RECORDING",
    "plot": "plot RECORDING -o DIR/out.png",
    "diff": "diff RECORDING RECORDING",
    "export": "export RECORDING --to csv -o DIR/out.csv",
    "replay --host": "replay RECORDING --host",
    "replay --virtual": "replay RECORDING --virtual",
    "replay --bus": "replay RECORDING --bus coulombus:none",
    "bridge": "bridge coulombus:none coulombus:other",
    "hz": "hz --bus coulombus:none",
    "hz FILE": "hz RECORDING",
    "pdo": "pdo",
    "dbc": "dbc",
    "tools": "tools DIR/tools",
    "check": "check",
    "measure": "measure --bus coulombus:none",
    "doctor": "doctor",
    "warm-up": "warm-up",
    "systemd": "systemd -o DIR/units",
    "plan": "plan",
    "commission": "commission --rig RIG --virtual --yes --step friction",
    "eds check": "eds check EDS",
    "init": "init --drive EDS --brake bench",
    "node": "node EDS --node-id 1 --bus coulombus:none",
    "scan": "scan --bus coulombus:none",
    "lss": "lss --bus coulombus:none",
    "sdo get": "sdo get 1 1000h --bus coulombus:none",
    "sdo set": "sdo set 1 1017h 5 --bus coulombus:none",
    "sdo dump": "sdo dump 1 DIR/out.dcf --bus coulombus:none",
    "sdo restore": "sdo restore 1 EDS --bus coulombus:none",
    "sdo store": "sdo store 1 --bus coulombus:none",
    "sdo restore-defaults": "sdo restore-defaults 1 --bus coulombus:none",
    "sdo shell": "sdo 1 --bus coulombus:none",
    "nmt": "nmt start 1 --bus coulombus:none",
    "conformance": "conformance --bus coulombus:none --node 1 --eds EDS",
    "help": "help",
    "analyse": "analyse",
    "analyse hold": "analyse hold",
    "analyse felt": "analyse felt",
    "analyse z-width": "analyse z-width",
    "analyse map": "analyse map",
    "analyse plane": "analyse plane",
    "analyse study": "analyse study STUDIED",
    "identify": "identify RECORDING",
    "law": "law lugre --motion sine",
}
WITH_RIG = (
    "demo",
    "simulate",
    "emulate",
    "run",
    "stop",
    "status",
    "watch",
    "explain",
    "decode",
    "replay --host",
    "replay --virtual",
    "hz",
    "hz FILE",
    "pdo",
    "dbc",
    "tools",
    "check",
    "measure",
    "doctor",
    "systemd",
    "plan",
)
WITH_RIG += ("analyse", "analyse hold", "analyse felt", "analyse z-width", "analyse map", "analyse plane", "identify")
WITH_SET = (
    "demo",
    "simulate",
    "emulate",
    "run",
    "watch",
    "hz",
    "hz FILE",
    "pdo",
    "dbc",
    "tools",
    "check",
    "measure",
    "doctor",
    "plan",
    "analyse",
    "analyse hold",
    "analyse felt",
    "analyse z-width",
    "analyse map",
    "analyse plane",
)
WITH_RECORDING = (
    "explain",
    "decode",
    "hz FILE",
    "export",
    "plot",
    "diff",
    "replay --host",
    "replay --virtual",
    "replay --bus",
    "identify",
)
WITH_EDS = ("eds check", "init", "node", "conformance", "sdo restore")
WITH_BUS = (
    "experiment",
    "run",
    "stop",
    "status",
    "mark",
    "set",
    "measure",
    "watch",
    "hz",
    "replay --bus",
    "bridge",
    "conformance",
    "scan",
    "lss",
    "nmt",
)
WITH_BUS += ("sdo get", "sdo set", "sdo dump", "sdo restore", "sdo store", "sdo restore-defaults", "sdo shell")
OUTPUTS = (
    ("simulate", "--record", ".pcapng"),
    ("simulate", "--truth", ""),
    ("emulate", "--record", ".pcapng"),
    ("run", "--record", ".pcapng"),
    ("run", "--histogram", ".png"),
    ("watch", "--pcapng", ".pcapng"),
    ("dbc", "--out", ".dbc"),
    ("plan", "--gantt", ".png"),
    ("identify", "--figure", ".png"),
    ("conformance", "--junit", ""),
    ("conformance", "--report", ""),
    ("sdo get", "--output", ""),
)
NO_FILES = {
    "missing": lambda path: None,
    "directory": lambda path: path.mkdir(),
    "pipe": lambda path: os.mkfifo(path),
    "endless": lambda path: path.symlink_to("/dev/zero"),
    "other": lambda path: path.write_bytes(bytes(range(256))),
    "unreadable": lambda path: (path.write_text("x"), path.chmod(0)),
}


@pytest.fixture
def call(tmp_path, private_sockets, monkeypatch):
    """Return a call of a verb, with `more` words, some of its words replaced."""
    monkeypatch.chdir(tmp_path)
    with PcapngWriter(tmp_path / "recording.pcapng", attachments={}) as writer:
        writer.write(new_records(Frame, 3))
    words = {"DIR": tmp_path, "RECORDING": tmp_path / "recording.pcapng", "EDS": ROOT / "eds" / "motor.eds"}
    words["STUDY"] = ROOT / "examples" / "study_friction_jnd.toml"
    words["SWEEP"] = ROOT / "examples" / "sweep_hybrid.toml"

    def run(verb, more="", **replaced):
        text = f"{BASE[verb]} {more}"
        for name, value in (words | replaced).items():
            text = text.replace(name, shlex.quote(str(value)))
        result = CliRunner().invoke(main, shlex.split(text))
        assert "Traceback" not in result.output
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
        return result

    return run


def is_a(kind, path):
    if kind == "unreadable" and os.getuid() == 0:
        pytest.skip("root reads everything")
    NO_FILES[kind](path)
    return path


def test_every_verb_is_in_this_test():
    assert {verb.split()[0] for verb in BASE} == set(main.commands)


@pytest.mark.parametrize("verb", BASE)
def test_an_unknown_option_is_a_usage_error(call, verb):
    assert call(verb, "--nonsense").exit_code == USAGE


@pytest.mark.parametrize("kind", NO_FILES)
@pytest.mark.parametrize("verb", WITH_RIG)
def test_a_rig_file_that_is_none_is_a_configuration_error(call, tmp_path, verb, kind):
    result = call(verb, "--rig DIR/my-rig.toml", UNUSED=is_a(kind, tmp_path / "my-rig.toml"))
    assert result.exit_code == CONFIGURATION, result.output
    assert "my-rig.toml" in result.output


@pytest.mark.parametrize("verb", WITH_SET)
@pytest.mark.parametrize("text", ["nonsense", "bus.nonsense=1", "bus.period_s=fast", "bus.period_s=" + "9" * 5000])
def test_an_override_that_is_none_is_a_configuration_error(call, verb, text):
    assert call(verb, f"--set {text}").exit_code == CONFIGURATION


@pytest.mark.parametrize("kind", NO_FILES)
@pytest.mark.parametrize("verb", WITH_RECORDING)
def test_a_recording_that_is_none_is_a_usage_error_and_a_missing_one_a_missing_file(call, tmp_path, verb, kind):
    result = call(verb, RECORDING=is_a(kind, tmp_path / "theirs.pcapng"))
    assert result.exit_code == (CONFIGURATION if kind == "missing" else USAGE), result.output
    assert "theirs.pcapng" in re.sub(r"\W*\n\W*", "", result.output)


@pytest.mark.parametrize("kind", ["missing", "directory", "other"])
@pytest.mark.parametrize("verb", WITH_EDS)
def test_an_eds_file_that_is_none_is_a_configuration_error(call, tmp_path, verb, kind):
    result = call(verb, EDS=is_a(kind, tmp_path / "their.eds"))
    assert result.exit_code == CONFIGURATION, result.output
    assert "their.eds" in result.output


@pytest.mark.parametrize("kind", NO_FILES)
@pytest.mark.parametrize("verb", ["simulate", "emulate"])
@pytest.mark.parametrize("option", ["--faults", "--script"])
def test_a_fault_file_or_script_that_is_none_is_a_configuration_error(call, tmp_path, verb, kind, option):
    result = call(verb, f"{option} DIR/file.toml", x=is_a(kind, tmp_path / "file.toml"))
    assert result.exit_code == CONFIGURATION, result.output
    assert "file.toml" in result.output


@pytest.mark.parametrize("kind", NO_FILES)
def test_a_sweep_file_that_is_none_is_a_configuration_error(call, tmp_path, kind):
    result = call("sweep", SWEEP=is_a(kind, tmp_path / "their.toml"))
    assert result.exit_code == CONFIGURATION, result.output
    assert "their.toml" in result.output


@pytest.mark.parametrize(("verb", "option", "suffix"), OUTPUTS)
def test_a_file_that_cannot_be_written_is_a_usage_error(call, tmp_path, verb, option, suffix):
    (tmp_path / f"folder{suffix}").mkdir()
    for place in (f"/proc/nonexistent/x{suffix}", f"{tmp_path}/folder{suffix}"):
        assert call(verb, f"{option} {place}").exit_code == USAGE
    if suffix:
        result = call(verb, f"{option} {tmp_path}/rig.toml")
        assert result.exit_code == USAGE
        assert "ends in" in result.output


@pytest.mark.parametrize(("verb", "option", "suffix"), OUTPUTS)
def test_a_file_that_exists_is_not_replaced_unless_asked(call, tmp_path, verb, option, suffix):
    mine = tmp_path / f"mine{suffix}"
    mine.write_text("mine")
    link = tmp_path / f"link{suffix}"
    link.symlink_to(tmp_path / "nowhere")
    for path in (mine, link):
        result = call(verb, f"{option} {path}")
        assert result.exit_code == USAGE, result.output
        assert "replace it with --overwrite" in " ".join(result.output.replace("│", " ").split())
    assert mine.read_text() == "mine"
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize(
    "words",
    ["simulate --record", "simulate --truth", "emulate --record"],
)
def test_a_full_disk_is_a_usage_error_before_anything_is_armed(call, words):
    verb, _, option = words.partition(" ")
    result = call(verb, f"{option} /dev/full")
    assert result.exit_code == USAGE, result.output
    assert "No space left" in result.output


@pytest.mark.parametrize(
    "words",
    [
        *(
            "simulate --seconds x",
            "simulate --seconds -1",
            "simulate --seed x",
            "run --cpu 99999",
            "run --cpu -1",
            "run --cpu x",
        ),
        *(
            "emulate --cpu 99999",
            "emulate --priority 100",
            "emulate --seconds 0",
            "watch --interval 0",
            "watch --seconds nan",
            "plan --axes 0",
            "measure --rounds 1",
        ),
        *("doctor --latency 0", "doctor --latency x", "doctor --cpu 99999", "doctor --bus x"),
        *("plan --bitrate x", "plan --errors x", "node --node-id 0", "node --node-id 128", "conformance --node 0"),
        *(
            "conformance --timeout 0",
            "bridge --drop 2",
            "replay_--bus --speed 0",
            "replay_--bus --ids x",
            "eds_check --node-id 0",
        ),
        *(
            "demo --seed x",
            "analyse --mass x",
            "analyse_map --workers 0",
            "analyse_map --axis x",
            "simulate --mode turbo",
            "sweep --processes 0",
            "sweep --keep-recordings some",
            "sweep --processes 2 --dask tcp://127.0.0.1:1",
            "sweep -o /dev/null/sweep",
            "sweep -o /dev/null",
            "experiment --observer 0",
            "experiment --virtual",
            "experiment --subject ../S01",
        ),
    ],
)
def test_a_value_that_is_none_is_a_usage_error(call, words):
    verb, _, more = words.partition(" ")
    assert call(verb.replace("_", " "), more).exit_code == USAGE


@pytest.mark.parametrize("verb", WITH_BUS)
def test_a_bus_that_is_not_there_is_told_as_such(call, verb):
    result = call(verb)
    assert result.exit_code == BUS, result.output
    assert "coulombus:none" in result.output


@pytest.mark.parametrize(
    "verb", ["run", "stop", "status", "measure", "watch", "emulate", "node", "conformance", "replay --bus", "bridge"]
)
def test_a_name_that_is_no_bus_is_a_usage_error(call, verb):
    base = BASE[verb].replace("coulombus:none", "canbus0")
    result = CliRunner().invoke(
        main,
        shlex.split(
            base.replace("RECORDING", "recording.pcapng").replace("EDS", shlex.quote(str(ROOT / "eds/motor.eds")))
        ),
    )
    assert result.exit_code == USAGE, result.output


def test_every_exception_has_a_status_of_the_table():
    found = set()
    for path in ROOT.rglob("*.py"):
        if not {".venv", "tests"} & set(path.relative_to(ROOT).parts):
            found |= set(map(int, re.findall(r"exit_status(?:: ClassVar\[int\])? = (\d+)$", path.read_text(), re.M)))
    assert found <= set(STATUSES)


def test_help_and_documents_show_the_table():
    shown = " ".join(CliRunner().invoke(main, ["help", "exit"]).output.split())
    document = (ROOT / "docs" / "tools.md").read_text()
    for status, text in STATUSES.items():
        assert f"{status} {' '.join(text.split())}" in shown
        assert f"| {status} | {text} |" in document


@pytest.mark.parametrize("verb", BASE)
def test_a_verbs_help_says_where_the_table_is(verb):
    words = [word for word in verb.split() if not word.startswith("--")]
    assert CliRunner().invoke(main, [*words, "--help"]).output.rstrip().endswith(EXIT_STATUS)


@pytest.mark.parametrize("as_json", [False, True])
def test_a_mistake_of_this_program_is_no_failed_check(monkeypatch, as_json):
    """The interpreter's own end with a traceback is 1, a verdict on the rig."""

    def mistaken(name, overrides):
        raise KeyError("6072h")

    monkeypatch.setattr("coulombus.rigs.rig.load_rig", mistaken)
    result = CliRunner().invoke(main, ["check", *(["--json"] if as_json else [])])
    assert result.exit_code == FAULT == 70
    assert "in mistaken" in result.stderr
    assert result.stderr.splitlines()[-1] == ("coulombus: internal error, please report it: KeyError: '6072h'")
    if as_json:
        assert json.loads(result.stdout)["exit_status"] == FAULT


def test_a_bridge_goes_on_whoever_reads_that_it_is_ready(monkeypatch):
    reached = []

    def join(a, b, *, ready, **options):
        ready(a, b)
        reached.append("joined")
        return Result()

    def refused(text):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    monkeypatch.setattr("coulombus.sim_bus.server.bridge.bridge", join)
    monkeypatch.setattr("coulombus.cli.bridge.echo", refused)
    monkeypatch.setattr("coulombus.system.exit.abandon_stdout", lambda: reached.append("abandoned"))
    assert CliRunner().invoke(main, ["bridge", "coulombus:a", "coulombus:b", "--json"]).exit_code == 0
    assert reached[:2] == ["abandoned", "joined"]


def test_a_recording_does_not_command_the_terminal(call, tmp_path):
    with PcapngWriter(tmp_path / "theirs.pcapng", attachments={}) as writer:
        writer.write(new_records(Frame, 1), {0: "phase \x1b]52;c;aGVsbG8=\x07 \x9b2J"})
    shown = call("decode", "--rig bench", RECORDING=tmp_path / "theirs.pcapng").output
    assert "phase \\x1b]52;c;aGVsbG8=\\x07 \\x9b2J" in shown
    assert not set(shown) & set("\x1b\x07\x9b")


TWO_BUSES = ("axis.left.bus.channel=a", "axis.right.bus.channel=b")


def test_a_file_of_any_bus_that_exists_is_told_before_the_first_bus_is_run(call, tmp_path):
    mine = tmp_path / "run.b.pcapng"
    mine.write_text("mine")
    both = " ".join(f"--set {text}" for text in TWO_BUSES)
    for result in (
        call("simulate", f"--rig two_axes {both} --record DIR/run.pcapng"),
        CliRunner().invoke(main, f"run --rig two_axes {both} --record {tmp_path}/run.pcapng".split()),
    ):
        assert result.exit_code == USAGE, result.output
        assert f"{mine}: exists; choose another name" in result.output
    assert mine.read_text() == "mine"
    assert not (tmp_path / "run.a.pcapng").exists()


def test_what_a_link_stands_for_is_not_replaced_by_a_recording(call, tmp_path):
    mine = tmp_path / "rig.toml"
    mine.write_text("mine")
    (tmp_path / "link.pcapng").symlink_to(mine)
    result = call("simulate", "--record DIR/link.pcapng --force")
    assert result.exit_code == USAGE
    assert "rig.toml: expected a name that ends in .pcapng" in " ".join(result.output.split())
    assert mine.read_text() == "mine"


@pytest.mark.parametrize("option", ["record", "truth"])
def test_in_python_too_nothing_is_replaced_unless_forced(tmp_path, option):
    mine = tmp_path / "mine.pcapng"
    mine.write_text("mine")
    with pytest.raises(FileExistsError, match="force=True"):
        simulate("bench", "hybrid", 0.01, **{option: mine})
    assert mine.read_text() == "mine"


def write_new(path, *, force, meanwhile):
    with new_file(path, force=force) as beside:
        beside.write_text("new")
        meanwhile()


def test_a_file_that_comes_to_exist_meanwhile_is_not_replaced(tmp_path):
    mine = tmp_path / "plan.png"

    def found():
        return [(path.name, path.read_text()) for path in tmp_path.iterdir()]

    with pytest.raises(FileExistsError, match="exists"):
        write_new(mine, force=False, meanwhile=lambda: mine.write_text("mine"))
    assert found() == [("plan.png", "mine")]
    with pytest.raises(ZeroDivisionError):  # what is not whole replaces nothing
        write_new(mine, force=True, meanwhile=lambda: 1 / 0)
    assert found() == [("plan.png", "mine")]
    write_new(mine, force=True, meanwhile=lambda: None)
    assert found() == [("plan.png", "new")]


@pytest.mark.parametrize(
    "words",
    [
        "simulate --seconds 0.1 --record DIR/one.pcapng --truth DIR/one.pcapng",
        "conformance EDS --junit DIR/one --report DIR/one",
    ],
)
def test_two_outputs_of_one_name_are_refused_before_anything_is_run(tmp_path, words):
    words = words.replace("DIR", str(tmp_path)).replace("EDS", shlex.quote(str(ROOT / "eds/motor.eds")))
    result = CliRunner().invoke(main, shlex.split(words))
    assert result.exit_code == USAGE, result.output
    assert "writes there, too; choose another name" in " ".join(result.output.split())
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_read_is_named():
    """Opening names a file, reading does not: "[Errno 5] Input/output error" was all that
    was said.
    """
    if not Path("/proc/self/mem").exists():
        pytest.skip("no /proc/self/mem")
    result = CliRunner().invoke(main, ["decode", "/proc/self/mem", "--rig", "bench"])
    assert result.exit_code == 2
    assert "/proc/self/mem: Input/output error" in result.output
    result = CliRunner().invoke(main, ["check", "--rig", "/proc/self/mem.toml"])
    assert result.exit_code == 3
    with pytest.raises(OSError, match="Input/output error: '/proc/self/mem'"):
        read_regular("/proc/self/mem")


def test_several_buses_pass_their_options_on(monkeypatch):
    """--cpu was forgotten."""
    asked = []
    monkeypatch.setattr("coulombus.host.run.buses.supervise", lambda channels, words: asked.append(words("a")) or [])
    cpu = str(min(os.sched_getaffinity(0)))
    buses = [word for axis in ("left", "right") for word in ("--set", f'axis.{axis}.bus.channel="{axis[0]}"')]
    buses = [word.replace('"l"', '"a"').replace('"r"', '"b"') for word in buses]
    CliRunner().invoke(main, ["run", "--rig", "two_axes", *buses, "--cpu", cpu, "--seconds", "2"])
    (words,) = asked
    assert words[words.index("--cpu") + 1] == cpu


@pytest.mark.parametrize("error", [BrokenPipeError(), OSError(errno.ENOSPC, "No space left on device")])
def test_buses_are_served_on_whoever_reads_their_lines(monkeypatch, error):
    """The thread that passed the lines on died of the first one, and its bus stood still when the
    pipe was full.
    """

    def refused(line):
        raise error

    abandoned = []
    monkeypatch.setattr("coulombus.cli.emulate.echo", refused)
    monkeypatch.setattr("coulombus.cli.emulate.abandon_stdout", lambda: abandoned.append(1))

    def supervise(channels, words, tell):
        for channel in channels:
            tell(channel, "bus is ready")
        return [SimpleNamespace(status=0)]

    monkeypatch.setattr("coulombus.host.run.buses.supervise", supervise)
    assert emulate._sim_buses(["emulate"], {"a": None, "b": None}) == 0
    assert abandoned == [1, 1]
