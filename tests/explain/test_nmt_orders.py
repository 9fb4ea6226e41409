"""NMT commands that take a node out of OPERATIONAL under a master that works on; jitter is no cause of what follows it."""

from __future__ import annotations

import numpy as np
import pytest

from explain_log import TYPE_402, kinds, machine, only

PREOP, STOP, RESET = 0x80, 0x02, 0x81


def at_work(order_ms, command, node, until=1500.0, set_points_until=1500.0, again_ms=None):
    """Return a machine whose node 3 gets set-points, and no TPDO from it after a command."""
    log = machine(3, 4, until=until, beats=False).ask(3, 20, "4000100000000000", TYPE_402)
    log.order(order_ms, command, node)
    if again_ms is not None:
        log.order(again_ms, 1, node)
    log.cycles(100, until, (3, 4), skip=lambda cycle, n: n == 3 and 100 + 2.0 * cycle > order_ms)
    for ms in np.arange(100.6, set_points_until, 2.0):
        log.add(ms, 0x203, b"\x0f\x00")
    return log.beats(4, 60, until).beats(3, 60, order_ms).beats(3, order_ms + 10, until, state=0x7F)


@pytest.mark.parametrize("command", [PREOP, STOP])
@pytest.mark.parametrize("node", [3, 0])
def test_a_command_out_of_operational_under_set_points_heads_the_incident(command, node):
    explanation = at_work(800.0, command, node).explained()
    incident = explanation.incidents[0]
    assert (incident.root.kind, incident.node, incident.status) == ("ordered_away", 3, "unresolved")
    assert incident.root.begin_ns == 800_000_000
    assert explanation.verdict == "unresolved"


def test_it_is_over_when_the_node_is_started_again():
    explanation = at_work(800.0, PREOP, 3, again_ms=1400.0).explained()
    (clue,) = [c for incident in explanation.incidents for c in incident.clues if c.kind == "ordered_away"]
    assert (clue.begin_ns, clue.end_ns) == (800_000_000, 1_400_000_000)


def test_a_master_that_ends_its_set_points_means_its_command():
    explanation = at_work(800.0, PREOP, 0, until=1500.0, set_points_until=815.0).explained()
    assert "ordered_away" not in {clue.kind for incident in explanation.incidents for clue in incident.clues}


@pytest.mark.parametrize("pieces", [1, 7])
def test_a_fault_behind_jitter_that_lasts_is_an_incident_of_its_own(pieces):
    log = machine(3, until=5000, beats=False).ask(3, 20, "4000100000000000", TYPE_402)
    for cycle, ms in enumerate(np.arange(100.0, 5000.0, 2.0)):
        late = 1.2 if ms > 1000 and cycle % 40 == 0 else 0.0
        log.add(ms + late, 0x080).add(ms + late + 0.3, 0x183, bytes.fromhex("1802" if ms > 4000 else "3706"))
    explanation = log.beats(3, 60, 5000).explained(pieces=pieces)
    assert explanation.incidents[0].root.kind == "drive_fault"
    assert explanation.incidents[0].begin_ns == pytest.approx(4_000_300_000, abs=3_000_000)
    assert "sync_gap" in kinds(explanation)


def test_heartbeats_that_waited_in_a_queue_tell_no_period():
    """24 of them came within 20 us at the begin of a recording: a period of 2.8 us, and then a lost node."""
    log = machine(3, until=2000, beats=False)
    for k in range(12):
        log.add(60.0 + 0.002 * k, 0x703, b"\5")
    explanation = log.cycles(100, 2000, (3,)).beats(3, 110, 2000, period=50).explained()
    assert explanation.verdict == "ok"


def test_a_drive_fault_without_anything_else_is_one_incident():
    log = machine(3, until=2000, beats=False).ask(3, 20, "4000100000000000", TYPE_402)
    log.cycles(100, 2000, (3,), data=lambda cycle, node: bytes.fromhex("1802" if cycle > 500 else "3706"))
    assert only(log.beats(3, 60, 2000).explained()).root.kind == "drive_fault"
