"""Signals that end a verb (`system.stop_signals`), held until a compiled kernel has returned.

At the entry of a kernel that takes a friction law, numba runs Python code
(`numba.experimental.function_type`) without checking for an exception: with a pending exception it
continues, and a wrong TypeError or a crash of the interpreter follows.
"""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any

from coulombus.system.stop_signals import SIGNALS, TIMER

__all__ = ["InterruptsHeld"]


class InterruptsHeld:
    """While entered, a signal is only recorded; `pass_on`, and the end, pass it to its earlier handler.

    Does nothing outside the main thread.
    """

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}
        self._noted: tuple[int, FrameType | None] | None = None

    def __enter__(self) -> InterruptsHeld:
        if threading.current_thread() is threading.main_thread():
            for number in (*SIGNALS, *TIMER):
                before = signal.getsignal(number)
                if callable(before):
                    self._before[number] = before
                    signal.signal(number, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)
        self.pass_on()

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._noted = number, frame

    def pass_on(self) -> None:
        """Pass a recorded signal to its earlier handler; KeyboardInterrupt comes from Python's own."""
        if self._noted is not None:
            (number, frame), self._noted = self._noted, None
            self._before[number](number, frame)
