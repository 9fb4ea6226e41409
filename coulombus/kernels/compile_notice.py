"""Callbacks for the first compilation. Imports nothing, so that it can be registered early."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["compiling", "on_compiling"]

_waiting: list[Callable[[], None]] = []


def on_compiling(tell: Callable[[], None]) -> None:
    """Call `tell` once, when a kernel is compiled that is not in the cache."""
    _waiting.append(tell)


def compiling() -> None:
    """Run the registered callbacks: a kernel is being compiled."""
    while _waiting:
        _waiting.pop(0)()
