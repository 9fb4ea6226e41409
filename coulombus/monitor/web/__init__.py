"""The page: a bus live in a browser (``coulombus watch --web``)."""

__all__ = ["WebError"]


class WebError(Exception):
    """The page cannot be served; the text says why, and what to do."""

    exit_status = 2
