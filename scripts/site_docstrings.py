"""Tells mkdocstrings how docstrings of this project name what they take: `name : what it is`.

NumPy's style has the type behind the colon. Here the annotation has it, and the words behind the
colon are the description.
"""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension, Object

__all__ = ["Described"]

SECTION = re.compile(r"^(Parameters|Attributes)\n-+\n(.*?)(?=^\S[^\n]*\n-{3,}\n|\Z)", re.M | re.S)
ENTRY = re.compile(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*) : (.+)$", re.M)


class Described(Extension):
    """Moves each description from the colon to a line of its own."""

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Look at one docstring."""
        if obj.docstring is not None:
            obj.docstring.value = SECTION.sub(lambda found: ENTRY.sub(r"\1\n    \2", found[0]), obj.docstring.value)
