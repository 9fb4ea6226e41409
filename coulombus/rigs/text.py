"""Overrides as ``--set`` takes them, and the effective configuration as TOML."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np

from coulombus.rigs.errors import Source, dotted, toml_value
from coulombus.rigs.toml_lines import Key, Table, split_key

__all__ = ["apply_override", "emit"]


def apply_override(values: dict[str, Any], override: str, source: Source) -> None:
    """Set one key of `values` by "SECTION.KEY=VALUE"; an error is noted in `source`.

    The value is TOML; anything else is taken as a string, so that ``bus.actuation=on_reception`` needs no quotes.
    """
    name, equals, value = override.partition("=")
    parts = split_key(name)
    if not equals or parts is None or not value.strip():
        text = f"--set {override}: cannot be read; expected SECTION.KEY=VALUE, such as mode.active.F_s_Nm=1.0"
        source.found.append((float("inf"), text))
        return
    key: Key = ()
    here: Any = values
    for i, part in enumerate(parts):
        last = i == len(parts) - 1
        step: Any = part
        if isinstance(here, list):
            if not part.isdecimal() or int(part) >= len(here):
                _no_entry(key, part, here, override, source)
                return
            step = int(part)
        elif not isinstance(here, dict):
            source.overrides[(*key, part)] = override
            source.say((*key, part), f"{dotted(key)} is a value, no section; expected SECTION.KEY=VALUE")
            return
        key = (*key, step)
        if last:
            here[step] = _read(value)
        elif isinstance(here, dict):
            here = here.setdefault(step, {})
        else:
            here = here[step]
    source.overrides[key] = override


def _no_entry(key: Key, part: str, entries: list[Any], override: str, source: Source) -> None:
    expected = f"{dotted(key)}.0 to {dotted(key)}.{len(entries) - 1}" if entries else "no further key"
    source.overrides[(*key, part)] = override
    source.say((*key, part), f"there are {len(entries)} entries in {dotted(key)}; expected {expected}")


def _read(value: str) -> Any:
    try:
        read = tomllib.loads(f"value = {value}")
    except (ValueError, RecursionError):
        return value.strip()
    return read["value"] if len(read) == 1 else value.strip()


def emit(values: Table, comment: str) -> str:
    """Return nested sections as TOML text; None is omitted, lists of mappings become arrays of tables."""
    lines = [f"# {line}" for line in comment.splitlines()]
    for name, section in values.items():
        if section is not None:
            _section(lines, name, section)
    return "\n".join(lines) + "\n"


def _section(lines: list[str], name: str, section: Any) -> None:
    if not isinstance(section, Mapping):
        for table in section:
            lines += ["", f"[[{name}]]"]
            _keys(lines, table)
        return
    nested = {key: value for key, value in section.items() if _is_section(value)}
    plain = {key: value for key, value in section.items() if key not in nested and value is not None}
    if plain or not section:
        lines += ["", f"[{name}]"]
        _keys(lines, plain)
    for key, value in nested.items():
        _section(lines, f"{name}.{key}", value)


def _is_section(value: Any) -> bool:
    tables = isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(item, Mapping) for item in value)
    return isinstance(value, Mapping) or tables


def _keys(lines: list[str], section: Table) -> None:
    for key, value in sorted(section.items(), key=lambda item: item[0] != "kind"):
        plain = value.tolist() if isinstance(value, np.ndarray) else value
        if plain is not None:
            lines.append(f"{key} = {toml_value(plain)}")
