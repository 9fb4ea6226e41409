"""Tables in a terminal of 80 columns: nothing is cut, nothing wraps within a row."""

import io
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from rich.console import Console
from rich.table import Table

from coulombus.cli.main import main
from coulombus.cli.tables import print_fitting
from coulombus.monitor.decode import as_text, fitted
from coulombus.system.exit import say
from coulombus.system.wrap_text import folded, hanging

COLUMNS = 80
TABLES = (
    ["plan"],
    ["plan", "--rig", "two_axes"],
    ["plan", "--axes", "3"],
    ["plan", "--bitrate", "500000"],
    ["pdo", "--rig", "paper"],
    ["pdo"],
)


@pytest.fixture
def terminal(monkeypatch):
    monkeypatch.setattr("rich.console.Console.is_terminal", True)
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    monkeypatch.setenv("TERM", "dumb")


@pytest.mark.parametrize("arguments", TABLES, ids=" ".join)
def test_a_table_is_whole_in_a_terminal_of_80_columns(terminal, arguments):
    out = CliRunner().invoke(main, arguments).stdout
    assert out
    assert "…" not in out
    assert [line for line in out.splitlines() if len(line) > COLUMNS and "--set" not in line] == []


@pytest.mark.parametrize("arguments", [["check"], ["check", "--rig", "paper"]], ids=" ".join)
def test_a_list_ends_at_a_hundred_columns_in_a_pipe(arguments):
    out = CliRunner().invoke(main, arguments).stdout
    assert len(out.splitlines()) > 10
    assert [line for line in out.splitlines() if len(line) > 100] == []


def test_the_verdict_of_each_message_is_always_there(terminal):
    out = CliRunner().invoke(main, ["plan", "--rig", "two_axes"]).stdout
    rows = [line for line in out.splitlines() if line[:3].isalnum() and line[3:4] == "h"]
    assert len(rows) == 27
    assert all(line.endswith("ok") for line in rows)


def test_columns_are_left_out_in_their_order_and_only_as_needed():
    def shown(width):
        def build(left):
            table = Table(box=None, pad_edge=False)
            for name in "abcd":
                if name not in left:
                    table.add_column(name * 5, no_wrap=True)
            return table

        console = Console(width=width)
        with console.capture() as text:
            print_fitting(console, build, ("c", "b"))
        return "".join(sorted(set(text.get()) - {" ", "\n"}))

    assert (shown(26), shown(20), shown(13)) == ("abcd", "abd", "ad")


def test_a_decoded_frame_is_broken_between_its_signals():
    row = {"t_s": 1.0, "can_id": 0x181, "node": "motor", "pdo": "TPDO1", "service": None}
    row |= {"motor.statusword": 0x237, "motor.position_rad": 0.12345, "motor.torque_Nm": -0.00173}
    line = as_text(row)
    broken = fitted(line, COLUMNS)
    assert len(line) > COLUMNS >= max(map(len, broken.splitlines()))
    assert "position_rad=   +0.12345" in broken
    assert "".join(broken.split()) == "".join(line.split())
    assert fitted(line, 200) == line


def test_prose_goes_on_under_its_own_column():
    assert hanging("word       one two three", 15, 11) == "word       one\n           two\n           three"


@pytest.mark.parametrize(
    ("text", "piece"),
    [
        ("start one in another terminal with `coulombus emulate --rig my-rig.toml`", "`coulombus emulate --rig my-rig.toml`"),
        ("on a machine with others: --set motor.setpoint_fault_s=0.05 --seed 3", "--set motor.setpoint_fault_s=0.05 --seed 3"),
        ("what is withheld is told by coulombus commission --step friction: see", "coulombus commission --step friction:"),
        ("0 of 128 runs are done; to go on: coulombus sweep a/b.toml -o out/a", "coulombus sweep a/b.toml -o out/a"),
    ],
)  # fmt: skip
def test_what_is_to_be_copied_is_not_broken(text, piece):
    broken = hanging(text, 50, 2)
    assert piece in broken
    assert " ".join(broken.split()) == text
    assert len(broken.splitlines()) > 1


def test_what_is_said_breaks_between_words_and_a_pipe_has_it_whole(capsys, monkeypatch):
    text = "coulombus: " + "so many words that a terminal breaks them somewhere " * 3
    say(text)
    assert capsys.readouterr().err == text + "\n"
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    say(text + "\n    of a traceback" + 80 * "!")
    *lines, last = capsys.readouterr().err.splitlines()
    assert last == "    of a traceback" + 80 * "!"
    assert max(map(len, lines)) <= COLUMNS
    assert " ".join(line.strip() for line in lines) == text.strip()


def test_a_closed_stream_is_no_terminal():
    stream = io.StringIO()
    stream.close()
    assert folded(100 * "word ", stream) == 100 * "word "


def test_long_texts_of_a_run_stand_beneath_its_table_whole(capsys, monkeypatch):
    from coulombus.cli import run_table

    monkeypatch.setattr(run_table, "_columns", lambda results: results.items())

    class Result(SimpleNamespace):
        def __getattr__(self, name):
            return None

    path = "out/" + 30 * "long/" + "run.pcapng"
    run_table.print_runs({m: Result(cycles=7, recording=path, remarks=()) for m in ("active", "hybrid")})
    lines = capsys.readouterr().out.splitlines()
    assert f"recording, active: {path}" in lines
    assert max(len(line) for line in lines if path not in line) <= COLUMNS


def test_watch_tells_what_the_host_does(monkeypatch):
    from coulombus.cli.watch import host_line
    from coulombus.host.run import control_socket, last_word
    from coulombus.monitor.snapshot import HostLine

    found = {"mode": "hybrid", "trip": "SYNC lost", "axes": [{"axis": None, "phase": "tripped"}]}
    monkeypatch.setattr(control_socket, "ask_status", lambda address: found)
    assert host_line(None) == HostLine("host: mode hybrid  phase tripped  trip: SYNC lost", "tripped")

    def none(address):
        raise control_socket.NoHost("no host runs")

    monkeypatch.setattr(control_socket, "ask_status", none)
    monkeypatch.setattr(last_word, "last_word", lambda address: None)
    assert host_line(None) is None
    word = {"trip": None, "stopped_by": "coulombus stop", "ended": "", "lost_pdos": 95, "missed_deadlines": 431}
    monkeypatch.setattr(last_word, "last_word", lambda address: word)
    line = "no host; the last one ended stopped by coulombus stop; 95 PDOs lost, 431 deadlines missed"
    assert host_line(None) == HostLine(line, "ended")
    word["trip"] = "SPEED: too fast"
    assert host_line(None).state == "tripped"
