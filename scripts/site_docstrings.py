"""Tells mkdocstrings how docstrings of this project name what they take: `name : what it is`.

NumPy's style has the type behind the colon. Here the annotation has it, and the words behind the
colon are the description. Formulas in Sphinx's form become those of the pages (`site_math`).
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from griffe import Extension, Object

sys.path.insert(0, str(Path(__file__).resolve().parent))
from site_math import dollars

__all__ = ["Described"]

SECTION = re.compile(r"^(Parameters|Attributes)\n-+\n(.*?)(?=^\S[^\n]*\n-{3,}\n|\Z)", re.M | re.S)
RAISES = re.compile(r"^(Raises\n-+\n)(.*?)(?=^\S[^\n]*\n-{3,}\n|\Z)", re.M | re.S)
SEVERAL = re.compile(r"^(\S.*(?:\n\S.*)*)\n((?:    .*(?:\n|\Z))+)", re.M)
ENTRY = re.compile(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*) : (.+)$", re.M)


class Described(Extension):
    """Moves each description from the colon to a line of its own, and names each exception apart."""

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Look at one docstring."""
        if obj.docstring is not None:
            text = SECTION.sub(lambda match: ENTRY.sub(r"\1\n    \2", match[0]), dollars(obj.docstring.value))
            obj.docstring.value = RAISES.sub(lambda match: match[1] + SEVERAL.sub(_apart, match[2]), text)


def _apart(match: re.Match[str]) -> str:
    """Return an entry for each of the exceptions that share one."""
    names = [name.strip() for name in match[1].replace("\n", " ").split(",") if name.strip()]
    return "\n".join(f"{name}\n{match[2].rstrip()}" for name in names) + "\n"
