"""Errors of an export."""

from __future__ import annotations

from coulombus.system.errors import CoulombusError

__all__ = ["ExportError"]


class ExportError(CoulombusError):
    """The recording cannot be exported; the text has the reason and the remedy."""

    exit_status = 2
