"""Who may do what at the page: the token, the address, the origin, and the one who controls."""

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
"""Which a browser leaves out."""
TOKEN = re.compile(r"[A-Za-z0-9_-]{32,64}")


def new_token() -> str:
    """Return a token that nobody guesses: 192 bits."""
    return secrets.token_urlsafe(24)


def kept_token(path: Path) -> str:
    """Return the token that stands in a file of this user's alone, or write a new one there.

    So a page that is open finds the server again after that has been started anew.

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


def right_token(given: str, token: str) -> bool:
    """Tell whether a token is the right one, in the same time for each wrong one."""
    return hmac.compare_digest(given.encode("utf-8", "surrogateescape"), token.encode())


def same_origin(origin: str | None, host: str | None) -> bool:
    """Tell whether a request comes from the page itself: its header Origin names the host that is
    asked. None of either is no.
    """
    return bool(host) and origin in (f"http://{host}", f"https://{host}")


def served_as(host: str | None, address: str, port: int, name: str = "") -> bool:
    """Tell whether a request's header Host names the address that is served.

    A stranger's page may let its own name point to this machine, so that the browser takes the two
    for one (DNS rebinding); the header has that name then.

    Parameters
    ----------
    address, port : of this end of the connection
    name : by which the server was told to listen, or this machine's own
    """
    here = ipaddress.ip_address(address.partition("%")[0])
    if isinstance(here, ipaddress.IPv6Address):
        here = here.ipv4_mapped or here
    names = {name.lower(), f"[{here}]" if here.version == 6 else str(here)} - {""}
    if here.is_loopback:
        names |= {"localhost", "127.0.0.1", "[::1]"}
    given = (host or "").lower()
    return given in {f"{name}:{port}" for name in names} or (port == HTTP_PORT and given in names)


class ControlLock:
    """Which page controls; all others look on. STOP needs none."""

    def __init__(self) -> None:
        self.holder: int | None = None

    def acquire(self, session: int) -> bool:
        """Take the control where nobody has it; tell whether `session` has it now."""
        if self.holder is None:
            self.holder = session
        return self.holder == session

    def release(self, session: int) -> None:
        """Give it back; nothing where another session has it."""
        if self.holder == session:
            self.holder = None
