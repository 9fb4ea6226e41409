"""Many frames at once, against the client that takes them one by one."""

from __future__ import annotations

import socket
import struct
from contextlib import contextmanager

import numpy as np
import pytest

from coulombus.wire import frame_batches as blocks
from coulombus.wire.address import parse_address
from coulombus.wire.ancillary import SO_TIMESTAMPNS
from coulombus.wire.client import BusGone, Client, pack_frame
from coulombus.wire.frame_batches import Block, BlockReader
from coulombus.wire.handshake import Answer, BusStatus


@contextmanager
def two_clients(monkeypatch):
    """Yield a bus' ends of two connections, and the clients at the others."""
    pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(2)]
    free = [near for _, near in pairs]
    answer = Answer(BusStatus.OK, 500_000, 7)

    class Greeted:
        def __init__(self) -> None:
            self.socket, self.answer = free.pop(0), answer
            self.socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)

    monkeypatch.setattr("coulombus.wire.client.greet", lambda *_: Greeted())
    clients = [Client(parse_address("coulombus:x")) for _ in pairs]
    try:
        yield [far for far, _ in pairs], clients
    finally:
        for client in clients:
            client.close()
        for far, _ in pairs:
            far.close()


def frames(rng, count):
    return b"".join(pack_frame(int(rng.integers(0, 1 << 32)), rng.bytes(int(rng.integers(0, 9)))) for _ in range(count))


def rubbish(rng):
    """Return a message that holds a frame of nine bytes, an answer, or no whole frame."""
    return (
        struct.pack("=IB3x8s", 0x181, 9, bytes(8)) + pack_frame(0x80),
        Answer(BusStatus.OK, 250_000, 7, lost=int(rng.integers(1, 99))).pack(),
        rng.bytes(int(rng.choice([1, 17, 30, 24]))),
    )[int(rng.integers(3))]


@pytest.mark.parametrize("seed", range(3))
def test_blocks_hold_what_is_received_one_by_one(monkeypatch, seed):
    rng = np.random.default_rng(seed)
    with two_clients(monkeypatch) as (ends, (client, other)):
        reader = BlockReader(other)
        assert len(reader.receive()) == 0
        for count in (1, 40, 200):
            messages = [
                rubbish(rng) if rng.random() < 0.2 else frames(rng, int(rng.integers(1, 9))) for _ in range(count)
            ]
            for end in ends:
                for message in messages:
                    end.send(message)
            expected = []
            for _ in range(count):  # a message that holds no frame gives none
                expected += client.receive()
            block = reader.receive()
            rows = np.arange(len(block))
            assert [frame[1:] for frame in block.frames(rows)] == [frame[1:] for frame in expected]
            assert np.all(np.diff(block.t_ns) >= 0)
            for name in ("lost", "malformed", "bitrate_bit_s"):
                assert getattr(client, name) == getattr(other, name)
        assert client.malformed > 3


def test_a_long_queue_and_long_messages_come_whole(monkeypatch):
    with two_clients(monkeypatch) as (ends, (_, client)):
        monkeypatch.setattr(blocks, "MESSAGES", 16)
        reader = BlockReader(client)
        sent = [pack_frame(k, bytes([k % 251] * 8)) * (1 + 40 * (k % 7 == 0)) for k in range(1, 100)]
        for message in sent:
            ends[1].send(message)
        block = reader.receive()
        assert b"".join(pack_frame(i, d, n) for _, i, n, d in block.frames(np.arange(len(block)))) == b"".join(sent)
        assert (block.t_ns > 0).all()
        assert len(reader.receive()) == 0


def test_what_came_before_the_end_counts(monkeypatch):
    with two_clients(monkeypatch) as (ends, (_, client)):
        reader = BlockReader(client)
        ends[1].send(pack_frame(0x80))
        ends[1].close()
        assert reader.receive().can_ids.tolist() == [0x80]
        for _ in range(2):
            with pytest.raises(BusGone, match="coulombus:x is gone"):
                reader.receive()


def test_what_came_before_a_failure_counts(monkeypatch):
    with two_clients(monkeypatch) as (ends, (_, client)):
        monkeypatch.setattr(blocks, "MESSAGES", 2)
        reader = BlockReader(client)
        for can_id in (0x80, 0x81):
            ends[1].send(pack_frame(can_id))
        once, calls = reader._call, []

        def fails_later():
            if calls:
                raise client.failure(OSError(100, "Network is down"))
            calls.append(once())
            return calls[0]

        monkeypatch.setattr(reader, "_call", fails_later)
        assert reader.receive().can_ids.tolist() == [0x80, 0x81]
        with pytest.raises(OSError, match="interface is down"):
            reader.receive()


def test_bytes_beyond_the_length_are_none_of_the_frame(monkeypatch):
    with two_clients(monkeypatch) as (ends, (_, client)):
        ends[1].send(b"".join(struct.pack("=IB3x8s", 0x181, length, b"\xff" * 8) for length in range(9)))
        words = BlockReader(client).receive().words.view(np.uint64)
        assert words.tolist() == [(1 << 8 * length) - 1 for length in range(9)]


def test_a_closed_client_raises_what_the_system_says(monkeypatch):
    with two_clients(monkeypatch) as (_, (_, client)):
        reader = BlockReader(client)
        client.close()
        with pytest.raises(OSError, match="Bad file descriptor"):
            reader.receive()


def test_rows_are_those_of_an_identifier_in_order():
    block = Block.from_frames(
        [(5, 7, 1, b"\1" + bytes(7)), (6, 0x80000001, 0, bytes(8)), (7, 7, 2, b"\2" * 2 + bytes(6))]
    )
    assert {can_id: rows.tolist() for can_id, rows in block.rows.items()} == {7: [0, 2], 0x80000001: [1]}
    assert block.data(2) == b"\2\2" + bytes(6)
    assert Block.from_frames([]).rows == {}
    assert len(Block.joined([block, block])) == 6


def test_what_the_socket_dropped_is_told(monkeypatch):
    """As SocketCAN tells it: behind the stamp, or before it."""
    with two_clients(monkeypatch) as (_, (_, client)):
        reader = BlockReader(client)
        stamp, dropped = [32, blocks.STAMP, 7, 9], [20, blocks.OVERFLOW, 0xFFFF_FFFF_0000_0011, 0]
        for row, words in enumerate(([*stamp, 20, blocks.OVERFLOW, 5, 0], dropped[:3] + stamp)):
            reader._control[row, : len(words)] = np.array(words, np.uint64).view(np.int64)
        assert reader._stamps(2).tolist() == [7_000_000_009, 7_000_000_009]
        assert client.lost == 0x11
