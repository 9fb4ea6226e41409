"""Collect the errors of a sweep or study file, each with its line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from coulombus.rigs.errors import nearest, shown
from coulombus.rigs.rig import Rig, RigError, load_rig
from coulombus.rigs.toml_lines import Document, Key, of_another_kind, read_text, read_toml
from coulombus.sim_bus.faults.error_text import WANTED

__all__ = ["FileMistakes", "StrictTable", "read_checked", "rig_beside"]

M = TypeVar("M", bound=BaseModel)


class StrictTable(BaseModel):
    """A table of a sweep or study file: no other keys, and no value of another type."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class FileMistakes:
    """Collects the errors of a file.

    Parameters
    ----------
    error : type of the exception that `raise_all` raises
    """

    def __init__(self, path: str, document: Document, error: type[Exception]) -> None:
        self._path, self._document, self._error = path, document, error
        self._entries: list[tuple[int, str]] = []

    def say(self, key: Key, text: str) -> None:
        """Note an error of a key."""
        line = self._document.line(key)
        name, text = (_one_line(string) for string in (".".join(map(str, key)), text))
        self._entries.append((line, f"{self._path}:{line}: {name}: {text}" if name else f"{self._path}:{line}: {text}"))

    def explain(self, error: ValidationError, above: Key, model: type[BaseModel]) -> None:
        """Note pydantic's errors in the table `above`."""
        for finding in error.errors():
            place = tuple(part for part in finding["loc"] if not (isinstance(part, str) and "[" in part))
            got = "" if isinstance(finding["input"], dict) else f", not {shown(finding['input'])}"
            if finding["type"] == "extra_forbidden":
                hint = nearest(str(place[-1]), model.model_fields)
                text = f"no such key here{hint or '; expected ' + ', '.join(model.model_fields)}"
            elif finding["type"] == "missing":
                text = "is missing"
            elif finding["type"] == "too_short":
                text = "expected one value or more"
            elif finding["type"] in ("dict_type", "model_type"):
                text = f"expected a table [{place[-1]}]{got}"
            else:
                words = {key: value for key, value in finding.get("ctx", {}).items() if key != "error"}
                text = f"expected {WANTED.get(finding['type'], finding['msg']).format(**words)}{got}"
                if finding["type"] == "literal_error" and isinstance(finding["input"], str):
                    text += nearest(finding["input"], re.findall(r"'(\w+)'", words["expected"]))
            self.say((*above, *place), text)

    def raise_all(self) -> None:
        """Raise the exception with all errors in the file's order, if any."""
        if self._entries:
            ordered = sorted(self._entries, key=lambda mistake: mistake[0])
            raise self._error("\n".join(dict.fromkeys(text for _, text in ordered)))


def _one_line(text: str) -> str:
    """Return a text with escaped line ends: an error is one line."""
    return text.replace("\r", "\\r").replace("\n", "\\n")


def read_checked(path: Path, what: str, model: type[M], error: type[Exception]) -> tuple[str, M, FileMistakes]:
    """Return the text of the file `path`, its values validated by `model`, and a collector for
    further errors; raise `error` with a line for each error.
    """
    text = read_text(path, f"{what} file", error)
    document = read_toml(text)
    if document.problems:
        raise error("\n".join(f"{path}:{line}: {problem}" for line, problem in document.problems))
    if other := of_another_kind(document.values, what):
        raise error(f"{path}: {other}")
    mistakes = FileMistakes(str(path), document, error)
    try:
        return text, model.model_validate(document.values), mistakes
    except ValidationError as refused:
        mistakes.explain(refused, (), model)
        mistakes.raise_all()
        raise AssertionError("what pydantic refuses has a mistake") from None


def rig_beside(path: Path, name: str, mistakes: FileMistakes) -> Rig:
    """Return the rig that the file `path` names: a packaged one, or a path relative to it."""
    is_path = "/" in name or name.endswith(".toml")
    place = path.parent / name
    if is_path and not place.exists():
        mistakes.say(("rig",), f"there is no file {place}; expected a path beside this file, or the name of a rig")
        mistakes.raise_all()
    try:
        rig = load_rig(str(place) if "/" in str(place) else f"./{place}") if is_path else load_rig(name)
        for axis in rig.axes:
            _ = axis.simulation
    except RigError as error:
        if is_path and place.is_file():
            raise
        mistakes.say(("rig",), str(error).removeprefix(f"--rig {name}: "))
        mistakes.raise_all()
        raise
    return rig
