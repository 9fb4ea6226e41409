"""The command line, one file a verb, with the verb's name: the only place that knows click."""

from __future__ import annotations

import sys

__all__: list[str] = []


class _WithoutMf4:
    """python-can's MF4 reader is left without its library until a log is read that needs it
    (`coulombus.recording.mf4_log`).

    Where that is installed (the extra ``export``), python-can loads it and pandas at its own
    import: each start of a verb would take 0.7 s of processor time longer.
    """

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        """Refuse `asammdf` to python-can; whoever else asks is not looked at."""
        if name == "asammdf" and _imported_by("can.io.mf4") and not _imported_by("coulombus.recording.mf4_log"):
            raise ImportError("left out by coulombus.cli", name=name)


def _imported_by(module: str) -> bool:
    frame = sys._getframe()
    while frame.f_back is not None:
        frame = frame.f_back
        if frame.f_globals.get("__name__") == module:
            return True
    return False


sys.meta_path.insert(0, _WithoutMf4)
