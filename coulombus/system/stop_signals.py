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
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, NoReturn, Self, TypeAlias

__all__ = [
    "SIGNALS",
    "Signals",
    "StopSignals",
    "Stopped",
    "as_exceptions",
    "at_once",
    "end_at_once",
    "forget",
    "ignore",
    "raised",
    "status_of",
    "taken",
    "told",
]

SIGNALS: tuple[int, ...] = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
AGAIN_S = 1.0
"""A terminal that is closed sends SIGHUP by the shell and by the
kernel: what comes so soon after the first one is the same wish.
"""

SOON_S = 1e-3

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


def told(number: int, when: str = "") -> str:
    """Return how a verb tells that a signal has ended it."""
    return "interrupted" if number == signal.SIGINT and not when else f"ended by {Stopped(number, when)}"


def end_at_once(number: int, when: str = "") -> NoReturn:
    """End the process by a signal's status and one line, whatever it does: for a handler, while
    there is nothing yet to clean up.
    """
    with suppress(OSError):
        os.write(2, f"coulombus: {told(number, when)}\n".encode())
    os._exit(status_of(number))


def at_once() -> None:
    """Let each stop signal end the process at once, as long as nobody else takes it: an exception
    in the midst of an import may be lost, or become another one.
    """
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _at_once)


def _at_once(number: int, frame: FrameType | None) -> NoReturn:
    end_at_once(number)


_raised = 0


def raised() -> int:
    """Return the signal that was raised last in this verb; 0: none, or nobody asks any more
    (`forget`).

    An exception that comes behind it may be what became of it: an import that it interrupts in C,
    or a module that it left half made, fails in any way.
    """
    return _raised


def forget() -> None:
    """Go on behind a signal: it was meant for something else than the verb."""
    global _raised
    _raised = 0


def _noted(number: int, when: str = "") -> KeyboardInterrupt:
    """Return the exception of a signal that is raised now."""
    global _raised
    _raised = number
    return KeyboardInterrupt() if number == signal.SIGINT and not when else Stopped(number, when)


@contextmanager
def as_exceptions() -> Iterator[None]:
    """Let SIGTERM, SIGHUP and SIGQUIT raise `Stopped`, and SIGINT KeyboardInterrupt; in other
    threads than the main one: nothing.

    Where Python cannot raise it, as in the call-back of a weak reference, it is raised soon
    afterwards.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    forget()
    last_s, last = -AGAIN_S, KeyboardInterrupt()

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal last_s, last
        now = time.monotonic()
        if number != signal.SIGINT:
            if now - last_s < AGAIN_S:
                return
            last_s = now
        last = _noted(number)
        raise last

    def again(number: int, frame: FrameType | None) -> None:
        nonlocal last
        if _raised:
            last = _noted(_raised)
            raise last

    def lost(unraisable: Any) -> None:
        if unraisable.exc_value is last:
            signal.setitimer(signal.ITIMER_REAL, SOON_S)
        else:
            hook(unraisable)

    before: dict[int, Any] = {}
    hook, sys.unraisablehook = sys.unraisablehook, lost
    try:
        for number in SIGNALS:
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler, _at_once):
                before[number] = signal.signal(number, stop)
        before[signal.SIGALRM] = signal.signal(signal.SIGALRM, again)
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


class _First:
    """Takes the stop signals while it is entered, and remembers the first.

    Attributes
    ----------
    number
        The first signal that came; 0: none.
    """

    def __init__(self) -> None:
        self.number = 0
        self._handling = taken(self._handle)

    def __enter__(self) -> Self:
        self._handling.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._handling.__exit__(None, None, None)

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
            raise _noted(self.number, "before the run had begun")

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
