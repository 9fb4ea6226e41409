"""Optional libraries of the extra ``export``."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from coulombus.system.errors import CoulombusError

__all__ = ["EXTRA", "MissingExtra", "library"]

EXTRA = "pip install -e '.[export]' in the clone"


class MissingExtra(CoulombusError, ImportError):
    """A library is not installed; the text names the extra that installs it."""

    exit_status = 2


def library(name: str, what: str) -> Any:
    """Import and return the module `name` for `what`.

    Raises
    ------
    MissingExtra
        It is not installed.
    """
    package = name.partition(".")[0]
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != package:
            raise
        raise MissingExtra(f"{what} needs {package}, which is not installed: {EXTRA}") from None
