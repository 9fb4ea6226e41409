"""The host's answers to requests for a change of parameters, by ``coulombus set`` and the page.

The client sends a JSON object::

    {"values": {"F_s_Nm": 2.0}, "axis": "", "over_s": 0.5, "undo": false, "key": ""}

All keys are optional; without `values` and `undo` nothing is changed. The answer has the parameters of
each axis with their bounds, and the change; or ``error``, the reason of a refusal, and ``again`` if the
request may be repeated at once.

On a real rig a hand may be on the handle. There a change needs the arm key, which the host prints on the
terminal where it was started. So a change comes from a person at the rig, or from a person to whom that
person gave the key.

The key has six digits, so attempts are limited. After `TRIES` wrong keys within `WINDOW_NS` every key is
refused for `LOCK_NS`, even the right one. Each repetition doubles this time. The attempts of all clients
count together.
"""

from __future__ import annotations

import hmac
import json
import math
import secrets
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from coulombus.host.cycle.parameter_changes import OVER_S, Change, ChangeRefused, LiveParameters, NotTaken
from coulombus.wire.address import BusAddress

__all__ = ["LOCK_NS", "LONGEST_NS", "TRIES", "WINDOW_NS", "ArmKey", "Changes", "new_arm_key"]

KEYS = ("values", "axis", "over_s", "undo", "key")
TRIES = 5
WINDOW_NS = 600_000_000_000
LOCK_NS = 60_000_000_000
LONGEST_NS = 3600_000_000_000
_WHERE = "the host has printed it where it was started (coulombus set --key)"


class Changes:
    """Answers requests for a change of parameters.

    Parameters
    ----------
    parameters : live parameters of the run
    arm_key : key that a change needs (`host.run.changes`); "": none
    apply : publishes a change to the step, and sets its marker
    why_not : returns the reason why no change is possible now, or None
    """

    def __init__(
        self,
        parameters: LiveParameters,
        arm_key: str,
        apply: Callable[[Change], None],
        why_not: Callable[[], str | None],
    ) -> None:
        self.parameters, self.arm_key, self._key = parameters, arm_key, ArmKey(arm_key)
        self._apply, self._why_not = apply, why_not

    def rows(self) -> list[list[dict[str, Any]]]:
        """Return the parameters of each axis as plain values."""
        return self.parameters.rows()

    def answer(self, text: str, now_ns: int) -> dict[str, Any]:
        """Execute the request in a JSON text, and return the answer.

        Parameters
        ----------
        now_ns : time of a monotonic clock
        """
        try:
            request = _parsed(text)
            change = self._change(request, now_ns) if request["values"] or request["undo"] else None
        except NotTaken as error:
            return {"error": str(error), "again": True}
        except ChangeRefused as error:
            return {"error": str(error)}
        fields = {} if change is None else change.as_dict()
        return {**fields, "parameters": self.rows(), "arm_key": bool(self.arm_key)}

    def key_why_not(self, key: str, now_ns: int) -> str | None:
        """Return the reason why the arm key is refused; None if it is right, or none is needed."""
        return self._key.why_not(key, now_ns)

    def _change(self, request: Mapping[str, Any], now_ns: int) -> Change:
        reason = self._why_not() or self._key.why_not(request["key"], now_ns)
        if reason is not None:
            raise ChangeRefused(reason)
        if request["undo"]:
            change = self.parameters.undo(request["over_s"])
        else:
            change = self.parameters.change(request["values"], request["axis"], request["over_s"])
        self._apply(change)
        return change


def _parsed(text: str) -> dict[str, Any]:
    """Return the parsed request, with defaults, after a check of the types.

    Raises
    ------
    ChangeRefused
        the text is not a valid request
    """
    try:
        request = json.loads(text or "{}")
    except (ValueError, RecursionError):
        request = None
    if not isinstance(request, dict) or not request.keys() <= set(KEYS):
        raise ChangeRefused(f"expected a JSON object with keys of {', '.join(KEYS)}")
    full_request = {"values": {}, "axis": "", "over_s": OVER_S, "undo": False, "key": "", **request}
    values, right = full_request["values"], isinstance(full_request["values"], dict)
    right = right and all(_is_number(value) for value in values.values()) and _is_number(full_request["over_s"])
    right = right and isinstance(full_request["undo"], bool)
    if not right or not all(isinstance(full_request[name], str) for name in ("axis", "key")):
        raise ChangeRefused(
            'expected as in {"values": {"F_s_Nm": 2.0}, "axis": "", "over_s": 0.5, "undo": false, "key": ""}'
        )
    if values and full_request["undo"]:
        raise ChangeRefused("expected values, or undo, and not both")
    return full_request


def _is_number(value: object) -> bool:
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


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
