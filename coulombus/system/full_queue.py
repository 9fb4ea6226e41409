"""Connecting to a socket file while the queue of connections that it has not yet accepted is full."""

from __future__ import annotations

import socket
import time
from pathlib import Path

__all__ = ["connect_by"]

RETRY_S = 0.01


def connect_by(client: socket.socket, path: str | Path, deadline_s: float) -> None:
    """Connect an AF_UNIX socket; try again until `deadline_s` of `time.monotonic` while the queue is full.

    A blocking connect() would wait without end: the kernel returns EAGAIN at once where the socket has a time-out.

    Raises
    ------
    TimeoutError
        the queue was full until then
    OSError
        connect()'s own errors
    """
    while True:
        client.settimeout(max(1e-3, deadline_s - time.monotonic()))
        try:
            return client.connect(str(path))
        except BlockingIOError:
            if time.monotonic() >= deadline_s:
                raise TimeoutError from None
            time.sleep(RETRY_S)
