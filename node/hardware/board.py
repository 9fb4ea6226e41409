"""A Python class as a converter: ``read() -> mapping`` and ``write(mapping)``, once per period."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from coulombus.node.hardware.channels import HardwareError, SafeWrite, finite

__all__ = ["Board", "BoardInput", "BoardOutput", "load_class"]


def load_class(place: str, folder: Path = Path()) -> type[Any]:
    """Return the class of ``FILE.py:Class``, relative to `folder`, or ``module:Class``.

    Raises
    ------
    HardwareError
        The class does not exist, or cannot be imported.
    """
    where, _, name = place.rpartition(":")
    if not where or not name:
        raise HardwareError(f"{place!r}: expected FILE.py:Class or module:Class")
    try:
        if where.endswith(".py"):
            path = folder / where
            spec = importlib.util.spec_from_file_location(f"coulombus_board_{path.stem}", path)
            if spec is None or spec.loader is None:
                raise HardwareError(f"{path}: it is not a Python file")
            module = importlib.util.module_from_spec(spec)
            sys.modules[spec.name] = module
            spec.loader.exec_module(module)
        else:
            module = importlib.import_module(where)
    except HardwareError:
        raise
    except Exception as error:
        raise HardwareError(f"{place}: it cannot be imported: {error}") from error
    board_class = getattr(module, name, None)
    if not isinstance(board_class, type) or not all(
        callable(getattr(board_class, word, None)) for word in ("read", "write")
    ):
        raise HardwareError(f"{place}: expected a class with read() and write(values)")
    return board_class


class Board:
    """Instance of such a class, created without arguments.

    Its exceptions and invalid results are hardware failures. `read` returns a number for each input,
    and for each output its present value.
    """

    def __init__(self, place: str, folder: Path = Path()) -> None:
        where, _, name = place.rpartition(":")
        self.place = f"{folder / where}:{name}" if where.endswith(".py") else place
        board_class = load_class(place, folder)
        self.path = inspect.getfile(board_class)
        """File of the class, which is claimed."""
        try:
            self._object = board_class()
        except Exception as error:
            raise HardwareError(f"{place}: it cannot be made: {error!r}") from error
        self._values: Mapping[str, object] = {}

    def refresh(self) -> None:
        """Call `read`."""
        try:
            values = self._object.read()
        except Exception as error:
            raise HardwareError(f"{self.place}: read() raised {error!r}") from error
        if not isinstance(values, Mapping):
            raise HardwareError(f"{self.place}: read() returned {type(values).__name__}, expected a mapping")
        self._values = values

    def value(self, name: str) -> float:
        """Return the result of `read` for a name."""
        if name not in self._values:
            raise HardwareError(f"{self.place}: read() gave no {name!r}; it gave {', '.join(map(str, self._values))}")
        return finite(self._values[name], f"{self.place}: {name}")

    def write(self, values: Mapping[str, float]) -> None:
        """Call `write`."""
        try:
            self._object.write(values)
        except Exception as error:
            raise HardwareError(f"{self.place}: write() raised {error!r}") from error


class BoardInput:
    """A value of `Board.refresh`."""

    def __init__(self, board: Board, name: str) -> None:
        self._board, self._name = board, name

    def read(self) -> float:
        """Return the result of the last `read`."""
        return self._board.value(self._name)


class BoardOutput:
    """A value that is passed to the class by name."""

    def __init__(self, board: Board, name: str) -> None:
        self._board, self._name = board, name
        self.path = board.path

    def write(self, raw: float) -> None:
        """Output the value."""
        self._board.write({self._name: raw})

    def read_back(self) -> float:
        """Return the output value that the class reports."""
        self._board.refresh()
        return self._board.value(self._name)

    def spelled(self, raw: float) -> float:
        """Return the value itself."""
        return raw

    def orders(self, raw: float) -> Sequence[SafeWrite]:
        """Return the call that outputs the value."""
        return (SafeWrite(self._board.place, json.dumps({self._name: raw})),)
