"""Two buses joined: what goes over, what does not, and what is counted."""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
import sys
import threading
from contextlib import contextmanager

import pytest

from coulombus.sim_bus.server.bridge import SameBus, bridge, faults
from coulombus.wire.address import BusUnavailable, parse_address
from coulombus.wire.client import Client, pack_frame
from coulombus.wire.handshake import Flags, Hello
from coulombus.wire.identifiers import parse_identifiers
from places import ROOT
from tiny_bus import tiny_bus

pytestmark = [pytest.mark.real_time, pytest.mark.patient, pytest.mark.usefixtures("private_sockets")]

A, B = parse_address("coulombus:a"), parse_address("coulombus:b")
PATIENCE_S = 20.0


@contextmanager
def joined(monkeypatch, **options):
    """Two buses, a bridge in a thread, and a listener on each that also hears what it sends
    itself.
    """
    threads = []

    class Told:
        """Stands in for signals, which a thread cannot take."""

        number = 0

        def __enter__(self):
            self.reading, self.writing = os.pipe()
            return self

        def __exit__(self, *_):
            os.close(self.reading)
            os.close(self.writing)

        def fileno(self):
            return self.reading

        def end(self):
            self.number = signal.SIGTERM
            os.write(self.writing, b"x")

    told, ready, results = Told(), threading.Event(), []
    monkeypatch.setattr("coulombus.sim_bus.server.bridge.StopSignals", lambda: told)
    with tiny_bus("a") as left, tiny_bus("b") as right:
        thread = threading.Thread(target=lambda: results.append(bridge(A, B, ready=lambda *_: ready.set(), **options)))
        threads.append(thread)
        thread.start()
        assert ready.wait(PATIENCE_S)
        with Client(A, Hello(Flags.OWN)) as one, Client(B, Hello(Flags.OWN)) as other:
            yield one, other, left, right, results
            told.end() if thread.is_alive() else None
            thread.join(PATIENCE_S)
            assert not thread.is_alive()


def heard(client, count):
    """Return the next frames (identifier, data)."""
    found = []
    while len(found) < count:
        assert client.wait(PATIENCE_S)
        found += [(can_id, data[:length]) for _, can_id, length, data in client.receive()]
    assert len(found) == count
    return found


def test_both_ways_in_order_and_no_frame_comes_back(monkeypatch):
    sent = [(0x100 + i, struct.pack("<H", i)) for i in range(100)]
    with joined(monkeypatch) as (one, other, left, right, results):
        for can_id, data in sent:
            one.send(pack_frame(can_id, data))
        assert heard(other, 100) == sent
        other.send(pack_frame(0x80000123, b"back") + pack_frame(0x40000701, b"", 1))
        assert heard(other, 2) == heard(one, 102)[100:] == [(0x80000123, b"back"), (0x40000701, b"\0")]
    assert len(left.frames) == len(right.frames) == 102  # each frame once on each bus
    counts = results[0].ways
    assert (counts["coulombus:a -> coulombus:b"].forwarded, counts["coulombus:b -> coulombus:a"].forwarded) == (100, 2)
    assert results[0].exit_status == 0


def test_filters_and_one_way(monkeypatch):
    with joined(monkeypatch, ranges=parse_identifiers("180-1FF"), one_way=True) as (one, other, left, _right, results):
        other.send(pack_frame(0x181, b"no"))
        one.send(pack_frame(0x200) + pack_frame(0x181, b"yes"))
        assert heard(other, 2) == [(0x181, b"no"), (0x181, b"yes")]
    (counts,) = results[0].ways.values()
    assert (counts.received, counts.filtered, counts.forwarded) == (2, 1, 1)
    assert len(left.frames) == 2


def test_error_frames_stay_on_their_wire(monkeypatch):
    with joined(monkeypatch) as (_one, other, left, _right, _):
        left.deliver((0x20000004, bytes(8)), (0x100, b""))
        assert heard(other, 1) == [(0x100, b"")]


def test_delay_drop_and_seed(monkeypatch):
    dropped = [not list(faults(drop=0.5, seed=7)((i, 0, b""))) for i in range(1)]
    between = faults(drop=0.5, seed=7)
    passed = [i for i in range(200) if list(between((i, 0, bytes(8))))]
    assert dropped == [0 not in passed]
    assert 60 < len(passed) < 140
    with joined(monkeypatch, between=faults(delay_ms=20, drop=0.5, seed=7)) as (one, other, _, _, results):
        for i in range(200):
            one.send(pack_frame(i))
        assert [can_id for can_id, _ in heard(other, len(passed))] == passed
    counts = results[0].ways["coulombus:a -> coulombus:b"]
    assert (counts.received, counts.dropped, counts.forwarded) == (200, 200 - len(passed), len(passed))
    assert list(faults(delay_ms=1.5)((1, 0, b""))) == [(1_500_000, (1, 0, b""))]


def test_each_way_has_its_own_dice(monkeypatch):
    """What is dropped one way does not depend on what comes the other way meanwhile."""
    dice = faults(drop=0.5, seed=3)
    passed = [i for i in range(100) if list(dice((i, 0, bytes(8))))]
    with joined(monkeypatch, between=faults(drop=0.5, seed=3), back=faults(drop=1.0)) as (one, other, _, _, results):
        for i in range(100):
            other.send(pack_frame(0x700))
            one.send(pack_frame(i))
        assert [can_id for can_id, _ in heard(other, 100 + len(passed)) if can_id != 0x700] == passed
    assert results[0].ways["coulombus:b -> coulombus:a"].forwarded == 0


def test_frames_sent_twice_and_with_a_wrong_bit():
    assert list(faults(duplicate=1.0)((1, 0, bytes(8)))) == 2 * [(0, (1, 0, bytes(8)))]
    between = faults(corrupt=1.0, seed=1)
    for length in range(1, 9):
        ((_, (can_id, same, data)),) = between((0x181, length, bytes(8)))
        assert (can_id, same) == (0x181, length)
        assert int.from_bytes(data, "little").bit_count() == 1
        assert data[length:] == bytes(8 - length)
    assert list(between((0x181, 0, bytes(8)))) == [(0, (0x181, 0, bytes(8)))]
    assert list(between((0x40000181, 8, bytes(8)))) == [(0, (0x40000181, 8, bytes(8)))]


def test_any_fault_in_between(monkeypatch):
    def twice_and_reversed(frame):
        can_id, length, data = frame
        return [(0, frame), (0, (can_id, length, bytes(reversed(data[:length])).ljust(8, b"\0")))]

    with joined(monkeypatch, between=twice_and_reversed) as (one, other, *_):
        one.send(pack_frame(1, b"ab"))
        assert heard(other, 2) == [(1, b"ab"), (1, b"ba")]


def test_what_finds_no_room_is_dropped_and_counted(monkeypatch):
    with joined(monkeypatch, between=faults(delay_ms=100), room=10) as (one, other, _, _, results):
        one.send(b"".join(pack_frame(i) for i in range(25)))
        assert [can_id for can_id, _ in heard(other, 10)] == list(range(10))
    counts = results[0].ways["coulombus:a -> coulombus:b"]
    assert (counts.received, counts.overflow, counts.forwarded) == (25, 15, 10)


def test_a_bus_that_vanishes_ends_it_with_its_reason(monkeypatch):
    with joined(monkeypatch) as (_, _, _left, right, results):
        right.close()
        while not results:
            pass
    assert results[0].exit_status == 4
    assert "coulombus:b is gone" in results[0].gone


def test_the_command_ends_well_on_a_signal():
    with tiny_bus("a"), tiny_bus("b"):
        command = [sys.executable, "-m", "coulombus", "bridge", "coulombus:a", "coulombus:b", "--json"]
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        try:
            assert json.loads(process.stdout.readline())["event"] == "ready"
            process.send_signal(signal.SIGINT)
            out, _ = process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
        assert process.returncode == 0
        told = json.loads(out)
        assert (told["event"], told["gone"]) == ("end", None)
        assert set(told["ways"]) == {"coulombus:a -> coulombus:b", "coulombus:b -> coulombus:a"}


def test_ends_that_cannot_be_joined():
    with tiny_bus("a"):
        with pytest.raises(SameBus):
            bridge(A, A)
        with pytest.raises(BusUnavailable, match="no bus coulombus:b"):
            bridge(A, B)
