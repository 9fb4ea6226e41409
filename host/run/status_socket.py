"""What a running host tells other programs: one JSON line ten times a second, to each that connects
to a socket (``run --status``).

Whoever connects reads and says nothing. The data plane knows nothing of it: the lines are made of
the memory that it shares with its parent. A reader that is slow is not waited for: lines that find
no room are left out for it and counted, and one that reads nothing for `SLOW_S` is let go.
"""

from __future__ import annotations

import errno
import json
import os
import socket
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from coulombus.host.errors import HostError

__all__ = ["PERIOD_NS", "StatusError", "StatusSocket", "encoded"]

PERIOD_NS = 100_000_000
READERS, BACKLOG = 16, 8
SLOW_S = 5.0
RUBBISH = 4096
"""Bytes that a reader may say at a time; they are thrown away."""
MOST_RUBBISH = 16


class StatusError(HostError):
    """The socket cannot be made; the text says why."""

    exit_status = 2


def encoded(document: dict[str, Any]) -> bytes:
    """Return a document as one line of JSON; what is no number in it is null."""
    try:
        text = json.dumps(document, allow_nan=False)
    except ValueError:
        text = json.dumps(_finite(document), allow_nan=False)
    return text.encode() + b"\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not abs(value) < float("inf") else value


class _Reader:
    """Somebody who reads, and what of a line is still to be sent."""

    def __init__(self, connection: socket.socket, now_ns: int) -> None:
        connection.setblocking(False)
        self.connection, self.rest, self.took_ns = connection, b"", now_ns

    def gone(self) -> bool:
        """Throw away what it says; tell whether it has closed, or says too much."""
        for _ in range(MOST_RUBBISH):
            try:
                if not self.connection.recv(RUBBISH):
                    return True
            except BlockingIOError:
                return False
            except OSError:
                return True
        return True

    def send(self, line: bytes, now_ns: int) -> bool:
        """Send a line behind the rest of the last one; return False where it finds no room."""
        free = not self.rest
        self.rest = self.rest or line
        sent = self.connection.send(self.rest, socket.MSG_NOSIGNAL | socket.MSG_DONTWAIT)
        if sent:
            self.took_ns = now_ns
        self.rest = self.rest[sent:]
        if not free and not self.rest:
            return self.send(line, now_ns)
        return free


class StatusSocket:
    """Listens at `path` and tells a document to all who read.

    Parameters
    ----------
    document : makes it; called at most once in `PERIOD_NS`, and only where somebody reads

    Raises
    ------
    StatusError
        another host serves this socket, something else is there, or it cannot be made
    """

    def __init__(self, path: Path, document: Callable[[], dict[str, Any]]) -> None:
        self.path, self._document = path, document
        self._readers: list[_Reader] = []
        self._next_ns, self.left_out, self.let_go = 0, 0, 0
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
        try:
            _clear(path)
            self._listener.bind(str(path))
            self._listener.listen(BACKLOG)
        except OSError as error:
            self._listener.close()
            reason = "it is taken" if error.errno == errno.EADDRINUSE else error.strerror or str(error)
            raise StatusError(f"{path}: the status socket cannot be made: {reason}; choose another name") from None
        except BaseException:
            self._listener.close()
            raise
        self._inode = os.stat(path).st_ino

    def serve(self, now_ns: int) -> None:
        """Let in who comes, and tell everybody, where it is time; waits for nobody.

        OSError: nobody can come in any more.
        """
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + PERIOD_NS
        self._let_in(now_ns)
        if not self._readers:
            return
        line = encoded({**self._document(), "readers": len(self._readers), "lines_left_out": self.left_out})
        for reader in list(self._readers):
            try:
                gone = reader.gone()
                if not gone and not reader.send(line, now_ns):
                    self.left_out += 1
            except BlockingIOError:
                self.left_out += 1
            except OSError:
                gone = True
            slow = now_ns - reader.took_ns > SLOW_S * 1e9
            self.let_go += slow
            if gone or slow:
                self._readers.remove(reader)
                reader.connection.close()

    def _let_in(self, now_ns: int) -> None:
        for _ in range(READERS):
            try:
                connection, _ = self._listener.accept()
            except BlockingIOError:
                return
            except ConnectionAbortedError:
                continue
            if len(self._readers) < READERS:
                self._readers.append(_Reader(connection, now_ns))
            else:
                connection.close()

    def close(self) -> None:
        """Let everybody go and remove the socket, if it is still this one; may be called again."""
        if self._listener.fileno() < 0:
            return
        with suppress(OSError):
            if os.stat(self.path).st_ino == self._inode:
                self.path.unlink()
        self._listener.close()
        for reader in self._readers:
            reader.connection.close()
        self._readers.clear()


def _clear(path: Path) -> None:
    """Remove a socket that a killed host has left behind; StatusError for anything else."""
    try:
        kind = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(kind):
        raise StatusError(f"{path} is there and is no socket; choose another name")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK) as probe:
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink(missing_ok=True)
            return
        except (BlockingIOError, OSError):
            pass
    raise StatusError(f"{path}: another host tells its status there; choose another name")
