"""Name of a file while it is being written, next to its final name.

A process that is killed leaves its unfinished file behind. The name identifies the machine and the
process, so that the next process that writes into the folder removes it.
"""

from __future__ import annotations

import os
import re
import zlib
from contextlib import suppress
from pathlib import Path

__all__ = ["remove_unfinished", "unfinished"]

MACHINE = f"{zlib.crc32(os.uname().nodename.encode(errors='surrogateescape')):08x}"
"""Identifier of this machine, or container: process ids repeat among those that share a folder."""
NAME = re.compile(rf"\..+-{MACHINE}-([0-9]+)-[0-9a-f]{{8}}(\.[^.]*)?", re.DOTALL)


def unfinished(path: Path) -> Path:
    """Return a new hidden name, with the suffix of `path`, for this process's file that becomes `path`."""
    return path.with_name(f".{path.stem}-{MACHINE}-{os.getpid()}-{os.urandom(4).hex()}{path.suffix}")


def remove_unfinished(folder: Path) -> None:
    """Remove the unfinished files of this machine's ended processes from a folder, as far as permitted."""
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
    except OSError:  # owned by another user
        return False
    return False
