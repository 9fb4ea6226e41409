"""What `explain` tells of drives' values, of timers, load, guarding, histories, and of the host's own words."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.explain.explanation_text import checks, detail_lines, screen
from coulombus.kernels.records import new_records
from coulombus.recording.host_telemetry import FIRST, SOURCE_INSIDE
from coulombus.wire.can_flags import CAN_RTR_FLAG
from coulombus.wire.frame import Frame
from explain_log import DISABLED, ENABLED, Log, drive, machine, only


def mapped(log, node, number, words, transmission=1, timers=(0, 0), base=None):
    """Add the SDO configuration of a TPDO: map, transmission type, (inhibit time, event timer)."""
    communication, mapping = 0x1800 + number - 1, 0x1A00 + number - 1
    cob_id = (0x180 + 0x100 * (number - 1) if base is None else base) + node

    def write(index, subindex, value, size):
        at = (index & 0xFF, index >> 8, subindex)
        request = bytes((0x23 | (4 - size) << 2, *at)) + value.to_bytes(4, "little")
        log.ask(node, 20 + len(log.rows) / 10, request.hex(), bytes((0x60, *at, 0, 0, 0, 0)).hex(), 0.05)

    for subindex, word in enumerate(words, 1):
        write(mapping, subindex, word, 4)
    write(mapping, 0, len(words), 1)
    write(communication, 2, transmission, 1)
    for subindex, value in ((3, timers[0]), (5, timers[1])):
        write(communication, subindex, value, 2)
    write(communication, 1, cob_id, 4)
    return log


def shown(log, node, statuswords, others=(), until=3000, step=10.0):
    """Add TPDO1 of a drive: the statusword of that time, and more bytes."""
    ms = 70.0
    while ms < until:
        data = b"".join([w for begin, w in column if begin <= ms][-1] for column in (statuswords, *others))
        log.add(ms, 0x180 + node, data)
        ms += step
    return log


def word(value):
    return value.to_bytes(2, "little")


def told(incident):
    return incident.root.kind, incident.node, incident.status, incident.axes


def first_check(explanation):
    return checks(explanation.incidents[0])[0]


def test_a_following_error_stands_until_it_is_over():
    log = mapped(machine(5), 5, 1, (0x60410010, 0x60610008))
    words = [(0, word(ENABLED)), (1000, word(ENABLED | 0x2000)), (1800, word(ENABLED))]
    explanation = shown(log, 5, words, [[(0, b"\x08")]]).explained()
    assert told(only(explanation)) == ("following_error", 5, "recovered", (1,))
    assert only(explanation).sure == "reported"
    assert "following error (statusword bit 13)" in only(explanation).root.text
    assert first_check(explanation).startswith("Turn the axis by hand")


def test_bit_13_is_no_following_error_in_a_torque_mode():
    log = mapped(machine(5), 5, 1, (0x60410010, 0x60610008))
    assert shown(log, 5, [(0, word(ENABLED | 0x2000))], [[(0, b"\x0a")]]).explained().verdict == "ok"


def test_an_internal_limit_is_a_warning_and_of_the_second_axis():
    log = mapped(machine(5), 5, 1, (0x60410010, 0x68410010))
    words = [(0, word(ENABLED)), (1000, word(ENABLED | 0x0800)), (1500, word(ENABLED))]
    explanation = shown(log, 5, [(0, word(ENABLED))], [words]).explained()
    assert told(only(explanation)) == ("limit_active", 5, "warning", (2,))
    assert "6072h" in first_check(explanation)


def test_torque_of_a_drive_that_is_off_is_seen():
    log = mapped(machine(5), 5, 1, (0x60410010, 0x60770010))
    torques = [(0, word(0)), (1000, word(0x10000 - 200)), (2000, word(0))]
    explanation = shown(log, 5, [(0, word(DISABLED))], [torques]).explained()
    assert told(only(explanation)) == ("torque_when_off", 5, "recovered", (1,))
    assert "6077h:00 shows more than 10 %" in only(explanation).root.text
    assert first_check(explanation) == "Look whether the axis turns."


def test_a_mode_that_is_commanded_and_not_shown_is_seen():
    log = mapped(machine(5), 5, 1, (0x60410010, 0x60610008)).ask(5, 60, "2f60600008000000", "6060600000000000")
    explanation = shown(log, 5, [(0, word(ENABLED))], [[(0, b"\x08"), (1000, b"\x01")]]).explained()
    assert told(only(explanation)) == ("mode_refused", 5, "unresolved", (1,))
    assert "mode of operation 8 is commanded, 6061h:00 shows 1" in only(explanation).root.text
    assert first_check(explanation).startswith("Read 6502h")


def test_an_enable_that_leaves_a_step_out_says_which():
    log = drive(machine(5), 5, [(0, DISABLED)])
    for ms in range(100, 3000, 20):
        log.add(ms, 0x205, word(0x000F))
    explanation = log.explained()
    assert told(only(explanation)) == ("not_following", 5, "unresolved", (1,))
    assert "transition 2 to Ready To Switch On does not come, 0006h" in only(explanation).root.text
    assert "statusword bit 4" in first_check(explanation)


@pytest.mark.parametrize(
    ("timers", "gap_ms", "kind", "check"),
    [((0, 20), 45, "event_timer", "Read 1800h:05"), ((200, 0), 10, "inhibit_time", "Read 1800h:03")],
)
def test_timers_of_a_pdo_that_are_not_kept_are_warnings(timers, gap_ms, kind, check):
    log = mapped(machine(3), 3, 1, (0x60000008,), 254, timers)
    ms, gaps = 70.0, [20] * 60 + [gap_ms, 20] * 4 + [20] * 75
    for gap in gaps:
        log.add(ms, 0x183, bytes((int(ms) % 7,)))
        ms += gap
    explanation = log.explained()
    assert told(only(explanation)) == (kind, 3, "warning", ())
    assert first_check(explanation).startswith(check)


def test_an_error_history_that_is_read_is_named():
    explanation = machine(3).ask(3, 500, "4003100100000000", "4303100120230000").explained()
    assert told(only(explanation)) == ("error_history", 3, "warning", ())
    assert "1003h:01 (error history) has 0x2320: short circuit or earth leakage" in only(explanation).root.text
    assert first_check(explanation).startswith("Look whether that error came in this log")


def guarded(toggles, beats=True):
    """Return a log in which node 3 is guarded, with the toggle bits of its answers; None: no answer."""
    log = Log().boot(3).order(50, 1)
    for place, toggle in enumerate(toggles):
        ms = 100 + 100 * place
        log.add(ms, 0x703 | CAN_RTR_FLAG, b"\0")
        if toggle is not None:
            log.add(ms + 0.3, 0x703, bytes((toggle << 7 | 5,)))
    return log


def test_guarding_whose_toggle_bit_alternates_is_well():
    assert guarded([0, 1] * 8).explained().verdict == "ok"


def test_a_toggle_bit_that_does_not_alternate_is_a_warning():
    explanation = guarded([0, 1, 1, 0, 1, 0, 1]).explained()
    assert told(only(explanation)) == ("guard_toggle", 3, "warning", ())
    assert first_check(explanation).startswith("Look for a boot-up of the node")


def test_guarding_without_answers_is_a_lost_node_until_they_come():
    explanation = guarded([0, 1, 0, *[None] * 5]).explained()
    assert told(only(explanation)) == ("node_lost", 3, "unresolved", ())
    assert told(only(guarded([0, 1, 0, *[None] * 5, 1, 0, 1]).explained()))[2] == "recovered"


def test_a_full_bus_names_who_fills_it_and_who_is_starved():
    log = machine(3, 4, until=2000)
    for k in range(4000):  # 500 kbit/s: 8 bytes take 235 us
        log.add(1000 + 0.235 * k, 0x090 + k % 4, bytes(8))
    for ms in range(60, 1000, 10):
        log.add(ms, 0x184, bytes((ms % 5,)))
    explanation = log.explained()
    incident = explanation.incidents[0]
    assert told(incident)[:2] == ("bus_load", None)
    assert "at 500 kbit/s" in incident.root.text
    assert "184h does not come" in {clue.kind: clue.text for clue in incident.clues}["starved"]
    assert "coulombus hz" in first_check(explanation)


def test_a_block_transfer_that_takes_what_is_left_fills_no_bus():
    log = machine(3, until=3000)
    for k in range(20000):
        log.add(500 + 0.115 * k, 0x583, bytes((k % 127 + 1, *range(7))))
    assert "bus_load" not in {c.kind for i in log.explained().incidents for c in i.clues}


def test_destroyed_frames_are_counted_by_kind_and_identifier():
    log = machine(3).cycles(60, 3000, (3,))
    for k in range(30):
        log.error(2000.1 + 10 * k, 0x088, bytes((0, 0, 4 if k % 3 else 2, 8, 0, 0, 0, 0)))
    incident = only(log.explained())
    assert incident.root.text == "30 destroyed frames (bit stuffing 20, form 10); before 183h 30 times"
    assert incident.node == 3


def test_a_measuring_device_has_assumed_maps():
    log = machine(6).ask(6, 20, "4000100000000000", "4300100094010200")
    explanation = log.cycles(60, 3000, (6,), data=lambda cycle, node: bytes((cycle % 5, 0, 0, 0, 0))).explained()
    assert explanation.nodes[0].maps == "assumed"
    assert any("CiA 402 and 404" in remark for remark in explanation.remarks)


def test_a_trip_says_what_the_host_told_of_the_cycles_before():
    log = machine(3).cycles(60, 3000, (3,))
    inside = new_records(Frame, 400)
    for cycle in range(400):
        trip, limits = (1, 0) if cycle == 399 else (0, 64 if 390 <= cycle < 397 else 0)
        inside[cycle] = (round((960 + cycle) * 1e6), FIRST, 8, 5 | trip << 8 | limits << 16, SOURCE_INSIDE)
    row = int((log.frames["t_ns"] < 1360e6).sum())
    incident = only(log.explained(comments=[(row, "trip TPDO_LOST: no TPDO")], inside=inside))
    assert incident.root.text.endswith(
        "first doubt of axis 1 while it displayed; in the 399 cycles before: TPDO missed in 7"
    )


def test_a_log_of_j1939_has_a_table_of_its_parameter_groups():
    log = Log()
    for ms in range(500):
        log.add(10 * ms, 0x0CF00400 | 1 << 31, bytes(8))
        if ms % 10 == 0:
            log.add(10 * ms + 1, 0x18EA21FE | 1 << 31, bytes(3))
    explanation = log.explained()
    rows = [(row.group, row.source, row.frames, row.text) for row in explanation.identifiers]
    assert rows[0] == (61444, 0, 500, "PGN 61444 from 0, engine controller 1")
    assert rows[1][:3] == (59904, 0xFE, 50)
    text = "\n".join(screen(explanation, "a.log"))
    assert "CF00400h       500    10.00 ms  PGN 61444 from 0, engine controller 1" in text
    assert machine(3).explained().identifiers == ()


def set_points(log, node, begin, end, period=2.0, delay=1.0):
    for ms in np.arange(begin, end, period):
        log.add(ms + delay, 0x200 + node, word(0x0F))
    return log


NODES = "nodes (minimum / median / maximum)"


def bus_off():
    return machine(3).error(1000, 0x040, bytes(8))


def no_ack():
    log = machine(3)
    for k in range(20):
        log.error(1000 + 5 * k, 0x0A0, bytes(8))
    return log


def error_passive():
    return machine(3).error(1000, 0x204, bytes((0, 0x20, 0, 0, 0, 1, 130, 0)))


def overrun():
    return machine(3).error(1000, 0x004, bytes((0, 0x01, 0, 0, 0, 0, 0, 0)))


def host_lost():
    return machine(3, 4).ask(3, 20, "2316100164007f00", "6016100100000000").beats(0x7F, 60, 1500)


def error_code():
    log = mapped(machine(5), 5, 1, (0x60410010, 0x603F0010))
    return shown(log, 5, [(0, word(ENABLED))], [[(0, word(0)), (1000, word(0x4310))]])


def left_enabled():
    return set_points(drive(machine(5), 5, [(0, ENABLED), (1000, 0x0231)]), 5, 60, 1500)


def rpdo_late():
    log = machine(3).synchronous(3, 20, rpdo=True).cycles(60, 3000, (3,))
    for ms in range(60, 3000, 2):
        log.add(ms + (1.0 if not 1000 < ms < 1200 else 1.9), 0x203, word(ms % 7))
    return log


def pdo_stopped():
    log = machine(3)
    for ms in range(60, 1000, 10):
        log.add(ms, 0x283, bytes((ms // 20 % 7,)))
    return log


@pytest.mark.parametrize(
    ("log", "node", "status", "check"),
    [
        (bus_off, None, "unresolved", "Check that all nodes have the same bit rate."),
        (no_ack, 3, "warning", "Check that the other nodes have power."),
        (error_passive, None, "unresolved", "Look at plugs and cable to the node"),
        (overrun, None, "warning", "Record with fewer other programs running."),
        (host_lost, 0x7F, "unresolved", "Check whether the host's program still runs"),
        (error_code, 5, "unresolved", "Let it cool, and check load, fan and ambient temperature."),
        (left_enabled, 5, "unresolved", "Check the enable input and the emergency stop."),
        (rpdo_late, 3, "warning", "Look at what else ran on the host."),
        (pdo_stopped, 3, "unresolved", "Check the node's NMT state."),
    ],
)
def test_each_of_these_kinds_has_an_example(log, node, status, check):
    explanation = log().explained()
    incident = explanation.incidents[0]
    assert (incident.root.kind, incident.node, incident.status) == (log.__name__, node, status)
    assert first_check(explanation).startswith(check)


def test_an_incident_tells_cause_consequence_steps_clause_and_frames_apart():
    explanation = machine(5).add(1000, 0x085, bytes.fromhex("1042010000000000")).explained()
    lines = list(detail_lines(explanation, explanation.incidents[0], "a.log"))
    heads = [line.partition(":")[0] for line in lines if line and not line.startswith(" ")]
    assert heads[1:] == [
        "cause (reported)",
        "what happened",
        "check first",
        "why it matters",
        "see",
        "nodes (minimum / median / maximum)",
        "frames",
        "next",
    ]
    assert [line[2:5] for line in lines if line.startswith(("  1. ", "  2. ", "  3. "))] == ["1. ", "2. ", "3. "]
    assert any("  085  10 42 01" in line for line in lines)
