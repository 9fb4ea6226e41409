"""Errors of an export."""

from __future__ import annotations

__all__ = ["ExportError"]


class ExportError(Exception):
    """Nothing can be made of the recording; the text says why, and what to do."""

    exit_status = 2
