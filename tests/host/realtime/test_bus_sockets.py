"""The loop's buses: each frame goes to its bus, and one that is lost makes all axes safe on the others."""

from __future__ import annotations

import ctypes
import errno
import socket
import struct
from contextlib import suppress

import numpy as np
import pytest

from coulombus.eds.cia301 import CobId
from coulombus.host.cycle.axes import begin, safe_setpoints
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import Trip
from coulombus.host.realtime import bus_sockets
from coulombus.host.realtime.bus_sockets import (
    COMPLETE,
    DRAIN_MESSAGES,
    EMPTY,
    GONE,
    TOOK,
    drain,
    receive_message,
    transmit,
)
from coulombus.host.realtime.data_plane import rig_filters
from coulombus.host.realtime.log_rings import take_log
from coulombus.host.realtime.process import new_buffers
from coulombus.host.realtime.shared_memory import SharedPlane
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import CAN_ERR_FLAG, buses_of, frames, push, stations_of
from plane_buses import ONE_CYCLE

FRAME = struct.Struct("=IB3xq")
SYNC, T_NS = int(CobId.SYNC), 1_000_000_000


def plain(kernel):
    return getattr(kernel, "py_func", kernel)


class Buses:
    """The loop's end of two buses, and the other ends of their sockets."""

    def __init__(self):
        self.k = Controllers(load_rig("plane", ONE_CYCLE), "hybrid")
        self.shared = SharedPlane.create(len(self.k.each))
        self.k.adopt(self.shared.axes)
        self.shared.owner[:], self.shared.bus_of[:] = self.k.owner, self.k.bus_of
        self.shared.plane["packed"] = 0b11
        pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(2)]
        self.mine, self.others = zip(*pairs, strict=True)
        for other in self.others:
            other.setblocking(False)
        self.b = new_buffers([end.fileno() for end in self.mine], self.shared)
        self.k.start(T_NS)

    def messages(self, bus):
        """Return the messages that a bus has, each a list of frames: identifier, length, word."""
        found = []
        with suppress(BlockingIOError):
            while True:
                found.append(list(FRAME.iter_unpack(self.others[bus].recv(1 << 16))))
        return found

    def sent(self, bus):
        """Return the identifiers of the frames that a bus has."""
        return [can_id for message in self.messages(bus) for can_id, _, _ in message]

    def request(self, *can_ids):
        """Request frames of the host, each with a length and data of its own."""
        for n, can_id in enumerate(can_ids, 1):
            push(self.b.out, -1, T_NS, can_id, n % 8 + 1, -(0x0102030405060708 + n))

    def fill(self, bus):
        """Send on a bus until its socket takes no more."""
        self.mine[bus].setblocking(False)
        with suppress(BlockingIOError):
            while True:
                self.mine[bus].send(bytes(16))

    def arrive(self, bus, can_id, data=b"\0" * 8):
        self.others[bus].send(FRAME.pack(can_id, len(data), int.from_bytes(data, "little", signed=True)))

    @property
    def log(self):
        rows = frames(64)
        return rows[: take_log(self.shared.plane, self.shared.ring, rows)]

    def close(self):
        for end in (*self.mine, *self.others):
            end.close()
        self.shared.close()


@pytest.fixture
def buses():
    made = Buses()
    yield made
    made.close()


def test_sync_goes_to_all_buses_and_a_set_point_to_its_own(buses):
    begin(buses.b.axes, T_NS, buses.b.out)
    assert transmit(buses.b, 0) == 0
    heartbeat = CobId.HEARTBEAT + buses.k.rig.host.node_id
    assert [buses.sent(0), buses.sent(1)] == [[SYNC, heartbeat]] * 2
    safe_setpoints(buses.b.axes, T_NS, buses.b.out)
    assert transmit(buses.b, 0) == 0
    assert [buses.sent(0), buses.sent(1)] == [[0x201, 0x202, SYNC], [0x203, 0x204, SYNC]]
    rows = buses.log
    assert set(stations_of(rows)) == {-1}
    assert rows["can_id"][buses_of(rows) == 1].tolist() == [SYNC, heartbeat, 0x203, 0x204, SYNC]


@pytest.mark.parametrize("packed", [0b00, 0b01, 0b10, 0b11])
def test_a_bus_gets_each_frame_whole_in_one_message_where_it_takes_that(buses, packed):
    buses.shared.plane["packed"] = packed
    requested = (0x201, 0x203, 0x202, SYNC, 0x204)
    buses.request(*requested)
    rows = {can_id: (can_id, n % 8 + 1, -(0x0102030405060708 + n)) for n, can_id in enumerate(requested, 1)}
    assert transmit(buses.b, 0) == 0
    for bus, can_ids in enumerate(((0x201, 0x202, SYNC), (0x203, SYNC, 0x204))):
        expected = [rows[can_id] for can_id in can_ids]
        assert buses.messages(bus) == ([expected] if packed >> bus & 1 else [[row] for row in expected])
        logged = buses.b.ring[: 3 * 2]
        logged = logged[buses_of(logged) == bus]
        assert [tuple(row)[1:4] for row in logged[["t_ns", "can_id", "length", "word"]].tolist()] == expected
        assert buses.b.sent_ns[bus] == logged["t_ns"][0]
    assert buses.b.out.count == 0
    assert transmit(buses.b, 0) == 0  # nothing is left
    assert [buses.messages(bus) for bus in (0, 1)] == [[], []]


@pytest.mark.parametrize("packed", [0b00, 0b11])
def test_frames_that_a_full_bus_does_not_take_are_lost_and_counted(buses, packed):
    buses.shared.plane["packed"] = packed
    buses.fill(1)
    buses.request(0x203, SYNC, 0x204)
    assert transmit(buses.b, 0) == 0
    p = buses.shared.plane[0]
    assert (p.tx_full, p.unsent, p.lost_bus, p.log_head) == (3, 0, 0, 1)
    assert buses.sent(0) == [SYNC]


def test_the_last_frames_are_offered_again_with_pauses(buses, monkeypatch):
    pauses = []

    def pause(until_ns):
        pauses.append(until_ns)
        if len(pauses) == 2:
            buses.messages(1)  # the bus is free again

    clock, libc = iter(range(0, 1 << 40, 10_000_000)), ctypes.CDLL(None, use_errno=True)
    for name, double in {
        "sleep_until": pause,
        "now_ns": lambda: next(clock),
        "send": lambda fd, at, size, flags: libc.send(
            int(fd), ctypes.c_void_p(int(at)), ctypes.c_size_t(int(size)), int(flags)
        ),
        "errno": ctypes.get_errno,
    }.items():
        monkeypatch.setattr(bus_sockets, name, double)
    for name in ("_send", "lose", "watch", "stop"):
        monkeypatch.setattr(bus_sockets, name, plain(getattr(bus_sockets, name)))
    send_again = plain(bus_sockets.transmit)
    buses.fill(1)
    buses.request(0x203)
    assert send_again(buses.b, 3) == 0
    assert pauses == [bus_sockets.END_PAUSE_NS, 10_000_000 + bus_sockets.END_PAUSE_NS]
    assert buses.sent(1) == [0x203]
    assert buses.shared.plane["tx_full"][0] == 0
    buses.fill(1)
    buses.request(0x203)
    pauses[:] = [0, 0, 0]  # the bus stays full
    assert send_again(buses.b, 3) == 0
    assert len(pauses) == 6
    assert buses.shared.plane["tx_full"][0] == 1


@pytest.mark.parametrize(
    ("data", "malformed"), [(bytes(15), 1), (bytes(17), 1), (bytes(16 * 65), 1), (bytes(8), 1), (bytes(16), 0)]
)
def test_a_message_that_is_no_frames_is_dropped_and_counted(buses, data, malformed):
    buses.others[1].send(data)
    assert receive_message(buses.b, 1, 1) == TOOK
    p = buses.shared.plane[0]
    assert (p.rx_malformed, p.rx_frames) == (malformed, 1 - malformed)
    assert receive_message(buses.b, 1, 1) == EMPTY


def test_a_frame_that_is_too_long_is_dropped_and_its_neighbour_is_not(buses):
    buses.others[0].send(FRAME.pack(0x181, 9, 0) + FRAME.pack(0x181, 3, 0x0102030405060708))
    assert receive_message(buses.b, 0, 1) == TOOK
    p = buses.shared.plane[0]
    assert (p.rx_malformed, p.rx_frames) == (1, 1)
    assert buses.log[["can_id", "length", "word"]].tolist() == [(0x181, 3, 0x060708)]  # padding is not data


def test_a_message_has_up_to_64_frames(buses):
    buses.others[0].send(FRAME.pack(0x181, 8, 1) * 64)
    assert receive_message(buses.b, 0, 0) == TOOK
    assert (buses.shared.plane["rx_frames"][0], buses.shared.plane["rx_malformed"][0]) == (64, 0)


@pytest.mark.parametrize("live", [0, 1])
@pytest.mark.parametrize("bus", [0, 1])
def test_another_hosts_sync_on_any_bus_trips_while_the_cycle_runs(buses, bus, live):
    buses.arrive(bus, SYNC, b"")
    assert receive_message(buses.b, bus, live) == TOOK
    p = buses.shared.plane[0]
    assert (p.foreign_sync, p.asked) == ((1, Trip.SECOND_HOST) if live else (0, 0))


@pytest.mark.parametrize(("flags", "live", "lost"), [(0x40, 1, True), (0x40, 0, False), (0x04, 1, False)])
def test_a_controller_in_bus_off_is_a_lost_bus(buses, flags, live, lost):
    buses.arrive(1, CAN_ERR_FLAG | flags)
    assert receive_message(buses.b, 1, live) == TOOK
    p = buses.shared.plane[0]
    assert (p.error_frames, p.asked) == (1, Trip.BUS_LOST if lost else 0)


def test_a_flooded_bus_leaves_time_for_the_other(buses, monkeypatch):
    reads = []
    monkeypatch.setattr(
        bus_sockets, "receive_message", lambda b, k, live: reads.append((k, live)) or (TOOK if k == 0 else EMPTY)
    )
    assert plain(bus_sockets.drain)(buses.b) == 0
    assert reads == [(0, 1)] * DRAIN_MESSAGES + [(1, 1)]


def test_a_message_is_heard_of_every_bus_and_logged_as_its_own(buses):
    for bus, node in ((0, 1), (1, 3), (1, 4), (0, 2)):
        buses.arrive(bus, 0x180 + node)
    assert drain(buses.b) == 0
    rows = buses.log
    assert list(zip(rows["can_id"].tolist(), buses_of(rows).tolist(), strict=True)) == [
        (0x181, 0),
        (0x182, 0),
        (0x183, 1),
        (0x184, 1),
    ]
    assert set(stations_of(rows)) == {0}


def test_a_joint_is_complete_when_its_own_bus_has_answered(buses):
    begin(buses.b.axes, T_NS, buses.b.out)
    for bus, node, result in ((1, 3, TOOK), (1, 4, COMPLETE), (0, 1, TOOK), (0, 2, COMPLETE)):
        buses.arrive(bus, 0x180 + node, bytes(8 if node in (1, 3) else 6))
        assert receive_message(buses.b, bus, 1) == result
    assert [receive_message(buses.b, bus, 1) for bus in (0, 1)] == [EMPTY, EMPTY]


@pytest.mark.parametrize("lost", [0, 1])
def test_a_lost_bus_makes_all_axes_safe_and_the_other_goes_on(buses, lost):
    buses.others[lost].close()
    assert drain(buses.b) == 0
    p = buses.shared.plane[0]
    assert (p.lost_bus, p.asked, p.error) == (lost + 1, Trip.BUS_LOST, 0)
    assert set(buses.k.host["stop"].tolist()) == {int(Trip.BUS_LOST)}
    assert buses.b.fds[lost] == -1
    assert [entry & 0xFFFFFFFF == 0xFFFFFFFF for entry in buses.b.poll.tolist()] == [k == lost for k in (0, 1)]
    assert receive_message(buses.b, lost, 1) == EMPTY
    begin(buses.b.axes, T_NS, buses.b.out)
    assert transmit(buses.b, 0) == 0
    assert SYNC in buses.sent(1 - lost)
    assert p.unsent == 2  # SYNC and the heartbeat
    buses.others[1 - lost].close()
    assert drain(buses.b) == 1  # now none is left
    assert p.lost_bus == 2 - lost


@pytest.mark.parametrize("lost", [0, 1])
def test_a_bus_that_is_lost_in_sending_does_not_keep_the_frame_from_the_other(buses, lost):
    buses.mine[lost].shutdown(socket.SHUT_RDWR)
    begin(buses.b.axes, T_NS, buses.b.out)
    assert transmit(buses.b, 0) == 0
    p = buses.shared.plane[0]
    assert (p.lost_bus, p.error, p.unsent) == (lost + 1, errno.EPIPE, 2)
    assert SYNC in buses.sent(1 - lost)


def test_a_socket_with_the_number_0_is_a_bus_too(buses):
    buses.b.fds[0] = 0  # the standard input was closed
    assert plain(bus_sockets.lose)(buses.b, 1, 7) == TOOK
    assert buses.b.fds.tolist() == [0, -1]


def test_the_loss_of_the_last_bus_in_sending_is_told(buses):
    for end in buses.mine:
        end.shutdown(socket.SHUT_RDWR)
    buses.request(SYNC)
    assert transmit(buses.b, 0) == 1
    assert buses.b.fds[1] >= 0


def test_the_last_set_points_reach_the_bus_that_works_before_the_lost_one_is_tried_again(buses):
    buses.shared.plane["lost_bus"] = 1  # the first bus, of which it is not known yet whether it is back
    push(buses.b.out, -1, T_NS, SYNC, 0, 0)
    assert transmit(buses.b, 0) == 0
    assert buses.b.sent_ns[1] <= buses.b.sent_ns[0]


def test_the_only_bus_that_is_left_is_offered_the_last_frames_all_the_same(buses):
    buses.others[0].close()
    assert receive_message(buses.b, 0, 1) == TOOK
    buses.others[1].close()
    assert receive_message(buses.b, 1, 1) == GONE
    assert buses.b.fds[1] >= 0


def test_frames_that_a_socket_dropped_are_counted_over_all_buses(buses, monkeypatch):
    counts = {0: [2, 5], 1: [1, 1]}

    def receive(fd, box, flags):
        box["overflow"] = counts[buses.b.fds.tolist().index(fd)].pop(0)
        box["truncated"] = box["stamp_ns"] = 0
        return 16

    monkeypatch.setattr(bus_sockets, "receive", receive)
    monkeypatch.setattr(bus_sockets, "now_ns", lambda: T_NS)
    listen = plain(bus_sockets.receive_message)
    assert [listen(buses.b, k, 0) for k in (0, 1, 0, 1)] == [TOOK] * 4
    assert buses.shared.plane["rx_overflow"][0] == 5 + 1


def test_a_bus_lets_only_the_identifiers_of_its_own_nodes_in(buses):
    first, second = ({can_id for can_id, _ in rig_filters(buses.k, bus)} for bus in (0, 1))
    assert first & second == {0, SYNC, CobId.HEARTBEAT + buses.k.rig.host.node_id}
    assert {0x181, 0x581, 0x701} <= first
    assert {0x183, 0x583, 0x703} <= second
    assert np.array_equal(np.unique(buses.k.bus_of), [-1, 0, 1])
