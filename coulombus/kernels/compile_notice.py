"""Callbacks for the first compilation. Imports nothing, so that it can be registered early."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["compiled", "compiling", "count", "on_compiling"]

_waiting: list[Callable[[], None]] = []
_compiled = [0]


def on_compiling(tell: Callable[[], None]) -> None:
    """Call `tell` once, when a kernel is compiled that is not in the cache."""
    _waiting.append(tell)


def compiling() -> None:
    """Run the registered callbacks: a kernel is being compiled."""
    while _waiting:
        _waiting.pop(0)()


def count() -> None:
    """Count a function that this process compiles."""
    _compiled[0] += 1


def compiled() -> int:
    """Return the number of functions that this process has compiled, those of numba with them."""
    return _compiled[0]
