"""What a problem with a device of a rig is: where, what, and what to do."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Problem"]


class Problem(NamedTuple):
    """Why a device cannot have a role, or bring-up would be refused, and what to do.

    `accept` is the sentence of ``host.accept`` that acknowledges it; "" where nothing does.
    """

    role: str
    node: str
    object: str
    text: str
    remedy: str
    accept: str = ""

    def __str__(self) -> str:
        return f"{self.text}; {self.remedy}" if self.remedy else self.text
