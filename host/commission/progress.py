"""Progress of a commissioning, stored in a folder next to the rig file, so that it can be resumed.

    my.toml                         the rig file, with the findings
    my.commission/state.json        the outcome of each finished step
    my.commission/friction.pcapng   the recordings of the steps
    my.commission/my.TIME.toml      the rig file before each change
    my.commission/report.html       the report on one page

For a rig file with named axes, each axis has such a folder: ``my.commission/left``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from coulombus.host.commission.step import CommissionError
from coulombus.system.unfinished_file import write_whole

__all__ = ["Progress", "folder_of"]

VERSION = 1
LARGEST = 1 << 24
KEPT = ("at", "title", "findings", "remarks", "curves", "recordings")
"""Stored entries of a step."""


def folder_of(rig_path: Path, axis: str | None = None) -> Path:
    """Return the folder of a rig file's commissioning, or the folder of an axis in it."""
    folder = rig_path.with_name(f"{rig_path.stem}.commission")
    return folder if axis is None else folder / axis


@dataclass
class Progress:
    """The finished steps, in their order.

    Attributes
    ----------
    folder : folder of the commissioning
    steps : name of a step -> {"at": time, "findings": [...], "remarks": [...], "curves": [...],
        "recordings": [...]}
    """

    folder: Path
    steps: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def path(self) -> Path:
        """Path of the state file."""
        return self.folder / "state.json"

    @classmethod
    def load(cls, folder: Path) -> Progress:
        """Return the progress in a folder; empty if there is none.

        Raises
        ------
        CommissionError
            the file is not a state of this version
        OSError
            the file cannot be read
        """
        state = cls(folder)
        try:
            with state.path.open("rb") as file:
                raw = file.read(LARGEST)
        except FileNotFoundError:
            return state
        try:
            values = json.loads(raw)
            if values["version"] != VERSION or not all(set(KEPT) <= step.keys() for step in values["steps"].values()):
                raise ValueError
        except (ValueError, KeyError, TypeError, AttributeError):
            refusal = f"this is no state of a commissioning (version {VERSION}); take the folder away to begin anew"
            raise CommissionError(f"{state.path}: {refusal}") from None
        state.steps = values["steps"]
        return state

    def keep(self, name: str, outcome: dict[str, Any]) -> None:
        """Store the outcome of a step; the file is replaced as a whole.

        Raises
        ------
        OSError
            the file cannot be written; it is unchanged
        """
        steps = {other: result for other, result in self.steps.items() if other != name} | {name: outcome}
        write_whole(self.path, json.dumps({"version": VERSION, "steps": steps}, indent=1).encode())
        self.steps = steps
