"""Status socket of a running host (``run --status``): one JSON line ten times a second to each reader.

Readers send nothing. The data plane takes no part: the lines are built from the memory that it shares
with its parent. The host never waits for a slow reader. It skips and counts lines for which the reader's
buffer has no room, and disconnects a reader that reads nothing for `SLOW_S`.
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
"""Bytes that are read from a reader at a time, and discarded."""
MOST_RUBBISH = 16


class StatusError(HostError):
    """The socket cannot be created; the text gives the reason."""

    exit_status = 2


def encoded(document: dict[str, Any]) -> bytes:
    """Return a document as one line of JSON; NaN and infinite numbers become null."""
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


class _StatusReader:
    """A connected reader, and the unsent rest of its line."""

    def __init__(self, connection: socket.socket, now_ns: int) -> None:
        connection.setblocking(False)
        self.connection, self.rest, self.took_ns = connection, b"", now_ns

    def gone(self) -> bool:
        """Discard the reader's input; return whether it has disconnected, or sends too much."""
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
        """Send a line after the rest of the last one; return False if there is no room for it."""
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
    """Listens at `path` and sends a document to all readers.

    Parameters
    ----------
    document : returns the document; called at most once in `PERIOD_NS`, and only with a reader connected

    Raises
    ------
    StatusError
        another host serves this socket, the path is not a socket, or it cannot be created
    """

    def __init__(self, path: Path, document: Callable[[], dict[str, Any]]) -> None:
        self.path, self._document = path, document
        self._readers: list[_StatusReader] = []
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
        """Accept new readers and send the status when due; never blocks.

        OSError: the socket accepts no more readers.
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
                self._readers.append(_StatusReader(connection, now_ns))
            else:
                connection.close()

    def close(self) -> None:
        """Disconnect all readers, and remove the socket if it is still this one; may be called again."""
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
    """Remove a stale socket of a killed host; StatusError for anything else."""
    try:
        kind = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(kind):
        raise StatusError(f"{path} is not a socket; choose another name")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK) as probe:
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink(missing_ok=True)
            return
        except (BlockingIOError, OSError):
            pass
    raise StatusError(f"{path}: another host tells its status there; choose another name")
