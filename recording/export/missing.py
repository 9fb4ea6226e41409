"""Errors of an export, and the libraries that only some kinds need."""

from __future__ import annotations

from importlib import import_module
from typing import Any

__all__ = ["EXTRA", "ExportError", "library"]

EXTRA = "pip install 'coulombus[export]'"


class ExportError(Exception):
    """Nothing can be made of the recording; the text says why, and what to do."""

    exit_status = 2


def library(name: str, what: str) -> Any:
    """Return the module `name`, which `what` needs.

    Raises
    ------
    ExportError
        It is not installed; the text names the extra that installs it.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != name.partition(".")[0]:
            raise
        raise ExportError(f"{what} needs {name.partition('.')[0]}, which is not installed: {EXTRA}") from None
