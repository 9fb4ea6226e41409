"""Access control of the page: token, address, origin, and the control lock."""

from __future__ import annotations

import hmac
import ipaddress
import os
import re
import secrets
import stat
from pathlib import Path

__all__ = ["ControlLock", "kept_token", "new_token", "right_token", "same_origin", "served_as"]

HTTP_PORT = 80
"""Default port of HTTP, which a browser omits."""
TOKEN = re.compile(r"[A-Za-z0-9_-]{32,64}")


def new_token() -> str:
    """Return an unguessable token: 192 bits."""
    return secrets.token_urlsafe(24)


def kept_token(path: Path) -> str:
    """Return the token in a file readable only by this user, or write a new one there.

    An open page thus reconnects after a restart of the server.

    Raises
    ------
    OSError
        the file cannot be read or written
    """
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
    with os.fdopen(os.open(path, flags, 0o600), "r+", encoding="ascii", errors="replace") as file:
        status = os.fstat(file.fileno())
        text = file.read(100).strip()
        private = status.st_uid == os.getuid() and stat.S_IMODE(status.st_mode) & 0o077 == 0
        if private and TOKEN.fullmatch(text):
            return text
        os.fchmod(file.fileno(), 0o600)
        token = new_token()
        file.seek(0)
        file.truncate()
        file.write(token + "\n")
        return token


def right_token(candidate: str, token: str) -> bool:
    """Return whether a token is correct, in constant time."""
    return hmac.compare_digest(candidate.encode("utf-8", "surrogateescape"), token.encode())


def same_origin(origin: str | None, host: str | None) -> bool:
    """Return whether a request comes from the page itself: its header Origin names the requested
    host. False if either is missing.
    """
    return bool(host) and origin in (f"http://{host}", f"https://{host}")


def served_as(host: str | None, address: str, port: int, name: str = "") -> bool:
    """Return whether a request's header Host names the served address.

    A foreign page may make its own name resolve to this machine, so that the browser treats both as
    one origin (DNS rebinding); the header then has that name.

    Parameters
    ----------
    address, port : of this end of the connection
    name : the configured listening name, or this machine's own
    """
    here = ipaddress.ip_address(address.partition("%")[0])
    if isinstance(here, ipaddress.IPv6Address):
        here = here.ipv4_mapped or here
    names = {name.lower(), f"[{here}]" if here.version == 6 else str(here)} - {""}
    if here.is_loopback:
        names |= {"localhost", "127.0.0.1", "[::1]"}
    requested = (host or "").lower()
    return requested in {f"{name}:{port}" for name in names} or (port == HTTP_PORT and requested in names)


class ControlLock:
    """The session that controls; all others view. STOP needs no control."""

    def __init__(self) -> None:
        self.holder: int | None = None

    def acquire(self, session: int) -> bool:
        """Acquire control for `session` if free; return whether it has it."""
        if self.holder is None:
            self.holder = session
        return self.holder == session

    def release(self, session: int) -> None:
        """Release control; do nothing if another session has it."""
        if self.holder == session:
            self.holder = None
