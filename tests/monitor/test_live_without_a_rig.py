"""A live bus of which no rig is known, or that is not the rig's that was assumed."""

from __future__ import annotations

import struct

import pytest

from coulombus.monitor.live import Live
from coulombus.monitor.screen import as_dict, as_lines
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.rigs.rig import load_rig

S = 1_000_000_000
T0 = 1_700_000_000 * S
FACTS = {"bus": "coulombus:x", "bitrate_bit_s": 1_000_000, "lost": 0, "malformed": 0}
MAP = (0x60410010, 0x60640020)


@pytest.fixture(scope="module")
def rig():
    return load_rig("bench")


def frame(t_s, can_id, data=b""):
    return (T0 + round(t_s * S), can_id, len(data), data.ljust(8, b"\0"))


def mapped(node, t_s, index, *words):
    """Yield the downloads that map `words`."""
    for sub, value in (*enumerate(words, 1), (0, len(words))):
        place = struct.pack("<HB", index, sub)
        yield frame(t_s, 0x600 + node, b"\x23" + place + struct.pack("<I", value))
        yield frame(t_s, 0x580 + node, b"\x60" + place + bytes(4))


def test_pdos_are_learned_and_the_others_are_raw():
    live = Live(KnownBus())
    live.snapshot(T0)
    live.add_frames([frame(0, 0x705, b"\0"), *mapped(5, 0.01, 0x1A00, *MAP), frame(0.02, 0x705, b"\5")])
    live.add_frames([frame(0.1, 0x185, struct.pack("<Hi", 0x0237, -7)), frame(0.11, 0x309, b"\1\2\3")])
    snapshot = live.snapshot(T0 + S)
    rows = {row.name: row for row in snapshot.pdos}
    assert list(rows) == ["5.TPDO1", "9.RPDO2"]
    assert {value.name: value.value for value in rows["5.TPDO1"].values} == {
        "5.TPDO1.6041h:00": 0x0237,
        "5.TPDO1.6064h:00": -7,
    }
    assert rows["9.RPDO2"].data == b"\1\2\3"
    (node,) = snapshot.nodes
    assert (node.name, node.state, node.power_state) == ("5", "operational", "operation enabled")
    assert snapshot.unknown == 0
    assert as_dict(snapshot, FACTS, T0)["signals"]["5.TPDO1.6064h:00"] == -7
    assert any("5.TPDO1" in line for line in as_lines(snapshot, FACTS, T0))


def test_a_length_that_does_not_fit_a_map_is_counted_and_an_assumed_map_is_left():
    live = Live(KnownBus())
    kind = frame(0, 0x585, bytes.fromhex("4300100092010000"))
    live.add_frames([kind, *mapped(6, 0.01, 0x1A00, *MAP), frame(0.1, 0x185, b"\x37\2"), frame(0.1, 0x186, bytes(5))])
    snapshot = live.snapshot(T0 + S)
    rows = {row.name: row for row in snapshot.pdos}
    assert [value.name for value in rows["5.TPDO1"].values] == ["5.TPDO1.6041h:00"]
    assert (rows["6.TPDO1"].count, rows["6.TPDO1"].malformed) == (0, 1)
    assert any("186h has 5 bytes, its map 6" in event.text for event in snapshot.events)
    live.add_frames([frame(0.2, 0x185, bytes(8))])
    rows = {row.name: row for row in live.snapshot(T0 + 2 * S).pdos}
    assert (rows["5.TPDO1"].values, rows["5.TPDO1"].malformed, rows["5.TPDO1"].data) == ((), 0, bytes(8))


@pytest.mark.parametrize(
    "frames",
    [
        [frame(0.1, 0x705, b"\5")],  # a stranger alone
        [frame(0.1, 0x705, b"\5"), frame(0.1, 0x77F, b"\5"), frame(0.1, 0x202, bytes(2))],  # with some host
        [frame(0.1, 0x181, bytes(3))],  # a PDO that never fits
        [frame(0.1, 0x481, bytes(8))],  # a PDO that the rig does not have, of a node without those that it has
        [frame(0.1, 0x581, bytes.fromhex("4318100199000000"))],  # another maker's device
    ],
)
def test_an_assumed_rig_is_left_when_the_bus_is_another_ones(rig, frames):
    live = Live(KnownBus(rig), assumed=True)
    live.add_frames([*mapped(5, 0.01, 0x1A00, *MAP), *frames, frame(0.2, 0x185, struct.pack("<Hi", 0x0237, 9))])
    snapshot = live.snapshot(T0 + S)
    assert any("this is not rig bench" in event.text for event in snapshot.events)
    assert live.rig is None
    live.add_frames([frame(1.2, 0x185, struct.pack("<Hi", 0x0237, 9))])
    signals = as_dict(live.snapshot(T0 + 2 * S), FACTS, T0)["signals"]
    assert signals["5.TPDO1.6064h:00"] == 9
    assert not any("motor" in name for name in signals)


def test_a_node_that_only_sends_pdos_is_listed_when_the_rig_is_left(rig):
    live = Live(KnownBus(rig), assumed=True)
    live.add_frames([frame(0.1, 0x181, bytes(3)), frame(0.2, 0x189, bytes(4))])
    assert {node.name for node in live.snapshot(T0 + S).nodes} == {"1", "9"}


@pytest.mark.parametrize(
    "frames",
    [
        [frame(0.1, 0x705, b"\5")],  # a stranger beside the rig's nodes
        [frame(0.1, 0x181, bytes(3))],  # a frame of another length among those that fit
        [frame(0.1, 0x581, bytes.fromhex("4318100100000000"))],
    ],
)
def test_an_assumed_rig_stays_where_its_nodes_are(rig, frames):
    live = Live(KnownBus(rig), assumed=True)
    live.add_frames([frame(0, 0x701, b"\5"), frame(0.05, 0x181, struct.pack("<Hih", 0x0237, 0, 0)), *frames])
    live.snapshot(T0 + S)
    assert live.rig is rig


def test_a_rig_that_was_named_stays(rig):
    live = Live(KnownBus(rig))
    live.add_frames([frame(0.1, 0x705, b"\5"), frame(0.1, 0x181, bytes(3))])
    live.snapshot(T0 + S)
    assert live.rig is rig
