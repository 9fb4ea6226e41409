"""The arm key: a change of parameters needs it when a hand may be on the handle.

The key has six digits, so attempts are limited. After `TRIES` wrong keys within `WINDOW_NS` every key is
refused for `LOCK_NS`, even the right one. Each repetition doubles this time. The attempts of all clients
count together.
"""

from __future__ import annotations

import hmac
import secrets
from collections import deque

from coulombus.wire.address import BusAddress

__all__ = ["LOCK_NS", "LONGEST_NS", "TRIES", "WINDOW_NS", "ArmKey", "new_arm_key"]

TRIES = 5
WINDOW_NS = 600_000_000_000
LOCK_NS = 60_000_000_000
LONGEST_NS = 3600_000_000_000


def new_arm_key(address: BusAddress) -> str:
    """Return the arm key of a run: six digits, or "" on a virtual bus, which moves no hardware."""
    return f"{secrets.randbelow(10**6):06d}" if address.moves_hardware else ""


class ArmKey:
    """The key of one host, with the attempts of all clients.

    Parameters
    ----------
    text : the key; "": no key is needed
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self._wrong_ns: deque[int] = deque(maxlen=TRIES)
        self._lock_ns, self._until_ns = LOCK_NS, 0

    def why_not(self, key: str, now_ns: int) -> str | None:
        """Return the reason why a key is refused; None if it is accepted. An empty key is no attempt.

        Parameters
        ----------
        now_ns : time of a monotonic clock
        """
        if not self.text:
            return None
        if now_ns < self._until_ns:
            left_s = -(-(self._until_ns - now_ns) // 1_000_000_000)
            return f"too many wrong arm keys: none is taken for another {left_s} s, the right one neither"
        if not key:
            return "a hand may be on the handle: a change needs the arm key; " + _WHERE
        if hmac.compare_digest(key.encode(errors="surrogatepass"), self.text.encode()):  # JSON may hold a surrogate
            self._wrong_ns.clear()
            self._lock_ns = LOCK_NS
            return None
        return "the arm key is wrong; " + (self._locked(now_ns) or _WHERE)

    def _locked(self, now_ns: int) -> str | None:
        """Count a wrong key; return the text of the lock if it was one too many."""
        self._wrong_ns.append(now_ns)
        if len(self._wrong_ns) < TRIES or now_ns - self._wrong_ns[0] > WINDOW_NS:
            return None
        lock_ns = self._lock_ns
        self._wrong_ns.clear()
        self._until_ns, self._lock_ns = now_ns + lock_ns, min(2 * lock_ns, LONGEST_NS)
        return f"it was the {TRIES}th wrong one: none is taken for {lock_ns // 1_000_000_000} s"


_WHERE = "the host has printed it where it was started (coulombus set --key)"
