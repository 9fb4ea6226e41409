"""sd_notify messages of a service to systemd: ready, watchdog, stopping.

A message is one datagram to the socket that NOTIFY_SOCKET names. Nothing here raises or blocks:
without systemd nothing is sent, and a message that finds no room is lost.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import MutableMapping
from contextlib import suppress

__all__ = ["Notifier"]

SHARE = 4
"""Watchdog messages within the watchdog's period."""


class Notifier:
    """sd_notify client.

    Its variables are removed from the environment, so that no child process notifies in its place.

    Parameters
    ----------
    environment : mapping that holds NOTIFY_SOCKET and WATCHDOG_USEC
    """

    def __init__(self, environment: MutableMapping[str, str] | None = None) -> None:
        variables = os.environ if environment is None else environment
        name, self._period_s = variables.pop("NOTIFY_SOCKET", ""), _period_s(variables)
        for key in ("WATCHDOG_USEC", "WATCHDOG_PID"):
            variables.pop(key, None)
        self._address = "\0" + name[1:] if name.startswith("@") else name
        self._told_s = -float("inf")
        self._progress: object = None

    def send(self, **lines: str | int) -> None:
        """Send one message: ``READY=1``, ``STATUS=text``."""
        if not self._address.startswith(("\0", "/")):
            return
        text = "\n".join(f"{name}={' '.join(str(value).split())}" for name, value in lines.items())
        kind = socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC
        with suppress(OSError, ValueError), socket.socket(socket.AF_UNIX, kind) as mouth:
            mouth.sendto(text.encode(), self._address)

    def alive(self, progress: object) -> None:
        """Send a watchdog message if `progress` differs from the last call's, at most as often as the
        watchdog needs it.

        Without progress no message is sent, however often this is called.
        """
        if self._period_s is None or progress == self._progress:
            return
        now = time.monotonic()
        if now - self._told_s < self._period_s:
            return
        self._progress, self._told_s = progress, now
        self.send(WATCHDOG=1)


def _period_s(environment: MutableMapping[str, str]) -> float | None:
    """Return the period of the watchdog messages; None if there is no watchdog."""
    text, pid = environment.get("WATCHDOG_USEC", ""), environment.get("WATCHDOG_PID", str(os.getpid()))
    if not text.isdecimal() or int(text) == 0 or pid != str(os.getpid()):
        return None
    return int(text) * 1e-6 / SHARE
