"""The signals that end a verb, in one place: their handlers, and the exit status that they lead to.

SIGINT (Ctrl-C), SIGTERM, SIGHUP (the terminal was closed) and SIGQUIT (Ctrl-Backslash) ask for the
same thing, an orderly end. Every verb takes all four: by an exception (`as_exceptions`, around each
verb), or by a handler of its own while it drives something (`taken`, `StopSignals`, `Signals`).

A shell starts its background jobs with SIGINT and SIGQUIT ignored; a handler
takes them all the same. SIGHUP that is ignored stays so, as nohup(1) wants it.
"""

from __future__ import annotations

import os
import select
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Self, TypeAlias

__all__ = ["SIGNALS", "Signals", "StopSignals", "Stopped", "as_exceptions", "ignore", "status_of", "taken"]

SIGNALS: tuple[int, ...] = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
AGAIN_S = 1.0
"""A terminal that is closed sends SIGHUP by the shell and by the
kernel: what comes so soon after the first one is the same wish.
"""

Handler: TypeAlias = Callable[[int, FrameType | None], None]


def status_of(number: int) -> int:
    """Return the exit status of a verb that a signal has ended, as a
    shell counts it: 130 SIGINT, 143 SIGTERM, 129 SIGHUP, 131 SIGQUIT.
    """
    return 128 + number


class Stopped(KeyboardInterrupt):
    """A signal of `SIGNALS` ends the verb; `number` tells which. As
    KeyboardInterrupt it passes every ``except Exception`` on its way.

    Parameters
    ----------
    when : what was going on, as in "before the run had begun"
    """

    def __init__(self, number: int, when: str = "") -> None:
        super().__init__(f"{signal.Signals(number).name} {when}".rstrip())
        self.number = number


def ignore() -> None:
    """Let no signal of a person end this process, nor a reader that has gone: it ends with the
    process that it looks after.
    """
    for number in (*SIGNALS, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def taken(handler: Handler) -> Iterator[None]:
    """Let `handler` take all stop signals, also those that were
    ignored at the start; only SIGHUP under nohup(1) stays ignored.
    """
    before: dict[int, Any] = {}
    try:
        for number in SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, handler)
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, signal.SIG_DFL if previous is None else previous)


@contextmanager
def as_exceptions() -> Iterator[None]:
    """Let SIGTERM, SIGHUP and SIGQUIT raise `Stopped`, as SIGINT raises
    KeyboardInterrupt; in other threads than the main one: nothing.
    """
    last_s = -AGAIN_S

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal last_s
        now = time.monotonic()
        if now - last_s < AGAIN_S:
            return
        last_s = now
        raise Stopped(number)

    wanted: list[int] = []
    try:
        if threading.current_thread() is threading.main_thread():
            for number in SIGNALS[1:]:
                if signal.getsignal(number) is signal.SIG_DFL:
                    wanted.append(number)
                    signal.signal(number, stop)
        yield
    finally:
        for number in wanted:
            signal.signal(number, signal.SIG_DFL)


class _First:
    """Takes the stop signals while it is entered, and remembers the first.

    Attributes
    ----------
    number
        The first signal that came; 0: none.
    """

    def __init__(self) -> None:
        self.number = 0
        self._taken = taken(self._handle)

    def __enter__(self) -> Self:
        self._taken.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._taken.__exit__(None, None, None)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.number == 0:
            self.number = number
            self._came()

    def _came(self) -> None:
        raise NotImplementedError


class Signals(_First):
    """The stop signals of a run: until `defer` one ends what is being
    done by `Stopped`; from then on they are only remembered.
    """

    def __init__(self) -> None:
        super().__init__()
        self._deferred = False

    def _came(self) -> None:
        if not self._deferred:
            self.stop()

    def stop(self) -> None:
        """Raise `Stopped` for the signal that has come, if one has."""
        if self.number:
            raise Stopped(self.number, "before the run had begun")

    def defer(self) -> None:
        """Let the course of the run look at `number` from now on, and end safely."""
        self._deferred = True


class StopSignals(_First):
    """Remembers the signals while it is entered, and has a descriptor that becomes readable."""

    def __enter__(self) -> Self:
        self._reading, self._writing = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        return super().__enter__()

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        os.close(self._reading)
        os.close(self._writing)

    def _came(self) -> None:
        os.write(self._writing, b"x")

    def fileno(self) -> int:
        """Return the descriptor that is readable from the first signal on."""
        return self._reading

    def wait(self, seconds: float) -> bool:
        """Sleep for so long, or until a signal; tell whether one has come."""
        return bool(select.select([self._reading], [], [], max(0.0, seconds))[0])
