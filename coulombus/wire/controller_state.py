"""State and counters of a CAN controller, with the text of ``ip -details -statistics link show``.

A virtual bus reports them to a client in packed form.
"""

from __future__ import annotations

import struct
from dataclasses import astuple, dataclass
from enum import IntEnum

__all__ = ["BUS_OFF", "Confinement", "ControllerState"]

STATES = ("ERROR-ACTIVE", "ERROR-WARNING", "ERROR-PASSIVE", "BUS-OFF", "STOPPED")
MODES = ("LOOPBACK", "LISTEN-ONLY", "ONE-SHOT")
BUS_OFF = 3
_STATE = struct.Struct("<HHHHI6I12x")


class Confinement(IntEnum):
    """Fault confinement state that a CAN controller reports to its node [ISO 11898-1]."""

    ACTIVE = 1  # error active again
    PASSIVE = 2  # error passive
    BUS_OFF = 3
    RECOVERED = 4  # back from bus-off


@dataclass(frozen=True)
class ControllerState:
    """A controller: state (Linux's ``enum can_state``), modes (bits 0 to 2: loopback, listen only,
    one-shot), counters.
    """

    state: int = 0
    modes: int = 0
    tec: int = 0
    rec: int = 0
    restart_ms: int = 0
    restarts: int = 0
    bus_errors: int = 0
    arbitration_lost: int = 0
    warnings: int = 0
    passives: int = 0
    bus_offs: int = 0

    def pack(self) -> bytes:
        """Return the 48 bytes that follow a bus's answer, little endian."""
        return _STATE.pack(
            *(min(word, 0xFFFF) for word in astuple(self)[:4]), *(min(word, 0xFFFFFFFF) for word in astuple(self)[4:])
        )

    @classmethod
    def unpack(cls, content: bytes) -> ControllerState | None:
        """Return the controller packed in `content`, None if there is none; never raises."""
        return cls(*_STATE.unpack_from(content)) if len(content) >= _STATE.size else None

    def __str__(self) -> str:
        """Return the lines that ``ip`` prints."""
        modes = ",".join(name for n, name in enumerate(MODES) if self.modes >> n & 1)
        columns = {
            "re-started": self.restarts,
            "bus-errors": self.bus_errors,
            "arbit-lost": self.arbitration_lost,
            "error-warn": self.warnings,
            "error-pass": self.passives,
            "bus-off": self.bus_offs,
        }
        return (
            f"can {f'<{modes}> ' if modes else ''}state {STATES[min(self.state, len(STATES) - 1)]}"
            f" (berr-counter tx {self.tec} rx {self.rec}) restart-ms {self.restart_ms}\n"
            + " ".join(f"{name:<10}" for name in columns).rstrip()
            + "\n"
            + " ".join(f"{value:<10}" for value in columns.values()).rstrip()
        )
