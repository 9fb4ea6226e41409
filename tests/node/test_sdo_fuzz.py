"""The SDO servers against a model: two clients, every protocol, interrupted anywhere; and frames of
any kind.
"""

from __future__ import annotations

import binascii

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from benchmarks.nodes import fuzz, random_frame
from coulombus.node.device import SDO_TIMEOUT_NS
from coulombus.node.record import OUTBOX
from node_bench import MS, Bench

TEXT, HEARTBEAT, SLOPE = 0x2004, 0x1017, 0x6087
CLIENTS = {0: (0x601, 0x581), 1: (0x6D0, 0x580)}
"""Channel -> its identifiers, request and response."""

clients = st.sampled_from(list(CLIENTS))
texts = st.binary(max_size=300).map(lambda raw: bytes(32 + byte % 95 for byte in raw))


class Clients(RuleBasedStateMachine):
    """What a client wrote last and in full is what every client reads, whatever else was begun and
    left.
    """

    @initialize()
    def switch_on(self) -> None:
        self.bench = Bench("motor", 1)
        self.bench.power_on()
        self.bench.write(0x1201, 1, 0x6D0, 4)
        self.bench.write(0x1201, 2, 0x580, 4)
        self.bench.take()
        self.model = {TEXT: self.bench.upload(TEXT), HEARTBEAT: bytes(2), SLOPE: (10_000_000).to_bytes(4, "little")}

    def ask(self, client: int, data: bytes) -> list[bytes]:
        rx, tx = CLIENTS[client]
        self.bench.frame(rx, data.ljust(8, b"\0"))
        while self.bench.node.outbox_count:
            self.bench.run(100_000)
        answers = [frame.data for frame in self.bench.take(tx)]
        other = CLIENTS[1 - client][1]
        assert not [frame for frame in self.bench.take(other) if frame.data[0] != 0x80]  # nothing for the other
        return answers

    def abort(self, client: int) -> None:
        assert self.ask(client, b"\x80\0\0\0\0\0\0\x08") == []

    @rule(client=clients, index=st.sampled_from([HEARTBEAT, SLOPE]), value=st.integers(0, 65535))
    def write_expedited(self, client, index, value):
        size = 2 if index == HEARTBEAT else 4
        data = value.to_bytes(size, "little")
        self.abort(client)
        (answer,) = self.ask(client, bytes((0x23 | (4 - size) << 2,)) + index.to_bytes(2, "little") + b"\0" + data)
        assert answer[0] == 0x60
        self.model[index] = data

    @rule(client=clients, text=texts, stop=st.one_of(st.none(), st.integers(0, 40)))
    def write_segmented(self, client, text, stop):
        self.abort(client)
        (answer,) = self.ask(client, b"\x21\x04\x20\0" + len(text).to_bytes(4, "little"))
        assert answer[0] == 0x60
        parts = [text[k : k + 7] for k in range(0, len(text), 7)] or [b""]
        for number, part in enumerate(parts):
            if number == stop:
                return
            toggle = number % 2 << 4
            (answer,) = self.ask(client, bytes((toggle | (7 - len(part)) << 1 | (number == len(parts) - 1),)) + part)
            assert answer == bytes((0x20 | toggle,)) + bytes(7)
        self.model[TEXT] = text

    @rule(client=clients, text=texts, stop=st.one_of(st.none(), st.integers(0, 45)), crc=st.booleans())
    def write_block(self, client, text, stop, crc):
        self.abort(client)
        head = bytes((0xC2 | 4 * crc,)) + b"\x04\x20\0"
        (answer,) = self.ask(client, head + len(text).to_bytes(4, "little"))
        assert answer[0] & 0xFB == 0xA0
        parts = [text[k : k + 7] for k in range(0, len(text), 7)] or [b""]
        for number, part in enumerate(parts):
            if number == stop:
                return
            last = number == len(parts) - 1
            answers = self.ask(client, bytes((number + 1 | 0x80 * last,)) + part)
            assert [a[:2] for a in answers] == ([bytes((0xA2, number + 1))] if last else [])
        if stop == len(parts):
            return
        end = bytes((0xC1 | 7 * len(parts) - len(text) << 2,)) + binascii.crc_hqx(text, 0).to_bytes(2, "little")
        assert self.ask(client, end) == [b"\xa1" + bytes(7)]
        self.model[TEXT] = text

    @rule(client=clients, index=st.sampled_from([TEXT, HEARTBEAT, SLOPE]))
    def read(self, client, index):
        self.abort(client)
        (answer,) = self.ask(client, b"\x40" + index.to_bytes(2, "little") + b"\0")
        if answer[0] & 0x02:
            assert answer[4 : 8 - (answer[0] >> 2 & 3)] == self.model[index]
            return
        content, toggle = b"", 0
        while True:
            (segment,) = self.ask(client, bytes((0x60 | toggle,)))
            content += segment[1 : 8 - (segment[0] >> 1 & 7)]
            toggle ^= 0x10
            if segment[0] & 1:
                break
        assert content == self.model[index]

    @rule(client=clients, size=st.integers(1, 127), stop=st.one_of(st.none(), st.integers(0, 6)))
    def read_block(self, client, size, stop):
        self.abort(client)
        (answer,) = self.ask(client, b"\xa4\x04\x20\0" + bytes((size,)))
        assert answer[0] == 0xC6
        content, steps, segments = b"", 0, self.ask(client, b"\xa3")
        while segments[0][0] & 0xE3 != 0xC1 or len(content) < len(self.model[TEXT]):
            if steps == stop:
                return
            steps += 1
            content += b"".join(segment[1:] for segment in segments)
            segments = self.ask(client, bytes((0xA2, len(segments), size)))
            if content and len(content) >= len(self.model[TEXT]):
                break
            if not self.model[TEXT]:
                break
        padding = segments[0][0] >> 2 & 7
        assert content[: len(content) - padding] == self.model[TEXT]
        assert self.ask(client, b"\xa1") == []

    @rule(client=clients, data=st.binary(min_size=8, max_size=8))
    def say_anything_that_writes_nothing(self, client, data):
        """A first byte that is no download and no segment of one, then an abort."""
        self.abort(client)
        if data[0] >> 5 in (2, 3, 5, 7):
            answers = self.ask(client, data)
            assert len(answers) == 1 or data[0] & 0xE3 == 0xA1
        self.abort(client)

    @rule(client=clients)
    def fall_silent(self, client):
        """Whoever is in the middle of a transfer is told, once."""
        self.bench.take()
        self.bench.run(SDO_TIMEOUT_NS + MS)
        told = [frame.can_id for frame in self.bench.take() if frame.data[:1] == b"\x80"]
        assert len(told) == len(set(told)) <= 2
        self.bench.run(SDO_TIMEOUT_NS + MS)
        assert not [frame for frame in self.bench.take() if frame.can_id in (0x580, 0x581)]

    @invariant()
    def memory_is_bounded(self) -> None:
        if hasattr(self, "bench"):
            assert 0 <= self.bench.node.outbox_count <= OUTBOX


TestClients = Clients.TestCase
TestClients.settings = settings(max_examples=25, stateful_step_count=20, deadline=None)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.thorough)])
def test_no_frames_break_a_node(seed):
    result = fuzz(10_000, seed)
    assert result["queue_dropped"] == 0
    assert result["answers"] > 1000
    assert result["dropped_length"] > 10
    assert result["dropped_unknown"] > 10
    assert result["outbox_count"] <= OUTBOX


def test_after_any_frames_a_reset_makes_the_node_whole():
    import random

    rng = random.Random(5)
    bench = Bench("motor", 1)
    bench.power_on()
    for _ in range(3000):
        bench.run(rng.randrange(1, 3) * 100_000)
        can_id, data = random_frame(rng)
        bench.frame(can_id, data)
        bench.take()
    bench.device.store.put({name: {} for name in ("communication", "application", "manufacturer", "lss")})
    bench.device.power_off()
    bench.power_on()
    bench.take()
    assert bench.number(0x1000) == 0x20192
    assert bench.number(0x1017) == 0
    assert bench.node.out_torque_pm == 0
