"""Logs that misled `explain` once: a false all-clear, an invention, or a wrong culprit."""

from __future__ import annotations

import numpy as np
import pytest

from explain_log import TYPE_402, kinds, machine, only

PREOP, STOP, RESET = 0x80, 0x02, 0x81


@pytest.mark.parametrize(("command", "node"), [(RESET, 3), (STOP, 3)])
def test_a_host_that_dies_after_a_command_to_one_node_is_lost(command, node):
    log = machine(4, 5, until=6000).boot(3, 3).beats(3, 63, 2000).beats(0x7F, 60, 3000).order(2000, command, node)
    log.boot(3, 2050).beats(3, 2063, 6000, state=0x7F if command == RESET else 4)
    assert ("host_lost", 0x7F) in [(i.root.kind, i.node) for i in log.explained().incidents]


def test_a_host_that_dies_before_it_has_started_a_node_is_lost():
    log = machine(until=500).order(60, PREOP).beats(0x7F, 60, 2000).boot(3, 3).beats(3, 63, 5000, state=0x7F)
    log.rows = [row for row in log.rows if row[1] or row[3] != 1]  # no start
    assert kinds(log.explained()) == ["host_lost"]


@pytest.mark.parametrize("period_ms", [0, 300, 1000])
def test_a_heartbeat_time_that_is_written_holds_at_once(period_ms):
    log = machine(4, until=9000).boot(3, 3).beats(3, 63, 1500, state=0x7F)
    value = period_ms.to_bytes(2, "little").hex()
    log.ask(3, 1500, f"2b171000{value}0000", "6017100000000000")
    if period_ms:
        log.beats(3, 1500 + period_ms, 9000, state=0x7F, period=period_ms)
    log.rows = [row for row in log.rows if not (row[1] == 0 and row[0] < 1000e6)]
    assert log.explained().verdict == "ok"


def test_a_heartbeat_that_is_switched_off_at_work_is_the_clients():
    log = machine(4, until=5000).boot(3, 3).beats(3, 63, 1500).ask(3, 1500, "2b17100000000000", "6017100000000000")
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.who) == ("heartbeat_lost", 3, "client")


@pytest.mark.parametrize("later_ms", [5, 30, 200])
def test_set_points_may_end_before_the_nodes_are_stopped(later_ms):
    log = machine(5, until=3000).synchronous(5, 20, rpdo=True).synchronous(5, 30)
    for number, (write, sub) in enumerate((("23001a0110004160", 1), ("2f001a0001000000", 0))):
        log.ask(5, 35 + 3 * number, write, f"60001a0{sub}00000000")
    for ms in np.arange(60, 2500, 10):
        log.add(ms, 0x080).add(ms + 1, 0x185, (0x0637 if ms < 1500 else 0x0250).to_bytes(2, "little"))
        if ms < 2000:
            log.add(ms + 2, 0x205, (0x0F if ms < 1500 else 0).to_bytes(2, "little"))
    log.rows = [row for row in log.rows if not (row[1] == 0x705 and row[0] > 2000e6)]
    log.order(2000 + later_ms, STOP).beats(5, 2100 + later_ms, 3000, state=4)
    log.rows = [row for row in log.rows if not (row[1] == 0x185 and row[0] > (2000 + later_ms) * 1e6)]
    assert not {"rpdo_missing", "tpdo_missing"} & set(kinds(log.explained()))


def test_an_input_that_is_even_while_it_moves_did_not_stop():
    log = machine(3, until=9000)
    for begin in (500, 3000, 6000):
        for k in range(60):
            log.add(begin + 20 * k, 0x283, (begin + 7 * k).to_bytes(4, "little"))
    assert log.explained().verdict == "ok"


def test_a_node_that_is_not_at_work_is_not_ordered_away():
    log = machine(4, until=3000).boot(3, 3).beats(3, 63, 1000, state=0x7F)
    for ms in np.arange(60, 3000, 10):
        log.add(ms, 0x203, bytes(2))
    log.rows = [row for row in log.rows if row[1] or row[0] > 1000e6]
    log.order(50, 1, 4).order(1000, RESET, 3).boot(3, 1100).order(1150, 1, 3).beats(3, 1200, 3000)
    assert "ordered_away" not in kinds(log.explained())


def test_a_lost_node_that_is_reset_in_vain_is_lost_and_not_ordered_away():
    log = machine(4, until=9000).boot(3, 3).beats(3, 63, 2000).order(2300, RESET, 3)
    for ms in np.arange(60, 9000, 10):
        log.add(ms, 0x203, bytes(2))
        if ms < 2000:
            log.add(ms + 1, 0x183, bytes(2))
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.who) == ("node_lost", 3, "node")


def test_a_node_that_nobody_starts_is_told():
    log = machine(until=500).boot(3, 3).boot(4, 4).order(60, 1, 3).beats(3, 63, 6000).beats(4, 64, 6000, state=0x7F)
    log.rows = [row for row in log.rows if row[1] or row[0] != 50e6]
    for ms in np.arange(70, 6000, 10):
        log.add(ms, 0x203, bytes(2)).add(ms, 0x204, bytes(2)).add(ms + 1, 0x183, bytes(2))
    incident = only(log.explained())
    assert (incident.root.kind, incident.node, incident.who) == ("not_started", 4, "host")


def test_an_emergency_ends_when_its_node_boots():
    log = machine(4, until=5000).boot(3, 3).beats(3, 63, 1000).add(900, 0x083, bytes.fromhex("1042010000000000"))
    log.order(1000, RESET, 3).boot(3, 1100).order(1150, 1, 3).beats(3, 1200, 5000)
    assert only(log.explained()).status == "recovered"


def test_a_timer_of_a_pdo_without_a_map_is_watched():
    log = machine(3, until=5000).ask(3, 20, "2b001803f4010000", "6000180300000000")
    for k in range(326):
        log.add(100 + 15 * k, 0x183, (k % 250).to_bytes(2, "little"))
    assert kinds(log.explained()) == ["inhibit_time"]


def test_bit_12_counts_in_a_mode_that_was_written_and_not_mapped():
    log = machine(5).ask(5, 20, "4000100000000000", TYPE_402).ask(5, 30, "2f60600009000000", "6060600000000000")
    for ms in np.arange(70, 3000, 10):
        log.add(ms, 0x185, (0x1637 if ms < 1500 else 0x0637).to_bytes(2, "little"))
    assert only(log.explained()).root.kind == "setpoint_ignored"


def test_a_sensor_that_sends_at_even_intervals_from_the_begin_and_stops_is_told():
    log = machine(3, until=6000)
    for ms in np.arange(70, 4000, 20):
        log.add(ms, 0x283, int(ms * 7).to_bytes(4, "little"))
    assert kinds(log.explained()) == ["pdo_stopped"]


def test_a_pdo_with_an_event_timer_that_stops_is_told():
    log = machine(3, until=6000).ask(3, 20, "2b00180514000000", "6000180500000000")
    for ms in np.arange(2000, 4000, 20):
        log.add(ms, 0x183, int(ms * 7).to_bytes(4, "little"))
    assert kinds(log.explained()) == ["pdo_stopped"]


def test_sync_may_get_another_period():
    log = machine(3, until=9000).synchronous(3, 20).cycles(60, 3000, (3,), period=10.0)
    log.order(3000, PREOP).ask(3, 3010, "23061000204e0000", "6006100000000000").order(3100, 1)
    log.cycles(3110, 9000, (3,), period=20.0)
    assert log.explained().verdict == "ok"
