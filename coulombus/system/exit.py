"""Output and exit status of a verb: a closed or full stdout or stderr does not hide the status."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from coulombus.system.foreign_text import printable
from coulombus.system.wrap_text import folded

__all__ = ["abandon_stdout", "printed", "say", "show", "verdict"]


def abandon_stdout() -> None:
    """Redirect stdout to /dev/null, else the interpreter's final flush exits with 120."""
    with suppress(OSError, ValueError):
        null = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(null, sys.stdout.fileno())
        finally:
            os.close(null)


@contextmanager
def verdict(status: int, gist: str = "") -> Iterator[None]:
    """End the verb with `status` after the output printed inside, even if nobody reads it; `gist` as in `printed`."""
    with printed(status, gist):
        yield
    sys.exit(status)


@contextmanager
def printed(status: int = 0, gist: str = "") -> Iterator[None]:
    """Print the output of the block; continue even if its reader has gone.

    The exit status `status` stays the same if the reader has gone (`head`), the terminal was closed
    or the disk is full; but a full disk makes an error of a 0.

    Parameters
    ----------
    gist : text for stderr if the result cannot be printed
    """
    try:
        yield
        sys.stdout.flush()
    except OSError as error:
        abandon_stdout()
        if status == 0 and error.errno not in (errno.EPIPE, errno.EIO):
            raise
        if not isinstance(error, BrokenPipeError):
            say(f"coulombus: the result cannot be printed: {error.strerror}")
            if gist:
                say(f"coulombus: {gist}")


def say(text: str) -> None:
    """Print a text on stderr, without control characters (`system.foreign_text`); in a terminal,
    wrapped between words. A closed stderr is ignored.
    """
    with suppress(OSError):
        print(folded(printable(text), sys.stderr), file=sys.stderr, flush=True)


def show(text: str) -> None:
    """Print a result on stdout at once, without control characters."""
    print(printable(text), flush=True)
