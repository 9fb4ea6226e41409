"""An LSS slave as devices of the field are: it answers late, misses messages, stores slowly."""

from __future__ import annotations

from dataclasses import dataclass, field

LSS_RX, LSS_TX = 0x7E5, 0x7E4
NO_ID = 0xFF
MS = 1_000_000


@dataclass
class LssSlave:
    """A slave on a `devices_bench.DevicesLink`.

    Attributes
    ----------
    deaf_ns : it misses a message that comes so soon behind the one before
    answer_ns, store_ns : how long an answer takes; that to a store
    early : it enters LSS configuration with the last bit of the fastscan, before its last step
    inquiries : it tells its identity in LSS configuration
    odd : of a service: the bytes that it answers in the place of its own; b"": nothing
    """

    link: object
    identity: tuple[int, int, int, int]
    node_id: int = NO_ID
    deaf_ns: int = 0
    answer_ns: int = 100_000
    store_ns: int = 100_000
    early: bool = False
    inquiries: bool = True
    odd: dict[int, bytes] = field(default_factory=dict)

    def __post_init__(self):
        self.configures, self.part, self.selected, self.last_ns = False, 0, [], -(1 << 60)
        self.stored = None
        self.stores = 0
        self.link.others.append(self.hear)

    def hear(self, can_id, data):
        """Take a frame of the master; return what comes of it."""
        if can_id != LSS_RX:
            return []
        gap_ns, self.last_ns = self.link.t - self.last_ns, self.link.t
        if gap_ns < self.deaf_ns:
            return []
        answer = self.answer(data, int.from_bytes(data[1:5], "little"))
        if answer is None:
            return []
        content = self.odd.get(data[0], answer.ljust(8, b"\0"))
        return [(LSS_TX, content, self.store_ns if data[0] == 0x17 else self.answer_ns)] if content else []

    def answer(self, data, number):
        """Return the bytes of the answer, None without one."""
        service = data[0]
        if service == 0x04:
            self.configures = data[1] == 1
            return None
        if 0x40 <= service <= 0x43:
            self.selected = [*(self.selected if service != 0x40 else []), number]
            if service == 0x43 and tuple(self.selected) == self.identity:
                self.configures = True
                return b"\x44"
            return None
        if service == 0x51:
            return self.scanned(number, *data[5:8])
        return self.configured(service, data) if self.configures else None

    def scanned(self, number, bit, part, following):
        """Answer a step of the fastscan."""
        if self.configures or self.node_id != NO_ID:
            return None
        if bit == 0x80:
            self.part = 0
            return b"\x4f"
        if part != self.part or (self.identity[part] ^ number) >> bit:
            return None
        self.part = following
        if bit == 0 and part == 3 and (following == 0 or self.early):
            self.configures = True
        return b"\x4f"

    def configured(self, service, data):
        """Answer a service of LSS configuration."""
        if 0x5A <= service <= 0x5D and self.inquiries:
            return bytes((service,)) + self.identity[service - 0x5A].to_bytes(4, "little")
        if service == 0x5E:
            return bytes((service, self.node_id))
        if service == 0x11:
            self.node_id = data[1]
            return bytes((service, 0))
        if service == 0x17:
            self.stored = self.node_id
            self.stores += 1
        return bytes((service, 0)) if service in (0x13, 0x17) else None
