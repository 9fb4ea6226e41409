"""A lock on an open file; the system releases it when the file is closed or its process ends."""

from __future__ import annotations

from typing import IO, Any

__all__ = ["lock_file"]


def lock_file(file: int | IO[Any], *, shared: bool = False, wait: bool = False) -> None:
    """Lock an open file, or its descriptor, against other callers of this function.

    Nothing is locked on a system without flock(2), such as Windows.

    Parameters
    ----------
    shared : a shared lock: several processes may hold it
    wait : block until the lock is free

    Raises
    ------
    BlockingIOError
        another process holds it
    OSError
        the file system has no locks
    """
    try:
        import fcntl
    except ModuleNotFoundError:
        return
    fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB))
