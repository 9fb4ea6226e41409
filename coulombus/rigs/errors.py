"""Errors of a rig file: their places, all reported together; problems of its devices with their remedies."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from coulombus.rigs.toml_lines import Document, Key
from coulombus.system.errors import CoulombusError
from coulombus.system.foreign_text import printable

__all__ = ["Problem", "RigError", "Source", "dotted", "nearest", "number_hint", "shown", "toml_value"]


class Problem(NamedTuple):
    """The reason why a device cannot have a role or bring-up is refused, and the remedy.

    `accept` is the sentence of ``host.accept`` that acknowledges it, or "".
    """

    role: str
    node: str
    object: str
    text: str
    remedy: str
    accept: str = ""

    def __str__(self) -> str:
        return f"{self.text}; {self.remedy}" if self.remedy else self.text


LONGEST = 60
_LAW = re.compile(r'law\.function="(.*)"')
_KEY = re.compile(
    r"(?<![\w.])(?:bus|host|motor|brake|sensor|role|mechanics|kinematics|law|mode|limits|plane|plant|operator)(?:\.\w+)+"
)
"""Pattern of a rig-file key in a text."""
_WITH_UNIT = re.compile(r"([+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-z\u00b5\u03bc%\u00b0][^\d]*)")
_WITH_COMMA = re.compile(r"[+-]?\d+,\d+")
PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "\u00b5": 1e-6, "\u03bc": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}
"""SI prefix -> factor."""


class RigError(CoulombusError):
    """A rig file is refused; `errors` holds one line for each error.

    `problems`: errors about a role. `lacking`: keys that are missing in an existing section, as ``--set`` takes them.
    """

    exit_status = 3

    def __init__(self, errors: Sequence[str], problems: Sequence[Problem] = (), lacking: Sequence[str] = ()) -> None:
        self.errors, self.problems, self.lacking = tuple(errors), tuple(problems), tuple(lacking)
        super().__init__("\n".join(self.errors))

    def __reduce__(self) -> tuple[type[RigError], tuple[tuple[str, ...], tuple[Problem, ...], tuple[str, ...]]]:
        return type(self), (self.errors, self.problems, self.lacking)


@dataclass
class Source:
    """Origin of values: a file's lines, and overrides by their ``--set`` text.

    Collects the errors.
    """

    path: str
    document: Document
    overrides: dict[Key, str] = field(default_factory=dict)
    axis: Key = ()
    """("axis", NAME) while the values of one axis are checked: the prefix of its own keys."""
    found: list[tuple[float, str]] = field(default_factory=list)
    wrong: set[Key] = field(default_factory=set)
    problems: list[Problem] = field(default_factory=list)
    """Problems with roles."""
    lacking: list[str] = field(default_factory=list)
    """Keys that are missing in an existing section."""

    def of_axis(self, name: str) -> Source:
        """Return a separate source for the axis `name` of the same file."""
        return Source(self.path, self.document, self.overrides, ("axis", name))

    def full(self, key: Key) -> Key:
        """Return `key` as the user wrote it: below the axis if the axis has it, or more of its parents than the shared
        part.
        """
        if not self.axis:
            return key
        values = self.document.values
        depth = _depth(values, (*self.axis, *key)) - len(self.axis)
        return (*self.axis, *key) if depth == len(key) or depth > _depth(values, key) else key

    def spelled(self, key: Key) -> str:
        """Return `key` as the user wrote it, as a text."""
        return dotted(self.full(key))

    def spell_keys(self, text: str) -> str:
        """Return `text` with its rig-file keys as the user wrote them."""
        return _KEY.sub(lambda match: self.spelled(tuple(match[0].split("."))), text) if self.axis else text

    def where(self, key: Key) -> tuple[float, str]:
        """Return the place of `key` for sorting, and as text: ``file:line`` or ``--set
        KEY=VALUE``.
        """
        key = self.full(key)
        for length in range(len(key), 0, -1):
            if key[:length] in self.overrides:  # of this key, or of all that holds it
                return float("inf"), _option(self.overrides[key[:length]])
        if not any(place[: len(key)] == key for place in self.document.lines):
            for override, text in self.overrides.items():
                if override[: len(key)] == key:
                    return float("inf"), _option(text)
        line = self.document.line(key)
        return line, f"{self.path}:{line}"

    def say(self, key: Key, text: str) -> None:
        """Note an error of `key`; `text` follows the key's name."""
        place, where = self.where(key)
        self.wrong.add(key)
        self.found.append((place, f"{where}: {self.spelled(key)}: {self.spell_keys(text)}"))

    def stands(self, key: Key, value: Any, expected: str, choices: Iterable[str] = ()) -> None:
        """Note that `value` is not as `expected`."""
        hint = nearest(value, choices) if isinstance(value, str) else ""
        self.say(key, f"got '{shown(value)}', expected {expected}{hint}")

    def lacks(self, key: Key, expected: str) -> None:
        """Note that `key` is missing in an existing section."""
        self.lacking.append(self.spelled(key))
        self.say(key, f"missing in [{dotted(key[:-1])}]; expected {expected}")

    def is_wrong(self, key: Key) -> bool:
        """Return whether the value of `key`, or of a parent, is known to be wrong."""
        if self.wrong and any(key[:length] in self.wrong for length in range(1, len(key) + 1)):
            return True
        return bool(self.document.broken) and (
            self.document.is_broken(key) or (self.axis != () and self.document.is_broken((*self.axis, *key)))
        )

    def raise_all(self) -> None:
        """Raise RigError with all errors in the file's order, if any."""
        if self.found:
            ordered = [text for _, text in sorted(self.found, key=lambda item: item[0])]
            said_once = list(dict.fromkeys(ordered))  # shared by several axes
            raise RigError(said_once, self.problems, list(dict.fromkeys(self.lacking)))


def _option(override: str) -> str:
    """Return the option that gave an override: ``--law NAME`` for what `Rig.with_law` sets, else ``--set``."""
    law = _LAW.fullmatch(override)
    return f"--set {override}" if law is None else f"--law {law[1]}"


def _depth(values: Any, key: Key) -> int:
    """Return the number of leading parts of `key` that exist in `values`."""
    for depth, part in enumerate(key):
        inside = part in values if isinstance(values, Mapping) else isinstance(part, int) and isinstance(values, list)
        if not inside or (isinstance(part, int) and part >= len(values)):
            return depth
        values = values[part]
    return len(key)


def dotted(key: Key) -> str:
    """Return a key as ``--set`` takes it."""
    return ".".join(map(str, key))


def toml_value(value: Any) -> str:
    """Spell a value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return repr(value) if isinstance(value, float) else str(value)


def shown(value: Any) -> str:
    """Spell a value as TOML, shortened for a message."""
    text = printable(toml_value(value))
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def nearest(text: str, choices: Iterable[str]) -> str:
    """Return "; did you mean ...?" for the choice nearest to `text`, or ""."""
    by_small, small = {word.lower(): word for word in choices}, text.lower()
    words = difflib.get_close_matches(small, by_small, 1, 0.6)
    words = words or [word for word in by_small if len(small) > 2 and word.startswith(small)]  # a name without its unit
    return f"; did you mean '{by_small[words[0]]}'?" if words else ""


def number_hint(value: str, unit: str) -> str:
    """Return a hint "; ..." for a number written with a unit or a decimal comma, else "".

    Parameters
    ----------
    value : the text in place of a number
    unit : of the number, or ""
    """
    text = value.strip()
    if _WITH_COMMA.fullmatch(text):
        return f"; write {text.replace(',', '.')}, with a decimal point"
    match = _WITH_UNIT.fullmatch(text)
    if match is None:
        return ""
    number, unit_of_text = match[1], match[2].strip()
    prefix = unit_of_text if unit_of_text in ("k", "M") else unit_of_text.removesuffix(unit)
    if prefix in PREFIXES and (unit or prefix):
        return (
            f"; leave the unit off: {float(number) * PREFIXES[prefix]:.12g}"
            if prefix
            else (f"; leave the unit off: {number}")
        )
    return "; leave the unit off" + (f": the number is in {unit}" if unit else "")
