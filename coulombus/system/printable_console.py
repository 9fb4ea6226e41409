"""rich's console, without the control characters of foreign text (`system.foreign_text`)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from coulombus.system.foreign_text import printable

__all__ = ["PrintableConsole"]


class PrintableConsole(Console):
    """The only console for tables, live screens and progress bars."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Convert a string to a text before it is measured, so that a table's columns fit."""
        return super().render_str(printable(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Convert any renderable to segments; rich's own control segments stay."""
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                yield Segment(printable(segment.text), segment.style)
