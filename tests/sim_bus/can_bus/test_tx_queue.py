"""Frames that wait: the room's two heaps against a plain list."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.sim_bus.can_bus.arbiter import new_bus
from coulombus.sim_bus.can_bus.records import ROOM
from coulombus.sim_bus.can_bus.tx_queue import FEW, first_ns, take_in, win, withdraw
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import arbitration_key, new_queue, push


class Listed:
    """What waits, as a list that is searched from end to end."""

    def __init__(self) -> None:
        self.frames: list[tuple[int, int, int, int]] = []  # ready, arbitration field, number, station

    def first_ns(self) -> int:
        return min((ready for ready, *_ in self.frames), default=NEVER_NS)

    def winner(self, now_ns: int) -> int | None:
        ready = [frame for frame in self.frames if frame[0] <= now_ns]
        if not ready:
            return None
        best = min(ready, key=lambda frame: frame[1:])
        self.frames.remove(best)
        return best[2]


@pytest.mark.parametrize("seed", range(4))
def test_frames_leave_in_the_order_in_which_they_win(seed):
    random = np.random.default_rng(seed)
    bus, out, listed = new_bus(1_000_000)[0], new_queue(), Listed()
    now, number, most = 0, 0, 0
    for _ in range(300):
        for _ in range(int(random.integers(0, 5))):
            ready, can_id, station = (
                now + int(random.integers(0, 4)) * 20,
                int(random.integers(0, 6)) * 0x40,
                int(random.integers(-1, 3)),
            )
            push(out, station, ready, can_id, 8, number)
            listed.frames.append((ready, arbitration_key(can_id), number, station))
            number += 1
        if random.random() < 0.02:
            withdraw(bus, out, 1)
            listed.frames = [frame for frame in listed.frames if frame[3] != 1]
        now += int(random.integers(0, 30))
        assert max(first_ns(bus, out), now) == max(listed.first_ns(), now)
        expected = listed.winner(now)
        if expected is not None:
            win(bus, out, now)
            assert bus["word"] == expected
        most = max(most, len(listed.frames))
        assert bus["held"] + out["count"] == len(listed.frames)
        if bus["held"]:
            take_in(bus, out)
            for station in (-1, 0, 1, 2):
                assert bus["waiting_of"][station] == sum(frame[3] == station for frame in listed.frames)
    assert most > 4 * FEW
    while listed.frames:  # and all the way back to few
        now = max(now, listed.first_ns())
        expected = listed.winner(now)
        win(bus, out, now)
        assert bus["word"] == expected
    assert first_ns(bus, out) == NEVER_NS


def test_what_finds_no_room_is_counted():
    bus, out = new_bus(1_000_000)[0], new_queue()
    for _ in range(2):
        for n in range(ROOM - 10):
            push(out, 0, 0, n & 0x7FF, 0, 0)
        take_in(bus, out)
    assert bus["held"] == ROOM
    assert out["dropped"] == ROOM - 20
    win(bus, out, 0)
    assert bus["can_id"] == 0
    push(out, 0, 0, 0x123, 0, 0)
    take_in(bus, out)
    assert (bus["held"], out["dropped"]) == (ROOM, ROOM - 20)
