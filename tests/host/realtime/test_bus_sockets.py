"""The loop's buses: each frame goes to its bus, and one that is lost makes all axes safe on the others."""

from __future__ import annotations

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
from coulombus.host.realtime.bus_sockets import COMPLETE, EMPTY, GONE, TOOK, drain, take, transmit
from coulombus.host.realtime.data_plane import rig_filters
from coulombus.host.realtime.log_rings import take_log
from coulombus.host.realtime.process import new_buffers
from coulombus.host.realtime.shared_memory import SharedPlane
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import buses_of, frames, push, stations_of
from plane_buses import ONE_CYCLE

FRAME = struct.Struct("=IB3xq")
SYNC, T_NS = int(CobId.SYNC), 1_000_000_000


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

    def sent(self, bus):
        """Return the identifiers of the frames that a bus has."""
        found = []
        with suppress(BlockingIOError):
            while True:
                found += [row[0] for row in FRAME.iter_unpack(self.others[bus].recv(1 << 16))]
        return found

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
        assert take(buses.b, bus, 1) == result
    assert [take(buses.b, bus, 1) for bus in (0, 1)] == [EMPTY, EMPTY]


@pytest.mark.parametrize("lost", [0, 1])
def test_a_lost_bus_makes_all_axes_safe_and_the_other_goes_on(buses, lost):
    buses.others[lost].close()
    assert drain(buses.b) == 0
    p = buses.shared.plane[0]
    assert (p.lost_bus, p.asked, p.error) == (lost + 1, Trip.BUS_LOST, 0)
    assert set(buses.k.host["stop"].tolist()) == {int(Trip.BUS_LOST)}
    assert buses.b.fds[lost] == -1
    begin(buses.b.axes, T_NS, buses.b.out)
    assert transmit(buses.b, 0) == 0
    assert SYNC in buses.sent(1 - lost)
    buses.others[1 - lost].close()
    assert drain(buses.b) == 1  # now none is left


@pytest.mark.parametrize("lost", [0, 1])
def test_a_bus_that_is_lost_in_sending_does_not_keep_the_frame_from_the_other(buses, lost):
    buses.mine[lost].shutdown(socket.SHUT_RDWR)
    begin(buses.b.axes, T_NS, buses.b.out)
    assert transmit(buses.b, 0) == 0
    assert (buses.shared.plane[0].lost_bus, buses.shared.plane[0].error) == (lost + 1, errno.EPIPE)
    assert SYNC in buses.sent(1 - lost)


def test_the_last_set_points_reach_the_bus_that_works_before_the_lost_one_is_tried_again(buses):
    buses.shared.plane["lost_bus"] = 1  # the first bus, of which it is not known yet whether it is back
    push(buses.b.out, -1, T_NS, SYNC, 0, 0)
    assert transmit(buses.b, 0) == 0
    assert buses.b.sent_ns[1] <= buses.b.sent_ns[0]


def test_the_only_bus_that_is_left_is_offered_the_last_frames_all_the_same(buses):
    buses.others[0].close()
    assert take(buses.b, 0, 1) == TOOK
    buses.others[1].close()
    assert take(buses.b, 1, 1) == GONE
    assert buses.b.fds[1] >= 0


def test_frames_that_a_socket_dropped_are_counted_over_all_buses(buses):
    buses.b.overflows[:] = [3, 0]
    buses.b.box["overflow"] = 5
    buses.arrive(1, 0x183)
    assert take(buses.b, 1, 1) == TOOK
    assert buses.shared.plane["rx_overflow"][0] == buses.b.overflows[1]


def test_a_bus_lets_only_the_identifiers_of_its_own_nodes_in(buses):
    first, second = ({can_id for can_id, _ in rig_filters(buses.k, bus)} for bus in (0, 1))
    assert first & second == {0, SYNC, CobId.HEARTBEAT + buses.k.rig.host.node_id}
    assert {0x181, 0x581, 0x701} <= first
    assert {0x183, 0x583, 0x703} <= second
    assert np.array_equal(np.unique(buses.k.bus_of), [-1, 0, 1])
