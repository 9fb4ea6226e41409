"""What `explain` tells of logs made by hand, kind by kind, and what it leaves alone."""

from __future__ import annotations

import pytest

from coulombus.explain.incident_words import KINDS
from explain_log import DISABLED, ENABLED, FAULT, TYPE_402, Log, drive, kinds, machine, only


def test_a_machine_at_work_is_ok():
    told = machine(3, 4).cycles(60, 3000, (3, 4)).explained()
    assert (told.verdict, told.incidents) == ("ok", ())
    assert [(node.number, node.state, node.well) for node in told.nodes] == [
        (3, "OPERATIONAL", True),
        (4, "OPERATIONAL", True),
    ]


def test_an_ordered_stop_is_no_incident():
    log = machine(3, 4, until=2000).cycles(60, 1500, (3, 4)).order(1500, 128)
    log.rows = [row for row in log.rows if not (row[1] >= 0x700 and row[0] > 1500e6)]
    log.beats(3, 1510, 3000, state=127).beats(4, 1520, 3000, state=127)
    assert log.explained().verdict == "ok"


def test_a_node_that_falls_silent_is_lost():
    log = machine(3, 4).cycles(60, 3000, (3, 4), skip=lambda cycle, node: node == 4 and cycle > 600)
    log.rows = [row for row in log.rows if not (row[1] == 0x704 and row[0] > 1262e6)]
    told = log.explained()
    incident = only(told)
    assert (incident.root.kind, incident.node, incident.status) == ("node_lost", 4, "unresolved")
    assert {clue.kind for clue in incident.clues} == {"node_lost", "tpdo_missing"}
    assert incident.begin_ns / 1e9 == pytest.approx(1.2603, abs=0.003)
    assert told.verdict == "unresolved"


def test_a_heartbeat_alone_that_stops_is_no_lost_node():
    log = machine(3, 4).cycles(60, 3000, (3, 4))
    log.rows = [row for row in log.rows if not (row[1] == 0x704 and row[0] > 1200e6)]
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.status) == ("heartbeat_lost", 4, "unresolved")


def test_a_node_that_comes_back_is_recovered():
    log = machine(3, 4)
    log.rows = [row for row in log.rows if not (row[1] == 0x703 and 1000e6 < row[0] < 1900e6)]
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.status) == ("node_lost", 3, "recovered")


def test_a_boot_up_without_an_order_is_a_restart():
    log = machine(3, 4)
    log.rows = [row for row in log.rows if not (row[1] == 0x703 and row[0] > 1500e6)]
    told = log.boot(3, 1580).beats(3, 1600, 3000, state=127).explained()
    incident = only(told)
    assert (incident.root.kind, incident.node, incident.status) == ("restarted", 3, "unresolved")


def test_a_boot_up_after_an_ordered_reset_is_none():
    log = machine(3, 4)
    log.rows = [row for row in log.rows if not (row[1] == 0x703 and row[0] > 1500e6)]
    log.order(1510, 129, 3).boot(3, 1580).order(1590, 1, 3).beats(3, 1600, 3000)
    assert log.explained().verdict == "ok"


def test_a_node_that_leaves_operational_by_itself_is_seen():
    log = machine(3, 4)
    log.rows = [row for row in log.rows if not (row[1] == 0x703 and row[0] > 1500e6)]
    incident = only(log.beats(3, 1563, 3000, state=127).explained())
    assert (incident.root.kind, incident.node, incident.status) == ("left_operational", 3, "unresolved")


def test_a_start_that_a_node_does_not_follow_is_seen():
    log = Log().boot(3).boot(4, 1).order(50, 1).beats(3, 60, 3000).beats(4, 65, 3000, state=127)
    incident = only(log.explained())
    assert (incident.root.kind, incident.node) == ("not_started", 4)


@pytest.mark.parametrize(("cleared", "status"), [(True, "recovered"), (False, "unresolved")])
def test_an_emergency_is_reported_until_it_is_cleared(cleared, status):
    log = machine(3).add(1000, 0x083, bytes.fromhex("1042010000000000"))
    if cleared:
        log.add(1500, 0x083, bytes(8))
    incident = only(log.explained())
    assert (incident.root.kind, incident.status, incident.sure) == ("emcy", status, "reported")
    assert "0x4210: device temperature too high" in incident.root.text


def test_a_fault_and_its_emergency_are_one_incident():
    words = [(0, ENABLED), (1000, FAULT), (1800, DISABLED), (1900, ENABLED)]
    log = drive(machine(5), 5, words).add(1001, 0x085, bytes.fromhex("2171010000000000")).add(1801, 0x085, bytes(8))
    for ms, word in ((80, 0x0F), (1200, 0x80), (1300, 0x00), (1790, 0x80), (1810, 0x0F)):
        log.add(ms, 0x205, word.to_bytes(2, "little"))
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.status) == ("drive_fault", 5, "recovered")
    assert (incident.diagnosis.kind, incident.sure, incident.axes) == ("emcy", "reported", (1,))
    assert "0x7121: motor blocked" in incident.diagnosis.text
    assert [clue.text for clue in incident.clues if clue.kind == "reset_failed"] == [
        "reset 1 had no effect: the drive stays in FAULT"
    ]
    assert incident.root.end_text == "it leaves FAULT, 0.01 s after reset 2"


def test_a_drive_that_is_not_enabled_says_which_step_stops():
    log = drive(machine(5), 5, [(0, 0x0231)])
    for ms in range(100, 3000, 20):
        log.add(ms, 0x205, (0x000F).to_bytes(2, "little"))
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.status) == ("not_following", 5, "unresolved")
    assert "stays Ready To Switch On" in incident.root.text


def test_a_quick_stop_that_nobody_commands_is_seen():
    log = drive(machine(5), 5, [(0, ENABLED), (1000, 0x0217), (1500, DISABLED)])
    for ms in range(100, 3000, 20):
        log.add(ms, 0x205, (0x000F if ms < 1500 else 0).to_bytes(2, "little"))
    assert only(log.explained()).root.kind == "quick_stop"


def test_a_refused_write_names_object_and_remedy():
    log = machine(3).ask(3, 500, "2b17100102000000", "8017100111000906")
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.status) == ("sdo_abort", 3, "unresolved")
    assert "1017h:01 (producer heartbeat time)" in incident.root.text
    assert incident.root.check.startswith("Compare with the device's EDS file: the object has no such sub-index")


def test_a_refused_write_that_succeeds_later_is_recovered():
    log = machine(3).ask(3, 500, "2b17100064000000", "8017100022000008")
    incident = only(log.ask(3, 900, "2b17100064000000", "6017100000000000").explained())
    assert (incident.root.kind, incident.status) == ("sdo_abort", "recovered")


def test_an_optional_object_that_is_missing_is_a_warning():
    told = machine(3).ask(3, 500, "4008100000000000", "8008100000000206").explained()
    assert (told.verdict, kinds(told)) == ("warnings", ["sdo_refused_read"])


def test_a_setting_that_reads_back_otherwise_is_seen():
    log = machine(3).ask(3, 500, "2316100164007f00", "6016100100000000")
    incident = only(log.ask(3, 600, "4016100100000000", "43161001c8007f00").explained())
    assert (incident.root.kind, incident.node) == ("not_applied", 3)


def test_a_request_without_an_answer_is_a_missing_node_or_a_busy_one():
    absent = only(machine(3).ask(9, 500, "4000100000000000").explained())
    assert (absent.root.kind, absent.node, absent.status) == ("node_missing", 9, "unresolved")
    busy = only(machine(3, until=9000).ask(3, 500, "4000100000000000").explained())
    assert (busy.root.kind, busy.node) == ("sdo_timeout", 3)


def test_a_scan_of_all_node_ids_is_no_missing_node():
    log = machine(3)
    for node in range(20, 60):
        log.ask(node, 500 + node, "4000100000000000")
    assert log.explained().verdict == "ok"


def test_a_segmented_transfer_that_ends_half_way_is_seen():
    log = machine(3).ask(3, 500, "4008100000000000", "4108100010000000").ask(3, 501, "60" + "00" * 7, "00" + "41" * 7)
    incident = only(log.ask(3, 600, "4000100000000000", TYPE_402).explained())
    assert (incident.root.kind, incident.node) == ("sdo_incomplete", 3)


def test_a_segmented_transfer_that_is_whole_is_none():
    log = machine(3).ask(3, 500, "4008100000000000", "410810000a000000").ask(3, 501, "60" + "00" * 7, "00" + "41" * 7)
    log.ask(3, 502, "70" + "00" * 7, "19414141" + "00" * 4).ask(3, 600, "4000100000000000", TYPE_402)
    assert log.explained().verdict == "ok"


def test_sync_that_stops_is_the_cause_of_what_follows():
    log = machine(3, 4).cycles(60, 1500, (3, 4))
    log.add(1600, 0x083, bytes.fromhex("0087110000000000")).add(1601, 0x084, bytes.fromhex("0087110000000000"))
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.status) == ("sync_lost", None, "unresolved")
    assert [clue.kind for clue in incident.clues] == ["sync_lost", "emcy", "emcy"]


def test_a_late_sync_is_a_warning():
    log = machine(3).cycles(60, 1500, (3,)).cycles(1506, 3000, (3,))
    assert kinds(log.explained()) == ["sync_gap"]


def test_two_producers_of_sync_are_told():
    log = machine(3).cycles(60, 3000, (3,))
    for ms in range(1000, 3000, 2):
        log.add(ms + 0.7, 0x080)
    incident = only(log.explained())
    assert (incident.root.kind, incident.status) == ("two_sync", "unresolved")


def test_tpdos_that_are_missing_are_counted_and_come_again():
    log = machine(3, 4).cycles(60, 3000, (3, 4), skip=lambda cycle, node: node == 4 and 500 <= cycle < 520)
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.status) == ("tpdo_missing", 4, "recovered")
    assert incident.root.end_text.endswith("20 were missing")


def test_a_sync_that_no_node_heard_is_one_incident_of_the_bus():
    log = machine(3, 4).cycles(60, 3000, (3, 4), skip=lambda cycle, node: cycle == 500)
    incident = only(log.explained())
    assert (incident.root.kind, incident.node) == ("tpdo_missing", None)


def test_tpdos_that_come_late_are_a_warning():
    log = machine(3).synchronous(3, 20).cycles(60, 3000)
    for cycle, ms in enumerate(range(60, 3000, 2)):
        log.add(ms + (0.2 if not 600 < cycle < 700 else 1.5), 0x183, bytes((cycle % 7, 1)))
    told = log.explained()
    assert (kinds(told), told.incidents[0].node, told.verdict) == (["tpdo_late"], 3, "warnings")


def test_two_devices_of_one_node_id_are_told_by_their_tpdos():
    log = machine(3).cycles(60, 3000, (3,))
    for cycle, ms in enumerate(range(1000, 3000, 2)):
        log.add(ms + 0.9, 0x183, bytes((9, cycle % 5)))
    incident = only(log.explained())
    assert (incident.root.kind, incident.node) == ("duplicate_node", 3)


def test_two_devices_of_one_node_id_are_told_by_two_answers():
    log = (
        machine(3)
        .ask(3, 500, "4018100400000000", "4318100401000000")
        .add(500.6, 0x583, bytes.fromhex("4318100402000000"))
    )
    incident = only(log.explained())
    assert (incident.root.kind, incident.node) == ("duplicate_node", 3)


def test_two_devices_of_one_node_id_are_told_by_their_heartbeats():
    incident = only(machine(3).beats(3, 1030, 3000).explained())
    assert (incident.root.kind, incident.node) == ("duplicate_node", 3)


def test_two_masters_are_told_by_their_set_points():
    log = machine(3).cycles(60, 3000, (3,))
    for cycle, ms in enumerate(range(60, 3000, 2)):
        log.add(ms + 1.0, 0x203, bytes((0x0F, 0, cycle % 3)))
        if ms > 1500:
            log.add(ms + 1.4, 0x203, bytes((0x0F, 0, 77)))
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.status) == ("second_master", 3, "unresolved")


def test_set_points_that_stop_are_the_cause_of_the_fault():
    log = drive(machine(5).cycles(60, 3000, ()), 5, [(0, ENABLED), (1100, FAULT)], step=2.0)
    for ms in range(60, 1000, 2):
        log.add(ms + 1.0, 0x205, (0x0F).to_bytes(2, "little"))
    incident = only(log.add(1099, 0x085, bytes.fromhex("5082110000000000")).explained())
    assert (incident.root.kind, incident.node) == ("rpdo_missing", 5)
    assert {"drive_fault", "emcy"} <= {clue.kind for clue in incident.clues}


def test_an_identifier_that_floods_the_bus_is_babble():
    log = machine(3)
    for k in range(900):
        log.add(1000 + 0.15 * k, 0x010, b"\x55")
    assert kinds(log.explained()) == ["babble"]


def test_frames_that_came_twice_are_told_from_the_third_on():
    log = machine(3).cycles(60, 3000, (3,), data=lambda cycle, node: cycle.to_bytes(4, "little"))
    log.add(260.32, 0x183, (100).to_bytes(4, "little")).add(460.32, 0x183, (200).to_bytes(4, "little"))
    assert log.explained().verdict == "ok"
    log.add(660.32, 0x183, (300).to_bytes(4, "little"))
    told = log.explained()
    assert (told.verdict, kinds(told)) == ("warnings", ["repeated"])


def test_error_frames_now_and_then_are_no_incident_and_many_are():
    log = machine(3).cycles(60, 3000, (3,))
    for k in range(5):
        log.error(500 + 450 * k, 0x088, bytes((0, 0, 4, 8, 0, 0, 0, 0)))
    assert log.explained().verdict == "ok"
    for k in range(30):
        log.error(2000 + 10 * k, 0x088, bytes((0, 0, 4, 8, 0, 0, 0, 0)))
    assert kinds(log.explained()) == ["error_frames"]


def test_bus_off_stands_until_the_restart():
    log = machine(3).error(1000, 0x040, bytes(8))
    assert only(log.explained()).status == "unresolved"
    assert only(log.error(1500, 0x100, bytes(8)).explained()).status == "recovered"


def test_a_silent_bus_is_the_cause_of_all():
    log = machine(3, 4).cycles(60, 1500, (3, 4)).cycles(1900, 3000, (3, 4))
    log.rows = [row for row in log.rows if not 1500e6 < row[0] < 1900e6]
    incident = only(log.explained())
    assert (incident.root.kind, incident.status) == ("bus_silent", "recovered")


def test_a_pdo_shorter_than_its_map_is_seen():
    log = (
        machine(3).ask(3, 20, "23001a0110004160", "60001a0100000000").ask(3, 21, "23001a0220006460", "60001a0200000000")
    )
    log.ask(3, 22, "2f001a0002000000", "60001a0000000000").ask(3, 23, "2f00180201000000", "6000180200000000")
    log.cycles(60, 3000, (3,), data=lambda cycle, node: bytes(6 if cycle < 500 else 4))
    incident = only(log.explained())
    assert (incident.root.kind, incident.node) == ("pdo_length", 3)
    assert "has 4 bytes, its map (SDO seen in the log) 6" in incident.root.text


def test_a_trip_is_the_end_of_the_incident_that_led_to_it():
    log = machine(3, 4).cycles(60, 3000, (3, 4), skip=lambda cycle, node: node == 4 and cycle > 600)
    row = int((log.frames["t_ns"] < 1270e6).sum())
    incident = only(log.explained(comments=[(row, "trip TPDO_LOST: no complete set of TPDOs")]))
    assert [clue.kind for clue in incident.clues] == ["tpdo_missing", "host_trip"]
    assert (incident.root.kind, incident.node) == ("tpdo_missing", 4)


def test_a_trip_alone_is_an_incident_and_an_ordered_end_is_none():
    log = machine(3).cycles(60, 3000, (3,))
    assert log.explained(comments=[(900, "safe"), (10, "phase rest")]).verdict == "ok"
    incident = only(log.explained(comments=[(900, "trip SPEED: too fast")]))
    assert (incident.root.kind, incident.sure, incident.status) == ("host_trip", "reported", "unresolved")


def test_two_faults_of_two_nodes_are_two_incidents():
    log = machine(3, 4).ask(3, 500, "2b17100102000000", "8017100111000906")
    told = log.add(2000, 0x084, bytes.fromhex("1042010000000000")).explained()
    assert [(incident.root.kind, incident.node) for incident in told.incidents] == [("sdo_abort", 3), ("emcy", 4)]


@pytest.mark.parametrize("pieces", [2, 7, 40])
def test_pieces_of_a_log_are_told_as_the_whole_is(pieces):
    log = machine(3, 4).cycles(60, 3000, (3, 4), skip=lambda cycle, node: node == 4 and 500 <= cycle < 520)
    log.add(2500, 0x084, bytes.fromhex("1042010000000000"))
    whole, parts = log.explained(), log.explained(pieces=pieces)
    assert [vars(i.root) for i in parts.incidents] == [vars(i.root) for i in whole.incidents]
    assert kinds(whole) == ["emcy", "tpdo_missing"]


def test_what_is_no_canopen_is_said_to_be_none():
    log = Log()
    for ms in range(500):
        log.add(ms, 0x18FEF100 | 1 << 31, bytes(8))
    told = log.explained()
    assert told.verdict == "ok"
    assert "does not look like CANopen: 29-bit" in told.remarks[0]


def test_every_kind_has_three_steps_and_no_rank_is_shared_by_a_cause_and_a_report():
    for name, kind in KINDS.items():
        assert len(kind.checks) == 3, name
        assert all((kind.title, kind.cause, kind.why, kind.clause, *kind.checks)), name
    assert KINDS["rpdo_missing"].rank > KINDS["drive_fault"].rank > KINDS["emcy"].rank > KINDS["host_trip"].rank


def test_a_producer_that_beats_in_its_own_cycle_is_not_late():
    log = Log().boot(3).order(50, 1)
    ms = 60.0
    for gap in (40, 40, 40, 40, 60, 40, 60, 60, 40, 40, 60, 40, 60, 60.1, 40, 60):
        log.add(ms, 0x703, b"\5")
        ms += gap
    assert log.explained().verdict == "ok"


@pytest.mark.parametrize(("consumer_ms", "expected"), [(0, ["heartbeat_late"]), (100, ["heartbeat_late"]), (400, [])])
def test_a_heartbeat_is_late_by_its_usual_spread_and_its_consumer(consumer_ms, expected):
    log = machine(3, 4)
    log.rows = [row for row in log.rows if not (row[1] == 0x703 and row[0] > 1500e6)]
    if consumer_ms:
        words = 3 << 16 | consumer_ms
        log.ask(4, 20, "23161001" + words.to_bytes(4, "little").hex(), "6016100100000000")
    assert kinds(log.beats(3, 1630, 3000).explained()) == expected
