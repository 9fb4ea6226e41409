"""Conditions of a rate: comparisons of a run's figures, as in ``hold_counts_p2p <= 2 and trip == none``.

The text is parsed, never evaluated by Python. It may contain figures by name, numbers, quoted
strings, ``none``, ``true``, ``false``, ``+ - * /``, ``< <= > >= == !=`` (also chained: ``0 < a <=
2``), ``and``, ``or``, ``not`` and parentheses. A figure that a run lacks is ``none``: values
computed from it are unknown, and so are order comparisons with it; ``== none`` tests for it. An
unknown condition does not hold.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from coulombus.rigs.errors import nearest
from coulombus.system.errors import CoulombusError

__all__ = ["ConditionError", "RunCondition"]

LONGEST, DEEPEST, LARGEST = 500, 40, 1e300
_ORDERS: Mapping[type, Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
_EQUAL: Mapping[type, bool] = {ast.Eq: True, ast.NotEq: False}
_SUMS: Mapping[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_WORDS: Mapping[str, Any] = {"none": None, "null": None, "true": True, "false": False}


class ConditionError(CoulombusError, ValueError):
    """The text is not a condition; the message has the problem and the expectation."""

    exit_status = 3


@dataclass(frozen=True)
class RunCondition:
    """A checked condition."""

    text: str

    @classmethod
    def from_text(cls, text: str, figures: Mapping[str, type]) -> RunCondition:
        """Return the condition `text` over `figures`.

        Raises
        ------
        ConditionError
            it is not a condition, names an unknown figure, or compares a string with a number
        """
        tree = _tree(text)
        kind = _Kinds(figures).kind_of(tree)
        if kind is not bool:
            raise ConditionError("it is not a comparison; expected, for example, hold_counts_p2p <= 2")
        return cls(text)

    @property
    def figures(self) -> tuple[str, ...]:
        """The figures used."""
        return tuple(dict.fromkeys(_names(_tree(self.text))))

    def holds(self, figures: Mapping[str, Any]) -> bool:
        """Return whether the figures of a run satisfy it; False if unknown."""
        return _value(_tree(self.text), figures) is True


def _tree(text: str) -> ast.expr:
    if len(text) > LONGEST:
        raise ConditionError(f"{len(text)} characters; expected at most {LONGEST}")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        reason = getattr(error, "msg", None) or error
        raise ConditionError(f"it cannot be read ({reason}); expected one such as hold_counts_p2p <= 2") from None
    if _depth(tree) > DEEPEST:
        raise ConditionError(f"more than {DEEPEST} parts within each other")
    return tree


def _depth(tree: ast.AST) -> int:
    deepest, pending = 0, [(tree, 1)]
    while pending:
        node, depth = pending.pop()
        deepest = max(deepest, depth)
        pending += [(child, depth + 1) for child in ast.iter_child_nodes(node)]
    return deepest


def _dotted(node: ast.expr) -> str | None:
    """Return the name ``a.b.c``, or None."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        owner = _dotted(node.value)
        return None if owner is None else f"{owner}.{node.attr}"
    return None


def _names(node: ast.AST) -> Iterator[str]:
    name = _dotted(node) if isinstance(node, ast.expr) else None
    if name is not None:
        if name not in _WORDS:
            yield name
        return
    for child in ast.iter_child_nodes(node):
        yield from _names(child)


class _Kinds:
    """Type checker of the parts: float, str, bool, or NoneType; an error raises."""

    def __init__(self, figures: Mapping[str, type]) -> None:
        self._known = figures

    def kind_of(self, node: ast.expr) -> type:
        name = _dotted(node)
        if name is not None:
            return self._named(name)
        if isinstance(node, ast.Constant):
            return self._constant(node.value)
        if isinstance(node, ast.BoolOp):
            for part in node.values:
                self._expect(part, bool, "a comparison")
            return bool
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            self._expect(node.operand, bool, "a comparison")
            return bool
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
            self._expect(node.operand, float, "a number")
            return float
        if isinstance(node, ast.BinOp) and type(node.op) in _SUMS:
            self._expect(node.left, float, "a number")
            self._expect(node.right, float, "a number")
            return float
        if isinstance(node, ast.Compare):
            return self._compared(node)
        allowed = "figures, numbers, texts, + - * /, comparisons, and, or, not"
        raise ConditionError(f"'{ast.unparse(node)}' is not allowed; expected {allowed}")

    def _named(self, name: str) -> type:
        if name in _WORDS:
            return type(_WORDS[name])
        if name not in self._known:
            hint = nearest(name, self._known)
            hint = hint or _beginning(name, self._known)
            text = "" if hint else f"; expected one of {', '.join(self._known)}"
            raise ConditionError(f"no figure '{name}'{hint}{text}")
        return str if self._known[name] is str else float

    def _constant(self, value: Any) -> type:
        if value is None or isinstance(value, bool | str):
            return type(value)
        if isinstance(value, int | float) and abs(value) <= LARGEST:
            return float
        raise ConditionError(f"'{value}' is not allowed; expected a finite number or a text in quotes")

    def _expect(self, node: ast.expr, kind: type, what: str) -> None:
        if self.kind_of(node) is not kind:
            raise ConditionError(f"'{ast.unparse(node)}' is not {what}")

    def _compared(self, node: ast.Compare) -> type:
        parts = [node.left, *node.comparators]
        kinds = [self.kind_of(part) for part in parts]
        for op, left, right, a, b in zip(node.ops, parts, parts[1:], kinds, kinds[1:], strict=False):
            if type(op) in _ORDERS:
                self._expect(left, float, "a number")
                self._expect(right, float, "a number")
            elif type(op) not in _EQUAL:
                raise ConditionError(f"'{ast.unparse(node)}' is not allowed; expected < <= > >= == !=")
            elif a is not b and type(None) not in (a, b):
                raise ConditionError(f"'{ast.unparse(node)}' compares a text with a number, or with true and false")
        return bool


def _beginning(name: str, figures: Mapping[str, type]) -> str:
    """Return a hint at a figure with the same beginning as `name`."""
    suggestion = next((candidate for candidate in figures if len(name) > 2 and candidate.startswith(name)), None)
    return f"; did you mean '{suggestion}'?" if suggestion else ""


def _value(node: ast.expr, figures: Mapping[str, Any]) -> Any:
    """Return the value of a checked part; None: unknown."""
    name = _dotted(node)
    if name is not None:
        return _WORDS[name] if name in _WORDS else figures.get(name)
    if isinstance(node, ast.Constant):
        return node.value
    if isinstance(node, ast.BoolOp):
        return _both(node, figures)
    if isinstance(node, ast.UnaryOp):
        value = _value(node.operand, figures)
        if value is None:
            return None
        return not value if isinstance(node.op, ast.Not) else -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.BinOp):
        left, right = _value(node.left, figures), _value(node.right, figures)
        if left is None or right is None or (right == 0 and isinstance(node.op, ast.Div)):
            return None
        return _SUMS[type(node.op)](float(left), float(right))
    assert isinstance(node, ast.Compare)
    return _compared(node, figures)


def _both(node: ast.BoolOp, figures: Mapping[str, Any]) -> bool | None:
    """Return the value of ``and`` or ``or`` with unknown parts: the others may decide it."""
    values = [_value(part, figures) for part in node.values]
    deciding = isinstance(node.op, ast.Or)
    if deciding in values:
        return deciding
    return None if None in values else not deciding


def _compared(node: ast.Compare, figures: Mapping[str, Any]) -> bool | None:
    values = [_value(part, figures) for part in (node.left, *node.comparators)]
    truths: list[bool | None] = []
    for op, left, right in zip(node.ops, values, values[1:], strict=False):
        if type(op) in _EQUAL:
            truths.append((left == right) is _EQUAL[type(op)])
        elif left is None or right is None:
            truths.append(None)
        else:
            truths.append(_ORDERS[type(op)](left, right))
    return False if False in truths else None if None in truths else True
