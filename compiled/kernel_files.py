"""Numba's files of machine code, held against damage; and Ctrl-C, held against numba.
`compiled.decorator` imports this, after it has chosen the place.

A file that a full disk or a power cut has cut short would end every start with an exception, and
two processes that save at the same time may name the same file for different signatures. So each
file carries a CRC-32 and its key: what does not fit is told once, dropped and compiled again. A
place that takes no more is told once, too.

Only one process compiles a kernel (`_wait_for_turn`): the others wait, and load what it has saved.
What a directory of other sources has kept of a kernel whose own sources are the same is taken from
there.

LLVM calls back into Python; an exception of a signal's handler that is raised there is printed and
lost. While a kernel is compiled or loaded such an exception is kept, and raised behind it.
"""

from __future__ import annotations

import fcntl
import os
import pickle
import struct
import sys
import threading
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.runtime import rtsys
from numba.np import linalg

from coulombus.compiled.kernel_cache import COMPILING, others, say, trusted
from coulombus.compiled.sources import ours, stamp

__all__ = ["KernelCache", "interrupts_kept", "keep_interrupts"]


PATIENCE_S, PAUSE_S = 300.0, 0.02
"""How long a process waits for another one that compiles what it needs, before it does so itself.
"""


class DamagedError(ValueError):
    """A file is not what was saved."""


_told: set[str] = set()


def _tell_once(text: str) -> None:
    if text not in _told:
        _told.add(text)
        say(text)


class _Files(IndexDataCacheFile):  # type: ignore[misc]
    """The index of one function and its data files, each pickle behind its CRC-32, the data with
    their key.

    The index carries the `stamp` of the sources. It is asked for only where it matters: to read all
    the sources costs more than to load the code.
    """

    def __init__(self, directory: str, base: str, stamp: Callable[[], Any], any_stamp: bool) -> None:
        self._stamp, self._any_stamp = stamp, any_stamp
        super().__init__(directory, base, None)

    @property
    def _source_stamp(self) -> Any:
        return self._stamp()

    @_source_stamp.setter
    def _source_stamp(self, none: None) -> None:
        pass

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
        return overloads if self._any_stamp or stamp == self._source_stamp else {}

    def _load_data(self, name: str) -> Any:
        return _whole(Path(self._data_path(name)).read_bytes())

    def give(self, place: Path) -> bool:
        """Copy index and data files to the folder `place`; tell whether there were any."""
        names = self._load_index().values()
        for name in (*names, self._index_name) if names else ():  # the index comes last: it names the others
            with self._open_for_write(str(place / name)) as file:
                file.write(Path(self._data_path(name)).read_bytes())
        return bool(names)

    def save(self, key: Any, data: Any) -> None:
        super().save(key, (key, data))

    def load(self, key: Any) -> Any:
        found = super().load(key)
        return found[1] if found is not None and found[0] == key else None


def _whole(raw: bytes) -> Any:
    if len(raw) < 4 or zlib.crc32(raw[4:]) != int.from_bytes(raw[:4], "little"):
        raise DamagedError("its CRC-32 differs")
    return pickle.loads(raw[4:])


class KernelCache:
    """The cache of one kernel: numba's own, made when it is first needed.

    The options are in the files' names: the same function may be a law, whose address is taken, and
    a kernel, which has none.
    """

    def __init__(
        self, function: Callable[..., Any], options: Mapping[str, Any], numbas: type[FunctionCache] = FunctionCache
    ) -> None:
        self._function, self._make = function, numbas
        self._options = zlib.crc32(repr(sorted(options.items())).encode())
        self._lock: int | None = None  # held while it is compiled

    @cached_property
    def _numbas(self) -> FunctionCache | None:
        try:
            cache = self._make(self._function)
        except RuntimeError:  # it stands in no file
            return None
        self._locator = cache._impl.locator
        self._base = f"{cache._impl.filename_base}.{self._options:08x}"
        cache._cache_file = _Files(cache.cache_path, self._base, self._stamp, any_stamp=ours(self._file))
        return cache

    @property
    def _file(self) -> str:
        return self._function.__code__.co_filename

    @property
    def cache_path(self) -> str:
        """The folder of its files; empty where nothing is kept."""
        return "" if self._numbas is None else str(self._numbas.cache_path)

    def _stamp(self) -> Any:
        return stamp(self._file) if ours(self._file) else self._locator.get_source_stamp()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled function; None where there is none, or none that is whole: the caller
        compiles it then, and nobody else.
        """
        if self._numbas is None:
            return None
        try:
            with interrupts_kept():
                found = self._loaded(sig, target_context)
                if found is None and self._numbas._enabled and self._lock is None:
                    self._lock = _wait_for_turn(Path(self.cache_path), self._base)
                    self._adopt(Path(self.cache_path))
                    found = self._loaded(sig, target_context)
                if found is not None:
                    self.release()
                    return found
        except Exception:  # a damaged pickle raises whatever its bytes say
            self._forget()
        except BaseException:  # a signal's
            self.release()
            raise
        try:
            _import_arraymath()
        except BaseException:
            self.release()
            raise
        return None

    def _loaded(self, sig: Any, target_context: Any) -> Any:
        """Load as numba's `load_overload` does, without its `refresh`: that registers all that a
        kernel could call, an eighth of a start's time. Who compiles does so itself.
        """
        assert self._numbas is not None
        rtsys.initialize(target_context)
        return self._numbas._load_overload(sig, target_context)

    def _adopt(self, place: Path) -> None:
        """Take over what another state of the sources has kept, where this kernel is the same in
        both.
        """
        if not ours(self._file) or (place / f"{self._base}.nbi").exists():
            return
        for other in filter(trusted, others(place.parent)):
            with suppress(OSError, ValueError, EOFError, pickle.PickleError):
                if _Files(str(other / place.name), self._base, self._stamp, any_stamp=False).give(place):
                    return

    def _forget(self) -> None:
        _tell_once(f"the cache of compiled code in {Path(self.cache_path).parent} was damaged; it is compiled again")
        try:
            self.flush()
        except OSError:
            self.disable()

    def flush(self) -> None:
        """Forget what was kept."""
        if self._numbas is not None:
            self._numbas.flush()

    def disable(self) -> None:
        """Keep nothing from now on."""
        if self._numbas is not None:
            self._numbas.disable()

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function, where that is possible."""
        if self._numbas is None:
            return
        try:
            self._numbas.save_overload(sig, data)
        except (OSError, ValueError, EOFError, pickle.PickleError) as error:
            reason = getattr(error, "strerror", None) or error
            place = Path(self.cache_path).parent
            _tell_once(f"compiled code cannot be kept in {place} ({reason}); the next start compiles again")
            self.disable()
        finally:
            self.release()

    @property
    def kept(self) -> bool:
        """Whether there is anything of it."""
        return self._numbas is not None and Path(self.cache_path, f"{self._base}.nbi").exists()

    @property
    def taken(self) -> bool:
        """Whether another process compiles it now."""
        if self._numbas is None:
            return False
        try:
            file, wanted = _lock_of(Path(self.cache_path), self._base)
        except OSError:
            return False
        try:
            (kind,) = struct.unpack_from("h", fcntl.fcntl(file, fcntl.F_OFD_GETLK, wanted))
            return bool(kind != fcntl.F_UNLCK)
        except OSError:  # a file system without locks
            return False
        finally:
            os.close(file)

    def release(self) -> None:
        """Let another process compile it, where this one waited for its turn."""
        if self._lock is not None:
            lock, self._lock = self._lock, None
            os.close(lock)


def _lock_of(place: Path, base: str) -> tuple[int, bytes]:
    """Return a descriptor of the locks' file, and what asks for the lock of one kernel."""
    file = os.open(place.parent / COMPILING, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    at = zlib.crc32(f"{place.name}/{base}".encode())
    return file, struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, at, 1, 0)


def _wait_for_turn(place: Path, base: str) -> int | None:
    """Wait until no other process compiles the kernel whose files are `base` in `place`.

    Return the lock, None where there is none to be had.

    A kernel's callees are compiled within its own turn. Calls make no circle, so no two processes
    wait for each other.
    """
    try:
        lock, wanted = _lock_of(place, base)
    except OSError:
        return None
    try:
        for _ in range(round(PATIENCE_S / PAUSE_S)):
            with suppress(BlockingIOError):
                fcntl.fcntl(lock, fcntl.F_OFD_SETLK, wanted)
                return lock
            time.sleep(PAUSE_S)
    except OSError:  # a file system without locks
        pass
    except BaseException:  # a signal's
        os.close(lock)
        raise
    os.close(lock)
    return None


def _import_arraymath() -> None:
    """Import what numba imports before it first compiles, without scipy's BLAS: that would take
    half as long as all the rest.

    Without it numba computes `numpy.cov` by a loop of its own; matrix products ask for BLAS when
    they are compiled.
    """
    if "numba.np.arraymath" in sys.modules:
        return

    def none() -> None:
        raise ImportError

    ensure_blas, linalg.ensure_blas = linalg.ensure_blas, none
    try:
        import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = ensure_blas


class _Interrupts(event.Listener):  # type: ignore[misc]
    """Keeps what a signal's handler raised where nobody could catch it."""

    def __init__(self) -> None:
        self._depth = 0
        self._lost: BaseException | None = None
        self._before: Callable[[Any], Any] = sys.unraisablehook

    def _hook(self, unraisable: Any) -> None:
        error = unraisable.exc_value
        if isinstance(error, KeyboardInterrupt):
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
        if event is not None and sys.exc_info()[0] is not None:  # numba's own `Event.is_failed` says the contrary
            cache = event.data["dispatcher"]._cache
            if isinstance(cache, KernelCache):
                cache.release()
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
