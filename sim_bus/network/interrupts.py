"""Signals that end a verb (`system.stop_signals`), held until a compiled kernel has returned.

At the entry of a kernel that takes a friction law, numba runs Python code
(`numba.experimental.function_type`) and does not look whether an exception came of it: with one
pending it goes on, and what follows is a wrong TypeError, or the end of the interpreter.
"""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any

from coulombus.system.stop_signals import SIGNALS

__all__ = ["InterruptsHeld"]


class InterruptsHeld:
    """While entered, a signal is only noted; `pass_on`, and the end, give it to who had it before.

    In other threads than the main one: nothing.
    """

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}
        self._noted: tuple[int, FrameType | None] | None = None

    def __enter__(self) -> InterruptsHeld:
        if threading.current_thread() is threading.main_thread():
            for number in (*SIGNALS, signal.SIGALRM):  # which brings back one that Python has lost
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
        """Give a signal that was noted to the handler of before; KeyboardInterrupt is
        Python's own.
        """
        if self._noted is not None:
            (number, frame), self._noted = self._noted, None
            self._before[number](number, frame)
