"""The thread that reads a bus for a view: batches, a bus that is down for a while, the end."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest

from coulombus.monitor import bus_reader
from coulombus.monitor.bus_reader import BusReader
from coulombus.wire.client import BusDown, BusFull, BusGone
from coulombus.wire.frame_batches import Block

EMPTY = Block.from_frames(())
FRAME = Block.from_frames([(1, 0x181, 1, bytes(8))])


class View:
    """Notes what it gets."""

    def __init__(self):
        self.frames, self.told = [], []

    def add_frames(self, block):
        if len(block):
            self.frames.append(len(block))

    def add_event(self, t_ns, text, *, grave):
        self.told.append((text, grave))


class Rounds:
    """An event that is set after some waits."""

    def __init__(self, number):
        self.left = number

    def wait(self, pause_s):
        self.left -= 1
        return self.left < 0


@pytest.fixture
def read(monkeypatch):
    """Read what a bus gives in each round, a block or an error; return the view and the reader."""

    def run(*given, batch_s=0.0):
        answers = iter(given)

        def receive():
            answer = next(answers, EMPTY)
            if isinstance(answer, Exception):
                raise answer
            return answer

        client = SimpleNamespace(address=SimpleNamespace(packs_frames=False), ask=lambda: None)
        monkeypatch.setattr(bus_reader, "block_reader", lambda client: SimpleNamespace(receive=receive))
        view = View()
        reader = BusReader(client, view, threading.Lock(), batch_s=batch_s)
        reader.stop = Rounds(len(given))
        reader._run()
        return view, reader

    return run


def test_frames_wait_for_their_batch_and_for_who_asks(read):
    view, reader = read(FRAME, FRAME, batch_s=1e9)
    assert view.frames == []
    reader.hand_over()
    assert view.frames == [2]
    assert read(FRAME, FRAME)[0].frames == [1, 1]


def test_who_asks_gets_what_the_socket_still_has(read):
    view, reader = read(FRAME, batch_s=1e9)
    reader._reader.receive = lambda: FRAME
    before_ns = reader.until_ns
    reader.hand_over()
    assert view.frames == [2]
    assert reader.until_ns > before_ns


def test_a_bus_that_is_down_is_told_once_and_read_on(read):
    view, reader = read(BusDown("down"), BusDown("down"), FRAME, BusFull("full"), FRAME)
    assert view.told == [("down", True)]
    assert sum(view.frames) == 2
    assert reader.failure is None


def test_the_end_of_a_bus_hands_over_the_rest(read):
    view, reader = read(FRAME, FRAME, BusGone("gone"), FRAME, batch_s=1e9)
    assert view.frames == [2]
    assert str(reader.failure) == "gone"
