"""Detect the kind of a TOML document: a rig, faults, a script, a sweep or a study."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

__all__ = ["of_another_kind"]


class FileKind(NamedTuple):
    """Name of a kind of file, how it is passed, and keys of which it has at least one."""

    name: str
    given_by: str
    keys: frozenset[str]


KINDS: Mapping[str, FileKind] = MappingProxyType(
    {
        "rig": FileKind("a rig file", "--rig FILE", frozenset({"mechanics", "motor", "brake", "axis"})),
        "faults": FileKind("a fault file", "--faults FILE", frozenset({"fault", "controller", "noise"})),
        "script": FileKind("a script", "--script FILE", frozenset({"at"})),
        "sweep": FileKind("a sweep", "coulombus sweep FILE", frozenset({"vary", "design"})),
        "study": FileKind("a study", "coulombus experiment FILE", frozenset({"method", "question", "condition"})),
    }
)


def of_another_kind(values: Mapping[str, Any], kind: str) -> str | None:
    """Return the kind of a document that is not of `kind`, and how to pass it; None if it may be of `kind`."""
    if KINDS[kind].keys & values.keys():
        return None
    other = next((candidate for candidate in KINDS.values() if candidate.keys & values.keys()), None)
    if other is None:
        return None
    return f"this is {other.name} ({other.given_by}); expected {KINDS[kind].name} ({KINDS[kind].given_by})"
