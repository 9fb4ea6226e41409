"""The EDS file for a device on a bus, from a folder of EDS files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from coulombus.eds.own_devices import told_identity
from coulombus.eds.reader import Description, EdsError, read_eds

__all__ = ["fitting", "read_folder"]

SUFFIXES = (".eds", ".dcf", ".xdd", ".xdc")


def read_folder(folder: Path) -> tuple[list[Description], list[EdsError]]:
    """Read the EDS, DCF, XDD and XDC files of a folder, by name; return the readable descriptions, and the
    errors of the others.

    OSError: the folder itself cannot be read.
    """
    descriptions, refused = [], []
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in SUFFIXES:
            try:
                descriptions.append(read_eds(path))
            except EdsError as error:  # may be for another device: a missing file is reported when it is needed
                refused.append(error)
    return descriptions, refused


def fitting(descriptions: Iterable[Description], identity: tuple[int, int], revision: int = 0) -> Description | None:
    """Return the file that matches a device's 1018h:01 and :02, preferably of its revision (1018h:03); None
    if there is none.
    """
    alike = [description for description in descriptions if any(identity) and told_identity(description) == identity]
    return next(
        (description for description in alike if _revision(description) == revision), alike[0] if alike else None
    )


def _revision(description: Description) -> int:
    revision = description.default(0x1018, 3, 0) if description.has(0x1018, 3) else 0
    return revision if isinstance(revision, int) else 0
