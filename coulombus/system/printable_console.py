"""rich's console, which shows no control character of others' text (`system.foreign_text`)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from coulombus.system.foreign_text import printable

__all__ = ["PrintableConsole"]


class PrintableConsole(Console):
    """Tables, live screens and progress bars are printed by this one alone."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Make a text of a string: before it is measured, so that a table's columns fit."""
        return super().render_str(printable(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Make segments of whatever is printed; rich's own controls are none of their texts."""
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                yield Segment(printable(segment.text), segment.style)
