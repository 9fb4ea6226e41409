"""Keys of the terminal, read one by one while a verb runs."""

from __future__ import annotations

import os
import select
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any, Self

from coulombus.system.watch_thread import Lookout

try:
    import termios
    import tty
except ModuleNotFoundError:  # Windows: no terminal is read
    HAS_KEYS = False
else:
    HAS_KEYS = True

__all__ = ["Keys", "in_foreground"]

FROM_BEHIND = {getattr(signal, name) for name in ("SIGTTIN", "SIGTTOU") if hasattr(signal, name)}
"""Signals that would stop a background process as soon as it reads a key."""


def in_foreground() -> bool:
    """Tell whether the standard input is a terminal of which this process is in the foreground, and has keys."""
    if not HAS_KEYS:
        return False
    try:
        return sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):
        return False


class Keys:
    """Reads the terminal in a thread and calls ``struck(strokes)`` there; calls ``ended()`` when reading
    ends, also after an error.

    Keys struck earlier are discarded, or given to `earlier`.
    """

    def __init__(
        self,
        struck: Callable[[bytes], None],
        ended: Callable[[], None] = lambda: None,
        earlier: Callable[[bytes], None] | None = None,
    ) -> None:
        self._fd, self._call, self._earlier = sys.stdin.fileno(), struck, earlier
        self._lookout = Lookout("keys", self._watch, ended)
        self._mode: list[Any] = []

    def __enter__(self) -> Self:
        self._mode = termios.tcgetattr(self._fd)
        tty.setcbreak(self._fd, termios.TCSAFLUSH if self._earlier is None else termios.TCSADRAIN)
        if self._earlier is not None and select.select([self._fd], [], [], 0)[0]:
            self._earlier(os.read(self._fd, 4096))
        self._lookout.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lookout.end()
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, FROM_BEHIND)
        with suppress(termios.error):
            termios.tcsetattr(self._fd, termios.TCSAFLUSH, self._mode)  # discards pending key repeats
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)

    def _watch(self) -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, FROM_BEHIND)
        while self._lookout.ready([self._fd]) is not None:
            strokes = os.read(self._fd, 64)  # OSError or no bytes: the terminal is gone, or no longer ours
            if not strokes:
                return
            self._call(strokes)
