"""What the host answers to who asks for other parameters: ``coulombus set``, and the page.

Who asks sends a JSON object::

    {"values": {"F_s_Nm": 2.0}, "axis": "", "over_s": 0.5, "undo": false, "key": ""}

All keys may be left out; without `values` and `undo` nothing is changed. The answer has the
parameters of each axis, with bounds, and what was changed; or ``error``, the reason of a refusal,
and ``again`` where it may be asked again at once.

On a rig that is not simulated a hand may be on the handle. There a change needs the arm key, which
the host prints where it was started: who changes what the hand feels stands beside the rig, or has
it from who does. The tries are limited (`host.run.arm_key`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from typing import Any

from coulombus.host.cycle.parameter_changes import OVER_S, Change, ChangeRefused, LiveParameters, NotTaken
from coulombus.host.run.arm_key import ArmKey

__all__ = ["Changes"]

KEYS = ("values", "axis", "over_s", "undo", "key")


class Changes:
    """Answers who asks for other parameters.

    Parameters
    ----------
    parameters : of the run
    arm_key : that a change needs (`host.run.arm_key`); "": none
    apply : lets the step want a change, and marks it
    why_not : why nothing can be changed now; None where it can
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
        """Do what a JSON text asks for, and return the answer.

        Parameters
        ----------
        now_ns : of a clock that is never set
        """
        try:
            order = _order(text)
            change = self._change(order, now_ns) if order["values"] or order["undo"] else None
        except NotTaken as error:
            return {"error": str(error), "again": True}
        except ChangeRefused as error:
            return {"error": str(error)}
        fields = {} if change is None else change.as_dict()
        return {**fields, "parameters": self.rows(), "arm_key": bool(self.arm_key)}

    def _change(self, order: Mapping[str, Any], now_ns: int) -> Change:
        reason = self._why_not() or self._key.why_not(order["key"], now_ns)
        if reason is not None:
            raise ChangeRefused(reason)
        if order["undo"]:
            change = self.parameters.undo(order["over_s"])
        else:
            change = self.parameters.change(order["values"], order["axis"], order["over_s"])
        self._apply(change)
        return change


def _order(text: str) -> dict[str, Any]:
    """Return what is asked for, each key of its type.

    Raises
    ------
    ChangeRefused
        it is nothing of the kind
    """
    try:
        request = json.loads(text or "{}")
    except (ValueError, RecursionError):
        request = None
    if not isinstance(request, dict) or not request.keys() <= set(KEYS):
        raise ChangeRefused(f"expected a JSON object with keys of {', '.join(KEYS)}")
    order = {"values": {}, "axis": "", "over_s": OVER_S, "undo": False, "key": "", **request}
    values, right = order["values"], isinstance(order["values"], dict)
    right = right and all(_is_number(value) for value in values.values()) and _is_number(order["over_s"])
    right = right and isinstance(order["undo"], bool)
    if not right or not all(isinstance(order[name], str) for name in ("axis", "key")):
        raise ChangeRefused(
            'expected as in {"values": {"F_s_Nm": 2.0}, "axis": "", "over_s": 0.5, "undo": false, "key": ""}'
        )
    if values and order["undo"]:
        raise ChangeRefused("expected values, or undo, and not both")
    return order


def _is_number(value: object) -> bool:
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False
