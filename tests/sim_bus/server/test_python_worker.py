"""Python's share of a bus in real time, done beside the compiled loop."""

from __future__ import annotations

import contextlib
import struct
import threading

import numpy as np
import pytest

from coulombus.node.record import LOOP_WORDS, NODE, SERVICES_ONLY
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.server.records import JOBS
from coulombus.sim_bus.server.rig_server import SimServer
from coulombus.wire.address import BusAddress
from coulombus.wire.handshake import connect

pytestmark = [pytest.mark.real_time, pytest.mark.patient]

FRAME = struct.Struct("=IB3x8s")
TIMEOUT_S = 60.0
UPLOAD_NAME = bytes((0x40, 0x08, 0x10, 0, 0, 0, 0, 0))  # segmented: not by the core


def frame(can_id, data=b""):
    return FRAME.pack(can_id, len(data), bytes(data))


class Client:
    def __init__(self):
        self.socket = connect(BusAddress("coulombus", "t"))
        self.socket.settimeout(TIMEOUT_S)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def send(self, *frames):
        for one in frames:
            self.socket.send(one)

    def until(self, wanted, count=1):
        """Return the identifiers that came up to the `count`-th of `wanted`."""
        came = []
        while came.count(wanted) < count:
            message = self.socket.recv(1 << 16)
            assert message
            came += [FRAME.unpack_from(message, k)[0] for k in range(0, len(message), FRAME.size)]
        return came


@pytest.fixture
def server(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with contextlib.closing(SimServer(load_rig("bench"), BusAddress("coulombus", "t"))) as made:
        yield made


@contextlib.contextmanager
def running(server):
    failure = []

    def run():
        try:
            server.run(priority=None)
        except BaseException as error:
            failure.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield thread, failure
    finally:
        server.stop()
        thread.join(TIMEOUT_S)
        assert not thread.is_alive()


def held_up(server, monkeypatch):
    """Let the services of the nodes wait until the returned event is set."""
    go, serve = threading.Event(), server.world.serve

    def late(*arguments):
        assert go.wait(TIMEOUT_S)
        serve(*arguments)

    monkeypatch.setattr(server.world, "serve", late)
    return go


def test_pdos_go_on_while_python_serves(server, monkeypatch):
    go = held_up(server, monkeypatch)
    with running(server), Client() as client:
        client.send(frame(0x000, (1, 0)), frame(0x601, UPLOAD_NAME))
        before = []
        for _ in range(50):  # each is answered by both nodes, though node 1's services are at work
            client.send(frame(0x080))
            before += client.until(0x182)
        assert before.count(0x181) in (49, 50)
        assert 0x581 not in before
        go.set()
        client.until(0x581)


def test_what_came_meanwhile_is_served_in_its_order(server, monkeypatch):
    go = held_up(server, monkeypatch)
    with running(server), Client() as client:
        client.send(*(frame(0x601, UPLOAD_NAME) for _ in range(JOBS)))
        go.set()
        client.until(0x581, JOBS)
    assert server._worker.shared.state["served"] >= JOBS
    assert server.result.unserved == 0


def test_more_requests_than_may_wait_are_lost_and_counted_and_the_bus_goes_on(server, monkeypatch):
    """A flood of LSS frames let the bus stand still: it came 32 s late, and no SDO was answered."""
    go = held_up(server, monkeypatch)
    with running(server), Client() as client:
        client.send(frame(0x000, (1, 0)), *(frame(0x601, UPLOAD_NAME) for _ in range(JOBS + 21)))
        client.send(frame(0x080))
        assert 0x581 not in client.until(0x181)
        go.set()
        client.until(0x581, JOBS + 1)  # with the one that was under way
        assert server._worker.shared.state["dropped"] == 20
    assert server.result.unserved == 20


def test_each_frame_is_sent_once_whoever_put_it_there(server):
    """Boot-ups came a second time with what Python did first, and looked like a restart."""
    with running(server), Client() as client:
        for count in (1, 2):
            client.send(frame(0x601, UPLOAD_NAME))
            client.until(0x581)
            assert server._worker.shared.state["served"] == count
    assert server.result.frames == 2 + 4


def test_frames_that_are_no_lss_request_are_not_python_s(server, monkeypatch):
    go = held_up(server, monkeypatch)
    go.set()
    with running(server), Client() as client:
        client.send(frame(0x7E5, bytes(8)), frame(0x7E5, b"\x44" + bytes(7)), frame(0x7E5, b"\x04"))
        client.send(frame(0x601, UPLOAD_NAME))
        client.until(0x581)
        assert server._worker.shared.state["served"] == 1
        assert int(server._worker.loop.nodes["dropped_unknown"][0]) == 2
        assert int(server._worker.loop.nodes["dropped_length"][0]) == 1


def test_what_both_write_is_kept(server, monkeypatch):
    """A download is whole in the loop, and what the loop wrote since Python looked is not undone."""
    go = held_up(server, monkeypatch)
    with running(server), Client() as client:
        client.send(frame(0x000, (1, 0)))
        # the heartbeat's period of node 2, while node 2's set-point comes by RPDO
        client.send(frame(0x602, (0x2B, 0x17, 0x10, 0, 0x4D, 0, 0, 0)))
        rpdo = struct.pack("<HH", 6, 0)
        client.send(frame(0x202, rpdo), frame(0x080))
        client.until(0x182)
        loop = server._worker.loop.nodes
        rpdo_ns = int(loop["rpdo_ns"][1, 0])
        assert rpdo_ns > 0
        go.set()
        client.until(0x582)
        assert int(loop["rpdo_ns"][1, 0]) == rpdo_ns
        client.until(0x702, 2)  # heartbeats come of themselves now
    assert server.world.devices[1][0x1017, 0] == 0x4D


def test_a_job_that_fails_ends_the_bus_and_is_told(server, monkeypatch):
    def broken(*arguments):
        raise MemoryError("no room")

    monkeypatch.setattr(server.world, "serve", broken)
    with running(server) as (thread, failure), Client() as client:
        client.send(frame(0x601, UPLOAD_NAME))
        thread.join(TIMEOUT_S)
        assert not thread.is_alive()
    assert [type(one) for one in failure] == [MemoryError]


def test_fields_that_only_services_write_are_written_by_nobody_else(server):
    """The loop's records are not copied there; if the core wrote one, Python would not know."""
    with running(server), Client() as client:
        client.send(frame(0x000, (1, 0)))
        for _ in range(20):
            client.send(frame(0x201, bytes(8)), frame(0x202, bytes(4)), frame(0x080))
            client.until(0x182)
        client.send(frame(0x601, UPLOAD_NAME))
        client.until(0x581)
        client.send(frame(0x601, (0x60, 0, 0, 0, 0, 0, 0, 0)))
        client.until(0x581)
        for name in SERVICES_ONLY:
            assert np.array_equal(server._worker.loop.nodes[name], server.world.nodes[name]), name


def test_every_other_word_is_copied():
    words = np.zeros(NODE.itemsize // 8, bool)
    for first, last in LOOP_WORDS:
        assert not words[first:last].any()
        words[first:last] = True
    for name in NODE.names:
        kind, offset = NODE.fields[name][:2]
        copied = words[offset // 8 : -(-(offset + kind.itemsize) // 8)]
        assert copied.all() != (name in SERVICES_ONLY), name
        assert copied.any() != (name in SERVICES_ONLY), name
