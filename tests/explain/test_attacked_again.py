"""More logs that misled `explain` once: clients that poll or wait, settings that end something, and stamps of batches."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.wire.can_flags import CAN_ERR_FLAG
from explain_log import Log, kinds, machine, only

READ, ANSWER = "4001640100000000", "4b01640111000000"


def polled(until_ms, *, alive=False, period=500):
    """Return a machine whose node 4 answers a poll until 5 s, and nothing after it."""
    log = machine(3, until=until_ms).boot(4, 4)
    if alive:
        log.beats(4, 64, until_ms)
    for ms in np.arange(1000, until_ms, period):
        log.ask(4, ms, READ, ANSWER if ms < 5000 else None)
    return log


@pytest.mark.parametrize(("alive", "kind"), [(False, "sdo_timeout"), (True, "not_hearing")])
@pytest.mark.parametrize("period", [300, 500, 1000])
def test_a_poll_without_answers_is_told_while_it_goes_on(alive, kind, period):
    incident = only(polled(20e3, alive=alive, period=period).explained())
    assert (incident.root.kind, incident.node, incident.status) == (kind, 4, "unresolved")


def test_a_client_that_waits_for_a_node_at_work_is_healthy():
    log = machine(3, until=12e3).ask(3, 2000, "2f571f0103000000", "60571f0100000000", after=2500)
    assert log.explained().verdict == "ok"


def test_a_client_that_asks_until_a_node_boots_is_healthy():
    log = machine(3, until=6000).boot(7, 2000).beats(7, 2100, 6000, state=0x7F)
    for ms in np.arange(300, 2000, 100):
        log.ask(7, ms, "4000100000000000")
    assert log.ask(7, 2010, "4000100000000000", "4300100091010200").explained().verdict == "ok"


def test_a_scan_of_all_node_ids_is_healthy():
    log = machine(3, until=5000).beats(0x7F, 70, 5000)
    for node in range(1, 128):
        log.ask(node, 2000 + node, "4000100000000000", "4300100091010200" if node == 3 else None)
    assert log.explained().verdict == "ok"


def test_answers_about_another_object_are_no_silence():
    log = machine(3, until=9000)
    for ms in range(1000, 6000, 1000):
        log.ask(3, ms, READ, "4b01640211000000").ask(3, ms + 600, "8001640100000405")
    incident = only(log.explained())
    assert (incident.root.kind, incident.who) == ("sdo_wrong_object", "node")


@pytest.mark.parametrize(
    ("request_", "answer", "kind", "who"),
    [
        ("e001640100000000", "8001640101000405", "sdo_abort", "client"),  # an unknown command
        (READ, "8001640100000606", "sdo_abort", "node"),  # a hardware error
        (READ, "8001640105000405", "sdo_abort", "node"),  # out of memory
    ],
)
def test_an_abort_is_of_whom_its_code_is(request_, answer, kind, who):
    log = machine(3, until=4000)
    for ms in (1000, 2000):
        log.ask(3, ms, request_, answer)
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.who) == (kind, 3, who)


def test_a_toggle_bit_that_a_client_refuses_is_the_nodes():
    log = machine(3, until=4000).ask(3, 1000, "4008100000000000", "4108100010000000")
    log.ask(3, 1001, "6000000000000000", "0041424344454647").ask(3, 1002, "7000000000000000", "0041424344454647")
    log.ask(3, 1003, "8008100000000305")
    incident = only(log.explained())
    assert (incident.root.kind, incident.who) == ("sdo_client_abort", "node")


def test_a_node_that_is_given_a_heartbeat_time_and_never_beats_is_lost():
    log = machine(3, until=9000).boot(4, 4).ask(4, 200, "2b171000f4010000", "6017100000000000")
    assert (only(log.explained()).root.kind, only(log.explained()).node) == ("node_lost", 4)


def test_a_program_that_is_started_and_never_boots_is_lost():
    log = machine(3, until=40e3).boot(4, 4).ask(4, 1000, "2f511f0101000000", "60511f0100000000")
    assert (only(log.explained()).root.kind, only(log.explained()).node) == ("node_lost", 4)


def mapped(log, node, kind):
    """Configure a node's first TPDO, with a transmission type."""
    log.ask(node, 30, f"2f001802{kind:02x}000000", "6000180200000000")
    log.ask(node, 32, "23001a0110000060", "60001a0100000000")
    return log.ask(node, 34, "2f001a0001000000", "60001a0000000000")


def test_a_pdo_of_each_second_sync_is_told_when_it_stops():
    log = mapped(machine(3, 4, until=9000), 4, 2).cycles(60, 9000, period=10)
    for cycle, ms in enumerate(np.arange(60.3, 6000, 20)):
        log.add(ms, 0x184, cycle.to_bytes(2, "little"))
    incident = only(log.explained())
    assert (incident.root.kind, incident.node) == ("pdo_stopped", 4)


def test_a_pdo_that_a_client_switches_off_is_the_clients():
    log = mapped(machine(3, 4, until=9000), 4, 1).cycles(60, 9000, period=10)
    for cycle, ms in enumerate(np.arange(60.3, 6000, 10)):
        log.add(ms, 0x184, cycle.to_bytes(2, "little"))
    log.ask(4, 6000, "2300180184010080", "6000180100000000")
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.who) == ("tpdo_missing", 4, "client")
    assert "1800h:01 was written with 80000184h" in incident.root.text


def test_sync_that_a_client_switches_off_is_no_loss():
    log = machine(3, 4, until=9000).cycles(60, 6000, (3,)).ask(4, 20, "2305100080000040", "6005100000000000")
    log.ask(4, 6000, "2305100080000000", "6005100000000000")
    assert "sync_lost" not in kinds(log.explained())


def test_an_error_that_ends_while_another_one_remains_is_unresolved():
    log = machine(3, until=6000).add(2000, 0x083, bytes.fromhex("1042090000000000"))
    assert only(log.add(3000, 0x083, bytes.fromhex("0000010000000000")).explained()).status == "unresolved"
    assert only(log.add(4000, 0x083, bytes(8)).explained()).status == "recovered"


def test_two_nodes_with_one_cob_id_are_told():
    log = machine(3, 4, until=2000)
    for node in (3, 4):
        log.ask(node, 30 + node, "2300180183010000", "6000180100000000")
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.who) == ("same_cob_id", 4, "configuration")


def test_set_points_to_nodes_that_nobody_starts_are_told():
    log = Log().beats(0x7F, 20, 15e3).boot(3, 3).beats(3, 63, 15e3, state=0x7F)
    for ms in np.arange(100, 15e3, 50):
        log.add(ms, 0x203, b"\1\0")
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.who) == ("not_started", 3, "host")


@pytest.mark.parametrize("before_ms", [20, 200, 450])
def test_set_points_that_end_before_the_command_to_all_are_in_order(before_ms):
    log = machine(3, 4, until=4000).beats(0x7F, 60, 6000)
    for ms in np.arange(70, 4000 - before_ms, 10):
        log.add(ms, 0x203, b"\1\2")
    log.order(4000, 2).beats(3, 4063, 6000, state=4).beats(4, 4064, 6000, state=4)
    assert log.explained().verdict == "ok"


def test_a_restart_outranks_the_pdo_that_stopped_before_it():
    log = mapped(machine(3, until=9000).boot(4, 4).beats(4, 64, 5000, period=500), 4, 255)
    log.ask(4, 36, "2b001805c8000000", "6000180500000000").boot(4, 5750).beats(4, 6200, 9000, state=0x7F, period=500)
    for cycle, ms in enumerate(np.arange(70, 5000, 200)):
        log.add(ms, 0x184, cycle.to_bytes(2, "little"))
    incident = only(log.explained())
    assert (incident.root.kind, incident.node) == ("restarted", 4)


def test_a_host_in_mid_traffic_is_who_ends_with_sync():
    log = Log().beats(0x7F, 20, 6000, period=500).cycles(50, 6000, (3, 4), period=10)
    for node in (3, 4):
        log.beats(node, 100 * node, 12e3, period=500)
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.who) == ("host_lost", 0x7F, "host")


def test_frames_that_the_recorder_lost_are_no_gap_of_sync():
    log = machine(3, until=6000).cycles(60, 6000, (3,), period=10)
    log.rows = [row for row in log.rows if not (row[1] == 0x80 and 4970e6 < row[0] < 4999e6)]
    log.rows.append((round(5000e6), CAN_ERR_FLAG | 4, 8, 1 << 8, 0))
    assert log.explained().incidents[0].root.kind == "overrun"


@pytest.mark.parametrize(("period", "batch"), [(5, 16), (10, 16), (20, 16), (1, 4), (20, 100)])
def test_stamps_of_batches_say_nothing_of_times(period, batch):
    log = machine(3, 4, until=9000).cycles(60, 9000, (3, 4), period=period)
    log.rows = [((t_ns // (batch * 10**6) + 1) * batch * 10**6, *others) for t_ns, *others in sorted(log.rows)]
    explanation = log.explained()
    assert explanation.verdict == "ok"
    assert f"{batch} ms apart" in explanation.remarks[0]


def test_a_node_that_is_lost_in_batches_is_lost():
    log = machine(3, until=9000).boot(4, 4).beats(4, 64, 5000).cycles(60, 9000, (3,), period=10)
    log.rows = [((t_ns // (16 * 10**6) + 1) * 16 * 10**6, *others) for t_ns, *others in sorted(log.rows)]
    assert (only(log.explained()).root.kind, only(log.explained()).node) == ("node_lost", 4)


def test_an_encoder_that_moves_and_rests_is_healthy():
    log = machine(3, until=40e3)
    for begin, end in ((1000, 3000), (5000, 8000), (12e3, 14e3), (20e3, 23e3), (30e3, 31e3)):
        for ms in np.arange(begin, end, 20):
            log.add(ms, 0x283, round(1000 * ms).to_bytes(4, "little"))
    assert log.explained().verdict == "ok"


def test_a_request_of_a_wrong_length_is_the_clients():
    log = machine(3, until=3000)
    for ms in (1000, 1100, 1200):
        log.add(ms, 0x603, bytes.fromhex("4000100000"))
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.who) == ("service_length", 3, "client")
