"""Who is to blame: a client, the node, the wire, the host, the configuration."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.explain.explanation_text import as_dict
from explain_log import MS, TYPE_402, Log, drive, kinds, machine, only

READ, ANSWER, GAVE_UP = "4041600000000000", "4b41600037020000", "8041600000000405"


def asked(*rows):
    """Return a machine of node 3 with SDO frames: (ms, from the node, data)."""
    log = machine(3)
    for ms, from_node, data in rows:
        log.add(ms, (0x580 if from_node else 0x600) + 3, bytes.fromhex(data))
    return log


@pytest.mark.parametrize(
    ("rows", "kind", "who", "status"),
    [
        ([(500, 0, READ), (500.4, 1, ANSWER), (800, 0, GAVE_UP)], "sdo_not_taken", "client", "unresolved"),
        ([(500, 0, READ), (520, 0, GAVE_UP), (530, 1, ANSWER)], "sdo_late", "client", "recovered"),
        ([(500, 0, READ), (1500, 0, GAVE_UP), (1700, 1, ANSWER)], "sdo_late", "node", "recovered"),
        ([(500, 0, READ), (800, 0, READ), (880, 1, ANSWER), (881, 1, ANSWER)], "sdo_repeated", "client", "warning"),
        ([(500, 0, READ), (501, 1, "4b40600037020000"), (900, 0, GAVE_UP)], "sdo_wrong_object", "node", "unresolved"),
        (
            [(500, 0, READ), (500.5, 0, "406c600000000000"), (501, 1, ANSWER), (501.5, 1, "436c600000000000")],
            "sdo_overlap", "client", "warning",
        ),
        ([(500, 0, READ), (900, 0, GAVE_UP)], "sdo_timeout", "node", "unresolved"),
        ([(500 + 200 * k, 0, data) for k in range(6) for data in [(READ, GAVE_UP)[k % 2]]], "not_hearing", "node", "unresolved"),
        ([(500, 0, READ), (501, 1, "8041600000000206")], "sdo_refused_read", "client", "warning"),
        ([(500, 0, "2b17100164000000"), (501, 1, "8017100122000008")], "sdo_abort", "client", "unresolved"),
        ([(500, 0, "a108200004000000"), (501, 0, "8008200000000008")], "sdo_client_abort", "client", "warning"),
        (
            [(500, 0, "210020000a000000"), (501, 1, "6000200000000000"), (502, 0, "0041424344454647"),
             (503, 1, "2000000000000000"), (504, 0, "1148494a00000000"), (505, 1, "3000000000000000")],
            "sdo_data", "client", "unresolved",
        ),
    ],
)  # fmt: skip
def test_an_sdo_incident_names_the_one_who_did_not_wait_or_answer(rows, kind, who, status):
    explanation = asked(*rows).explained()
    incident = only(explanation)
    assert (incident.root.kind, incident.node, incident.who, incident.status) == (kind, 3, who, status)
    assert as_dict(explanation)["incidents"][0]["who"] == who


def test_a_client_that_takes_a_later_answer_has_recovered():
    rows = [(500, 0, READ), (500.4, 1, ANSWER), (800, 0, GAVE_UP), (900, 0, READ), (901, 1, ANSWER), (950, 0, READ)]
    assert only(asked(*rows, (951, 1, ANSWER)).explained()).status == "recovered"


def test_answers_that_nobody_asked_for_are_the_nodes():
    strays = [(600 + k, 1, "4b40600000000000") for k in (0, 60, 120)]
    incident = only(asked((500, 0, READ), (501, 1, ANSWER), *strays).explained())
    assert (incident.root.kind, incident.who) == ("sdo_stray", "node")


def test_equal_warnings_of_a_poll_are_one_incident():
    log = machine(3, until=30e3)
    for k in range(14):
        log.ask(3, 500 + 2000 * k, "4008100000000000", "8008100000000206")
    explanation = log.explained()
    assert (kinds(explanation), explanation.incidents[0].count) == (["sdo_refused_read"], 14)


def host_and_drive(*, written=()):
    """Return a host and an enabled drive whose velocity is 1000; the host falls silent at 2 s."""
    log = machine(5, until=6000).beats(0x7F, 60, 2000).ask(5, 20, "4000100000000000", TYPE_402)
    for number, (write, answer) in enumerate((
        ("23001a0110004160", "60001a0100000000"), ("23001a0220006c60", "60001a0200000000"),
        ("2f001a0002000000", "60001a0000000000"), *written,
    )):  # fmt: skip
        log.ask(5, 22 + number, write, answer)
    for ms in np.arange(70, 6000, 10):
        log.add(ms, 0x185, (0x1637).to_bytes(2, "little") + (1000).to_bytes(4, "little"))
    return log


def test_a_drive_that_runs_on_without_its_host_heads_the_list():
    explanation = host_and_drive().explained()
    first, second = explanation.incidents
    assert (first.root.kind, first.node, first.status, first.who) == ("runs_on", 5, "unresolved", "configuration")
    assert "velocity 1000; this log has no write of 1016h:01, 6007h:00, 1400h:05" in first.root.text
    assert (second.root.kind, second.node, second.who) == ("host_lost", 0x7F, "host")


def test_a_drive_that_a_watch_stops_does_not_run_on():
    log = host_and_drive()
    log.rows = [row for row in log.rows if not (row[1] == 0x185 and row[0] > 2200 * MS)]
    for ms in np.arange(2200, 6000, 10):
        log.add(ms, 0x185, (0x1650).to_bytes(2, "little") + bytes(4))
    assert "runs_on" not in kinds(log.explained())


@pytest.mark.parametrize("command", [0x80, 0x02, 0x81])
@pytest.mark.parametrize("node", [0, 5])
def test_a_host_that_orders_its_nodes_away_ends_in_order(command, node):
    log = machine(5, until=2000).beats(0x7F, 60, 2000).order(2000, command, node)
    if command == 0x81:
        log.boot(5, 2100)
    assert log.beats(5, 2065 if command != 0x81 else 2130, 4000, state=0x7F).explained().verdict == "ok"


def test_a_node_that_ignores_a_reset_does_not_hear():
    incident = only(machine(3, 4, until=9000).order(4000, 0x81, 3).explained())
    assert (incident.root.kind, incident.node, incident.who) == ("not_hearing", 3, "node")


def test_a_node_that_does_not_boot_after_a_reset_is_lost():
    log = machine(3, until=20e3).boot(4, 2).beats(4, 63, 4000).order(4000, 0x81, 4)
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.status) == ("node_lost", 4, "unresolved")
    assert "it does not boot" in incident.root.text


def test_two_devices_tell_two_states_in_turn():
    log = machine(3, until=4000).boot(3, 1930).beats(3, 2013, 4000, state=0x7F)
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.who) == ("duplicate_node", 3, "configuration")


def test_operational_nodes_without_a_pdo_are_told():
    log = machine(3, until=5000)
    for ms in np.arange(60, 5000, 10):
        log.add(ms, 0x080)
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.who) == ("no_pdo", 3, "configuration")
    log.add(900, 0x183, b"\1")
    assert log.explained().verdict == "ok"


def test_an_lss_refusal_and_a_time_that_stops_are_told():
    log = machine(3, until=20e3).add(100, 0x7E5, bytes.fromhex("11c8000000000000"))
    log.add(101, 0x7E4, bytes.fromhex("1101000000000000"))
    for second in range(1, 7):
        log.add(1000 * second, 0x100, bytes(6))
    assert sorted(kinds(log.explained())) == ["lss_refused", "time_lost"]


def test_sync_that_jitters_is_no_second_producer_and_comes_not_twice():
    log, dice = machine(3, until=8000), np.random.default_rng(5)
    for ms in np.arange(60, 8000, 10):
        log.add(ms + dice.uniform(0, 6), 0x080)
    log.add(70, 0x183, b"\1")
    assert kinds(log.explained()) == ["sync_jitter"]


def test_sync_that_is_late_and_caught_up_is_no_second_producer():
    log = machine(3, until=8000)
    for cycle, ms in enumerate(np.arange(60, 8000, 2)):
        log.add(max(ms, 60 + 400 * (cycle // 200) + 30), 0x080).add(ms + 35, 0x183, bytes((cycle % 7,)))
    assert set(kinds(log.explained())) <= {"sync_gap", "sync_lost", "repeated", "tpdo_late"}


def test_an_event_timer_beside_sync_is_healthy():
    for clock in (500e-6, 5000e-6):
        log = machine(3, until=25e3)
        for ms in np.arange(60, 25e3, 20):
            log.add(ms, 0x080)
        for ms in np.arange(61, 25e3, 20 * (1 + clock)):
            log.add(ms, 0x183, b"\1\2")
        assert log.explained().verdict == "ok"


def test_a_timer_that_waits_for_the_burst_behind_sync_is_not_late():
    log = machine(3, until=3000).cycles(60, 3000)
    for cycle in range(1470):
        after_ms = 1.95 if cycle < 60 else (0.07, 0.71)[cycle // 3 % 2]
        log.add(60 + 2 * cycle + after_ms, 0x283, b"\1\2")
    assert log.explained().verdict == "ok"


def test_error_frames_with_which_a_silence_begins_are_its_cause():
    log = machine(3, 4, until=2000).cycles(60, 2000, (3, 4))
    for k in range(200):
        log.error(2000 + 5 * k, 0x088, bytes((0, 0, 4, 8, 0, 0, 0, 0)))
    assert only(log.explained()).root.kind == "error_frames"


def test_a_cyclic_drive_that_drops_bit_12_ignores_its_set_points():
    log = drive(machine(5), 5, [(0, 0x1637), (1500, 0x0637)]).ask(5, 30, "2f60600008000000", "6060600000000000")
    log.ask(5, 32, "4061600000000000", "4f61600008000000")
    incident = only(log.explained())
    assert (incident.root.kind, incident.node) == ("setpoint_ignored", 5)


def test_emergencies_alone_are_no_canopen():
    log = Log()
    for ms in np.arange(0, 3000, 100):
        for can_id in (0x081, 0x0A1):
            log.add(ms, can_id, bytes.fromhex("0ad7231200000000"))
    explanation = log.explained()
    assert (explanation.verdict, explanation.nodes) == ("ok", ())
    assert "does not look like CANopen" in explanation.remarks[0]


def test_each_node_has_its_figures():
    log = machine(3, until=4000).ask(3, 500, READ, ANSWER, after=0.5).ask(3, 600, READ, ANSWER, after=1.5)
    log.ask(3, 700, READ, ANSWER, after=2.5).add(900, 0x083, bytes.fromhex("1042010000000000"))
    for ms in np.arange(1000, 2000, 10):
        log.add(ms, 0x183, b"\1")
    (node,) = as_dict(log.explained())["nodes"]
    assert (node["boots"], node["emcy"], node["sdo_transfers"]) == (1, 1, 3)
    assert node["heartbeat_s"] == pytest.approx([0.1, 0.1, 0.1])
    assert node["sdo_response_s"] == pytest.approx([0.0005, 0.0015, 0.0025])
    assert node["pdos_per_s"] == pytest.approx(100 / 3.96, rel=0.02)
    assert node["states"]["OPERATIONAL"] > 0.97


def test_a_frame_too_short_for_its_service_is_a_warning():
    log = machine(3).add(500, 0x000, b"\x01").add(700, 0x083, b"\x10").add(900, 0x583, bytes(5))
    explanation = log.explained()
    assert (explanation.verdict, set(kinds(explanation))) == ("warnings", {"service_length"})
    assert {clue.text for incident in explanation.incidents for clue in incident.clues} == {
        "NMT (000h) with 1 bytes, expected 2", "EMCY (083h) with 1 bytes, expected 8", "SDO (583h) with 5 bytes, expected 8",
    }  # fmt: skip


def test_a_program_that_is_loaded_is_no_lost_node():
    log = machine(3, until=20e3).boot(4, 2).beats(4, 63, 4000)
    log.ask(4, 4000, "2f511f0100000000", "60511f0100000000").boot(4, 12e3).order(12.1e3, 1, 4)
    assert log.beats(4, 12.2e3, 20e3).explained().verdict == "ok"


def test_a_poll_in_turn_says_for_what_it_waits():
    log = Log()
    for k in range(400):
        node = 1 + k % 4
        log.ask(node, 100 + 1.2 * k, READ, ANSWER, after=1.0)
    (remark,) = log.explained().remarks
    assert remark.startswith("SDO asks 4 nodes in turn: a round waits 4 x 1 ms for answers, 83% of the time")


def test_nodes_that_restart_at_once_share_something():
    log = machine(3, 4, 5, until=2000)
    for place, node in enumerate((3, 4, 5)):
        log.boot(node, 2000 + 10 * place).beats(node, 2063 + place, 4000, state=0x7F)
    (remark,) = log.explained().remarks
    assert remark == "nodes 3, 4, 5 restarted within 100 ms: look at the supply and cable that they share"
