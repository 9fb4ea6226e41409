"""EDS files for the devices of a bus: given as ``5=drive.eds``, or a folder whose files are matched by identity."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from coulombus.eds.own_devices import identity_from_1018h
from coulombus.eds.reader import Description, EdsError, read_eds

__all__ = ["EdsFiles", "eds_files", "fitting", "read_folder"]

SUFFIXES = (".eds", ".dcf", ".xdd", ".xdc")


@dataclass
class EdsFiles:
    """EDS files by node id, and files that are matched with nodes by identity."""

    of_nodes: dict[int, Description] = field(default_factory=dict)
    candidates: tuple[Description, ...] = ()
    refused: list[str] = field(default_factory=list)
    """Reasons why files of a folder cannot be read."""

    def __bool__(self) -> bool:
        """Return whether any file is given."""
        return bool(self.of_nodes or self.candidates)


def eds_files(texts: Iterable[str] | EdsFiles) -> EdsFiles:
    """Return the files named by ``NODE=FILE`` or ``FOLDER``; files that are read already as they are.

    Raises
    ------
    EdsError
        An argument has neither form, or its file cannot be read.
    """
    if isinstance(texts, EdsFiles):
        return texts
    files = EdsFiles()
    for text in texts:
        number, equals, name = text.partition("=")
        if equals and number.strip().isdecimal():
            node = int(number)
            if not 1 <= node <= 127:
                raise EdsError(f"--eds {text}: node id {node}; expected 1 to 127")
            if node in files.of_nodes:
                raise EdsError(f"--eds {text}: node {node} has {files.of_nodes[node].path}, too; give one of them")
            files.of_nodes[node] = read_eds(Path(name))
        elif Path(text).is_dir():
            descriptions, refused = read_folder(Path(text))
            files.candidates += tuple(descriptions)
            files.refused += [str(error) for error in refused]
        else:
            raise EdsError(f"--eds {text}: expected NODE=FILE, as in 5=drive.eds, or a folder of EDS files")
    return files


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
    alike = [
        description for description in descriptions if any(identity) and identity_from_1018h(description) == identity
    ]
    return next(
        (description for description in alike if _revision(description) == revision), alike[0] if alike else None
    )


def _revision(description: Description) -> int:
    revision = description.default(0x1018, 3, 0) if description.has(0x1018, 3) else 0
    return revision if isinstance(revision, int) else 0
