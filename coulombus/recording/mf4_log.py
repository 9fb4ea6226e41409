"""Enable python-can's reader of .mf4 logs.

The verbs suppress `asammdf` when they import python-can, because it takes most of a second
(`coulombus.cli`). This module loads it for a log that needs it.
"""

from __future__ import annotations

import importlib

__all__ = ["ready"]


def ready() -> None:
    """Load the library of python-can's reader, if installed."""
    import can.io.mf4 as reader

    if vars(reader)["asammdf"] is None:
        importlib.reload(reader)  # in its own namespace, which existing classes use
