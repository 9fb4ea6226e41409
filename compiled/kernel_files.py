"""Numba's files of machine code, held against damage; and Ctrl-C, held against numba. `compiled.decorator` imports this, after it has chosen the
place.

A file that a full disk or a power cut has cut short would end every start with an exception, and two processes that save at the same time may
name the same file for different signatures. So each file carries a CRC-32 and its key: what does not fit is told once, dropped and compiled
again. A place that takes no more is told once, too.

LLVM calls back into Python; an exception of a signal's handler that is raised there is printed and lost. While a kernel is compiled or loaded such
an exception is kept, and raised behind it.
"""

from __future__ import annotations

import pickle
import sys
import threading
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile

from coulombus.compiled.kernel_cache import say

__all__ = ["KernelCache", "interrupts_kept", "keep_interrupts"]


class DamagedError(ValueError):
    """A file is not what was saved."""


_told: set[str] = set()


def _tell_once(text: str) -> None:
    if text not in _told:
        _told.add(text)
        say(text)


class _Files(IndexDataCacheFile):  # type: ignore[misc]
    """The index of one function and its data files, each pickle behind its CRC-32, the data with their key."""

    def _dump(self, obj: Any) -> bytes:
        data: bytes = super()._dump(obj)
        return zlib.crc32(data).to_bytes(4, "little") + data

    def _load_index(self) -> dict[Any, str]:
        try:
            with open(self._index_path, "rb") as file:
                if pickle.load(file) != self._version:
                    return {}
                stamp, overloads = _whole(file.read())
        except FileNotFoundError:
            return {}
        return overloads if stamp == self._source_stamp else {}

    def _load_data(self, name: str) -> Any:
        return _whole(Path(self._data_path(name)).read_bytes())

    def save(self, key: Any, data: Any) -> None:
        super().save(key, (key, data))

    def load(self, key: Any) -> Any:
        found = super().load(key)
        return found[1] if found is not None and found[0] == key else None


def _whole(raw: bytes) -> Any:
    if len(raw) < 4 or zlib.crc32(raw[4:]) != int.from_bytes(raw[:4], "little"):
        raise DamagedError("its CRC-32 differs")
    return pickle.loads(raw[4:])


class KernelCache(FunctionCache):  # type: ignore[misc]
    """The cache of one kernel."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        stamp = self._impl.locator.get_source_stamp()
        self._cache_file = _Files(self._cache_path, self._impl.filename_base, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled function; None where there is none, or none that is whole."""
        try:
            with interrupts_kept():
                return super().load_overload(sig, target_context)
        except Exception as error:  # a damaged pickle raises whatever its bytes say
            if hasattr(error, "exit_status"):  # a signal's
                raise
            self._forget()
            return None

    def _forget(self) -> None:
        _tell_once(f"the cache of compiled code in {Path(self._cache_path).parent} was damaged; it is compiled again")
        try:
            self.flush()
        except OSError:
            self.disable()

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function, where that is possible."""
        try:
            super().save_overload(sig, data)
        except (OSError, ValueError, EOFError, pickle.PickleError) as error:
            reason = getattr(error, "strerror", None) or error
            place = Path(self._cache_path).parent
            _tell_once(f"compiled code cannot be kept in {place} ({reason}); the next start compiles again")
            self.disable()


class _Interrupts(event.Listener):  # type: ignore[misc]
    """Keeps what a signal's handler raised where nobody could catch it."""

    def __init__(self) -> None:
        self._depth = 0
        self._lost: BaseException | None = None
        self._before: Callable[[Any], Any] = sys.unraisablehook

    def _hook(self, unraisable: Any) -> None:
        error = unraisable.exc_value
        if isinstance(error, KeyboardInterrupt) or hasattr(error, "exit_status"):
            self._lost = error
        else:
            self._before(unraisable)

    def on_start(self, event: Any) -> None:
        if threading.current_thread() is not threading.main_thread():
            return  # handlers run in the main thread only
        if self._depth == 0:
            self._before, sys.unraisablehook = sys.unraisablehook, self._hook
        self._depth += 1

    def on_end(self, event: Any) -> None:
        if threading.current_thread() is not threading.main_thread():
            return
        self._depth -= 1
        if self._depth == 0:
            sys.unraisablehook = self._before
        lost, self._lost = self._lost, None
        if lost is not None:
            raise lost


_interrupts = _Interrupts()


@contextmanager
def interrupts_kept() -> Iterator[None]:
    """Raise at the end what a signal's handler raised meanwhile and nobody could catch."""
    _interrupts.on_start(None)
    try:
        yield
    finally:
        _interrupts.on_end(None)


def keep_interrupts() -> None:
    """Do so whenever numba compiles."""
    event.register("numba:compile", _interrupts)
