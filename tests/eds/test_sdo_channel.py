"""SDO transfers in words: what clients and servers really send, from the initiation to the end, from
the middle on, and with frames that the recording lost.
"""

from __future__ import annotations

import random
from contextlib import suppress

import canopen
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.eds.cia301 import Abort
from coulombus.eds.sdo_channel import SdoChannel
from coulombus.host.sdo.sdo_client import SdoClient
from coulombus.host.sdo.transfers import SdoProtocolError, SdoRefused, SdoSilent
from coulombus.node.profile import SdoAbort
from coulombus.node.sdo_server import SdoServer
from devices_bench import DevicesLink

NODE = 5
PLACE = (0x2000, 1)
MULTIPLEXER = bytes.fromhex("002001")
TRANSFERS = settings(max_examples=120, derandomize=True, deadline=None, database=None)
contents = st.one_of(
    st.binary(min_size=1, max_size=60),
    st.builds(lambda n, seed: random.Random(seed).randbytes(n), st.integers(1, 900), st.integers(0, 1 << 30)),
    st.builds(lambda n, byte: bytes((byte,)) * n, st.integers(1, 900), st.integers(0, 255)),
)
"""One byte over and over makes segments that differ in their numbers alone."""
losses = st.frozensets(st.integers(1, 260), min_size=1, max_size=6)


class Memory:
    """The one object of a server, of any length."""

    def __init__(self, content=b""):
        self.content = content

    def upload(self, index, subindex):
        if (index, subindex) != PLACE:
            raise SdoAbort(Abort.NO_OBJECT)
        return self.content

    def check_download(self, index, subindex, size):
        self.upload(index, subindex)
        return 4000

    def download(self, index, subindex, data):
        self.content = data


class Bus:
    """A server and all that goes over the bus to it and from it.

    Attributes
    ----------
    recorded : the frames (data, whether the server sent it)
    lost : numbers of the block transfers' segments that are sent and not received
    doubled : numbers of the frames that come twice
    """

    def __init__(self, content=b"", seed=0, lost=frozenset(), doubled=frozenset()):
        self.memory = Memory(content)
        self.server = SdoServer(self.memory)
        self.sizes = random.Random(seed)
        self.changing = seed > 0
        self.lost, self.doubled = lost, doubled
        self.recorded, self.segments = [], 0

    def _put(self, data, from_server):
        """Record a frame; return how often it arrives."""
        times = 2 if len(self.recorded) in self.doubled else 1
        self.recorded += [(data, from_server)] * times
        return times

    def request(self, data):
        """Take a frame of a client; return those of the server in answer that arrive."""
        data = bytes(data)
        in_block = self.server.expected != (0, 0)
        times = self._put(data, False)
        if in_block and self._loses(data):
            return []
        answers = []
        for _ in range(times):
            if self.changing:
                self.server.block_size = self.sizes.choice((1, 2, 5, 40, 127))
            answer = self.server.request(data)
            sent = [*([] if answer is None else [answer]), *self.server.burst]
            answers += [(frame, frame in self.server.burst) for frame in sent]
        return [
            frame
            for frame, segment in answers
            for times in (self._put(frame, True),)
            if not (segment and self._loses(frame))
            for _ in range(times)
        ]

    def _loses(self, segment):
        """The last segment of a block arrives: a client would wait for it."""
        self.segments += 1
        return self.segments in self.lost and segment[0] < 0x80 and segment[0] not in (1, 2, 5, 40, 127)


def ours(bus):
    """The product's client."""
    link = DevicesLink()
    link.others.append(
        lambda can_id, data: [(0x580 + NODE, frame) for frame in bus.request(data)] if can_id == 0x600 + NODE else []
    )
    return SdoClient(link, NODE)


class Wire(canopen.Network):
    def __init__(self, bus):
        super().__init__()
        self.bus = bus

    def send_message(self, can_id, data, remote=False):
        for frame in self.bus.request(data):
            self.notify(0x580 + NODE, bytearray(frame), 0.0)


def theirs(bus):
    """The client of the package canopen, which gives up by the wall clock: not on a loaded machine."""
    node = canopen.RemoteNode(NODE, canopen.ObjectDictionary())
    node.sdo.RESPONSE_TIMEOUT = 60.0
    Wire(bus).add_node(node)
    return node.sdo


def followed(recorded):
    channel = SdoChannel(None)
    return [channel.row(*frame) for frame in recorded]


def joined(rows):
    return [bytes.fromhex(row["content"]) for row in rows if "content" in row]


def assert_no_abort_but_real_ones(rows, recorded):
    assert [row["phase"] == "Abort transfer" for row in rows] == [data[0] == 0x80 for data, _ in recorded]


def written_by_blocks(bus, content):
    with theirs(bus).open(*PLACE, "wb", size=len(content), block_transfer=True) as stream:
        stream.write(content)
    assert bus.memory.content == content


def read_by_blocks(bus, content):
    with theirs(bus).open(*PLACE, "rb", block_transfer=True) as stream:
        assert stream.read() == content


def written_and_read_by_blocks(bus, content):
    written_by_blocks(bus, content)
    read_by_blocks(bus, content)


@given(content=contents, seed=st.integers(0, 3), doubled=st.frozensets(st.integers(0, 300), max_size=4))
@TRANSFERS
def test_transfers_of_the_products_client(content, seed, doubled):
    """Expedited, by segments, and (from 890 bytes on) by blocks, with frames that CAN delivers twice."""
    bus = Bus(seed=seed, doubled=doubled)
    client = ours(bus)
    client.download(*PLACE, content)
    assert client.upload(*PLACE) == content
    rows = followed(bus.recorded)
    assert_no_abort_but_real_ones(rows, bus.recorded)
    assert joined(rows) == [content, content]
    kind = "expedited" if len(content) <= 4 else "segmented" if len(content) < 890 else "block"
    services = [row["service"] for row in rows if "content" in row]
    assert services == [f"SDO {kind} download", f"SDO {kind} upload"]


@given(content=contents, seed=st.integers(0, 3))
@TRANSFERS
def test_block_transfers_of_canopens_client(content, seed):
    bus = Bus(seed=seed)
    written_and_read_by_blocks(bus, content)
    rows = followed(bus.recorded)
    assert [row["phase"] for row in rows if "Abort" in row["phase"] or "nknown" in row["phase"]] == []
    assert joined(rows) == [content, content]
    assert {row["service"] for row in rows} == {"SDO block download", "SDO block upload"}
    assert {(row["index"], row["subindex"]) for row in rows} == {PLACE}
    assert not any("remark" in row for row in rows)


@pytest.mark.thorough
@pytest.mark.slow
def test_every_length_of_a_block_transfer():
    for length in range(1, 901):
        bus, content = Bus(), random.Random(length).randbytes(length)
        written_and_read_by_blocks(bus, content)
        rows = followed(bus.recorded)
        assert joined(rows) == [content, content]
        assert not any("remark" in row or row["phase"] == "Abort transfer" for row in rows)


@given(content=contents, seed=st.integers(0, 3), lost=losses)
@TRANSFERS
def test_segments_of_uploads_that_are_lost_come_again(content, seed, lost):
    bus = Bus(content, seed=seed, lost=lost)
    read_by_blocks(bus, content)
    rows = followed(bus.recorded)
    assert_no_abort_but_real_ones(rows, bus.recorded)
    assert joined(rows) == [content]


@pytest.mark.thorough
@given(length=st.integers(890, 2000), seed=st.integers(0, 3), lost=losses)
@TRANSFERS
def test_segments_of_the_products_client_that_are_lost_come_again(length, seed, lost):
    bus, content = Bus(seed=seed, lost=lost), random.Random(length).randbytes(length)
    client = ours(bus)
    client.download(*PLACE, content)
    assert client.upload(*PLACE) == content
    rows = followed(bus.recorded)
    assert_no_abort_but_real_ones(rows, bus.recorded)
    assert joined(rows) == [content, content]


def all_transfers(content, seed):
    bus = Bus(seed=seed)
    written_and_read_by_blocks(bus, content)
    client = ours(bus)
    client.download(*PLACE, content)
    client.upload(*PLACE)
    with suppress(SdoRefused):
        client.upload(0x3000, 0)
    return bus.recorded


@pytest.mark.thorough
@given(content=contents, seed=st.integers(0, 3), data=st.data())
@TRANSFERS
def test_from_the_middle_on_nothing_is_invented(content, seed, data):
    """Whatever frames are missing at the beginning: no abort, no object's bytes that it does not have."""
    recorded = all_transfers(content, seed)
    first = data.draw(st.integers(0, len(recorded) - 1))
    rows = followed(recorded[first:])
    assert_no_abort_but_real_ones(rows, recorded[first:])
    assert set(joined(rows)) <= {content}


@given(content=contents, seed=st.integers(0, 3), data=st.data())
@TRANSFERS
def test_a_recording_with_losses_has_no_wrong_bytes(content, seed, data):
    recorded = all_transfers(content, seed)
    missing = data.draw(st.sets(st.integers(0, len(recorded) - 1), min_size=1, max_size=8))
    rest = [frame for k, frame in enumerate(recorded) if k not in missing]
    rows = followed(rest)
    assert_no_abort_but_real_ones(rows, rest)
    assert set(joined(rows)) <= {content}


@given(st.lists(st.tuples(st.binary(min_size=0, max_size=8), st.booleans()), max_size=60))
@TRANSFERS
def test_any_frames_have_a_row(recorded):
    for row, (data, _) in zip(followed(recorded), recorded, strict=True):
        assert row["service"].startswith("SDO")
        assert ("malformed" in row) == (len(data) != 8)
        assert (row.get("phase") == "Abort transfer") == (len(data) == 8 and data[0] == 0x80)


def frames(*lines):
    """Frames of "<" (server) or ">" (client) and hexadecimal bytes."""
    return [(bytes.fromhex(line[1:]).ljust(8, b"\0"), line[0] == "<") for line in lines]


UPLOAD = frames(
    "> A4 08 10 00 14", "< C6 08 10 00 0C", "> A3", "< 01 44 72 69 76 65 20 6F", "< 82 20 6E 6F 64 65",
    "> A2 02 14", "< C9 9F DA", "> A1",
)  # fmt: skip
UPLOAD_PHASES = [
    "Initiate block upload request", "Initiate block upload response", "Start block upload", "Block upload segment",
    "Block upload segment", "Block upload response", "End block upload request", "End block upload response",
]  # fmt: skip


def test_a_block_upload_from_its_initiation_to_its_end():
    rows = followed(UPLOAD)
    assert {(row["service"], row["index"], row["subindex"]) for row in rows} == {("SDO block upload", 0x1008, 0)}
    assert [row["phase"] for row in rows] == UPLOAD_PHASES
    assert [row.get("bytes") for row in rows] == [None, None, None, 7, 12, 12, 12, 12]
    assert rows[1]["size"] == 12
    assert (rows[4]["number"], rows[4]["segment"], rows[4]["last"]) == (2, "206e6f64650000", True)
    assert bytes.fromhex(rows[7]["content"]) == b"Drive o node"


def test_a_block_download_from_its_initiation_to_its_end():
    rows = followed(
        frames(
            "> C6 21 1F 01 0C",
            "< A4 21 1F 01 7F",
            "> 01 44 72 69 76 65 20 6F",
            "> 82 20 6E 6F 64 65",
            "< A2 02 7F",
            "> C9 9F DA",
            "< A1",
        )
    )
    assert {(row["service"], row["index"], row["subindex"]) for row in rows} == {("SDO block download", 0x1F21, 1)}
    assert [row["phase"] for row in rows] == [
        "Initiate block download request", "Initiate block download response", "Block download segment",
        "Block download segment", "Block download response", "End block download request", "End block download response",
    ]  # fmt: skip
    assert bytes.fromhex(rows[6]["content"]) == b"Drive o node"


@pytest.mark.parametrize("first", range(1, len(UPLOAD)))
def test_a_block_upload_whose_beginning_is_missing(first):
    rows = followed(UPLOAD[first:])
    assert [row["phase"] for row in rows[1:]] == UPLOAD_PHASES[first + 1 :]
    expected = {3: "Within a segmented or block transfer", 4: "Within a block transfer"}.get(
        first, UPLOAD_PHASES[first]
    )
    assert rows[0]["phase"] == expected
    assert {row["service"] for row in rows[1:]} <= {"SDO block upload"}
    assert "not in the recording" in rows[0]["remark"]
    assert ("content" in rows[-1]) == (first == 1)  # its response names object and length


def test_what_is_missing_comes_again():
    rows = followed(
        frames(
            "> A4 00 20 01 7F",
            "< C6 00 20 01 15",
            "> A3",
            "< 01 61 61 61 61 61 61 61",
            "< 83 63 63 63 63 63 63 63",
            "> A2 01 7F",
            "< 01 62 62 62 62 62 62 62",
            "< 82 63 63 63 63 63 63 63",
            "> A2 02 7F",
            "< C1 3E 1F",
            "> A1",
        )
    )
    assert rows[4]["remark"] == "segment 2 is missing"
    assert rows[5]["remark"] == "asks for the segments from 2 on again"
    assert [row["bytes"] for row in rows[3:9]] == [7, 7, 7, 14, 21, 21]
    assert bytes.fromhex(rows[-1]["content"]) == b"aaaaaaabbbbbbbccccccc"


@pytest.mark.parametrize("side", ["<", ">"])
def test_a_real_abort_ends_a_block_transfer(side):
    rows = followed(
        [*UPLOAD[:4], *frames(side + " 80 08 10 00 03 00 04 05", "> 40 00 10 00", "< 43 00 10 00 92 01 02")]
    )
    assert (rows[4]["service"], rows[4]["phase"]) == ("SDO block upload", "Abort transfer")
    assert rows[4]["text"] == "0x05040003: invalid sequence number"
    assert (rows[6]["service"], rows[6]["value"]) == ("SDO expedited upload", 0x20192)


def test_a_server_without_block_transfer_answers_with_an_ordinary_one():
    rows = followed(frames("> A4 00 20 01 7F 15", "< 41 00 20 01 03", "> 60", "< 09 61 62 63"))
    assert [row["service"] for row in rows] == ["SDO block upload"] + ["SDO segmented upload"] * 3
    assert rows[3]["content"] == b"abc".hex()


def test_a_crc_that_does_not_match_is_said():
    rows = followed([*UPLOAD[:6], *frames("< C9 01 02", "> A1")])
    assert rows[6]["remark"] == "CRC 0201h does not match the bytes, whose CRC is DA9Fh"


def test_a_length_that_does_not_match_is_said():
    rows = followed(frames("> 40 00 20 01", "< 41 00 20 01 05", "> 60", "< 09 61 62 63"))
    assert rows[3]["remark"] == "5 bytes were announced, 3 came"
    assert "content" not in rows[3]


def test_a_client_that_begins_anew_within_a_block_download():
    rows = followed(
        frames("> C6 00 20 01 FF", "< A4 00 20 01 05", "> 01 61", "> 40 00 10 00", "< 43 00 10 00 92 01 02")
    )
    assert [row["service"] for row in rows[3:]] == ["SDO upload", "SDO expedited upload"]
    assert rows[4]["content"] == "92010200"


def test_the_end_of_a_block_upload_is_no_segment():
    """A1h and 22h follow each other as the numbers of two segments would."""
    rows = followed([*UPLOAD, *frames("> 22 17 10 00 64", "< 60 17 10 00")])
    assert [row["service"] for row in rows[8:]] == ["SDO expedited download"] * 2
    assert rows[9]["content"] == "64000000"


def test_a_gap_from_one_block_transfer_into_another():
    """The server's segments look like upload responses; two in a row are none."""
    rows = followed(
        [
            *frames("> C6 00 20 01 FF", "< A4 00 20 01 7F", "> 01 0C 0C 0C"),
            *frames(*(f"< {number:02X} 0C 0C 0C 0C 0C 0C 0C" for number in range(0x41, 0x50))),
        ]
    )
    assert rows[3]["remark"] == "its request is not in the recording, or this is a segment of a block transfer"
    assert {row["phase"] for row in rows[4:]} == {"Block upload segment"}
    assert joined(rows) == []


def test_a_late_answer_belongs_to_the_request_before():
    rows = followed(frames("> 40 18 10 01", "> 40 18 10 02", "< 43 18 10 01 11", "< 43 18 10 02 22"))
    assert [row.get("content") for row in rows] == [None, None, None, "22000000"]
    assert rows[2]["remark"] == "the request is about 1018h:02"


def test_answers_alone_are_decoded():
    """A recording of what the server sends, and no more."""
    rows = followed(
        frames("< 4B 41 60 00 37 02", "< 4B 41 60 00 38 02", "< 41 08 10 00 0A", "< 00 41 42 43 44 45 46 47")
    )
    assert [row.get("value") for row in rows] == [0x237, 0x238, None, None]
    assert rows[0]["remark"] == "its request is not in the recording, or this is a segment of a block transfer"
    assert (rows[3]["phase"], rows[3]["index"]) == ("Upload segment response", 0x1008)


def test_an_unknown_command_is_no_transfer():
    rows = followed(
        frames("> 40 00 10 00", "< 43 00 10 00 92 01 02", "> E0", "< 80 00 00 00 01 00 04 05", "< 82 20 6E")
    )
    assert [row["phase"] for row in rows[2:]] == ["Unknown command E0h", "Abort transfer", "Unknown command 82h"]


@pytest.mark.parametrize("length", [3, 20, 895])
def test_what_ends_without_an_answer_has_no_bytes(length):
    bus = Bus()
    client = ours(bus)
    bus.request = lambda data: bus._put(bytes(data), False) and []
    with pytest.raises((SdoSilent, SdoProtocolError)):
        client.download(*PLACE, bytes(length))
    rows = followed(bus.recorded)
    assert joined(rows) == []
    assert [row["phase"] for row in rows][-1] == "Abort transfer"


def test_a_transfer_is_completed_by_the_frame_that_ends_it():
    channel = SdoChannel(None)
    request, response = bytes.fromhex("2B00200134120000"), bytes.fromhex("6000200100000000")
    ended = []
    for data, from_server in ((request, False), (response, True), (response, True)):
        channel.row(data, from_server)
        ended.append(channel.completed)
    assert [transfer is not None for transfer in ended] == [False, True, False]
    assert (ended[1].place, ended[1].upload, bytes(ended[1].joined.content)) == (PLACE, False, b"\x34\x12")
