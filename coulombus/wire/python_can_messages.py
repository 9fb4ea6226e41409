"""The only conversion between a classical CAN frame of Linux and python-can's message.

A frame is an identifier with flags, a length and data.

Imports no numba, because python-can's plugins load this module at their start.
"""

from __future__ import annotations

import can

from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from coulombus.wire.data_word import data_word

__all__ = ["can_id_of", "data_of", "is_classical", "message_of", "word_of"]


def message_of(
    stamp_s: float, can_id: int, length: int, data: bytes, *, channel: str | int, is_rx: bool = True
) -> can.Message:
    """Return a frame as python-can's message.

    Parameters
    ----------
    stamp_s : time of reception [s]
    can_id : with Linux's flags ``CAN_EFF_FLAG``, ``CAN_RTR_FLAG``, ``CAN_ERR_FLAG``
    length : its DLC, 0 to 8
    data : at least `length` bytes; ignored for a remote frame
    """
    extended, remote, error = (bool(can_id & flag) for flag in (CAN_EFF_FLAG, CAN_RTR_FLAG, CAN_ERR_FLAG))
    return can.Message(
        timestamp=stamp_s,
        arbitration_id=can_id & (0x1FFFFFFF if extended or error else 0x7FF),
        is_extended_id=extended,
        is_remote_frame=remote,
        is_error_frame=error,
        is_rx=is_rx,
        channel=channel,
        dlc=length,
        data=b"" if remote else data[:length],
    )


def is_classical(message: can.Message) -> bool:
    """Tell whether a message is a classical CAN frame: no CAN FD, at most 8 data bytes."""
    return not message.is_fd and len(message.data) <= 8 and message.dlc <= 8


def can_id_of(message: can.Message) -> int:
    """Return a message's identifier with Linux's flags."""
    can_id: int = message.arbitration_id
    can_id |= CAN_EFF_FLAG if message.is_extended_id else 0
    can_id |= CAN_RTR_FLAG if message.is_remote_frame else 0
    return can_id | (CAN_ERR_FLAG if message.is_error_frame else 0)


def data_of(message: can.Message) -> bytes:
    """Return a message's data bytes, none for a remote frame."""
    return b"" if message.is_remote_frame else bytes(message.data[: message.dlc])


def word_of(message: can.Message) -> int:
    """Return a message's data as a frame record's `word`: a little-endian INTEGER64, zero-padded."""
    return data_word(data_of(message))
