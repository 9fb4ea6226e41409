"""The page: a bus live in a browser (``coulombus watch --web``)."""

from __future__ import annotations

from coulombus.system.errors import CoulombusError

__all__ = ["WebError"]


class WebError(CoulombusError):
    """The page cannot be served; the text says why, and what to do."""

    exit_status = 2
