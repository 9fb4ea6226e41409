"""Folders that only their user may enter: for compiled code that is loaded, and for sockets that move a motor.

A folder is made with mode 0700, whatever the umask is. An existing folder is refused if another
user could have written to it, or could exchange it. This module imports nothing of this project:
`coulombus.kernels` and `coulombus.wire` both use it, and neither imports the other.
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
    """Make a folder, and its missing parents, with mode 0700; leave existing folders as they are.

    Raises
    ------
    OSError
        the folder cannot be made, or a file has its name
    """
    if folder.is_dir():
        return
    if not folder.parent.exists():
        make_private(folder.parent)
    try:
        os.mkdir(folder, PRIVATE)
    except FileExistsError:  # another process was faster, or the path is no folder
        if not folder.is_dir():
            raise
        return
    with suppress(FileNotFoundError):  # another process has removed it
        os.chmod(folder, PRIVATE)  # the umask may have taken even the user's own bits


def reason_against(folder: Path) -> str:
    """Return why a folder is not private, with the remedy; "" if it is private.

    A private folder is no link, its owner is this user, and its mode gives nothing to group and
    others.

    Raises
    ------
    OSError
        the folder cannot be examined
    """
    status = folder.lstat()  # not stat: in a world-writable folder anybody can place a link
    if not stat.S_ISDIR(status.st_mode):
        return f"{folder} is not a folder: remove it"
    if status.st_uid != os.geteuid():
        return f"{folder} belongs to user {status.st_uid}, and not to user {os.geteuid()}: remove it"
    mode = stat.S_IMODE(status.st_mode)
    if mode & 0o077:
        return f"{folder} has mode {mode:04o}, expected 0700: chmod 700 {shlex.quote(str(folder))}"
    return ""


def reason_against_above(folder: Path) -> str:
    """Return why another user could exchange the content of `folder`, with the remedy; "" if nobody could.

    The content is safe if the owner is this user or root, and if nobody else may write to the folder,
    or each user only to own files (the sticky bit, as on /tmp).

    Raises
    ------
    OSError
        the folder cannot be examined
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
