"""An oracle of frame lengths: a station that sends a frame bit by bit, written from ISO 11898-1's
text, knows nothing of `wire.bits`.

Slow and plain on purpose. Every bit goes through `Station.send`, which keeps the rule of stuffing;
the CRC is a shift register, one step a bit. `tests/wire/test_bits.py` holds the planner's lengths
against it, ``python -m benchmarks bits`` does on a million frames.
"""

from __future__ import annotations

CRC_WIDTH, CRC_POLYNOMIAL = 15, 0b100_0101_1001_1001
"""The polynomial stands without its highest term. The register begins at 0."""


def crc(bits: list[int]) -> list[int]:
    """Return the CRC sequence of `bits`, most significant bit first."""
    register = 0
    for bit in bits:
        out = register >> (CRC_WIDTH - 1) & 1
        register = register << 1 & ((1 << CRC_WIDTH) - 1)
        if bit != out:
            register ^= CRC_POLYNOMIAL
    return numbered(register, CRC_WIDTH)


def numbered(value: int, width: int) -> list[int]:
    """Return `value` as `width` bits, the most significant first."""
    return [value >> i & 1 for i in range(width - 1, -1, -1)]


class Station:
    """A sender; `wire` has the bits so far."""

    def __init__(self) -> None:
        self.wire: list[int] = []
        self._run = 0

    def raw(self, bit: int) -> None:
        """Put one bit on the wire, and count how many equal ones stand at its end."""
        self._run = self._run + 1 if self.wire and self.wire[-1] == bit else 1
        self.wire.append(bit)

    def send(self, bits: list[int]) -> None:
        """Send bits: before a further one goes out, five equal ones are followed by their opposite."""
        for bit in bits:
            self.pending_stuff_bit()
            self.raw(bit)

    def pending_stuff_bit(self) -> None:
        """Insert the stuff bit that the last five bits ask for, if they do."""
        if self._run == 5:
            self.raw(1 - self.wire[-1])

    def tail(self, bits: str) -> None:
        """Send bits that are never stuffed."""
        for bit in bits:
            self.raw(int(bit))


def payload_bits(data: bytes) -> list[int]:
    """Return the data field."""
    return [bit for byte in data for bit in numbered(byte, 8)]


def classical(can_id: int, data: bytes, extended: bool = False, remote: bool = False) -> list[int]:
    """Return the bits of a classical frame; a remote one asks for as many bytes as `data` has."""
    rtr = int(remote)
    if extended:
        identifier = numbered(can_id, 29)
        bits = [0, *identifier[:11], 1, 1, *identifier[11:], rtr, 0, 0]
    else:
        bits = [0, *numbered(can_id, 11), rtr, 0, 0]
    bits += numbered(len(data), 4) + ([] if remote else payload_bits(data))
    station = Station()
    station.send(bits + crc(bits))
    station.pending_stuff_bit()  # the last bit of the CRC may ask for one
    station.tail("1" + "01" + "1111111" + "111")
    return station.wire
