"""Folders that nobody but their user may enter: for compiled code that is loaded, and for sockets
that move a motor.

A folder is made with mode 0700, whatever the umask is. One that is there already is refused where
another user could have written to it, or could exchange it. It imports nothing of this project:
`coulombus.kernels` and `coulombus.wire`, which do not know each other, both use it.
"""

from __future__ import annotations

import os
import shlex
import stat
from contextlib import suppress
from pathlib import Path

__all__ = ["make_private", "reason_against", "reason_against_above"]

PRIVATE = 0o700


def make_private(folder: Path) -> None:
    """Make a folder, and those above it that are missing, with mode 0700; leave what is there.

    Raises
    ------
    OSError
        it cannot be made, or a file stands in its place
    """
    if folder.is_dir():
        return
    if not folder.parent.exists():
        make_private(folder.parent)
    try:
        os.mkdir(folder, PRIVATE)
    except FileExistsError:  # another process was quicker, or it is no folder
        if not folder.is_dir():
            raise
        return
    with suppress(FileNotFoundError):  # another process has removed it
        os.chmod(folder, PRIVATE)  # the umask may have taken even the user's own bits


def reason_against(folder: Path) -> str:
    """Return why a folder is not private, with what mends it; "" where it is private.

    It is private where it is a folder and no link, its owner is this user, and its mode gives
    nothing to group and others.

    Raises
    ------
    OSError
        it cannot be looked at
    """
    status = folder.lstat()  # not stat: in a folder that all may write to, anybody can place a link
    if not stat.S_ISDIR(status.st_mode):
        return f"{folder} is no folder: remove it"
    if status.st_uid != os.geteuid():
        return f"{folder} belongs to user {status.st_uid}, and not to user {os.geteuid()}: remove it"
    mode = stat.S_IMODE(status.st_mode)
    if mode & 0o077:
        return f"{folder} has mode {mode:04o}, expected 0700: chmod 700 {shlex.quote(str(folder))}"
    return ""


def reason_against_above(folder: Path) -> str:
    """Return why what is in `folder` could be exchanged by another user, with what mends it; ""
    where it could not.

    The owner is this user or root, and nobody else writes to it, or each user only to what is his
    (the sticky bit, as /tmp has it).

    Raises
    ------
    OSError
        it cannot be looked at
    """
    status = folder.stat()
    if status.st_uid not in (0, os.geteuid()):
        return f"{folder} belongs to user {status.st_uid}, who could exchange what is in it: take another folder"
    mode = stat.S_IMODE(status.st_mode)
    if mode & 0o022 and not mode & stat.S_ISVTX:
        return (
            f"{folder} has mode {mode:04o}, so others could exchange what is in it: "
            f"chmod go-w {shlex.quote(str(folder))}"
        )
    return ""
