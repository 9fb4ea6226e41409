"""The command line: one file per verb, named after it; the only package that uses click."""

from __future__ import annotations

import sys

__all__: list[str] = []


class _WithoutMf4:
    """Import hook that hides asammdf from python-can until a log needs it (`coulombus.recording.logs.mf4`).

    If asammdf is installed (the extra ``export``), python-can would load it and pandas on import:
    each start of a verb would take 0.7 s of processor time longer.
    """

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        """Hide `asammdf` from python-can; other importers are not affected."""
        if name == "asammdf" and _imported_by("can.io.mf4") and not _imported_by("coulombus.recording.logs.mf4"):
            raise ImportError("left out by coulombus.cli", name=name)


def _imported_by(module: str) -> bool:
    frame = sys._getframe()
    while frame.f_back is not None:
        frame = frame.f_back
        if frame.f_globals.get("__name__") == module:
            return True
    return False


sys.meta_path.insert(0, _WithoutMf4)
