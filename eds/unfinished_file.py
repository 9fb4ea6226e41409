"""The name of a file that is being written, beside the one that it becomes when it is whole.

A process that is killed leaves its unfinished file behind. The name tells the machine and the
process, so that the next one that writes into the folder removes it.
"""

from __future__ import annotations

import os
import re
import zlib
from contextlib import suppress
from pathlib import Path

__all__ = ["remove_unfinished", "unfinished"]

MACHINE = f"{zlib.crc32(os.uname().nodename.encode(errors='surrogateescape')):08x}"
"""This machine, or container: others that share a folder have processes of the same numbers."""
NAME = re.compile(rf"\..+-{MACHINE}-([0-9]+)-[0-9a-f]{{8}}(\.[^.]*)?", re.DOTALL)


def unfinished(path: Path) -> Path:
    """Return a new hidden name for a file of this process that becomes `path`, with its suffix."""
    return path.with_name(f".{path.stem}-{MACHINE}-{os.getpid()}-{os.urandom(4).hex()}{path.suffix}")


def remove_unfinished(folder: Path) -> None:
    """Remove from a folder the unfinished files of this machine's processes that have ended, as far
    as that is allowed.
    """
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            match = NAME.fullmatch(entry.name)
            if match is not None and entry.is_file(follow_symlinks=False) and _has_ended(int(match[1])):
                with suppress(OSError):
                    os.unlink(entry.path)


def _has_ended(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return True
    except OSError:  # another user's
        return False
    return False
