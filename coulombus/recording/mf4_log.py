"""python-can's reader of .mf4 logs, with the library that it needs.

The verbs leave `asammdf` out when python-can is imported, as it takes most of a second
(`coulombus.cli`). Who reads such a log gets it here.
"""

from __future__ import annotations

import importlib

__all__ = ["ready"]


def ready() -> None:
    """Give python-can's reader its library, where that is installed."""
    import can.io.mf4 as reader

    if vars(reader)["asammdf"] is None:
        importlib.reload(reader)  # in its own namespace, in which the classes that were made look
