"""Errors of an export."""

from __future__ import annotations

from coulombus.system.errors import CoulombusError

__all__ = ["ExportError"]


class ExportError(CoulombusError):
    """Nothing can be made of the recording; the text says why, and what to do."""

    exit_status = 2
