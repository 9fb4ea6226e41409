"""A lock on an open file, which the system gives back when the file is closed or its process ends."""

from __future__ import annotations

from typing import IO, Any

__all__ = ["lock_file"]


def lock_file(file: int | IO[Any], *, shared: bool = False, wait: bool = False) -> None:
    """Lock an open file, or its descriptor, against everybody who asks in the same way.

    Where the system has no flock(2), as Windows, nothing is locked.

    Parameters
    ----------
    shared : others may hold it too, as long as they all share it
    wait : until it is free

    Raises
    ------
    BlockingIOError
        another one holds it
    OSError
        the file system has no locks
    """
    try:
        import fcntl
    except ModuleNotFoundError:
        return
    fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB))
