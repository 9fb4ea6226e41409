"""A thread that waits for files until it is ended."""

from __future__ import annotations

import os
import select
import threading
from collections.abc import Callable
from contextlib import suppress

__all__ = ["Lookout"]


class Lookout:
    """Calls ``watch()`` in its own thread, and ``ended()`` when `watch` returns or raises.

    `watch` waits with `ready`, and returns when `ready` returns None.
    """

    def __init__(self, name: str, watch: Callable[[], None], ended: Callable[[], None]) -> None:
        self._watch, self._ended = watch, ended
        self._end, self._wake = os.pipe()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def end(self) -> None:
        """End the thread, and wait for its end."""
        os.close(self._wake)
        self._thread.join()
        os.close(self._end)

    def ready(self, sources: list[int], timeout_s: float | None = None) -> list[int] | None:
        """Wait until sources are readable; return them, or None if the thread is to end."""
        readable, _, _ = select.select([*sources, self._end], [], [], timeout_s)
        return None if self._end in readable else readable

    def _run(self) -> None:
        try:
            with suppress(OSError):
                self._watch()
        finally:
            self._ended()
