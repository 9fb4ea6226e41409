"""Who is told that something is compiled: asked for before anything is imported that takes long."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["compiling", "on_compiling"]

_waiting: list[Callable[[], None]] = []


def on_compiling(tell: Callable[[], None]) -> None:
    """Call `tell`, once, when a kernel is compiled that is not in the cache."""
    _waiting.append(tell)


def compiling() -> None:
    """A kernel is compiled now: tell those who wait for it."""
    while _waiting:
        _waiting.pop(0)()
