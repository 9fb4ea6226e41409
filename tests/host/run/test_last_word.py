"""The last word of a host: left at its end, read by observers, forgotten by the next host."""

import json
import os
import re
import time
from datetime import datetime
from pathlib import Path

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.cli.watch import host_line
from coulombus.host.run import control_socket
from coulombus.host.run.control_socket import control_path
from coulombus.host.run.last_word import (
    ending,
    forget_word,
    keep_page,
    last_page,
    last_word,
    leave_word,
    newest_word,
    wall_time,
)
from coulombus.wire.address import parse_address

BUS = parse_address("coulombus:word")
OUTCOME = {
    "mode": "hybrid",
    "cycles": 812,
    "trip": None,
    "exit_status": 0,
    "stopped_by": "coulombus stop",
    "lost_pdos": 95,
    "missed_deadlines": 431,
}

pytestmark = pytest.mark.usefixtures("private_sockets")


def place():
    host = control_path(BUS)
    return host.with_name(host.name + ".last")


def test_it_is_read_after_the_end_and_forgotten_by_the_next_host():
    assert last_word(BUS) is None
    leave_word([BUS], OUTCOME)
    word = last_word(BUS)
    assert {**OUTCOME, "ended": word["ended"], "recording": None} == word
    assert ending(word).endswith(", stopped by coulombus stop")
    assert [path.name for path in place().parent.iterdir()] == [place().name]
    forget_word([BUS])
    assert last_word(BUS) is None
    leave_word([BUS], None)  # nothing was armed
    assert last_word(BUS) is None


def test_why_is_the_trip_else_who_stopped_it_else_its_time():
    word = {**OUTCOME, "ended": "2026-11-27T10:31:02.000000Z"}
    assert ", stopped by coulombus stop" in ending(word)
    assert ending(word | {"trip": "SPEED: too fast"}).endswith(", trip SPEED: too fast")
    assert ending(word | {"stopped_by": None}).endswith(", its display was over")
    assert ending(word | {"ended": "yesterday"}) == "stopped by coulombus stop"


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "[" * 5000, '{"mode": 1}', json.dumps({**OUTCOME, "ended": 3}), "\0\xff"]
)
def test_what_is_no_word_is_none(text):
    place().write_bytes(text.encode("latin-1"))
    assert last_word(BUS) is None
    assert host_line(BUS) is None


def test_a_word_that_cannot_be_left_raises_nothing(monkeypatch):
    place().mkdir()
    leave_word([BUS], OUTCOME)
    forget_word([BUS])
    assert last_word(BUS) is None


def test_the_page_of_a_trip_is_kept_until_the_next_host():
    leave_word([BUS], OUTCOME, Path("run.pcapng"))
    assert last_word(BUS)["recording"] == str(Path("run.pcapng").absolute())
    assert last_page(BUS) is None
    keep_page(BUS, b"seen")
    assert last_page(BUS) == b"seen"
    assert last_word(BUS)["cycles"] == OUTCOME["cycles"]
    forget_word([BUS])
    assert last_page(BUS) is None


def test_a_last_page_that_nobody_kept_names_what_is_left():
    words = ["watch", "--web", "--last"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 4
    assert "no host of this user on this machine has left a word" in " ".join(done.output.split())
    leave_word([BUS], OUTCOME)
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 4
    assert "did not trip; it ended" in " ".join(done.output.split())
    done = CliRunner().invoke(main, ["stop"])
    assert done.exit_code == 4
    assert "no host runs on bus coulombus:word; the last one ended" in " ".join(done.output.split())
    leave_word([BUS], OUTCOME | {"trip": "SPEED: too fast"}, Path("a run.pcapng"))
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 4
    text = " ".join(done.output.split())
    assert "no page was open at the end of the last host on bus coulombus:word" in text
    assert "trip SPEED: too fast" in text
    assert f"coulombus watch '{Path('a run.pcapng').absolute()}' --web" in text
    keep_page(BUS, b"{")
    assert "the page of the last trip cannot be read" in CliRunner().invoke(main, [*words, "--bus", str(BUS)]).output
    assert CliRunner().invoke(main, ["watch", "--last"]).exit_code == 2


def test_the_ten_newest_reports_stay():
    buses = [parse_address(f"coulombus:word{number}") for number in range(13)]
    for age_s, bus in enumerate(buses):
        leave_word([bus], OUTCOME)
        host = control_path(bus)
        os.utime(host.with_name(host.name + ".last"), (1e9 - age_s, 1e9 - age_s))
    other = place().with_name("other.json")
    other.write_text("{}")
    leave_word([BUS], OUTCOME)
    assert [bus for bus in (BUS, *buses) if last_word(bus)] == [BUS, *buses[:9]]
    assert other.exists()


def test_status_and_watch_tell_it():
    leave_word([BUS], OUTCOME | {"trip": "SPEED: too fast"})
    done = CliRunner().invoke(main, ["status", "--bus", str(BUS)])
    assert done.exit_code == 4
    for part in ("no host runs", "trip SPEED: too fast", "812 cycles", "95 PDOs lost", "431 deadlines missed"):
        assert part in done.output, part
    assert "what to do: coulombus help SPEED" in " ".join(done.output.split())
    line = host_line(BUS)
    assert line.state == "tripped"
    assert "trip SPEED: too fast" in line.text


def test_status_without_a_bus_tells_the_end_of_the_host_that_ended_last():
    assert newest_word() is None
    assert "no host runs on bus coulombus:bench" in CliRunner().invoke(main, ["status"]).output
    earlier, later = BUS, parse_address("socketcan:can7")
    for second, (bus, trip) in enumerate(((earlier, None), (later, "NMT_STATE: a node left"))):
        leave_word([bus], OUTCOME | {"trip": trip})
        file = control_path(bus).with_name(control_path(bus).name + ".last")
        word = json.loads(file.read_text())
        file.write_text(json.dumps(word | {"ended": f"2026-11-29T10:00:0{second}.000000Z"}))
    assert newest_word()[0] == later
    done = CliRunner().invoke(main, ["status"])
    assert done.exit_code == 4
    told = " ".join(done.output.split())
    assert "no host runs on bus socketcan:can7" in told
    assert "trip NMT_STATE: a node left" in told
    assert "coulombus help NMT_STATE" in told
    assert "no host runs on bus coulombus:bench" in CliRunner().invoke(main, ["status", "--rig", "bench"]).output


def test_a_stop_that_finds_no_host_says_where_one_runs(monkeypatch):
    monkeypatch.setattr(control_socket, "hosts_here", lambda: [parse_address("coulombus:rehearsal")])
    done = CliRunner().invoke(main, ["stop", "--bus", "coulombus:none"])
    assert done.exit_code == 4
    assert "no host runs on bus coulombus:none; on this machine one runs on coulombus:rehearsal" in " ".join(
        done.output.split()
    )


def test_a_trip_is_told_with_its_own_time_not_that_of_the_hosts_end():
    assert wall_time(0) is None
    second_ago = wall_time(time.monotonic_ns() - 1_000_000_000)
    leave_word([BUS], OUTCOME | {"trip": "SPEED: too fast", "tripped": second_ago})
    word = last_word(BUS)
    assert 0.9 <= (datetime.fromisoformat(word["ended"]) - datetime.fromisoformat(second_ago)).total_seconds() < 60
    later = ending(word | {"ended": "2026-11-29T12:00:05+00:00", "tripped": "2026-11-29T12:00:03+00:00"})
    assert re.match(r"2026-11-29 \d\d:\d\d:03, trip SPEED", later)
    assert re.match(r"2026-11-29 \d\d:\d\d:05", ending(word | {"ended": "2026-11-29T12:00:05+00:00", "tripped": None}))
