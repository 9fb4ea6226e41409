"""The host's SDO client: all kinds of transfers with our nodes and with canopen's, and servers that
do it wrong.
"""

from __future__ import annotations

import re
from contextlib import suppress
from random import Random
from types import SimpleNamespace

import canopen
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.eds.cia301 import Abort
from coulombus.host.errors import HostError
from coulombus.host.sdo.sdo_client import LATE_S, SdoClient, load_defaults, store_parameters
from coulombus.host.sdo.transfers import DuplicateNodeId, SdoProtocolError, SdoRefused, SdoSilent
from coulombus.node.sdo_server import SdoServer
from devices_bench import EDS, DevicesLink, Server, eds

S = 1_000_000_000
LABEL = (0x2004, 0)
PLACE = (0x2000, 1)
HEAD = b"\x00\x20\x01"
LENGTHS = (1, 4, 5, 7, 8, 14, 889, 890, 896, 1778, 2000)


def motor():
    link = DevicesLink()
    link.add(eds("motor"), 1)
    return link, SdoClient(link, 1)


@pytest.mark.parametrize("length", LENGTHS)
def test_what_is_written_is_read_again(length):
    """Expedited, by segments, and (from 890 bytes on) by blocks."""
    link, client = motor()
    data = bytes(32 + k % 90 for k in range(length))
    told = []
    client.download(*LABEL, data, progress=lambda done, total: told.append((done, total)))
    assert client.upload(*LABEL) == data
    assert told[-1:] == ([(length, length)] if length > 4 else [])
    assert any(frame[0] & 0xE3 == 0xC2 for _, frame in link.sent) == (length > 889)
    assert any(frame[0] == 0xA4 for _, frame in link.sent) == (length > 889)


def test_a_long_object_comes_by_blocks_with_progress():
    link, client = motor()
    told = []
    content = client.upload(0x1021, 0, progress=lambda done, total: told.append((done, total)))
    assert content == (EDS / "motor.eds").read_bytes()
    assert told == sorted(told)
    assert told[-1] == (len(content), len(content))
    assert link.t < 0.3 * S
    assert not any(data[0] == 0x80 for _, data in link.sent)  # its length is known to be long: nothing is aborted


class LocalNode:
    """A node of canopen on the link, which has no block transfer that works."""

    def __init__(self, link, node_id=5):
        self.answers = []
        self.network = canopen.Network()
        self.network.send_message = lambda can_id, data, remote=False: self.answers.append((can_id, bytes(data)))
        self.node = canopen.LocalNode(node_id, str(EDS / "motor.eds"))
        self.network.add_node(self.node)
        link.others.append(self._hear)

    def _hear(self, can_id, data):
        self.answers.clear()
        self.network.notify(can_id, bytearray(data), 0.0)
        return list(self.answers)


@pytest.mark.parametrize("length", [2, 20, 1500])
def test_a_node_of_canopen_is_read_and_written(length):
    link = DevicesLink()
    local, client = LocalNode(link), SdoClient(link, 5)
    data = bytes(65 + k % 26 for k in range(length))
    client.download(*LABEL, data)
    assert client.upload(*LABEL) == data
    assert client.upload(0x1000, 0) == b"\x92\x01\x02\x00"
    with pytest.raises(SdoRefused, match="0x06020000: object does not exist"):
        client.upload(0x5FFF, 0)
    assert local.node.sdo[LABEL[0]].raw == data.decode()


def test_an_abort_is_told_in_words():
    _, client = motor()
    with pytest.raises(SdoRefused, match="download to 1000h:00 was aborted: 0x06010002: attempt to write") as caught:
        client.download(0x1000, 0, bytes(4))
    assert caught.value.exit_status == 6


def test_a_node_that_is_not_there_is_told_and_nobody_waits_longer():
    link = DevicesLink()
    with pytest.raises(SdoSilent, match=r"node 9 does not answer \(SDO of 2000h:01\)") as caught:
        SdoClient(link, 9, 0.25).upload(*PLACE)
    assert caught.value.exit_status == 5
    assert link.t < 0.3 * S
    assert link.sent[-1][1] == b"\x80" + HEAD + b"\x00\x00\x04\x05"


def _read_identity(client):
    for subindex in (1, 2, 3, 4):
        with suppress(SdoRefused):
            client.upload(0x1018, subindex)


@pytest.mark.parametrize("answer", [b"\x43%b\x92\x01\x00\x00", b"\x80%b\x00\x00\x02\x06"], ids=["value", "abort"])
@pytest.mark.parametrize("after_ns", [10_000, 30_000])
def test_a_second_answer_to_one_request_is_a_second_device(answer, after_ns):
    link, client = motor()
    Server(link, 1, lambda request: [(answer % request[1:4], after_ns)] if request[0] == 0x40 else [])
    told = r"two devices answer as node 1 \(SDO of 1018h:0\d\): .*coulombus lss"
    with pytest.raises(DuplicateNodeId, match=told) as caught:
        _read_identity(client)
    assert caught.value.exit_status == 3


def test_a_late_answer_is_no_second_device():
    link = DevicesLink()
    late = iter((2 * S, 0, 0))
    Server(link, 5, lambda request: [(b"\x43" + request[1:4] + bytes(4), next(late))] if request[0] == 0x40 else [])
    client = SdoClient(link, 5)
    with pytest.raises(SdoSilent):
        client.upload(0x1018, 1)
    link.receive(link.now_ns() + S - 1000)
    assert client.upload(0x1018, 2) == client.upload(0x1018, 1) == bytes(4)


def upload_of(*segments, size=None):
    """Return a server of one upload by segments, and after them always the last one."""

    def answer(request):
        if request[0] == 0x40:
            return [(b"\x41" if size is not None else b"\x40") + request[1:4] + (size or 0).to_bytes(4, "little")]
        if request[0] >> 5 == 3:
            return [rows.pop(0) if len(rows) > 1 else rows[0]]
        return []

    rows = list(segments)
    return answer


FULL, LAST = b"\x00ABCDEFG", b"\x01ABCDEFG"


@pytest.mark.parametrize(
    ("answer", "text", "code"),
    [
        (upload_of(FULL, FULL), "toggle bit", 0x05030000),
        (upload_of(b"\x10ABCDEFG"), "toggle bit", 0x05030000),
        (upload_of(FULL, b"\x11ABCDEFG", size=15), "15 bytes were told, 14 came", 0x06070010),
        (upload_of(FULL, b"\x10ABCDEFG", FULL, size=9), "continues beyond 9 bytes", 0x06070012),
        (upload_of(LAST, size=1 << 31), "2147483648 bytes", 0x05040005),
        (upload_of(b"\x80" + b"\x00" * 7), "0x00000000", None),
        (upload_of(b"\x20" + bytes(7)), "command 20h is no segment", 0x05040001),
        (lambda request: [b"\x60" + request[1:4] + bytes(4)], "no upload response", 0x05040001),
    ],
)
def test_a_server_that_does_it_wrong_is_told_and_aborted(answer, text, code):
    link = DevicesLink()
    server = Server(link, 5, answer)
    with pytest.raises((SdoProtocolError, SdoRefused), match=text) as caught:
        SdoClient(link, 5).upload(*PLACE)
    assert caught.value.exit_status == 6
    if code is not None:
        assert server.requests[-1] == b"\x80" + HEAD + code.to_bytes(4, "little")


def test_an_answer_to_somebody_elses_request_within_the_segments_is_a_twins():
    link = DevicesLink()
    server = Server(link, 5, upload_of(FULL, b"\x43\x18\x10\x01\xc0\x04\0\0"))
    with pytest.raises(
        DuplicateNodeId, match=r"answer to an SDO of 1018h:01 came within the upload of .*another SDO client"
    ) as caught:
        SdoClient(link, 5).upload(*PLACE)
    assert caught.value.exit_status == 3
    assert server.requests[-1] == b"\x80" + HEAD + Abort.GENERAL.to_bytes(4, "little")


def test_an_upload_without_an_end_is_given_up():
    link, toggle = DevicesLink(), [0x10]

    def answer(request):
        if request[0] == 0x40:
            return [b"\x40" + request[1:4] + bytes(4)]
        toggle[0] ^= 0x10
        return [bytes((toggle[0],)) + bytes(7)] if request[0] >> 5 == 3 else []

    Server(link, 5, answer)
    with pytest.raises(SdoProtocolError, match="continues beyond 100 bytes"):
        SdoClient(link, 5).upload(*PLACE, most=100)


def test_answers_to_earlier_requests_are_none_to_this_one():
    link = DevicesLink()
    late = [b"\x43\x18\x10\x01\x01\0\0\0", b"\x80\x18\x10\x02\0\0\x02\x06", b"\x00" * 8, b"\x43" + HEAD + b"\x07\0\0\0"]
    Server(link, 5, lambda request: late if request[0] == 0x40 else [])
    assert SdoClient(link, 5).upload(*PLACE) == b"\x07\0\0\0"


def test_answers_of_a_wrong_length_are_dropped():
    link = DevicesLink()
    Server(link, 5, lambda request: [b"\x43" + HEAD, b"\x4b" + HEAD + b"\x07\0\0\0"] if request[0] == 0x40 else [])
    assert SdoClient(link, 5).upload(*PLACE) == b"\x07\0"


@pytest.mark.parametrize("answer", [b"\x4b%b\x07\0", b"\x60%b"[:3], b"", b"\x43%b\x07\0\0"])
def test_an_answer_of_another_length_is_told_as_that(answer):
    link = DevicesLink()
    content = answer.replace(b"%b", HEAD)
    Server(link, 5, lambda request: [content])
    text = rf"node 5, SDO of 2000h:01: it answers with {len(content)} bytes; an SDO message has 8"
    client = SdoClient(link, 5)
    for act in (lambda: client.upload(*PLACE), lambda: client.download(*PLACE, b"\0\0")):
        with pytest.raises(SdoProtocolError, match=text) as caught:
            act()
        assert caught.value.exit_status == 6


@settings(max_examples=40, deadline=None, derandomize=True)
@given(timeout_s=st.floats(0.05, 2.0), after=st.floats(1.01, 3.0), kind=st.sampled_from([b"\x4b", b"\x80"]))
def test_a_late_answer_is_told_as_that(timeout_s, after, kind):
    link = DevicesLink()
    late_ns = round(timeout_s * after * S)
    Server(link, 5, lambda request: [(kind + HEAD + bytes(4), late_ns)] if request[0] == 0x40 else [])
    with pytest.raises(SdoSilent) as caught:
        SdoClient(link, 5, timeout_s, late_s=LATE_S).upload(*PLACE)
    assert caught.value.exit_status == 5
    told = re.match(r"node 5 answers late: after ([\d.]+) s \(SDO of 2000h:01\), and (\S+) s are", str(caught.value))
    if timeout_s * (after - 1) > LATE_S:
        assert str(caught.value) == "node 5 does not answer (SDO of 2000h:01)"
    else:
        assert float(told[1]) == pytest.approx(timeout_s * after, abs=0.06)
        assert float(told[2]) == pytest.approx(timeout_s, rel=1e-4)


def test_an_answer_about_another_object_is_told_each_time():
    link = DevicesLink()
    Server(link, 5, lambda request: [b"\x4b\xff\x20\0" + bytes(4)] if request[0] == 0x40 else [])
    client = SdoClient(link, 5)
    for _ in range(2):
        with pytest.raises(SdoProtocolError, match=r"node 5 does not answer .*, but about 20FFh:00"):
            client.upload(*PLACE)


def test_a_second_answer_to_the_last_request_is_told():
    link = DevicesLink()
    second = b"\x80" + HEAD + b"\x09\0\0\x0f"
    Server(link, 5, lambda request: [b"\x4b" + HEAD + bytes(4), (second, S // 100)] if request[0] == 0x40 else [])
    client = SdoClient(link, 5)
    assert client.upload(*PLACE) == bytes(2)
    with pytest.raises(DuplicateNodeId, match=r"two devices answer as node 5 \(SDO of 2000h:01\): one request has two"):
        client.settle()


@pytest.mark.parametrize(("index", "seconds"), [(0x1010, 9.9), (0x1011, 9.9), (0x2000, 0.9)])
def test_a_write_to_storage_has_more_time(index, seconds):
    link = DevicesLink()
    Server(link, 5, lambda request: [(b"\x60" + request[1:4] + bytes(4), round(seconds * S))])
    SdoClient(link, 5, 1.0).download(index, 1, b"save")
    assert link.t >= seconds * S
    with pytest.raises(SdoSilent):
        SdoClient(link, 5, 0.5, storing_s=0.5).download(index, 1, b"save")


def test_four_bytes_of_which_nobody_says_how_many_count_are_cut_by_the_reader():
    link = DevicesLink()
    Server(link, 5, lambda request: [b"\x42" + HEAD + b"\1\2\3\4"])
    client = SdoClient(link, 5)
    assert client.upload(*PLACE) == b"\1\2\3\4"
    assert client.upload(*PLACE, unsized=lambda data: data[:1]) == b"\1"


@pytest.mark.parametrize("lost", [1, 3, 127, 130])
def test_a_segment_that_is_lost_in_a_block_is_asked_for_again(lost):
    link, client = motor()
    data = bytes(32 + k % 90 for k in range(2000))
    client.download(*LABEL, data)
    count = [0]

    def tamper(frame):
        begun = any(sent[0] == 0xA3 for _, sent in link.sent[-1:])
        if frame.can_id == 0x581 and (begun or count[0]):
            count[0] += 1
            if count[0] == lost:
                return [type(frame)(frame.t_ns, frame.can_id, b"\x7f" + frame.data[1:], 8)] if lost == 127 else []
        return [frame]

    link.tamper = tamper
    assert client.upload(*LABEL) == data
    assert count[0] > lost


def test_a_wrong_crc_is_told():
    link, client = motor()
    client.download(*LABEL, bytes(2000 * b"x"))
    link.tamper = lambda frame: [
        type(frame)(frame.t_ns, frame.can_id, frame.data[:1] + b"\0\0" + frame.data[3:], 8)
        if frame.can_id == 0x581 and frame.data[0] & 0xE3 == 0xC1 and frame.data[3:] == bytes(5)
        else frame
    ]
    with pytest.raises(SdoProtocolError, match="CRC is wrong"):
        client.upload(*LABEL)


def test_a_server_without_block_transfer_is_asked_by_segments():
    link = DevicesLink()
    link.add(eds("motor"), 1)
    refused, original = [], link.send

    def send(can_id, data=b"", length=None):
        if can_id == 0x601 and data[0] in (0xA4, 0xC6):
            refused.append(data[0])
            link.put(0x581, b"\x80" + data[1:4] + b"\x01\x00\x04\x05")
        else:
            original(can_id, data, length)

    link.send = send
    client, data = SdoClient(link, 1), b"x" * 1500
    client.download(*LABEL, data)
    assert client.upload(*LABEL) == data
    assert refused == [0xC6, 0xA4]


@pytest.mark.parametrize(("code", "error"), [(0x05040001, None), (0x06020000, "object does not exist")])
def test_a_domain_that_is_refused_by_blocks_is_asked_by_segments_or_told(code, error):
    link = DevicesLink()
    link.add(eds("motor"), 1)
    original = link.send

    def send(can_id, data=b"", length=None):
        if can_id == 0x601 and data[0] == 0xA4:
            link.put(0x581, b"\x80" + data[1:4] + code.to_bytes(4, "little"))
        else:
            original(can_id, data, length)

    link.send = send
    client = SdoClient(link, 1)
    if error is None:
        assert client.upload(0x1021, 0) == (EDS / "motor.eds").read_bytes()
    else:
        with pytest.raises(SdoRefused, match=error):
            client.upload(0x1021, 0)
    assert link.t < 1.5 * S  # segments need one; nobody waits for an answer


@pytest.mark.parametrize("length", [1, 4, 5, 254, 255, 256, 900])
def test_a_short_domain_comes_as_the_server_chooses(length):
    link, content = DevicesLink(), bytes(k % 251 for k in range(length))
    memory = SimpleNamespace(upload=lambda index, subindex: content)
    server = SdoServer(memory)

    def hear(can_id, data):
        if can_id != 0x605:
            return []
        answer = server.request(bytes(data))
        return [(0x585, frame) for frame in ([] if answer is None else [answer]) + list(server.burst)]

    link.others.append(hear)
    assert SdoClient(link, 5).upload(0x1021, 0) == content
    first = [data[0] for can_id, data in link.sent if can_id == 0x605]
    assert (0xA3 in first) == (length > 255)
    assert 0x80 not in first


def test_who_is_interrupted_aborts_the_transfer():
    link, client = motor()

    def interrupted(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        client.upload(0x1021, 0, progress=interrupted)
    assert link.sent[-1] == (0x601, b"\x80\x21\x10\x00\x00\x00\x00\x08")
    assert client.upload(0x1000, 0) == b"\x92\x01\x02\x00"


def test_parameters_are_stored_and_defaults_come_back():
    link, client = motor()
    client.download(0x1017, 0, b"\x64\0")
    store_parameters(link, 1)
    link.send(0x000, b"\x81\x01")
    assert client.upload(0x1017, 0) == b"\x64\0"
    load_defaults(link, 1)
    link.send(0x000, b"\x81\x01")
    assert client.upload(0x1017, 0) == b"\0\0"


@pytest.mark.parametrize("seed", range(4))
def test_whatever_a_server_answers_ends_in_a_value_or_an_error(seed):
    random = Random(seed)
    heads = (0x00, 0x01, 0x10, 0x20, 0x41, 0x43, 0x60, 0x80, 0xA0, 0xA2, 0xA4, 0xC1, 0xC4, 0xC6, 0xA1)
    sizes = (b"\xff\xff\xff\xff", bytes(4), (900).to_bytes(4, "little"), (2000).to_bytes(4, "little"))

    def answer(request):
        rows = []
        for _ in range(random.choice((0, 1, 1, 1, 2, 3))):
            place = request[1:4] if random.random() < 0.7 else random.randbytes(3)
            row = bytes((random.choice(heads),)) + place + random.choice(sizes)
            rows.append(row[: random.choice((8, 8, 8, 8, 7, 0))])
        return rows

    link = DevicesLink()
    Server(link, 5, answer)
    client, ended = SdoClient(link, 5, 0.05), 0
    for size in 40 * (0, 1, 5, 20, 900):
        for act in (lambda: client.upload(*PLACE), lambda size=size: client.download(*PLACE, bytes(size))):
            begin = link.t
            with suppress(HostError):
                act()
            ended += 1
            assert link.t - begin < 30 * S
    assert ended == 400
