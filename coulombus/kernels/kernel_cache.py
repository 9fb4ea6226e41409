"""Cache directories of the kernels' machine code, one per state of the sources, and their removal.

::

    BASE/coulombus/kernels-0123456789abcdef/coulombus-kernels      the marker, locked as long as a process uses it
    BASE/coulombus/kernels-0123456789abcdef/entries                fully compiled entries; locked during a compilation
    BASE/coulombus/kernels-0123456789abcdef/host_1a2b.../*.nbi     numba's cache files

BASE is ``NUMBA_CACHE_DIR``, else ``$XDG_CACHE_HOME``, else ``~/.cache``. The cached code is
executed: a directory that another user may enter is refused, and so is a parent directory in which
another user could exchange it; then the next place is used (`coulombus.system.private_folder`).
Only directories of this module are removed: the name has its form, the marker in it states the same
name, and no process uses it. Of its content only the marker and files with numba's suffixes are
removed. No link is followed.
"""

from __future__ import annotations

import atexit
import os
import re
import shutil
import stat
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from coulombus.kernels.compile_notice import compiling
from coulombus.system.file_lock import lock_file
from coulombus.system.private_folder import make_private, reason_against, reason_against_above

__all__ = [
    "LONGEST_S",
    "MARKER",
    "SCOPES",
    "alone",
    "choose",
    "damaged",
    "empty",
    "is_cached",
    "leave_lock_to_parent",
    "say",
]

SCOPES = ("run", "simulate", "arm")
"""What the kernels are for; each contains those before it: a host and a bus in real time, the loop in virtual time,
an arm in the plane.
"""

OURS = "coulombus"
MARKER = "coulombus-kernels"
ENTRIES = "entries"
LONGEST_S, MOST_BYTES = 7 * 86400, 2 << 30
"""Directories that were used in this time are kept, the newest of them up to this size together; a directory in use is
never removed.
"""

_NAME = re.compile(r"kernels-[0-9a-f]{16}")
_FILES = re.compile(rf".+\.(nbi|nbc)(\.tmp\.[0-9a-f]+)?|{ENTRIES}")
_TRIES = 8
_locks: list[int] = []  # descriptors of the markers that this process has locked
_parent_locks = [False]  # whether the parent holds the lock of the compilation


def say(text: str) -> None:
    """Print a line on stderr, if there is one."""
    with suppress(OSError, ValueError, AttributeError):
        sys.stderr.write(f"coulombus: {text}\n")
        sys.stderr.flush()


def choose(key: str) -> Path | None:
    """Return the directory for the sources whose hash is `key`, created and marked as used; None if no
    place is writable.

    The variable ``NUMBA_CACHE_DIR`` is set to it, so that a child process uses the same directory.
    """
    name = f"kernels-{key}"
    inherited = _inherited(name)
    directory = inherited or _first(_places(), name)
    if directory is None:
        say("no writable cache, so every start compiles: no directory can be written; name one by NUMBA_CACHE_DIR")
        os.environ.pop("NUMBA_CACHE_DIR", None)
        return None
    os.environ["NUMBA_CACHE_DIR"] = str(directory)
    if inherited is None:
        _tidy(directory)
    return directory


def is_cached(directory: Path | None, name: str) -> bool:
    """Tell whether a process has compiled, or loaded, the entry `name`."""
    with suppress(OSError):
        return directory is not None and name in (directory / ENTRIES).read_text().split()
    return False


@contextmanager
def alone(directory: Path | None, name: str) -> Iterator[None]:
    """Compile, or load, the entry `name` in this context: until it is cached, one process compiles at a
    time, and the others wait for its result.

    So no two processes cache the same kernel for different types of arguments at the same time:
    numba would give both files the same name.

    A process of `leave_lock_to_parent` does not wait.
    """
    if directory is None or is_cached(directory, name):
        yield
        return
    lock = None
    with suppress(OSError):  # no space left, or a file system without locks
        flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        lock = os.open(directory / ENTRIES, flags, 0o600)
        if not _parent_locks[0]:
            try:
                lock_file(lock)
            except BlockingIOError:
                compiling()  # another process compiles
                lock_file(lock, wait=True)
    try:
        yield
        if lock is not None:
            with suppress(OSError):
                os.write(lock, f"{name}\n".encode())
    finally:
        if lock is not None:
            os.close(lock)


def leave_lock_to_parent() -> None:
    """Compile without a lock from now on: the parent holds it, and its other children compile other kernels."""
    _parent_locks[0] = True


def _base() -> Path:
    named = os.environ.get("NUMBA_CACHE_DIR")
    if named:
        path = Path(named).absolute()
        ours = _NAME.fullmatch(path.name) and path.parent.name == OURS
        return path.parent.parent if ours else path  # the choice of a parent with other sources
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")).absolute()


def _inherited(name: str) -> Path | None:
    """Return the directory that a parent with the same sources chose."""
    named = Path(os.environ.get("NUMBA_CACHE_DIR") or "/")
    if named.name != name or named.parent.name != OURS or not _usable(named):
        return None
    return named


def _places() -> Iterator[Path]:
    """Yield the possible parent directories of the cache, the preferred one first."""
    base = _base()
    yield base / OURS
    try:
        mine = Path(tempfile.gettempdir()) / f"coulombus-{os.getuid()}"
    except OSError:  # there is no place for temporary files
        return
    with suppress(OSError):  # no folder can be created
        make_private(mine)
        why = reason_against(mine)  # in a world-writable folder anybody can create it, or place a link
        if why:
            say(f"refused for compiled code: {why}")
        else:
            yield mine / OURS
    with suppress(OSError):  # another file has this name
        lost = Path(tempfile.mkdtemp(prefix="coulombus-"))
        _remove_at_exit(lost)
        say(f"compiled code cannot be kept in {base}, so every start compiles; name a directory by NUMBA_CACHE_DIR")
        yield lost / OURS


def _is_own_directory(path: Path) -> bool:
    """Tell whether `path` is a directory of this user, and no link."""
    with suppress(OSError):
        status = path.lstat()
        return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()
    return False


def _reason_against(directory: Path) -> str:
    """Return why the content of `directory` may come from another user; "" if it cannot."""
    ours, base = directory.parent, directory.parent.parent
    return reason_against(directory) or reason_against_above(ours) or reason_against_above(base)


def _first(places: Iterator[Path], name: str) -> Path | None:
    return next((place / name for place in places if _usable(place / name)), None)


def _remove_at_exit(path: Path) -> None:
    made_by = os.getpid()

    def remove() -> None:
        if os.getpid() == made_by:
            shutil.rmtree(path, ignore_errors=True)

    atexit.register(remove)


def _usable(directory: Path) -> bool:
    """Create the directory and its marker, and lock the marker.

    Tell whether all that, and writing, works.
    """
    for _ in range(_TRIES):  # another process may remove it between two of these calls
        try:
            make_private(directory)
            why = _reason_against(directory)
            if why:
                say(f"refused for compiled code: {why}")
                return False
            lock = _marker(directory, create=True)
            if lock is None:
                return False
            with suppress(OSError):  # a file system without locks: nothing is ever removed there
                lock_file(lock, shared=True, wait=True)
            if not _stands(directory, lock):
                os.close(lock)
                continue
            with tempfile.NamedTemporaryFile(dir=directory, suffix=".nbi"):
                pass
            os.utime(lock)
        except OSError:
            return False
        _locks.append(lock)
        return True
    return False


def _marker(directory: Path, *, create: bool = False) -> int | None:
    """Open the marker; None if the directory is not from this module.

    The marker states the directory's name, so that a copied directory is not accepted.
    """
    flags = os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK | (os.O_CREAT if create else 0)
    name = f"{directory.name}\n".encode()
    lock = os.open(directory / MARKER, flags, 0o600)
    status = os.fstat(lock)
    if stat.S_ISREG(status.st_mode) and status.st_uid == os.getuid():
        if create and status.st_size == 0:
            os.pwrite(lock, name, 0)
        if os.pread(lock, len(name) + 1, 0) == name:
            return lock
    os.close(lock)
    return None


def _stands(directory: Path, lock: int) -> bool:
    """Tell whether the open marker still belongs to the directory."""
    with suppress(OSError):
        return os.path.samestat(os.fstat(lock), os.lstat(directory / MARKER))
    return False


def _tidy(directory: Path) -> None:
    """Remove the directories of this module next to `directory` that are beyond `LONGEST_S` or `MOST_BYTES`."""
    with suppress(OSError):
        if directory.parent.is_symlink():
            return
        oldest_ns = time.time_ns() - LONGEST_S * 1_000_000_000
        size = _bytes(directory)
        for other in _others(directory):
            size += _bytes(other)
            if _used_ns(other) < oldest_ns or size > MOST_BYTES:
                with suppress(OSError):
                    _remove(other)


def _bytes(directory: Path) -> int:
    """Return the bytes of the files in a directory."""
    return sum(
        os.stat(name, dir_fd=at, follow_symlinks=False).st_size
        for _, _, files, at in os.fwalk(directory, follow_symlinks=False)
        for name in files
    )


def _others(directory: Path) -> list[Path]:
    """Return this user's directories of other source states, the last used first."""
    if not (_NAME.fullmatch(directory.name) and directory.parent.name == OURS):
        return []
    try:
        names = [entry.name for entry in os.scandir(directory.parent) if entry.is_dir(follow_symlinks=False)]
    except OSError:
        return []
    folders = [directory.parent / name for name in names if _NAME.fullmatch(name) and name != directory.name]
    return sorted(
        (folder for folder in folders if _is_own_directory(folder) and _used_ns(folder)), key=_used_ns, reverse=True
    )


def _used_ns(directory: Path) -> int:
    try:
        return (directory / MARKER).lstat().st_mtime_ns
    except OSError:
        return 0  # no marker: not from this module


def damaged(error: BaseException | None) -> bool:
    """Tell whether an error comes from reading numba's cache: a power cut has truncated a file."""
    while error is not None:
        frames = traceback.extract_tb(error.__traceback__)
        if any(Path(frame.filename).parts[-3:] == ("numba", "core", "caching.py") for frame in frames):
            return True
        error = error.__cause__ or error.__context__
    return False


def empty(directory: Path) -> None:
    """Remove the cached files of a directory of this module; other files stay."""
    for _, folders, files, at in os.fwalk(directory, topdown=False, follow_symlinks=False):
        for name in filter(_FILES.fullmatch, files):
            os.unlink(name, dir_fd=at)
        for name in folders:
            with suppress(OSError):  # not empty, or a link
                os.rmdir(name, dir_fd=at)


def _remove(directory: Path) -> None:
    """Remove a directory of this module that no process uses.

    Foreign files in it stay, and then the directory stays, too.
    """
    lock = _marker(directory)
    if lock is None:
        return
    try:
        lock_file(lock)  # OSError: a process uses it
        if not _stands(directory, lock):
            return
        empty(directory)
        (directory / MARKER).unlink()
        directory.rmdir()
    finally:
        os.close(lock)
