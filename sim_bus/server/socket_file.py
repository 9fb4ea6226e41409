"""Socket file of a virtual bus: its owner, its creation and its removal, and who connects to it."""

from __future__ import annotations

import os
import socket
import struct
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from coulombus.system.file_lock import lock_file
from coulombus.wire.address import BusAddress, BusUnavailable

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["Peer", "locked", "peer", "refuse_live", "unlink_own"]

SO_PEERCRED = 17
_CREDENTIALS = struct.Struct("3i")


class Peer(NamedTuple):
    """The process at the other end of a connection, as it was when it connected."""

    pid: int
    uid: int
    gid: int


def peer(connection: socket.socket) -> Peer:
    """Return the process at the other end, by Linux's ``struct ucred``."""
    return Peer(*_CREDENTIALS.unpack(connection.getsockopt(socket.SOL_SOCKET, SO_PEERCRED, _CREDENTIALS.size)))


@contextmanager
def locked(directory: Path) -> Iterator[None]:
    """Hold the lock on the sockets' directory, so that two servers that start at the same time do not both
    replace a stale socket.
    """
    fd = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        lock_file(fd, wait=True)
        yield
    finally:
        os.close(fd)


def refuse_live(path: Path, address: BusAddress) -> bool:
    """Refuse a socket's file whose process is alive.

    Return whether a stale file exists.
    """
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)) as probe:
        try:
            probe.connect(str(path))
        except FileNotFoundError:
            return False
        except ConnectionRefusedError:
            return True
        except BlockingIOError:  # its queue is full: the process is alive
            pass
    raise BusUnavailable(
        f"bus {address} is served already by another process ({path}); stop that one, or choose another name with --bus"
    )


def unlink_own(path: Path, inode: int) -> None:
    """Remove a socket's file if it still has this inode."""
    with locked(path.parent), suppress(FileNotFoundError):
        if path.stat().st_ino == inode:
            path.unlink()
