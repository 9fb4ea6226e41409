"""Source of a friction law, attached to a recording.

It documents the displayed law, and a replay compares it with the present source.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from coulombus.eds.regular_file import read_regular
from coulombus.host.laws.laws import LawError, find_law
from coulombus.host.laws.plane.plane_laws import builtin_laws
from coulombus.rigs.rig import Rig

__all__ = ["SHA256", "SOURCE", "LawSource", "law_attachments", "law_source", "recorded_sha256"]

MOST_BYTES = 1 << 20
SOURCE, SHA256 = "host.law.py", "host.law.sha256"
"""Names of the attachments."""


@dataclass(frozen=True)
class LawSource:
    """A law's name and source text.

    The text is the law's whole file, without its imports. For `karnopp` and `coulomb` it is the function
    alone.
    """

    name: str
    text: bytes

    @property
    def sha256(self) -> str:
        """SHA-256 of the text."""
        return hashlib.sha256(self.text).hexdigest()

    @property
    def attachments(self) -> dict[str, bytes]:
        """The attachments of a recording with this law."""
        return {SOURCE: self.text, SHA256: self.sha256.encode()}


def law_source(rig: Rig) -> LawSource | None:
    """Return the source of the rig's law, without running it; None if it cannot be read."""
    name = rig.law_function
    place = name.rpartition(":")[0]
    law = builtin_laws(rig).get(name)
    if law is not None:
        text = inspect.getsource(
            law.function if law.uses_mode_keys else inspect.getmodule(law.function) or law.function
        )
        return LawSource(name, text.encode())
    try:
        if place.endswith(".py"):
            return LawSource(name, read_regular(find_law(place, rig.law_directory), MOST_BYTES))
        spec = importlib.util.find_spec(place)
        return None if spec is None or spec.origin is None else LawSource(name, Path(spec.origin).read_bytes())
    except (OSError, LawError, ImportError, ValueError):
        return None


def law_attachments(rig: Rig) -> dict[str, bytes]:
    """Return the attachments for the rig's law; empty if its source cannot be read."""
    source = law_source(rig)
    return {} if source is None else source.attachments


def recorded_sha256(attachments: Mapping[str, bytes]) -> str | None:
    """Return the hash of the law's source in a recording; None without one."""
    return attachments[SHA256].decode(errors="replace") if SHA256 in attachments else None
