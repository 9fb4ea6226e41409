"""The incidents of a live bus: found while frames come, followed, shown and opened."""

import io

import numpy as np
from rich.console import Console

from coulombus.monitor.incident_lines import OpenedIncident, incident_dict, news
from coulombus.monitor.live import Live
from coulombus.monitor.live_incidents import IncidentReader, LiveIncidents
from coulombus.monitor.screen import Screen, as_dict, as_lines
from coulombus.monitor.watch import ViewKeys
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame_batches import Block

S = 1_000_000_000
T0 = 1_800_000_000 * S
FACTS = {"bus": "coulombus:bench", "bitrate_bit_s": 1_000_000, "lost": 0, "malformed": 0}
RIG = load_rig("bench")


def frame(t_s, can_id, data=b""):
    return (T0 + round(t_s * S), can_id, len(data), data.ljust(8, b"\0"))


def beats(begin_s, end_s, *nodes):
    """Heartbeats of operational nodes, ten a second."""
    times = np.arange(begin_s, end_s - 1e-9, 0.1)
    return [frame(t_s, 0x700 + node, b"\x05") for t_s in times for node in nodes]


def emergency(t_s):
    return frame(t_s, 0x081, bytes.fromhex("1042010000000000"))


def followed(*batches):
    """What is known after each batch, which is (frames, time of the look [s])."""
    incidents = LiveIncidents(KnownBus(RIG))
    looks = []
    for frames, t_s in batches:
        incidents.add_frames(Block.from_frames(frames))
        looks.append(incidents.update(T0 + round(t_s * S)))
    return looks


def test_an_incident_is_told_when_it_is_one_and_its_state_is_followed():
    first, second, third = followed(
        (beats(0, 2, 1, 2), 2),
        ([*beats(2, 3, 1, 2), emergency(3)], 3),
        ([*beats(3, 3.5, 1, 2), frame(3.5, 0x081, bytes(8)), *beats(3.5, 5, 1, 2)], 5),
    )
    assert first == ()
    (told,), (over,) = second, third
    assert (told.status, over.status) == ("unresolved", "recovered")
    assert told.key == over.key
    assert told.title.startswith("motor (node 1): ")
    assert (told.begin_ns, told.end_ns) == (T0 + 3 * S, None)
    assert over.end_ns == T0 + round(3.5 * S)
    assert len(told.checks) == 3
    assert told.course[0][0] == T0 + 3 * S


def test_a_bus_that_falls_silent_is_an_incident_though_no_frame_comes():
    sync = [frame(k / 1000, 0x80) for k in range(2000)]
    before, after = followed((sync, 2.0), ([], 4.0))
    assert before == ()
    assert [row.status for row in after] == ["unresolved"]


def test_a_healthy_bus_has_none():
    assert followed((beats(0, 5, 1, 2), 5), (beats(5, 9, 1, 2), 9)) == [(), ()]


def orderly_end():
    """A host in OPERATIONAL cycles, orders PRE-OPERATIONAL, and ends; its nodes go on."""
    cycles = [frame(k / 1000, 0x80) for k in range(3000)]
    host = [frame(k / 10, 0x77F, b"\x05") for k in range(31)]
    nodes = [frame(k / 10 + 0.01, 0x700 + n, b"\x05" if k < 30 else b"\x7f") for k in range(80) for n in (1, 2)]
    orders = [frame(0.001, 0, b"\x01\x00"), frame(3.005, 0, b"\x80\x00")]
    return sorted([*cycles, *host, *nodes, *orders, frame(0.02, 0x181, bytes(8))])


def test_an_orderly_end_is_no_incident_whenever_somebody_looks():
    frames = orderly_end()
    for step_ms in (250, 400, 1100):
        batches = []
        for t_ms in range(step_ms, 8000, step_ms):
            inside = [f for f in frames if t_ms - step_ms <= (f[0] - T0) // 1_000_000 < t_ms]
            batches.append((inside, t_ms / 1000))
        assert followed(*batches) == [()] * len(batches), step_ms


def test_a_host_that_vanishes_is_an_incident():
    frames = [f for f in orderly_end() if f[0] <= T0 + 3 * S or f[1] in (0x701, 0x702)]
    (rows,) = followed((frames, 8))
    assert "host" in rows[0].title or "SYNC" in rows[0].title
    assert rows[0].status == "unresolved"


def test_the_reader_goes_on_where_a_look_fails(monkeypatch):
    reader = IncidentReader(KnownBus(RIG))
    reader.add_frames([*beats(0, 1, 1, 2), emergency(1)])
    reader.update(T0 + 2 * S)
    (row,) = reader.rows
    assert row.title.startswith("motor")

    def fail(now_ns):
        raise ValueError("an odd bus")

    monkeypatch.setattr("coulombus.monitor.live_incidents.LOOK_S", 0.0)
    monkeypatch.setattr(reader, "update", fail)
    reader._run()
    assert reader.failure == "the search for incidents has ended: ValueError: an odd bus"
    reader.add_frames(beats(1, 2, 1))
    assert reader._waiting == []


def shown(rows, opened="", height=50, width=100):
    live = Live(KnownBus(RIG))
    live.add_frames([frame(0.1, 0x080)])
    console = Console(file=io.StringIO(), width=width, height=height, color_system=None, force_terminal=True)
    facts = {**FACTS, "keys": "q end"}
    console.print(Screen(live.snapshot(T0 + S), facts, (), T0, True, (), rows, opened))
    return console.file.getvalue()


def test_the_end_of_the_search_is_told():
    snapshot, ended = (
        Live(KnownBus(RIG)).snapshot(T0 + S),
        FACTS | {"incidents_end": "the search for incidents has ended: why"},
    )
    assert any("! the search for incidents has ended: why" in line for line in as_lines(snapshot, ended, T0))
    assert as_dict(snapshot, ended, T0)["incidents_end"] == "the search for incidents has ended: why"
    assert not any("search" in line for line in as_lines(snapshot, FACTS, T0))


def test_frames_that_come_with_one_stamp_are_searched():
    """A bus without time packs some frames into a message, which has one stamp."""
    burst = [frame(1 + k / 1000, 0x181, bytes(8)) for k in range(200) for _ in range(10)]
    (found,) = followed(([*beats(0, 1.3, 1, 2), *burst], 1.3))[0]
    assert found.title.startswith("motor (node 1): ")
    assert "several times with one stamp" in " ".join(text for _, _, text in found.course)


def test_the_screen_lists_incidents_and_opens_one():
    (rows,) = followed((sorted([*beats(0, 3, 1, 2), emergency(1)]), 3))
    (row,) = rows
    closed = shown(rows)
    assert "incidents: 1, 1 unresolved" in closed
    assert f" 1  unresolved  1.000 s to now  {row.title}" in closed
    assert row.checks[1][:30] not in closed
    opened = shown(rows, row.key)
    for number, check in enumerate(row.checks, 1):
        assert f"{number}. {check[:40]}" in opened
    assert f"cause ({row.sure}): " in opened
    assert "incidents" not in shown(())
    for height in range(12, 40):
        lines = shown(rows, row.key, height).splitlines()
        assert len(lines) <= height
        assert all(len(line) <= 100 for line in lines)


def test_a_digit_opens_the_incident_that_has_the_number_then_and_closes_it():
    (rows,) = followed((sorted([*beats(0, 3, 1, 2), emergency(1)]), 3))
    keys, opened = ViewKeys(), OpenedIncident()
    assert opened.follow(keys.number, keys.strokes, rows) == ""
    keys.struck(b"1")
    assert opened.follow(keys.number, keys.strokes, rows) == rows[0].key
    assert opened.follow(keys.number, keys.strokes, ()) == rows[0].key  # no key was struck since
    keys.struck(b"1")
    assert opened.follow(keys.number, keys.strokes, rows) == ""
    keys.struck(b"7")
    assert opened.follow(keys.number, keys.strokes, rows) == ""


def test_lines_tell_a_change_once_and_json_has_all():
    second, third = followed(
        (sorted([*beats(0, 3, 1, 2), emergency(1)]), 3),
        ([*beats(3, 3.5, 1, 2), frame(3.5, 0x081, bytes(8)), *beats(3.5, 5, 1, 2)], 5),
    )
    known = {}
    (line,) = news(second, known, T0)
    assert line.startswith("     1.000  ! incident 1, unresolved: motor (node 1): ")
    assert list(news(second, known, T0)) == []
    (line,) = news(third, known, T0)
    assert "* incident 1, recovered" in line
    live = Live(KnownBus(RIG))
    (entry,) = as_dict(live.snapshot(T0), FACTS, T0, third)["incidents"]
    assert entry == incident_dict(third[0], T0)
    assert (entry["status"], entry["t_s"], entry["end_s"], len(entry["check"])) == ("recovered", 1.0, 3.5, 3)
