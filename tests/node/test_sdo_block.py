"""SDO block transfers both ways: byte for byte, every block size, lost segments, every abort,
canopen's client.
"""

from __future__ import annotations

import itertools
import random

import canopen
import pytest

from cases import thorough
from coulombus.node.device import SDO_TIMEOUT_NS
from node_bench import EDS, MS, Bench

TEXT = (EDS / "motor.eds").read_bytes()
"""What 1021h holds: 40 kB."""


def crc_bitwise(data: bytes) -> int:
    """CRC-16-CCITT by its definition: polynomial 1021h, start 0, bits from the left, no final
    inversion.
    """
    remainder = 0
    for byte in data:
        remainder ^= byte << 8
        for _ in range(8):
            remainder = (remainder << 1 ^ 0x1021 if remainder & 0x8000 else remainder << 1) & 0xFFFF
    return remainder


def powered(name: str = "motor", node_id: int = 1, **options) -> Bench:
    bench = Bench(name, node_id, **options)
    bench.power_on()
    bench.take()
    return bench


def head(index: int, subindex: int = 0) -> bytes:
    return index.to_bytes(2, "little") + bytes((subindex,))


def code(frame: bytes | None) -> int:
    assert frame is not None
    assert frame[0] == 0x80, frame.hex()
    return int.from_bytes(frame[4:], "little")


def frames(bench: Bench) -> list[bytes]:
    """Let all that waits go out, and take it."""
    while bench.node.outbox_count:
        bench.run(100_000)
    return [sent.data for sent in bench.take(0x580 + bench.node_id)]


def send(bench: Bench, data: bytes) -> list[bytes]:
    bench.frame(0x600 + bench.node_id, data.ljust(8, b"\0"))
    return frames(bench)


def block_upload(bench, index, subindex=0, *, sizes=(127,), crc=True, lose=frozenset(), asked=None):
    """Read an object as a client that loses the segments whose number of all that were sent is in
    `lose`.
    """
    sizes = itertools.cycle(sizes)
    size = next(sizes)
    (answer,) = send(bench, bytes((0xA4 if crc else 0xA0,)) + head(index, subindex) + bytes((size, 0)))
    assert answer[0] == (0xC6 if crc else 0xC2)
    assert answer[1:4] == head(index, subindex)
    total = int.from_bytes(answer[4:], "little")
    content, count, received = b"", 0, send(bench, b"\xa3")
    while True:
        assert len(received) <= size
        expected = 1
        last = False
        for number, segment in enumerate(received, 1):
            assert segment[0] & 0x7F == number
            count += 1
            if count not in lose and number == expected:
                content += segment[1:]
                expected += 1
                last = bool(segment[0] & 0x80)
        if asked is not None:
            asked.append(expected - 1)
        size = next(sizes)
        received = send(bench, bytes((0xA2, expected - 1, size)))
        if last:
            break
    (end,) = received
    assert end[0] & 0xE3 == 0xC1
    content = content[: len(content) - (end[0] >> 2 & 7)]
    assert len(content) == total
    assert int.from_bytes(end[1:3], "little") == (crc_bitwise(content) if crc else 0)
    assert send(bench, b"\xa1") == []
    return content


def block_download(bench, index, data, subindex=0, *, crc=True, sized=True, lose=frozenset(), wrong_crc=0):
    """Write an object as a client of which the segments in `lose` (counted over all that it sends)
    do not arrive.
    """
    first = (
        bytes((0xC0 | 4 * crc | 2 * sized,)) + head(index, subindex) + (len(data) if sized else 0).to_bytes(4, "little")
    )
    (answer,) = send(bench, first)
    if answer[0] == 0x80:
        return code(answer)
    assert answer[0] == (0xA4 if crc else 0xA0)
    size, position, count = answer[4], 0, 0
    segments = max(-(-len(data) // 7), 1)
    while position < segments:
        answers = []
        sent = min(size, segments - position)
        for number in range(1, sent + 1):
            part = data[7 * (position + number - 1) :][:7]
            last = position + number == segments
            count += 1
            if count not in lose:
                answers += send(bench, bytes((number | 0x80 * last,)) + part)
        (answer,) = answers
        if answer[0] == 0x80:
            return code(answer)
        assert answer[0] == 0xA2
        position += answer[1]
        size = answer[2]
    padding = 7 * segments - len(data)
    (answer,) = send(
        bench, bytes((0xC1 | padding << 2,)) + ((crc_bitwise(data) if crc else 0) ^ wrong_crc).to_bytes(2, "little")
    )
    if answer[0] == 0x80:
        return code(answer)
    assert answer == b"\xa1" + bytes(7)
    return 0


def test_upload_byte_for_byte():
    bench = powered()
    text = b"Coulombus motor drive"  # 21 bytes, three segments
    assert crc_bitwise(b"123456789") == 0x31C3  # CiA 301, 7.2.4.3.16
    assert send(bench, bytes.fromhex("a408100002000000")) == [bytes.fromhex("c608100015000000")]
    assert send(bench, b"\xa3") == [b"\x01" + text[:7], b"\x02" + text[7:14]]
    assert send(bench, bytes.fromhex("a2020a")) == [b"\x81" + text[14:]]
    assert send(bench, bytes.fromhex("a2017f")) == [b"\xc1" + crc_bitwise(text).to_bytes(2, "little") + bytes(5)]
    assert send(bench, b"\xa1") == []
    assert code(send(bench, b"\xa3")[0]) == 0x05040001  # it is over


def test_download_byte_for_byte():
    bench = powered()
    text = b"handle, left"  # 12 bytes
    assert send(bench, bytes.fromhex("c60420000c000000")) == [bytes.fromhex("a40420007f000000")]
    assert send(bench, b"\x01" + text[:7]) == []
    assert send(bench, b"\x82" + text[7:]) == [bytes.fromhex("a2027f0000000000")]
    end = bytes((0xC1 | 2 << 2,)) + crc_bitwise(text).to_bytes(2, "little")
    assert send(bench, end) == [bytes.fromhex("a100000000000000")]
    assert bench.upload(0x2004) == text


@pytest.mark.parametrize("sizes", [(127,), (1,), (2, 126, 5), (89,), (127, 1)])
@pytest.mark.parametrize("crc", [True, False])
def test_upload_in_blocks_of_any_size(sizes, crc):
    bench = powered()
    index = 0x1008 if sizes == (1,) else 0x1021
    assert block_upload(bench, index, sizes=sizes, crc=crc) == (TEXT if index == 0x1021 else b"Coulombus motor drive")
    assert block_upload(bench, 0x1000, sizes=sizes, crc=crc) == bytes.fromhex("92010200")
    assert bench.node.outbox_count == 0


def test_lost_segments_of_an_upload_are_sent_again():
    bench = powered()
    asked: list[int] = []
    lose = {1, 2, 130, 255, 256, 400, 700}
    assert block_upload(bench, 0x1021, lose=lose, asked=asked) == TEXT
    assert asked[0] == 0  # nothing in order: the whole block again
    assert any(0 < number < 127 for number in asked[:-1])


@pytest.mark.parametrize("size", [0, 1, 4, 6, 7, 8, 13, 14, 888, 889, 890, 1778, 4096])
@pytest.mark.parametrize("crc", [True, False])
def test_download_of_any_size_with_and_without_its_size(size, crc):
    bench = powered()
    text = bytes(65 + k % 26 for k in range(size))
    for sized in (True, False):
        assert block_download(bench, 0x2004, text, crc=crc, sized=sized) == 0
        assert bench.upload(0x2004) == text
    bench.write(0x1017, 0, 0, 2)
    assert block_download(bench, 0x1017, b"\xfa\x00", crc=crc) == 0
    assert bench.number(0x1017) == 250


def test_lost_segments_of_a_download_are_asked_for_again():
    bench = powered()
    text = bytes(65 + k % 26 for k in range(4000))
    assert block_download(bench, 0x2004, text, lose={1, 2, 130, 253, 255, 300, 500}) == 0
    assert bench.upload(0x2004) == text


def test_the_server_may_change_the_size_of_the_next_block():
    bench = powered()
    server = next(iter(bench.device._sdo._channels.values())).server
    sizes = itertools.cycle((1, 127, 3, 50))
    text = bytes(65 + k % 26 for k in range(3000))
    original = server.request

    def request(data):
        server.block_size = next(sizes)
        return original(data)

    server.request = request
    assert block_download(bench, 0x2004, text) == 0
    assert bench.upload(0x2004) == text


def test_too_much_too_little_and_a_wrong_crc_change_nothing():
    bench = powered()
    before = bench.upload(0x2004)
    assert block_download(bench, 0x2004, bytes(4097)) == 0x06070012
    assert block_download(bench, 0x2004, bytes(4097), sized=False) == 0x06070012
    assert (
        block_download(bench, 0x2004, bytes(9000), sized=False) == 0x06070012
    )  # found out within, told at a block's end
    assert block_download(bench, 0x1017, bytes(3), sized=False) == 0x06070012
    assert block_download(bench, 0x1017, bytes(1), sized=False) == 0x06070013
    assert block_download(bench, 0x1019, b"\xf1") == 0x06090031
    assert block_download(bench, 0x1000, bytes(4)) == 0x06010002
    assert block_download(bench, 0x2004, b"abcdefghij", wrong_crc=1) == 0x05040004
    send(bench, bytes.fromhex("c604200008000000"))  # eight bytes are announced
    send(bench, b"\x01abcdefg")
    send(bench, b"\x82hi")
    assert code(send(bench, b"\xd1" + crc_bitwise(b"abcdefghij").to_bytes(2, "little"))[0]) == 0x06070012
    send(bench, bytes.fromhex("c604200008000000"))
    send(bench, b"\x81abcdefg")
    assert code(send(bench, b"\xc1" + crc_bitwise(b"abcdefg").to_bytes(2, "little"))[0]) == 0x06070013
    assert bench.upload(0x2004) == before


@pytest.mark.parametrize("number", [0, 11])
def test_a_segment_that_has_no_number_in_the_block_is_refused(number):
    bench = powered()
    next(iter(bench.device._sdo._channels.values())).server.block_size = 10
    send(bench, bytes.fromhex("c204200010000000"))
    assert code(send(bench, bytes((number,)) + b"abcdefg")[0]) == 0x05040003
    assert code(send(bench, b"\xc1")[0]) == 0x05040001


@pytest.mark.parametrize(
    ("requests", "abort"),
    [
        (("a408100000",), 0x05040002),
        (("a408100080",), 0x05040002),
        (("a40810000a", "a3", "a20300"), 0x05040002),
        (("a40810000a", "a3", "a20180"), 0x05040002),
        (("a40810000a", "a3", "a2040a"), 0x05040003),  # three segments were sent
        (("a40810000a", "a3", "a2800a"), 0x05040003),
        (("a40810000a", "a3", "a300000000000001"), 0x05040001),
        (("a40810000a", "a2000a"), 0x05040001),  # acknowledged before it began
        (("a40810000a", "a1"), 0x05040001),
        (("a40810000a", "a3", "a1"), 0x05040001),
        (("a40810000a", "60"), 0x05040001),
        (("a40810000a", "a3", "a2030a", "a2000a"), 0x05040001),
        (("c604200008000000", "8161626364656667", "60"), 0x05040001),
        (("c604200008000000", "8161626364656667", "a3"), 0x05040001),
    ],
)
def test_what_does_not_fit_is_aborted_and_ends_the_transfer(requests, abort):
    bench = powered()
    for request in requests[:-1]:
        assert all(answer[0] != 0x80 for answer in send(bench, bytes.fromhex(request)))
    answer = send(bench, bytes.fromhex(requests[-1]))[0]
    assert code(answer) == abort
    assert answer[1:4] in (head(0x1008), head(0x2004))
    assert code(send(bench, b"\xa1")[0]) == 0x05040001
    assert bench.number(0x1000) == 0x20192


@pytest.mark.parametrize(
    "requests",
    [
        ("a408100002",),
        ("a408100002", "a3"),
        ("a408100002", "a3", "a2027f"),
        ("a408100002", "a3", "a2027f", "a2017f"),
        ("c604200008000000",),
        ("c604200008000000", "0161626364656667"),
        ("c604200008000000", "8161626364656667"),
    ],
)
def test_every_phase_ends_in_a_time_out_or_with_the_client_s_abort_or_a_new_request(requests):
    bench = powered()
    index = 0x1008 if requests[0].startswith("a") else 0x2004
    for request in requests:
        assert all(answer[0] != 0x80 for answer in send(bench, bytes.fromhex(request)))
    bench.run(SDO_TIMEOUT_NS + MS)
    assert [sent.data for sent in bench.take(0x581)] == [b"\x80" + head(index) + bytes.fromhex("00000405")]
    bench.run(3 * SDO_TIMEOUT_NS)
    assert bench.take(0x581) == []
    for request in requests:
        send(bench, bytes.fromhex(request))
    assert send(bench, b"\x80" + head(index) + bytes.fromhex("00000008")) == []  # no answer to an abort
    bench.run(3 * SDO_TIMEOUT_NS)
    assert bench.take(0x581) == []
    if "0161626364656667" not in requests and len(requests) > 1:
        for request in requests:
            send(bench, bytes.fromhex(request))
        assert bench.number(0x1000) == 0x20192
        assert code(send(bench, b"\xa1")[0]) == 0x05040001


def test_each_request_of_a_block_download_may_be_delivered_twice():
    bench, text = powered(), bytes(65 + k % 26 for k in range(900))
    (answer,) = [one for _ in range(2) for one in send(bench, bytes.fromhex("c604200084030000"))]
    assert answer[0] == 0xA4
    parts = [text[k : k + 7].ljust(7, b"\0") for k in range(0, 900, 7)]
    for block in (parts[:127], parts[127:]):
        for number, part in enumerate(block, 1):
            last = 0x80 * (len(block) < 127 and number == len(block))
            answers = [send(bench, bytes((number | last,)) + part) for _ in range(2)]
        assert answers == [[bytes((0xA2, len(block), 127, 0, 0, 0, 0, 0))], []]
    end = bytes((0xC1 | (-900 % 7) << 2,)) + crc_bitwise(text).to_bytes(2, "little")
    assert [send(bench, end) for _ in range(2)] == [[b"\xa1" + bytes(7)], []]
    assert bench.upload(0x2004) == text


def test_each_request_of_a_block_upload_may_be_delivered_twice():
    bench = powered()
    content = bench.upload(0x1021)
    send(bench, bytes.fromhex("a42110007f"))
    got, request = b"", b"\xa3"
    while True:
        for _ in range(2):
            bench.frame(0x601, request.ljust(8, b"\0"))
        segments = frames(bench)
        if segments[0][0] & 0xE3 == 0xC1 and len(got) >= len(content):
            break
        assert [one[0] & 0x7F for one in segments] == list(range(1, len(segments) + 1))
        got += b"".join(one[1:] for one in segments)
        request = bytes((0xA2, len(segments), 127))
    assert len(segments) == 1
    assert got[: len(content)] == content


def test_a_small_object_may_go_by_the_other_protocols():
    bench = powered()
    assert send(bench, bytes.fromhex("a400100014040000")) == [bytes.fromhex("4300100092010200")]
    assert send(bench, bytes.fromhex("a408100014150000"))[0][0] == 0x41
    assert send(bench, b"\x60")[0] == b"\x00Coulomb"
    assert send(bench, bytes.fromhex("a408100014140000"))[0][0] == 0xC6  # one byte more than the threshold


def test_a_block_leaves_room_on_the_bus_for_others():
    bench = powered()
    bench.write(0x1017, 0, 1, 2)
    send(bench, bytes.fromhex("a42110007f"))
    bench.frame(0x601, b"\xa3" + bytes(7))
    assert bench.node.outbox_count == 127
    assert len(bench.take()) == 0  # nothing at once: the queue is everybody's
    bench.out["waiting"] = 3  # the bus has three frames of others to send
    bench.run(2 * MS)
    assert [sent.can_id for sent in bench.take()] == [0x701, 0x701]
    bench.out["waiting"] = 0
    bench.run(200_000)
    assert 0 < len(bench.take(0x581)) < 10
    bench.nmt(2)
    assert bench.node.outbox_count == 0
    bench.take()
    bench.run(2 * SDO_TIMEOUT_NS)
    assert bench.take(0x581) == []


def count_services(bench: Bench) -> list[bytes]:
    """Let every frame that Python serves be listed."""
    served: list[bytes] = []
    service = bench.device.service

    def counted(t_ns, can_id, length, word, out):
        served.append(word.to_bytes(8, "little", signed=True))
        service(t_ns, can_id, length, word, out)

    bench.device.service = counted
    return served


def test_python_serves_a_block_s_beginning_and_end_and_no_segment_between():
    bench = powered()
    served = count_services(bench)
    text = bytes(65 + k % 26 for k in range(4000))  # 572 segments: four blocks of 127, and one of 64
    assert block_download(bench, 0x2004, text) == 0
    assert [data[0] for data in served] == [0xC6, 127, 127, 127, 127, 0x80 | 64, 0xC1 | 4 << 2]
    assert bench.upload(0x2004) == text
    assert bench.node.segments_open == 0


def test_behind_a_lost_segment_python_serves_the_rest_of_the_block_only():
    bench = powered()
    served = count_services(bench)
    text = bytes(65 + k % 26 for k in range(889 * 3))
    assert block_download(bench, 0x2004, text, lose={227}) == 0  # the second block's segment 100
    assert [data[0] for data in served[:30]] == [0xC6, 127, *range(101, 128), 127]
    assert bench.upload(0x2004) == text


def test_each_segment_that_the_core_collects_puts_the_time_out_off():
    bench = powered()
    send(bench, bytes.fromhex("c604200016000000"))
    for number in (1, 2, 3):
        bench.run(SDO_TIMEOUT_NS - MS)
        assert send(bench, bytes((number,)) + b"abcdefg") == []
    assert send(bench, b"\x84h") == [bytes.fromhex("a2047f0000000000")]
    assert send(bench, b"\xd9" + crc_bitwise(b"abcdefg" * 3 + b"h").to_bytes(2, "little"))[0][0] == 0xA1


@pytest.mark.parametrize("ending", ["time-out", "abort", "reset", "stopped", "new request"])
def test_what_the_core_collected_goes_with_its_transfer(ending):
    bench = powered()
    before = bench.upload(0x2004)
    send(bench, bytes.fromhex("c604200015000000"))
    assert send(bench, b"\x01abcdefg") == []
    assert bench.node.segments_open == 1
    if ending == "time-out":
        bench.run(2 * SDO_TIMEOUT_NS)
    elif ending == "abort":
        send(bench, b"\x80" + head(0x2004) + bytes.fromhex("00000008"))
    elif ending == "new request":
        assert code(send(bench, b"\x00abcdefg")[0]) == 0x05040003  # in a block every frame is a segment
    else:
        bench.nmt(0x81 if ending == "reset" else 0x02)
        bench.nmt(0x80)
    bench.take()
    assert code(send(bench, b"\x02hijklmn")[0]) == 0x05040001
    assert bench.node.segments_open == 0
    assert bench.upload(0x2004) == before
    assert block_download(bench, 0x2004, b"once more, from its beginning") == 0
    assert bench.upload(0x2004) == b"once more, from its beginning"


def test_two_servers_collect_beside_each_other():
    bench = powered()
    bench.write(0x1201, 1, 0x6D0, 4)
    bench.write(0x1201, 2, 0x580, 4)
    texts = {0x601: (0x581, b"left " * 20), 0x6D0: (0x580, b"right" * 20)}
    for rx in texts:
        bench.frame(rx, bytes.fromhex("c204200064000000"))
    bench.take()
    for number in range(1, 15):
        for rx, (_, text) in texts.items():
            bench.frame(rx, bytes((number,)) + text[7 * number - 7 : 7 * number])
    assert bench.node.segments_open == 2
    assert bench.take() == []
    for rx, (tx, text) in texts.items():
        bench.frame(rx, b"\x8f" + text[98:].ljust(7, b"\0"))
        bench.frame(rx, bytes((0xC1 | 5 << 2,)).ljust(8, b"\0"))
        assert [sent.data[:2] for sent in bench.take(tx)] == [b"\xa2\x0f", b"\xa1\0"]
        assert bench.upload(0x2004) == text


def test_a_server_whose_identifier_changes_forgets_what_was_collected_for_it():
    bench = powered()
    bench.write(0x1201, 1, 0x6D0, 4)
    bench.write(0x1201, 2, 0x580, 4)
    bench.frame(0x6D0, bytes.fromhex("c204200064000000"))
    bench.frame(0x6D0, b"\x01abcdefg")
    assert bench.node.segments_open == 1
    bench.write(0x1201, 1, 0x800006D0, 4)
    assert bench.node.segments_open == 0
    bench.write(0x1201, 1, 0x6D0, 4)
    bench.take()
    bench.frame(0x6D0, b"\x02hijklmn")
    assert [code(sent.data) for sent in bench.take(0x580)] == [0x05040001]


_PIECES = tuple(
    bytes.fromhex(text) for text in (
        "c604200010000000", "c204200032000000", "c004200000000000", "c100000000000000", "d500000000000000",
        "8004200000000008", "4000100000000000", "4004200000000000", "6000000000000000", "2b17100032000000",
    )
)  # fmt: skip


@pytest.mark.parametrize("seed", [0, *thorough(1, 2, 3)])
def test_with_and_without_the_core_s_collecting_a_node_sends_the_same_bytes(seed, monkeypatch):
    """Random downloads: gaps, repetitions, numbers that are none, pauses over the time-out,
    lengths, other requests.
    """
    rng = random.Random(seed)
    benches = [powered(), powered()]
    plain = next(iter(benches[1].device._sdo._channels.values())).server
    plain.__class__ = type("Plain", (type(plain),), {"expected": (0, 0)})
    size = rng.choice((3, 10, 127))
    for bench in benches:
        next(iter(bench.device._sdo._channels.values())).server.block_size = size
    number = collected = 0
    for _ in range(600):
        number = number % size + 1 if rng.random() < 0.9 else rng.randrange(1, size + 1)
        data = bytes((number | 0x80 * (rng.random() < 0.03),)) + rng.randbytes(7)
        if not plain.transfer or rng.random() < 0.03:
            data, number = rng.choice(_PIECES), 0
        if rng.random() < 0.01:
            data = data[: rng.randrange(8)]
        pause = rng.choice((1, 1, 1, 1, 1, 1, 1, 600, 1100)) * MS
        for bench in benches:
            bench.run(pause)
            bench.frame(0x601, data)
        collected += int(benches[0].node.segments_open)
        first, second = (bench.take() for bench in benches)
        assert first == second
    assert collected > 100
    for bench in benches:
        send(bench, b"\x80" + head(0x2004) + bytes.fromhex("00000008"))
    assert benches[0].upload(0x2004) == benches[1].upload(0x2004)


class Wire(canopen.Network):
    """canopen's network without a thread: what it sends reaches the device, and the answers its
    subscribers, at once.
    """

    def __init__(self, bench: Bench):
        super().__init__()
        self.bench = bench

    def send_message(self, can_id, data, remote=False):
        self.bench.frame(can_id, bytes(data))
        while self.bench.node.outbox_count:
            self.bench.run(100_000)
        for sent in self.bench.take():
            self.notify(sent.can_id, bytearray(sent.data), 0.0)


def client(bench: Bench, eds: str) -> canopen.RemoteNode:
    node = canopen.RemoteNode(bench.node_id, eds)
    Wire(bench).add_node(node)
    return node


@pytest.mark.thorough
@pytest.mark.parametrize("size", [1, 7, 8, 889, 890, 4000])
@pytest.mark.parametrize("crc", [True, False])
def test_canopens_client_both_ways(size, crc):
    bench = powered("mr_brake", 2)
    node = client(bench, str(EDS / "mr_brake.eds"))
    content = bytes(random.Random(size).randrange(32, 127) for _ in range(size))
    with node.sdo.open(0x2004, 0, "wb", size=size, block_transfer=True, request_crc_support=crc) as stream:
        stream.write(content)
    with node.sdo.open(0x2004, 0, "rb", block_transfer=True, request_crc_support=crc) as stream:
        assert stream.read() == content
    with node.sdo.open(0x1021, 0, "rb", block_transfer=True, request_crc_support=crc) as stream:
        assert stream.read() == (EDS / "mr_brake.eds").read_bytes()
