"""The eight data bytes of a frame as one number: `word` of a frame's record.

Imports no numba, because python-can's plugins load this module at their start.
"""

from __future__ import annotations

__all__ = ["data_bytes", "data_word"]


def data_word(data: bytes) -> int:
    """Return up to eight data bytes as a signed 64-bit little-endian word, zero-padded."""
    return int.from_bytes(data.ljust(8, b"\0"), "little", signed=True)


def data_bytes(word: int, length: int) -> bytes:
    """Return the first `length` data bytes of the word `word`."""
    return int(word).to_bytes(8, "little", signed=True)[:length]
