"""A call that fails: the n-th one of all that Python code makes into C, system calls with an
OSError, all others as if memory had run out.

What the interpreter calls in C is seen by a profile function (`sys.setprofile`); an exception that
it raises comes out of the call, which is then not made. So every system call and every allocation
that has a name can fail, once, in a run that is the same each time.
"""

from __future__ import annotations

import errno
import sys
from dataclasses import dataclass, field
from functools import cache

from places import ROOT

SYSTEM = {"posix", "_socket", "select", "time", "mmap", "_io", "io", "fcntl", "socket"}
"""Modules of C whose functions and objects call the system."""
NEVER = {"close", "__exit__", "unlink", "fileno"}
"""What does not fail: it gives back, and needs nothing."""


@dataclass
class Shim:
    """Counts the calls made between `with` and its end, and lets one fail.

    Attributes
    ----------
    fail_at : the number of the call that fails, from 1; 0: none
    sites : (file, line, function) -> the numbers of its calls
    failed : where the call failed
    """

    fail_at: int = 0
    calls: int = 0
    sites: dict[tuple[str, int, str], list[int]] = field(default_factory=dict)
    failed: tuple[str, int, str] | None = None

    def numbers(self, most):
        """Return the numbers of the first `most` calls of each place.

        Of more than one, the last one's, too.
        """
        chosen = set()
        for calls in self.sites.values():
            chosen.update(calls[:most], calls[-1:] if most > 1 else ())
        return sorted(chosen)

    def __enter__(self):
        sys.setprofile(self._profile)
        return self

    def __exit__(self, *_):
        sys.setprofile(None)

    def _profile(self, frame, event, function):
        if event != "c_call" or not _counts(frame.f_code.co_filename):
            return
        if function.__name__ in NEVER:
            return
        self.calls += 1
        site = (frame.f_code.co_filename, frame.f_lineno, getattr(function, "__qualname__", str(function)))
        self.sites.setdefault(site, []).append(self.calls)
        if self.calls == self.fail_at:
            self.failed = site
            sys.setprofile(None)  # the rest of the run is not counted, and runs at its own pace
            raise _error(function)


@cache
def _counts(filename):
    """The project's own code and the library's that it calls.

    Not the tests, not the import system, not what only cleans up after a file.
    """
    own = filename.startswith(str(ROOT)) and not filename.startswith((str(ROOT / "tests"), str(ROOT / ".venv")))
    return own or filename.endswith(("/socket.py", "/subprocess.py", "/pathlib.py"))


def _error(function):
    owner = getattr(function, "__module__", None) or type(getattr(function, "__self__", None)).__module__
    if owner in SYSTEM:
        return OSError(errno.EMFILE, "Too many open files")
    return MemoryError("no memory left")
