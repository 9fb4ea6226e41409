"""The SDO server: transfers both ways, abort codes in their places, canopen's client against every
object.
"""

from __future__ import annotations

import struct

import canopen
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.eds.cia301 import DATA_TYPES
from coulombus.node.device import SDO_TIMEOUT_NS
from coulombus.node.dictionary import SdoAbort
from coulombus.node.sdo_server import SdoServer
from node_bench import EDS, MS, Bench, SdoAborted, description, motor


def powered(name: str = "motor", node_id: int = 1) -> Bench:
    bench = Bench(name, node_id)
    bench.power_on()
    bench.take()
    return bench


def code(answer: bytes | None) -> int:
    assert answer is not None
    assert answer[0] == 0x80
    return int.from_bytes(answer[4:], "little")


def test_expedited_upload_byte_for_byte():
    bench = powered()
    assert bench.request(bytes.fromhex("4000100000000000")) == bytes.fromhex("4300100092010200")
    assert bench.request(bytes.fromhex("4019100000000000")) == bytes.fromhex("4f19100000000000")


def test_segmented_upload_byte_for_byte():
    bench = powered()
    text = b"Coulombus motor drive"
    assert bench.request(bytes.fromhex("4008100000000000")) == bytes.fromhex("41081000") + struct.pack("<I", len(text))
    assert bench.request(bytes.fromhex("6000000000000000")) == b"\x00" + text[:7]
    assert bench.request(bytes.fromhex("7000000000000000")) == b"\x10" + text[7:14]
    assert bench.request(bytes.fromhex("6000000000000000")) == b"\x01" + text[14:]
    assert code(bench.request(bytes.fromhex("7000000000000000"))) == 0x05040001  # it is over


def test_last_segment_tells_its_unused_bytes():
    bench = powered()
    bench.request(bytes.fromhex("4009100000000000"))  # "virtual", 7 bytes
    assert bench.request(bytes.fromhex("6000000000000000")) == b"\x01virtual"
    bench.download(0x2004, 0, b"ab")
    assert bench.request(bytes.fromhex("4004200000000000")) == bytes.fromhex("4b042000") + b"ab\0\0"
    bench.download(0x2004, 0, b"12345678")
    bench.request(bytes.fromhex("4004200000000000"))
    bench.request(bytes.fromhex("6000000000000000"))
    assert bench.request(bytes.fromhex("7000000000000000")) == bytes.fromhex("1d") + b"8" + bytes(6)


@pytest.mark.parametrize(
    ("request_hex", "abort"),
    [
        ("4004100000000000", 0x06020000),  # 1004h does not exist
        ("4000100100000000", 0x06090011),  # 1000h:01 does not exist, a VAR has one sub-index
        ("4018100900000000", 0x06090011),
        ("4003200000000000", 0x06010001),  # write-only
        ("2300100001000000", 0x06010002),  # read-only
        ("2308100061626364", 0x06010002),  # const
        ("2f99990000000000", 0x06020000),
        ("2f17100132000000", 0x06090011),
        ("2317100032000000", 0x06070012),  # 4 bytes to UNSIGNED16
        ("2f17100032000000", 0x06070013),  # 1 byte to UNSIGNED16
        ("2f19100001000000", 0x06090030),  # 1 is no counter overflow
        ("2f191000f1000000", 0x06090031),  # 241 is above the EDS' limit
        ("2b6060000a000000", 0x06070012),
        ("2b71600010270100", 0x00000000),  # 10000 is allowed
        ("2b71600011270000", 0x06090031),  # 10001
        ("2b716000efd80000", 0x06090032),  # -10001
        ("2f29100103000000", 0x06090031),
        ("2116100108000000", 0x06070012),  # segmented, 8 bytes announced for 4
        ("2116100103000000", 0x06070013),
        ("2100100004000000", 0x06010002),  # a segmented write to a read-only object is refused at its beginning
        ("a400100000000000", 0x05040002),  # block upload with 0 segments a block
        ("a400100080000000", 0x05040002),  # with 128
        ("a499990010000000", 0x06020000),
        ("a403200010000000", 0x06010001),
        ("a100000000000000", 0x05040001),  # end, acknowledgement and start of a block upload that is not open
        ("a27f7f0000000000", 0x05040001),
        ("a300000000000000", 0x05040001),
        ("c600100004000000", 0x06010002),  # block download to a read-only object
        ("c617100004000000", 0x06070012),
        ("c617100001000000", 0x06070013),
        ("c100000000000000", 0x05040001),  # end of a block download that is not open
        ("e000100000000000", 0x05040001),
        ("6000000000000000", 0x05040001),  # a segment without a transfer
        ("0100000000000000", 0x05040001),
        ("2305100080000020", 0x06090030),  # 29-bit SYNC identifier
        ("2305100001060000", 0x06090030),  # SYNC on an SDO's identifier
        ("2b06100032000000", 0x06070013),
        ("2306100032000000", 0x06090030),  # a SYNC every 50 us
    ],
)
def test_abort_codes(request_hex, abort):
    bench = powered()
    request = bytes.fromhex(request_hex)
    answer = bench.request(request)
    if abort == 0:
        assert answer is not None
        assert answer[0] == 0x60
        return
    assert code(answer) == abort
    if request[0] >> 5 in (1, 2):
        assert answer is not None
        assert answer[1:4] == request[1:4]


def test_an_abort_leaves_the_value_as_it_was():
    bench = powered()
    before = bench.number(0x6071)
    for data in (b"\x11\x27", b"\x00", b"\x00\x00\x00\x00"):
        with pytest.raises(SdoAborted):
            bench.download(0x6071, 0, data)
    assert bench.number(0x6071) == before


def test_toggle_error_ends_the_transfer_both_ways():
    bench = powered()
    bench.request(bytes.fromhex("4008100000000000"))
    answer = bench.request(bytes.fromhex("7000000000000000"))
    assert code(answer) == 0x05030000
    assert answer is not None
    assert answer[1:4] == bytes.fromhex("081000")
    assert code(bench.request(bytes.fromhex("6000000000000000"))) == 0x05040001
    bench.request(bytes.fromhex("2104200010000000"))
    bench.request(b"\x00" + b"abcdefg")
    assert code(bench.request(b"\x00" + b"hijklmn")) == 0x05030000
    assert code(bench.request(b"\x10" + b"hijklmn")) == 0x05040001
    assert bench.upload(0x2004) == b"Coulombus motor drive, handle axis"


def test_a_segment_that_is_delivered_twice_is_answered_once():
    """CAN does so when the last bit of a frame's end is disturbed."""
    bench = powered()
    bench.download(0x2004, 0, b"abcdefghij")
    bench.request(bytes.fromhex("4004200000000000"))
    for request, answer in ((b"\x60", b"\x00abcdefg"), (b"\x70", b"\x19hij\0\0\0\0")):
        assert [bench.request(request + bytes(7)) for _ in range(3)] == [answer, None, None]
    assert code(bench.request(b"\x60" + bytes(7))) == 0x05040001
    bench.request(bytes.fromhex("210420000a000000"))
    for request, answer in ((b"\x00klmnopq", b"\x20"), (b"\x19rst\0\0\0\0", b"\x30")):
        assert [bench.request(request) for _ in range(2)] == [answer + bytes(7), None]
    assert bench.upload(0x2004) == b"klmnopqrst"


def test_an_initiation_that_is_delivered_twice_is_served_twice():
    bench = powered()
    for _ in range(2):
        assert bench.request(bytes.fromhex("2104200003000000")) == bytes.fromhex("6004200000000000")
    bench.request(b"\x09abc\0\0\0\0")
    assert bench.upload(0x2004) == b"abc"


def test_what_is_repeated_behind_another_request_is_no_doubled_frame():
    bench = powered()
    bench.request(bytes.fromhex("4008100000000000"))
    bench.request(bytes.fromhex("6000000000000000"))
    bench.request(bytes.fromhex("7000000000000000"))
    assert code(bench.request(bytes.fromhex("7000000000000001"))) == 0x05030000
    bench.request(bytes.fromhex("4008100000000000"))
    bench.request(bytes.fromhex("6000000000000000"))
    bench.run(SDO_TIMEOUT_NS + MS)
    assert code(bench.request(bytes.fromhex("6000000000000000"))) == 0x05040001  # its time is over


def test_a_client_that_aborts_gets_no_answer_and_ends_the_transfer():
    bench = powered()
    bench.request(bytes.fromhex("4008100000000000"))
    assert bench.request(bytes.fromhex("8008100000000405")) is None
    assert code(bench.request(bytes.fromhex("6000000000000000"))) == 0x05040001


def test_a_new_initiation_replaces_the_open_transfer():
    bench = powered()
    bench.request(bytes.fromhex("2104200010000000"))
    bench.request(b"\x00" + b"abcdefg")
    assert bench.number(0x1000) == 0x20192
    assert code(bench.request(b"\x10" + b"hijklmn")) == 0x05040001
    assert bench.upload(0x2004).startswith(b"Coulombus")


def test_segmented_download_with_and_without_size_and_its_lengths():
    bench = powered()
    for size in (0, 1, 6, 7, 8, 13, 14, 15, 200):
        for sized in (True, False):
            text = bytes(65 + k % 26 for k in range(size))
            bench.download_segmented(0x2004, 0, text, sized=sized)
            assert bench.upload(0x2004) == text
    bench.download_segmented(0x1017, 0, struct.pack("<H", 250))
    assert bench.number(0x1017) == 250
    with pytest.raises(SdoAborted, match="06070012"):
        bench.download_segmented(0x1017, 0, bytes(3), sized=False)
    with pytest.raises(SdoAborted, match="06070013"):
        bench.download_segmented(0x1017, 0, bytes(1), sized=False)
    assert bench.number(0x1017) == 250


def test_more_or_less_data_than_announced():
    bench = powered()
    bench.request(bytes.fromhex("2104200003000000"))
    assert code(bench.request(b"\x01" + b"abcdefg")) == 0x06070012
    bench.request(bytes.fromhex("2104200008000000"))
    assert code(bench.request(b"\x01" + b"abcdefg")) == 0x06070013


def test_an_endless_download_is_aborted():
    bench = powered()
    bench.request(bytes.fromhex("2004200000000000"))
    answer, toggle, count = None, 0, 0
    while answer is None or answer[0] != 0x80:
        answer = bench.request(bytes((toggle,)) + b"xxxxxxx")
        toggle ^= 0x10
        count += 1
        assert count < 1000
    assert code(answer) == 0x06070012


def test_a_stale_transfer_is_aborted_by_the_core_at_its_time():
    bench = powered()
    bench.run(5 * MS)
    bench.request(bytes.fromhex("4008100000000000"))
    bench.run(400 * MS)
    bench.request(bytes.fromhex("6000000000000000"))
    last = bench.t
    bench.until(last + SDO_TIMEOUT_NS, judge_end=False)
    assert bench.take(0x581) == []
    bench.run(0)
    (frame,) = bench.take(0x581)
    assert frame.data == bytes.fromhex("8008100000000405")
    assert frame.t_ns == last + SDO_TIMEOUT_NS + 20_000
    assert code(bench.request(bytes.fromhex("7000000000000000"))) == 0x05040001
    bench.run(3 * SDO_TIMEOUT_NS)
    assert bench.take(0x581) == []


def test_a_segment_at_the_very_time_out_is_in_time():
    bench = powered()
    bench.request(bytes.fromhex("4008100000000000"))
    bench.until(bench.t + SDO_TIMEOUT_NS, judge_end=False)
    assert bench.request(bytes.fromhex("6000000000000000")) == b"\x00Coulomb"


def test_requests_of_a_wrong_length_are_dropped_and_counted():
    bench = powered()
    bench.frame(0x601, bytes.fromhex("40001000"))
    assert bench.take() == []
    assert bench.node.dropped_length == 1


def test_expedited_without_a_size_takes_what_the_object_has():
    bench = powered()
    assert bench.request(bytes.fromhex("2217100064000000")) == bytes.fromhex("6017100000000000")
    assert bench.number(0x1017) == 100


class Echo:
    """A backend with one object of any length."""

    def __init__(self, content: bytes = b""):
        self.content = content

    def upload(self, index, subindex):
        return self.content

    def check_download(self, index, subindex, size):
        if size is not None and size > 5000:
            raise SdoAbort(0x06070012)
        return 5000

    def download(self, index, subindex, data):
        self.content = data


@settings(deadline=None)
@given(st.binary(max_size=300))
def test_any_content_survives_a_download_and_an_upload(content):
    echo = Echo()
    server = SdoServer(echo)
    assert server.request(b"\x21\x00\x20\x00" + struct.pack("<I", len(content))) == b"\x60\x00\x20\x00" + bytes(4)
    chunks = [content[k : k + 7] for k in range(0, len(content), 7)] or [b""]
    for number, chunk in enumerate(chunks):
        toggle = 0x10 * (number % 2)
        head = toggle | (7 - len(chunk)) << 1 | (number == len(chunks) - 1)
        assert server.request(bytes((head,)) + chunk.ljust(7, b"\xaa")) == bytes((0x20 | toggle,)) + bytes(7)
    assert echo.content == content
    answer = server.request(b"\x40\x00\x20\x00" + bytes(4))
    assert answer is not None
    if 1 <= len(content) <= 4:
        assert answer[0] == 0x43 | (4 - len(content)) << 2
        assert answer[4 : 4 + len(content)] == content
    else:
        read, toggle = b"", 0
        while True:
            segment = server.request(bytes((0x60 | toggle,)) + bytes(7))
            assert segment is not None
            read += segment[1 : 8 - (segment[0] >> 1 & 7)]
            toggle ^= 0x10
            if segment[0] & 1:
                break
        assert read == content


@settings(deadline=None, max_examples=80)
@given(st.lists(st.binary(min_size=8, max_size=8), max_size=30))
def test_every_request_ends_in_a_response_or_an_abort(requests):
    server = SdoServer(Echo(b"0123456789"))
    for data in requests:
        answer = server.request(data)
        # no answer: to an abort, within a block, when the client says that it has the whole of one,
        # and to a frame that was delivered twice
        assert answer is not None or data[0] >> 5 == 4 or server.transfer or data[0] & 0xE3 == 0xA1 or server.again
        assert answer is None or len(answer) == 8


class Wire(canopen.Network):
    """canopen's network without a thread: what it sends reaches the device at once, and the answer
    its subscribers.
    """

    def __init__(self, bench: Bench):
        super().__init__()
        self.bench = bench

    def send_message(self, can_id, data, remote=False):
        self.bench.frame(can_id, bytes(data))
        for sent in self.bench.take():
            self.notify(sent.can_id, bytearray(sent.data), 0.0)


def client(bench: Bench, name: str) -> canopen.RemoteNode:
    node = canopen.RemoteNode(bench.node_id, str(EDS / f"{name}.eds"))
    Wire(bench).add_node(node)
    return node


@pytest.mark.parametrize(("name", "node_id"), [("motor", 1), ("mr_brake", 2)])
def test_canopens_client_reads_every_object_with_its_default(name, node_id):
    bench = powered(name, node_id)
    sdo = client(bench, name).sdo
    count = 0
    for index, entry in description(name).objects.items():
        for subindex, variable in entry.variables.items():
            if variable.access == "wo" or (index == 0x1003 and subindex):
                with pytest.raises(canopen.SdoAbortedError) as caught:
                    sdo.upload(index, subindex)
                assert caught.value.code == (0x06010001 if variable.access == "wo" else 0x08000024)
                continue
            data, kind = sdo.upload(index, subindex), DATA_TYPES[variable.data_type]
            default = description(name).default(index, subindex, node_id)
            if kind.kind == "text":
                assert data.decode() == default
            elif kind.kind == "domain":
                assert data == (EDS / f"{name}.eds").read_bytes()
            elif kind.kind == "real":
                assert struct.unpack("<f", data)[0] == pytest.approx(default)
            elif index not in (0x6041, 0x6079):  # what the device measures
                assert len(data) == (kind.bits + 7) // 8
                assert int.from_bytes(data, "little", signed=kind.signed) == default, f"{index:04X}h:{subindex}"
            count += 1
    assert count > 150


@pytest.mark.parametrize(("name", "node_id"), [("motor", 1), ("mr_brake", 2)])
def test_canopens_client_writes_back_every_object(name, node_id):
    bench = powered(name, node_id)
    sdo = client(bench, name).sdo
    for index, entry in description(name).objects.items():
        for subindex, variable in entry.variables.items():
            if variable.access in ("ro", "const"):
                with pytest.raises(canopen.SdoAbortedError) as caught:
                    sdo.download(index, subindex, bytes(max((variable.bits + 7) // 8, 1)))
                assert caught.value.code == 0x06010002
            elif variable.access == "wo":
                signature = b"zero" if index == 0x6125 else bytes(variable.bits // 8)
                sdo.download(index, subindex, signature)
            elif index in (0x1010, 0x1011) and subindex:  # these want a signature
                with pytest.raises(canopen.SdoAbortedError) as caught:
                    sdo.download(index, subindex, sdo.upload(index, subindex))
                assert caught.value.code == 0x08000020
            else:
                value = sdo.upload(index, subindex)
                sdo.download(index, subindex, value)
                assert sdo.upload(index, subindex) == value
                sdo.download(index, subindex, value, force_segment=True)
                assert sdo.upload(index, subindex) == value
    assert bench.node.nmt == 127


def test_canopens_client_by_name_and_long_text():
    bench = powered("mr_brake", 2)
    node = client(bench, "mr_brake")
    assert node.sdo["Manufacturer device name"].raw == "Coulombus MR brake"
    node.sdo[0x2004].raw = "a label that is rather longer than a segment"
    assert node.sdo[0x2004].raw == "a label that is rather longer than a segment"
    node.sdo[0x6126][1].raw = 2.5
    assert bench.device[0x6126, 1] == 2.5


def test_not_served_when_stopped():
    bench = motor()
    bench.nmt(2)
    assert bench.request(bytes.fromhex("4000100000000000")) is None
    bench.nmt(128)
    assert bench.number(0x1000) == 0x20192
