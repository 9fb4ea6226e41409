"""An oracle of frame lengths: a station that sends a frame bit by bit, written from ISO 11898-1's
text, knows nothing of `wire.bits`.

Slow and plain on purpose. Every bit goes through `send`, which keeps the rule of stuffing and the
rate; the CRC is a shift register, one step a bit. `tests/wire/test_fd_bits.py` holds the planner's
lengths against it, ``python -m benchmarks bits`` does on a million frames.
"""

from __future__ import annotations

from dataclasses import dataclass, field

CRC_15 = (15, 0b100_0101_1001_1001, 0)
CRC_17 = (17, 0x1685B, 1 << 16)
CRC_21 = (21, 0x102899, 1 << 20)
"""Width, polynomial without its highest term, initial vector (ISO: the most significant bit of an
FD frame's register is 1).
"""
FD_DLC = {0: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 5, 6: 6, 7: 7, 8: 8, 12: 9, 16: 10, 20: 11, 24: 12, 32: 13, 48: 14, 64: 15}


def crc(bits: list[int], kind: tuple[int, int, int]) -> list[int]:
    """Return the CRC sequence of `bits`, most significant bit first."""
    width, polynomial, register = kind
    for bit in bits:
        out = register >> (width - 1) & 1
        register = register << 1 & ((1 << width) - 1)
        if bit != out:
            register ^= polynomial
    return numbered(register, width)


def numbered(value: int, width: int) -> list[int]:
    """Return `value` as `width` bits, the most significant first."""
    return [value >> i & 1 for i in range(width - 1, -1, -1)]


@dataclass
class Station:
    """A sender: the bits on the wire so far, and the rate of each ("n" nominal, "d" data)."""

    wire: list[int] = field(default_factory=list)
    rates: list[str] = field(default_factory=list)
    rate: str = "n"
    run: int = 0
    stuffed: int = 0

    def raw(self, bit: int) -> None:
        """Put one bit on the wire, and count how many equal ones stand at its end."""
        self.run = self.run + 1 if self.wire and self.wire[-1] == bit else 1
        self.wire.append(bit)
        self.rates.append(self.rate)

    def send(self, bits: list[int]) -> None:
        """Send bits under the dynamic rule: before a further bit goes out, five equal ones are
        followed by their opposite.
        """
        for bit in bits:
            self.pending_stuff_bit()
            self.raw(bit)

    def pending_stuff_bit(self) -> None:
        """Insert the stuff bit that the last five bits ask for, if they do."""
        if self.run == 5:
            self.raw(1 - self.wire[-1])
            self.stuffed += 1

    def send_fixed(self, bits: list[int]) -> None:
        """Send a CRC field: its stuff bits stand at fixed places, each the opposite of the bit
        before it.
        """
        for i, bit in enumerate(bits):
            if i % 4 == 0:
                self.raw(1 - self.wire[-1])
            self.raw(bit)

    def tail(self, bits: str) -> None:
        """Send bits that are never stuffed."""
        for bit in bits:
            self.raw(int(bit))


def payload_bits(data: bytes) -> list[int]:
    """Return the data field."""
    return [bit for byte in data for bit in numbered(byte, 8)]


def classical(can_id: int, data: bytes, extended: bool = False, remote: bool = False) -> Station:
    """Send a classical frame; a remote one asks for as many bytes as `data` has."""
    rtr = int(remote)
    if extended:
        identifier = numbered(can_id, 29)
        bits = [0, *identifier[:11], 1, 1, *identifier[11:], rtr, 0, 0]
    else:
        bits = [0, *numbered(can_id, 11), rtr, 0, 0]
    bits += numbered(len(data), 4) + ([] if remote else payload_bits(data))
    station = Station()
    station.send(bits + crc(bits, CRC_15))
    station.pending_stuff_bit()  # the last bit of the CRC may ask for one
    station.tail("1" + "01" + "1111111" + "111")
    return station


def flexible(can_id: int, data: bytes, extended: bool = False, switch: bool = True) -> Station:
    """Send an FD frame of an error active station."""
    station = Station()
    if extended:
        identifier = numbered(can_id, 29)
        station.send([0, *identifier[:11], 1, 1, *identifier[11:], 0, 1, 0, int(switch)])
    else:
        station.send([0, *numbered(can_id, 11), 0, 0, 1, 0, int(switch)])
    if switch:
        station.rate = "d"
    station.send([0, *numbered(FD_DLC[len(data)], 4), *payload_bits(data)])
    covered = list(station.wire)  # ISO: the stuff bits, too
    count = station.stuffed % 8
    gray = numbered(count ^ count >> 1, 3)
    stuff_count = [*gray, sum(gray) % 2]
    covered += stuff_count
    station.send_fixed(stuff_count + crc(covered, CRC_17 if len(data) <= 16 else CRC_21))
    station.tail("1")
    station.rate = "n"
    station.tail("01" + "1111111" + "111")
    return station


def fd_lengths(can_id: int, data: bytes, extended: bool = False, switch: bool = True) -> tuple[int, int]:
    """Return (bits at the nominal rate, bits at the data rate)."""
    rates = flexible(can_id, data, extended, switch).rates
    return rates.count("n"), rates.count("d")
