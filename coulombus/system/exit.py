"""How a verb ends with its verdict: on stdout or stderr, and by an
exit status that a closed or full one does not hide.
"""

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
    """Let go of a stdout that takes nothing: the interpreter would
    try it again at its end, and exit with 120.
    """
    with suppress(OSError, ValueError):
        null = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(null, sys.stdout.fileno())
        finally:
            os.close(null)


@contextmanager
def verdict(status: int, gist: str = "") -> Iterator[None]:
    """End the verb with `status` behind what is printed inside, also
    when nobody reads it; `gist` as in `printed`.
    """
    with printed(status, gist):
        yield
    sys.exit(status)


@contextmanager
def printed(status: int = 0, gist: str = "") -> Iterator[None]:
    """Print what is printed inside; what follows is done, whoever reads it.

    A reader that has gone (`head`), or a terminal that was closed, hides no
    verdict `status`; nor does a full disk, but that makes an error of a 0.

    Parameters
    ----------
    gist : what is said on stderr of a result that cannot be printed
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
    """Say something on stderr, without control characters (`system.foreign_text`), in a terminal
    broken between words; one that is closed keeps nothing from its course.
    """
    with suppress(OSError):
        print(folded(printable(text), sys.stderr), file=sys.stderr, flush=True)


def show(text: str) -> None:
    """Print a result on stdout at once, without control characters."""
    print(printable(text), flush=True)
