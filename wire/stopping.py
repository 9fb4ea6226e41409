"""SIGINT, SIGTERM and SIGHUP for what runs until it is told to end: remembered, and a descriptor that becomes readable."""

from __future__ import annotations

import os
import select
import signal
from types import FrameType
from typing import Any

__all__ = ["StopSignals"]

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopSignals:
    """Takes the signals while it is entered, also those that were ignored at the start, as in a shell's background job.

    Attributes
    ----------
    number
        The first signal that came; 0: none.
    """

    def __init__(self) -> None:
        self.number = 0
        self._before: dict[int, Any] = {}

    def __enter__(self) -> StopSignals:
        self._reading, self._writing = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._before = {number: signal.signal(number, self._handle) for number in SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        os.close(self._reading)
        os.close(self._writing)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.number == 0:
            self.number = number
            os.write(self._writing, b"x")

    def fileno(self) -> int:
        """Return the descriptor that is readable from the first signal on."""
        return self._reading

    def wait(self, seconds: float) -> bool:
        """Sleep for so long, or until a signal; tell whether one has come."""
        return bool(select.select([self._reading], [], [], max(0.0, seconds))[0])
