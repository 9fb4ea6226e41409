"""Rows of `coulombus decode`: PDOs by name, every other CANopen service by what it says."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coulombus.eds.reader import Description, Object, Variable
from coulombus.eds.sdo_channel import SdoChannel
from coulombus.host.sdo.sdo_client import SdoClient
from coulombus.monitor.decode import as_json, as_text, rows
from coulombus.monitor.services import lss
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.recording.reading import read
from coulombus.rigs.rig import Rig, load_rig
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, FRAME, data_word
from devices_bench import EDS, DevicesLink, eds


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("bench")


@pytest.fixture
def decoded(rig: Rig, tmp_path: Path):
    """Return the rows of frames given as (identifier, data)."""

    def decode(*sent: tuple[int, bytes], comments: dict[int, str] | None = None) -> list[dict[str, Any]]:
        frames = np.zeros(len(sent), FRAME)
        for i, (record, (can_id, data)) in enumerate(zip(frames, sent, strict=True)):
            record["t_ns"], record["can_id"] = i * 1_000_000, can_id
            record["length"], record["word"] = len(data), data_word(data)
        with PcapngWriter(tmp_path / "a.pcapng", attachments={}, force=True) as writer:
            writer.write(frames, comments)
        return list(rows(read(tmp_path / "a.pcapng", rig)))

    return decode


def said(row: dict[str, Any]) -> dict[str, Any]:
    """The row without time, identifier and data."""
    return {key: value for key, value in row.items() if key not in ("t_s", "can_id", "data")}


def test_pdos_carry_their_signals_by_name(decoded):
    rows = decoded(
        (0x182, struct.pack("<hhh", -1250, 640, 221)),
        (0x201, struct.pack("<Hh", 0x000F, 0)),
        (0x202, struct.pack("<h", 3500)),
        (0x182, struct.pack("<hhh", 1, 0, 0)),
        comments={2: "phase hold\nsecond line"},
    )
    assert rows[0] == {
        "t_s": 0.0, "can_id": 0x182, "node": "brake", "pdo": "TPDO1", "brake.handle_torque_Nm": pytest.approx(-1.25),
        "brake.coil_current_A": pytest.approx(0.64), "brake.coil_temperature_degC": pytest.approx(22.1),
    }  # fmt: skip
    assert rows[1] == {
        "t_s": 0.001, "can_id": 0x201, "node": "motor", "pdo": "RPDO1",
        "motor.controlword": 15, "motor.target_torque_Nm": 0.0,
    }  # fmt: skip
    assert said(rows[2]) == {
        "node": "brake", "pdo": "RPDO1", "brake.setpoint_Nm": pytest.approx(3.5), "marker": "phase hold; second line",
    }  # fmt: skip
    assert rows[3]["brake.handle_torque_Nm"] == pytest.approx(0.001)


def test_every_row_is_json_and_has_the_four_keys(decoded):
    rng = np.random.default_rng(7)
    ids = [*range(0x800), *rng.integers(0, 1 << 29, 200).tolist()]
    sent = []
    for i, can_id in enumerate(ids):
        flags = CAN_EFF_FLAG if i >= 0x800 else (0, 0, CAN_RTR_FLAG, CAN_ERR_FLAG)[rng.integers(4)]
        sent.append((can_id | flags, b"" if flags == CAN_RTR_FLAG else rng.bytes(int(rng.integers(9)))))
    for row in decoded(*sent):
        again = json.loads(json.dumps(row, allow_nan=False))
        assert again == row
        assert list(row)[:4] == ["t_s", "can_id", "node", "pdo"]
        assert "\n" not in as_text(row)


@pytest.mark.parametrize(
    ("can_id", "data", "expected"),
    [
        (0x000, "0101", {"node": "motor", "service": "nmt", "command": "start"}),
        (0x000, "0200", {"node": "all", "service": "nmt", "command": "stop"}),
        (0x000, "8005", {"node": "5", "service": "nmt", "command": "enter pre-operational"}),
        (0x000, "07ff", {"node": "255", "service": "nmt", "command": "unknown command 7"}),
        (0x000, "01", {"node": None, "service": "nmt", "malformed": "1 bytes, expected 2"}),
        (0x080, "", {"node": None, "service": "sync"}),
        (0x080, "11", {"node": None, "service": "sync", "counter": 17}),
        (0x080, "1122", {"node": None, "service": "sync", "malformed": "2 bytes, expected 0 or 1"}),
        (0x100, "70716202983a", {"node": None, "service": "time", "time": "2025-01-25T11:06:46.000"}),
        (0x100, "0000", {"node": None, "service": "time", "malformed": "2 bytes, expected 6"}),
        (0x701, "00", {"node": "motor", "service": "heartbeat", "state": "boot-up"}),
        (0x702, "05", {"node": "brake", "service": "heartbeat", "state": "operational"}),
        (0x77F, "7f", {"node": "host", "service": "heartbeat", "state": "pre-operational"}),
        (0x705, "84", {"node": "5", "service": "heartbeat", "state": "stopped"}),  # node guarding, toggle bit set
        (0x701, "03", {"node": "motor", "service": "heartbeat", "state": "unknown state 3"}),
        (0x701, "", {"node": "motor", "service": "heartbeat", "malformed": "0 bytes, expected 1"}),
        (
            0x082, "5082110102030405",
            {"node": "brake", "service": "emcy", "code": 0x8250, "text": "0x8250: RPDO time-out", "register": 0x11,
             "manufacturer": "0102030405"},
        ),
        (0x081, "00", {"node": "motor", "service": "emcy", "malformed": "1 bytes, expected 8"}),
        (
            0x081, "508211",
            {"node": "motor", "service": "emcy", "malformed": "3 bytes, expected 8", "code": 0x8250,
             "text": "0x8250: RPDO time-out", "register": 0x11, "manufacturer": ""},
        ),
        (0x7E5, "0400000000000000", {"node": None, "service": "lss", "command": "switch state global", "state": "waiting"}),
        (0x700, "00", {"node": None, "service": "unknown"}),
        (0x123, "00", {"node": None, "service": "unknown"}),
        (0x385, "0102", {"node": "5", "pdo": "TPDO3", "service": "pdo"}),  # a node that the rig does not know
        (0x301, "0102", {"node": "motor", "pdo": "RPDO2", "service": "pdo"}),  # a PDO that the host does not map
        (0x202, "010203", {"node": "brake", "pdo": "RPDO1", "service": "pdo", "malformed": "3 bytes, expected 2"}),
        (0x18000181 | CAN_EFF_FLAG, "01", {"node": None, "service": "unknown", "extended": True}),
        (
            0x004 | CAN_ERR_FLAG, "0000000000000000",
            {"node": None, "service": "error", "classes": ["controller problem"], "text": "controller problem"},
        ),
    ],
)  # fmt: skip
def test_services(decoded, can_id: int, data: str, expected: dict[str, Any]):
    (row,) = decoded((can_id, bytes.fromhex(data)))
    assert row["can_id"] == can_id & 0x1FFFFFFF
    assert row["data"] == data
    assert said(row) == {"pdo": None, **expected}


def test_remote_frames(decoded):
    pdo, guard = decoded((0x181 | CAN_RTR_FLAG, bytes(8)), (0x701 | CAN_RTR_FLAG, bytes(1)))
    assert said(pdo) == {"node": "motor", "pdo": "TPDO1", "service": "pdo", "remote": True, "length": 8}
    assert said(guard) == {"node": "motor", "pdo": None, "service": "heartbeat", "remote": True, "length": 1}
    assert "remote request, 8 bytes" in as_text(pdo)


@pytest.mark.parametrize(
    ("classes", "data", "expected"),
    [
        (
            0x288, "0000880a00010800",
            {
                "classes": ["protocol violation", "bus error"], "violation": ["dominant bit not sent", "while sending"], "place": "data",
                "tec": 8, "rec": 0,
                "text": "protocol violation (dominant bit not sent, while sending, in data), bus error, TEC 8, REC 0",
            },
        ),
        (
            0x204, "0024000000008801",
            {
                "classes": ["controller problem"], "controller": ["receive warning", "transmit error passive"], "tec": 136, "rec": 1,
                "text": "controller problem (receive warning, transmit error passive), TEC 136, REC 1",
            },
        ),
        (
            0x2A0, "0000001900000800",
            {"classes": ["no acknowledgement", "bus error"], "tec": 8, "rec": 0, "text": "no acknowledgement, bus error, TEC 8, REC 0"},
        ),
        (0x002, "0c", {"classes": ["arbitration lost"], "lost_at_bit": 12, "text": "arbitration lost (in bit 12)"}),
        (0x002, "", {"classes": ["arbitration lost"], "text": "arbitration lost"}),
        (
            0x010, "0000000084",
            {
                "classes": ["transceiver problem"], "transceiver": ["CANH no wire", "CANL short to CANH"],
                "text": "transceiver problem (CANH no wire, CANL short to CANH)",
            },
        ),
        (
            0x008, "000001ff",
            {
                "classes": ["protocol violation"], "violation": ["single bit"], "place": "place FFh",
                "text": "protocol violation (single bit, in place FFh)",
            },
        ),
        (0x000, "", {"classes": [], "text": "class not told"}),
    ],
)  # fmt: skip
def test_error_frames_in_words(decoded, classes: int, data: str, expected: dict[str, Any]):
    """As linux/can/error.h says."""
    (row,) = decoded((classes | CAN_ERR_FLAG, bytes.fromhex(data)))
    assert said(row) == {"node": None, "pdo": None, "service": "error", **expected}
    assert as_text(row).endswith(expected["text"])


def sdo(text: str) -> bytes:
    return bytes.fromhex(text).ljust(8, b"\0")


def test_sdo_transfers(decoded):
    rows = decoded(
        (0x601, sdo("40 41 60 00")),  # read the status word
        (0x581, sdo("4B 41 60 00 37 02")),
        (0x601, sdo("2B 71 60 00 FE FF")),  # target torque, INTEGER16: -2
        (0x581, sdo("60 71 60 00")),
        (0x602, sdo("40 34 12 05")),
        (0x582, sdo("80 34 12 05 00 00 02 06")),
    )
    assert [row["service"] for row in rows] == [
        "SDO upload", "SDO expedited upload", "SDO expedited download", "SDO expedited download", "SDO upload", "SDO upload",
    ]  # fmt: skip
    assert [row["node"] for row in rows] == ["motor"] * 4 + ["brake"] * 2
    assert [row["phase"] for row in rows] == [
        "Initiate upload request", "Initiate upload response", "Initiate download request", "Initiate download response",
        "Initiate upload request", "Abort transfer",
    ]  # fmt: skip
    assert {(row["index"], row["subindex"]) for row in rows[:2]} == {(0x6041, 0)}
    assert [row.get("value") for row in rows] == [None, 0x0237, -2, -2, None, None]
    assert (rows[4]["index"], rows[4]["subindex"]) == (0x1234, 5)
    assert rows[5]["code"] == 0x06020000
    assert rows[5]["text"] == "0x06020000: object does not exist in the object dictionary"
    assert "tatus" in rows[0]["name"]
    assert "name" not in rows[4]


def test_segments_belong_to_the_transfer_that_was_begun(decoded):
    rows = decoded(
        (0x582, sdo("00 11")),  # nobody saw its beginning
        (0x601, sdo("40 08 10 00")),
        (0x581, sdo("41 08 10 00 0A")),
        (0x605, sdo("21 00 20 01 09")),  # another server in between
        (0x601, sdo("60")),
        (0x581, sdo("00 41 42 43 44 45 46 47")),
        (0x601, sdo("70")),
        (0x581, sdo("19 48 49 4A")),
        (0x605, sdo("00 01 02 03 04 05 06 07")),
        (0x585, sdo("20")),
    )
    assert rows[0]["phase"] == "Upload segment response"
    assert "index" not in rows[0]
    assert rows[0]["remark"] == "its beginning is not in the recording"
    assert rows[2]["size"] == 10
    assert [row["phase"] for row in rows[4:]] == [
        "Upload segment request", "Upload segment response", "Upload segment request", "Upload segment response",
        "Download segment request", "Download segment response",
    ]  # fmt: skip
    assert {row["index"] for row in rows[4:8]} == {0x1008}
    assert {(row["index"], row["subindex"]) for row in rows[8:]} == {(0x2000, 1)}
    assert (rows[5]["segment"], rows[5]["last"]) == ("41424344454647", False)
    assert (rows[7]["segment"], rows[7]["last"]) == ("48494a", True)
    assert (rows[7]["content"], rows[7]["value"]) == (b"ABCDEFGHIJ".hex(), "ABCDEFGHIJ")


def test_sdo_oddities(decoded):
    rows = decoded(
        (0x605, b"\x40"),
        (0x605, sdo("22 00 20 00 01 02 03 04")),  # size not given: all four bytes
        (0x585, sdo("60 00 20 00")),
        (0x605, sdo("E0")),
    )
    assert (rows[0]["service"], rows[0]["malformed"]) == ("SDO", "1 bytes, expected 8")
    assert rows[1]["value"] == 0x04030201
    assert (rows[3]["service"], rows[3]["phase"]) == ("SDO", "Unknown command E0h")


def test_a_block_transfer_in_lines(decoded):
    """Each server has its own transfer; a segment may look like an abort or an initiation."""
    lines = [
        as_text(row)
        for row in decoded(
            (0x601, sdo("A4 08 10 00 7F")),
            (0x581, sdo("C6 08 10 00 0C")),
            (0x602, sdo("40 00 10 00")),
            (0x601, sdo("A3")),
            (0x581, sdo("01 44 72 69 76 65 20 6F")),
            (0x581, sdo("82 20 6E 6F 64 65")),
            (0x582, sdo("43 00 10 00 92 01 02")),
            (0x601, sdo("A2 02 7F")),
            (0x581, sdo("C9 9F DA")),
            (0x601, sdo("A1")),
        )
    ]
    assert sum("SDO block upload" in line for line in lines) == 8
    assert [line for line in lines if "bort" in line or "nknown" in line] == []
    assert lines[5].endswith("1008h:00 Manufacturer device name segment 2 206e6f64650000 (last) (12 bytes so far)")
    assert lines[6].endswith("Device type = 131474 (0x20192) (4 bytes, complete)")
    assert lines[9].endswith(
        "End block upload response        1008h:00 Manufacturer device name = Drive o node (12 bytes, complete)"
    )


class Recorded(DevicesLink):
    """A link that keeps what went over it."""

    def __init__(self):
        super().__init__()
        self.frames = []

    def send(self, can_id, data=b"", length=None):
        self.frames.append((can_id, bytes(data)))
        super().send(can_id, data, length)

    def receive(self, until_ns):
        frame = super().receive(until_ns)
        if frame is not None:
            self.frames.append((frame.can_id, frame.data))
        return frame


def test_the_device_s_own_file_read_by_the_products_client(decoded):
    """1021h has 40 kB, and is long by its definition: it is read by blocks."""
    link = Recorded()
    link.add(eds("motor"), 1)
    stored = SdoClient(link, 1).upload(0x1021, 0)
    rows = [row for row in decoded(*link.frames) if row["service"].startswith("SDO")]
    assert [row["phase"] for row in rows[:2]] == ["Initiate block upload request", "Initiate block upload response"]
    assert {row["service"] for row in rows} == {"SDO block upload"}
    assert {row["index"] for row in rows} == {0x1021}
    assert not any(row["phase"] == "Abort transfer" or "remark" in row for row in rows)
    assert bytes.fromhex(rows[-1]["content"]) == stored == (EDS / "motor.eds").read_bytes()


def test_a_long_object_whose_length_comes_first_is_read_by_blocks_after_an_abort(decoded):
    link, content = Recorded(), bytes(65 + k % 26 for k in range(1500))
    link.add(eds("motor"), 1)
    client = SdoClient(link, 1)
    client.download(0x2004, 0, content)
    link.frames.clear()
    assert client.upload(0x2004, 0) == content
    rows = [row for row in decoded(*link.frames) if row["service"].startswith("SDO")]
    assert [row["phase"] for row in rows[:5]] == [
        "Initiate upload request", "Initiate upload response", "Abort transfer", "Initiate block upload request",
        "Initiate block upload response",
    ]  # fmt: skip
    assert {row["service"] for row in rows[3:]} == {"SDO block upload"}
    assert not any(row["phase"] == "Abort transfer" or "remark" in row for row in rows[3:])
    assert bytes.fromhex(rows[-1]["content"]) == content


def test_sdo_values_by_their_data_type():
    types = {0x2000: 0x0008, 0x2001: 0x0009, 0x2002: 0x0003, 0x2003: 0x0006, 0x2004: 0x7777}
    objects = {i: Object(i, "x", 7, {0: variable(i, data_type)}) for i, data_type in types.items()}
    server = SdoChannel(Description("x.eds", "", objects, (), {}))

    def value(index: int, raw: bytes) -> Any:
        unused = 4 - len(raw)
        return server.row(bytes([0x43 | unused << 2, index & 0xFF, index >> 8, 0]) + raw + bytes(unused), True)["value"]

    assert value(0x2000, struct.pack("<f", 0.5)) == 0.5
    assert value(0x2000, struct.pack("<f", float("-inf"))) == "-inf"
    assert value(0x2001, b"AB") == "AB"
    assert value(0x2002, b"\xfe\xff") == -2
    assert value(0x2003, b"\xfe\xff") == 0xFFFE
    assert value(0x2004, b"\xff") == value(0x2005, b"\xff") == 0xFF


def variable(index: int, data_type: int) -> Variable:
    return Variable(index, 0, "x", data_type, "rw", None, False, None, None, False, 1)


def test_lines_for_the_eye(decoded):
    lines = [
        as_text(row)
        for row in decoded(
            (0x080, b""),
            (0x181, struct.pack("<Hih", 0x0237, 1_000, -7)),
            (0x181, struct.pack("<Hih", 0x1637, -100_000, 700)),
            (0x082, bytes.fromhex("5082110000000000")),
            (0x601, sdo("40 41 60 00")),
            (0x582, sdo("80 34 12 05 00 00 02 06")),
            (0x123, b"\xde\xad"),
            (0x202, b"\x01"),
            comments={1: "phase hold"},
        )
    ]
    assert lines[0] == "      0.000000       080  -      sync"
    assert lines[1] == (
        "      0.001000       181  motor  TPDO1      "
        "statusword=0x0237  position_rad=   +0.08000  torque_Nm=   -0.01208  # phase hold"
    )
    assert lines[1].index("torque_Nm") == lines[2].index("torque_Nm")
    assert "brake  emcy       0x8250: RPDO time-out  register=0x11" in lines[3]
    assert "Initiate upload request          6041h:00" in lines[4]
    assert lines[5].endswith("1234h:05 0x06020000: object does not exist in the object dictionary")
    assert lines[6].endswith("unknown    dead")
    assert lines[7].endswith("malformed=1 bytes, expected 2  01")


def test_a_number_that_is_none_is_text_in_json():
    row = {"t_s": 0.5, "a": float("nan"), "b": float("-inf"), "c": 3, "d": None, "e": "x"}
    assert json.loads(as_json(row), parse_constant=pytest.fail) == row | {"a": "nan", "b": "-inf"}
    assert as_json({"t_s": 0.5}) == '{"t_s": 0.5}'


@pytest.mark.parametrize(
    ("can_id", "data", "expected"),
    [
        (0x7E5, "1107000000000000", {"command": "configure node id", "node_id": 7}),
        (0x7E4, "1101000000000000", {"command": "configure node id", "result": "node id out of range"}),
        (0x7E4, "1700000000000000", {"command": "store configuration", "result": "ok"}),
        (0x7E4, "17FF050000000000", {"command": "store configuration", "result": "error 255, specific 5"}),
        (0x7E5, "1300020000000000", {"command": "configure bit timing", "bitrate_bit_s": 500_000}),
        (0x7E5, "1501000000000000", {"command": "activate bit timing", "delay_ms": 1}),
        (0x7E5, "4078563412000000", {"command": "switch vendor", "value": 0x12345678}),
        (0x7E4, "5E05000000000000", {"command": "inquire node id", "node_id": 5}),
        (0x7E5, "5112340000801F01", {"command": "fastscan", "value": 0x3412, "bit": 0x80, "sub": 0x1F, "next": 1}),
        (0x7E5, "FF00000000000000", {"command": "unknown service 0xff"}),
        (0x7E5, "04", {"malformed": "1 bytes, expected 8"}),
    ],
)
def test_lss_in_words(can_id: int, data: str, expected: dict[str, Any]):
    assert lss(bytes.fromhex(data), from_device=can_id == 0x7E4) == expected
