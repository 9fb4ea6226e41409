"""Web page: live view of a bus in a browser (``coulombus watch --web``)."""

from __future__ import annotations

from coulombus.system.errors import CoulombusError

__all__ = ["WebError"]


class WebError(CoulombusError):
    """The page cannot be served; the text has the reason and the remedy."""

    exit_status = 2
