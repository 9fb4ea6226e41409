"""The text of a rig file: sections, keys, and above each guess a comment with its reason."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from coulombus.rigs.axis import Sections
from coulombus.rigs.errors import toml_value
from coulombus.rigs.field_help import fields_of, kinds_of, named_in
from coulombus.rigs.toml_lines import Key
from coulombus.system.quoting import comment

__all__ = ["CHECK", "REHEARSAL", "RigText", "rehearsal_marks"]

CHECK, REHEARSAL = "CHECK", "REHEARSAL"
"""Marks in comments: a guess; a value for simulated devices only."""
MARK = re.compile(rf"#.*\b{REHEARSAL}\b")
COLUMNS, WIDTH = 110, 32
"""Width of a comment, and of the keys and values with a trailing comment."""
NUMBERS = ("vendor_id", "product_code", "index")
"""Keys whose values are written in hexadecimal."""


class RigText:
    """The values of a new rig file by section, and their comments.

    Attributes
    ----------
    head : the file's first comment
    values : the sections, as TOML has them
    notes : comments over a key or a section
    """

    def __init__(self, values: dict[str, Any]) -> None:
        self.head: list[str] = []
        self.values = values
        self.notes: dict[Key, list[str]] = {}

    def get(self, path: str) -> Any:
        """Return the value of a key, or None."""
        here: Any = self.values
        for part in path.split("."):
            here = here.get(part) if isinstance(here, Mapping) else None
        return here

    def put(self, path: str, value: Any, note: str = "", mark: str = CHECK) -> None:
        """Set a key; with a note it is marked."""
        *parents, name = path.split(".")
        here = self.values
        for part in parents:
            here = here.setdefault(part, {})
        here[name] = value
        self.notes.pop((*parents, name), None)
        if note:
            self.note(path, note, mark)

    def append(self, path: str, table: dict[str, Any], note: str) -> None:
        """Add a table to a list of tables, with a marked note."""
        notes = self.notes.get(tuple(path.split(".")), [])
        self.put(path, [*(self.get(path) or ()), table])
        self.notes[tuple(path.split("."))] = notes
        self.note(path, note, CHECK)

    def drop(self, path: str) -> None:
        """Remove a key or a section, with its comments."""
        *parents, name = path.split(".")
        here = self.get(".".join(parents)) if parents else self.values
        if isinstance(here, dict):
            here.pop(name, None)
        key: Key = (*parents, name)
        self.notes = {at: texts for at, texts in self.notes.items() if at[: len(key)] != key}

    def note(self, path: str, text: str, mark: str = "") -> None:
        """Add a comment above a key or a section."""
        self.notes.setdefault(tuple(path.split(".")), []).append(f"{mark}: {text}" if mark else text)

    def __str__(self) -> str:
        lines = [line for text in self.head for line in _comment(text)]
        for name, info in fields_of(Sections).items():
            lines += self._section((name,), self.values.get(name), info)
        return "\n".join(lines) + "\n"

    def _section(self, key: Key, value: Any, info: FieldInfo | None) -> Iterator[str]:
        """Yield a section and its subsections."""
        name, named, models = ".".join(map(str, key)), named_in(info), kinds_of(info)
        notes = [line for text in self.notes.get(key, ()) for line in _comment(text)]
        if isinstance(value, list | tuple):
            for table in value:
                yield from ("", *notes, f"[[{name}]]", *self._keys((), table, models[table.get("kind", "")]))
                notes = []
        elif value:
            model = None if named else models[""]
            fields = {} if model is None else fields_of(model)
            nested = {part for part, entry in value.items() if named or _is_section(entry)}
            plain = {part: entry for part, entry in value.items() if part not in nested and entry is not None}
            about = info.description if info and len(key) == 1 else ""
            head = (*(_comment(f"{about[0].upper()}{about[1:]}.") if about else ()), *notes)
            if plain and model is not None:
                yield from ("", *head, f"[{name}]", *self._keys(key, plain, model))
            elif head:
                yield from ("", *head)
            for part, entry in value.items():
                if part in nested:
                    yield from self._section((*key, part), entry, info_of(named) if named else fields[part])

    def _keys(self, key: Key, entries: Mapping[str, Any], model: type[BaseModel]) -> Iterator[str]:
        fields = fields_of(model)
        for name, value in sorted(entries.items(), key=lambda item: (item[0] != "kind", list(fields).index(item[0]))):
            for text in self.notes.get((*key, name), ()):
                yield from _comment(text)
            plain = value.tolist() if isinstance(value, np.ndarray) else value  # a phase's columns
            spelled = f"0x{plain:X}" if name in NUMBERS else toml_value(plain)
            line = f"{name} = {spelled}"
            description = fields[name].description
            yield f"{line:<{WIDTH}}  # {description}" if description else line


def info_of(model: type[BaseModel]) -> FieldInfo:
    """Return a field of this model, as of each table in a table of names."""
    return FieldInfo(annotation=model)


def _is_section(value: Any) -> bool:
    if isinstance(value, Mapping):
        return True
    return isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(entry, Mapping) for entry in value)


def _comment(text: str) -> list[str]:
    return [f"# {line}" for line in textwrap.wrap(comment(text), COLUMNS, break_on_hyphens=False)] or ["#"]


def rehearsal_marks(text: str) -> tuple[int, ...]:
    """Return the lines of a rig file with the mark REHEARSAL in a comment."""
    return tuple(number for number, line in enumerate(text.splitlines(), 1) if MARK.search(line))
