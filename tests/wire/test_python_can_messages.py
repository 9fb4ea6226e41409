"""Frames and python-can's messages are turned into each other in one place."""

from __future__ import annotations

import re

import can
import pytest

from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from coulombus.wire.python_can_messages import can_id_of, data_of, is_classical, message_of, word_of
from places import ROOT


@pytest.mark.parametrize(
    "can_id",
    [
        0x181,
        0x7FF,
        0x181 | CAN_RTR_FLAG,
        0x12345678 | CAN_EFF_FLAG,
        0x1 | CAN_EFF_FLAG | CAN_RTR_FLAG,
        0x40 | CAN_ERR_FLAG,
    ],
)
@pytest.mark.parametrize("data", [b"", b"\x80", bytes(range(248, 256))])
def test_a_frame_comes_out_of_a_message_as_it_went_in(can_id, data):
    message = message_of(1.5, can_id, len(data), data.ljust(8, b"\x55"), channel="x", is_rx=False)
    kept = b"" if can_id & CAN_RTR_FLAG else data
    assert (can_id_of(message), message.dlc, data_of(message)) == (can_id, len(data), kept)
    assert word_of(message).to_bytes(8, "little", signed=True) == kept.ljust(8, b"\0")
    assert (message.timestamp, message.channel, message.is_rx) == (1.5, "x", False)
    assert is_classical(message)


def test_can_fd_is_not_classical():
    assert not is_classical(can.Message(is_fd=True, data=bytes(4)))
    assert not is_classical(can.Message(is_fd=True, data=bytes(64)))
    assert is_classical(can.Message(data=bytes(8)))


def test_no_other_place_turns_them_into_each_other():
    sources = [
        path
        for room in ("wire", "recording", "host", "monitor", "sim_bus", "lab")
        for path in (ROOT / "coulombus" / room).resolve().rglob("*.py")
    ]
    names = {path.name for path in sources if re.search(r"arbitration_id(=| \|)", path.read_text())}
    assert names == {"python_can_messages.py"}
