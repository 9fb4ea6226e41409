"""EDS files for a log, given as ``5=drive.eds`` or as a folder."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from coulombus.eds.description import Description, EdsError
from coulombus.eds.eds_folder import read_folder
from coulombus.eds.reader import read_eds

__all__ = ["EdsFiles", "eds_files"]


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
