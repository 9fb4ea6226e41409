"""A problem with a device of a rig: place, reason, remedy."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Problem"]


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
