"""Signals that end a verb: their handlers and the exit statuses that they lead to.

SIGINT (Ctrl-C), SIGTERM, SIGHUP (the terminal was closed) and SIGQUIT (Ctrl-Backslash) all request
an orderly end. Every verb handles all four: by an exception (`as_exceptions`, around each verb), or
by its own handler while it drives something (`taken`, `StopSignals`, `Signals`).

A shell starts its background jobs with SIGINT and SIGQUIT ignored; a handler is installed all the
same. An ignored SIGHUP stays ignored, as nohup(1) requires.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType, TracebackType
from typing import Any, NoReturn, Self, TypeAlias

__all__ = [
    "SIGNALS",
    "TIMER",
    "InterruptsHeld",
    "Signals",
    "StopSignals",
    "Stopped",
    "as_exceptions",
    "at_once",
    "end_at_once",
    "end_line",
    "forget",
    "ignore",
    "raised",
    "status_of",
    "taken",
]

SIGNALS: tuple[int, ...] = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)
)  # Windows has the first two
TIMER: tuple[int, ...] = (signal.SIGALRM,) if hasattr(signal, "setitimer") else ()
"""Brings back a signal that Python has lost; Windows has none."""
AGAIN_S = 1.0
"""When a terminal is closed, both the shell and the kernel send SIGHUP: signals that follow
the first one within this time count as the same request.
"""

SOON_S = 1e-3

Handler: TypeAlias = Callable[[int, FrameType | None], None]


def status_of(number: int) -> int:
    """Return the exit status of a verb that a signal has ended, by the shell's convention: 130 SIGINT,
    143 SIGTERM, 129 SIGHUP, 131 SIGQUIT.
    """
    return 128 + number


class Stopped(KeyboardInterrupt):
    """A signal of `SIGNALS` ends the verb; `number` is the signal.

    As a KeyboardInterrupt it passes every ``except Exception`` on its way.

    Parameters
    ----------
    when : activity that was interrupted, as in "before the run had begun"
    """

    def __init__(self, number: int, when: str = "") -> None:
        super().__init__(f"{signal.Signals(number).name} {when}".rstrip())
        self.number = number


def ignore() -> None:
    """Ignore the stop signals, and SIGPIPE: this process ends with the process that it supervises."""
    for number in (*SIGNALS, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def taken(handler: Handler) -> Iterator[None]:
    """Route all stop signals to `handler`, also those ignored at the start; only SIGHUP under nohup(1)
    stays ignored.
    """
    before: dict[int, Any] = {}
    try:
        for number in SIGNALS:
            if signal.Signals(number).name != "SIGHUP" or signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, handler)
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, signal.SIG_DFL if previous is None else previous)


def end_line(number: int, when: str = "") -> str:
    """Return the line that reports a verb's end by a signal."""
    return "interrupted" if number == signal.SIGINT and not when else f"ended by {Stopped(number, when)}"


def end_at_once(number: int, when: str = "") -> NoReturn:
    """End the process with a signal's status and one line: for a handler, while there is nothing to
    clean up.
    """
    with suppress(OSError):
        os.write(2, f"coulombus: {end_line(number, when)}\n".encode())
    os._exit(status_of(number))


def at_once() -> None:
    """Let each stop signal end the process at once until another handler is installed: an exception
    during an import may be lost or replaced.
    """
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _at_once)


def _at_once(number: int, frame: FrameType | None) -> NoReturn:
    end_at_once(number)


_raised = 0


def raised() -> int:
    """Return the last signal raised in this verb; 0: none, or `forget` was called.

    A later exception may be its consequence: an import that it interrupts in C code, or a module that
    it leaves half initialised, can fail in any way.
    """
    return _raised


def forget() -> None:
    """Clear the signal that was raised: it was not meant to end the verb."""
    global _raised
    _raised = 0


def _noted(number: int, when: str = "") -> KeyboardInterrupt:
    """Record a signal and return its exception."""
    global _raised
    _raised = number
    return KeyboardInterrupt() if number == signal.SIGINT and not when else Stopped(number, when)


@contextmanager
def as_exceptions() -> Iterator[None]:
    """Let SIGTERM, SIGHUP and SIGQUIT raise `Stopped`, and SIGINT KeyboardInterrupt; does nothing
    outside the main thread.

    Where Python cannot raise the exception, as in the callback of a weak reference, it is raised soon
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
        if unraisable.exc_value is last and TIMER:
            signal.setitimer(signal.ITIMER_REAL, SOON_S)
        else:
            hook(unraisable)

    before: dict[int, Any] = {}
    hook, sys.unraisablehook = sys.unraisablehook, lost
    try:
        for number in SIGNALS:
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler, _at_once):
                before[number] = signal.signal(number, stop)
        for number in TIMER:
            before[number] = signal.signal(number, again)
        yield
    finally:
        if TIMER:
            signal.setitimer(signal.ITIMER_REAL, 0)
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


class _First:
    """Handles the stop signals while it is entered, and remembers the first.

    Attributes
    ----------
    number
        First signal that came; 0: none.
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
    """Stop signals of a run: before `defer` a signal raises `Stopped` in the code that runs; afterwards
    it is only recorded.
    """

    def __init__(self) -> None:
        super().__init__()
        self._deferred = False

    def _came(self) -> None:
        if not self._deferred:
            self.stop()

    def stop(self) -> None:
        """Raise `Stopped` if a signal has come."""
        if self.number:
            raise _noted(self.number, "before the run had begun")

    def defer(self) -> None:
        """Stop raising: from now on the run itself checks `number`, and ends safely."""
        self._deferred = True


class StopSignals(_First):
    """Records the signals while it is entered, and has a descriptor that becomes readable."""

    def __enter__(self) -> Self:
        self._reading, self._writing = socket.socketpair()  # Windows can select no pipe
        self._reading.setblocking(False)
        self._writing.setblocking(False)
        return super().__enter__()

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        self._reading.close()
        self._writing.close()

    def _came(self) -> None:
        self._writing.send(b"x")

    def fileno(self) -> int:
        """Return the descriptor that is readable from the first signal on."""
        return self._reading.fileno()

    def wait(self, seconds: float) -> bool:
        """Sleep for `seconds`, or until a signal; tell whether a signal has come."""
        return bool(select.select([self._reading], [], [], max(0.0, seconds))[0])


class InterruptsHeld:
    """While entered, a signal is only recorded; `pass_on`, and the end, pass it to its earlier handler.

    For a compiled kernel that takes a friction law: at its entry numba runs Python code
    (`numba.experimental.function_type`) without checking for an exception. With a pending exception it
    continues, and a wrong TypeError or a crash of the interpreter follows. Does nothing outside the main
    thread.
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
