"""The arm key: what a change of parameters needs where a hand may be on the handle.

It has six digits, so the tries are limited: after `TRIES` wrong ones within `WINDOW_NS` no key is
taken for `LOCK_NS`, not even the right one, and for twice as long each time that it happens again.
The tries of all who ask the host count together.
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
    """Return the arm key of a run: six digits; none on a virtual bus, which moves nobody."""
    return f"{secrets.randbelow(10**6):06d}" if address.moves_hardware else ""


class ArmKey:
    """The key of one host, with the tries of all who ask it.

    Parameters
    ----------
    text : the key; "": none is needed
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self._wrong_ns: deque[int] = deque(maxlen=TRIES)
        self._lock_ns, self._until_ns = LOCK_NS, 0

    def why_not(self, given: str, now_ns: int) -> str | None:
        """Return why a key is refused; None where it is taken. None given is no try.

        Parameters
        ----------
        now_ns : of a clock that is never set
        """
        if not self.text:
            return None
        if now_ns < self._until_ns:
            left_s = -(-(self._until_ns - now_ns) // 1_000_000_000)
            return f"too many wrong arm keys: none is taken for another {left_s} s, the right one neither"
        if not given:
            return "a hand may be on the handle: a change needs the arm key; " + _WHERE
        if hmac.compare_digest(given.encode(errors="surrogatepass"), self.text.encode()):  # JSON: half a character
            self._wrong_ns.clear()
            self._lock_ns = LOCK_NS
            return None
        return "the arm key is wrong; " + (self._locked(now_ns) or _WHERE)

    def _locked(self, now_ns: int) -> str | None:
        """Count a wrong try; return what follows where it is one too many."""
        self._wrong_ns.append(now_ns)
        if len(self._wrong_ns) < TRIES or now_ns - self._wrong_ns[0] > WINDOW_NS:
            return None
        lock_ns = self._lock_ns
        self._wrong_ns.clear()
        self._until_ns, self._lock_ns = now_ns + lock_ns, min(2 * lock_ns, LONGEST_NS)
        return f"it was the {TRIES}th wrong one: none is taken for {lock_ns // 1_000_000_000} s"


_WHERE = "the host has printed it where it was started (coulombus set --key)"
