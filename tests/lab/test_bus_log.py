"""Phrases about a bus, and their order, in virtual time."""

from __future__ import annotations

import pytest

from coulombus.lab.bus_log import LoggedNetwork
from coulombus.sim_bus.faults.fault_file import faults_of
from places import EDS

MS = 1_000_000
NMT_START = (0x000, b"\x01\x05")
WRITE_1017H = (0x605, bytes.fromhex("2B17100064000000"))
READ_1018H = (0x605, bytes.fromhex("4018100100000000"))


def network_with(*frames, node_id=5):
    """A node that has booted, and the frames of a station, 10 ms apart."""
    network = LoggedNetwork()
    network.add(EDS / "motor.eds", node_id)
    network.power_on()
    station = network.station()
    for n, (can_id, data) in enumerate(frames, 1):
        station.send(can_id, data, at_ns=10 * n * MS)
    network.wait_ns(10 * (len(frames) + 1) * MS)
    return network


def test_a_write_before_the_start_is_said_in_this_order():
    log = network_with(WRITE_1017H, NMT_START).log
    log.assert_before("SDO write of 1017h", "NMT start")
    log.assert_said("heartbeat boot-up node 5", "SDO write 1017h = 100", "NMT start node 5")


def test_a_write_after_the_start_is_refused_with_its_line():
    log = network_with(NMT_START, WRITE_1017H).log
    with pytest.raises(AssertionError, match=r"'NMT start' was on the bus before 'SDO write of 1017h':\n.*0\.01.*nmt"):
        log.assert_before("SDO write of 1017h", "NMT start")
    with pytest.raises(AssertionError, match="'NMT start' was not on the bus after 'SDO write 1017h'"):
        log.assert_said("SDO write 1017h", "NMT start")


def test_before_needs_both():
    log = network_with(NMT_START).log
    with pytest.raises(AssertionError, match="before 'SDO write 1017h'"):
        log.assert_before("SDO write 1017h", "NMT start")
    with pytest.raises(AssertionError, match="'SDO write 1017h' was not on the bus"):
        log.assert_before("NMT start", "SDO write 1017h")


def test_a_phrase_repeated_is_said_as_often():
    log = network_with(NMT_START, WRITE_1017H, NMT_START).log
    log.assert_said("NMT start", "SDO write 1017h", "NMT start")
    with pytest.raises(AssertionError, match="'NMT start' was not on the bus"):
        log.assert_said(*["NMT start"] * 3)


@pytest.mark.parametrize(
    ("phrase", "count"),
    [
        ("SDO write 1017h", 1),
        ("sdo WRITE 1017H", 1),
        ("SDO read 1017h", 0),
        ("SDO read 1018h", 1),
        ("SDO read 1018h:01", 1),
        ("SDO read 1018h:02", 0),
        ("SDO read 1018", 0),
        ("SDO write 1017h = 100", 1),
        ("SDO write 1017h = 10", 0),
        ("SDO write 1017h to node 5", 1),
        ("SDO write 1017h node 6", 0),
        ("SDO write node 5", 1),
        ("heartbeat", 1),
        ("Producer heartbeat time", 2),  # the object's name, of request and response
        ("EMCY", 0),
    ],
)
def test_words_of_a_phrase(phrase, count):
    assert len(network_with(WRITE_1017H, READ_1018H).log.said(phrase)) == count


def test_a_phrase_without_words_is_refused():
    with pytest.raises(ValueError, match='expected words of a line, such as "SDO write 1017h"'):
        network_with().log.said("node 5")


def test_a_node_that_comes_later_names_its_earlier_frames():
    network = LoggedNetwork()
    network.add(EDS / "motor.eds", 5)
    network.power_on()
    station = network.station()
    station.send(0x606, WRITE_1017H[1])
    network.wait_ns(MS)
    assert not network.log.said("Producer heartbeat time node 6")
    network.add(EDS / "motor.eds", 6)
    assert len(network.log.said("Producer heartbeat time node 6")) == 1


def test_the_report_has_the_newest_lines():
    log = network_with(*[NMT_START] * 4).log
    lines = log.lines()
    assert len(lines) == 5
    assert log.report(5).splitlines() == lines
    assert log.report(2).splitlines() == ["(3 earlier lines)", *lines[-2:]]


def test_a_marker_stands_at_its_time():
    log = network_with(NMT_START, NMT_START).log
    log.mark(15 * MS, "fault drop")
    assert [("fault" in line, "nmt" in line) for line in log.lines()[1:]] == [(0, 1), (1, 0), (0, 1)]
    assert log.said("fault drop")


@pytest.mark.parametrize("seed", [1, 2])
def test_the_same_seed_gives_the_same_faults(seed):
    def lines(seed):
        network = LoggedNetwork()
        network.add(EDS / "motor.eds", 5)
        station = network.station()
        network.inject(faults_of('[[fault]]\nkind = "noise"\nrate = 1e-3', "faults"), seed)
        network.power_on()
        for n in range(40):
            station.send(*NMT_START, at_ns=n * MS)
        network.wait_ns(50 * MS)
        assert network.log.said("error")
        with pytest.raises(RuntimeError, match="has faults already"):
            network.inject(faults_of('[[fault]]\nkind = "stuck_dominant"', "faults"))
        return network.log.lines()

    assert lines(seed) == lines(seed) != lines(seed + 1)


def test_faults_count_from_their_injection():
    network = network_with(NMT_START)
    begin = network.t_ns
    network.inject(faults_of('[[fault]]\nkind = "reset"\nnode = 5\nat_s = 0.005', "faults"))
    network.wait_ns(20 * MS)
    (line,) = network.log.said("fault reset")
    assert float(line.split()[0]) == pytest.approx((begin + 5 * MS) / 1e9, abs=1e-6)
    assert len(network.log.said("heartbeat boot-up")) == 2


def test_the_same_frames_give_the_same_bytes():
    first, second = (network_with(WRITE_1017H, NMT_START).log.lines() for _ in range(2))
    assert first == second
