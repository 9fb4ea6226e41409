"""The only decorators that compile functions in this project, and the cache for their machine code.

They use numba's public interface: ``numba.njit`` with ``cache=True``. The cache is in a folder of
this project, which `kernels.kernel_cache` chooses by the sources of all kernels
(`kernels.sources`): numba's cache checks the file of the function that it compiles, not those of
its callees.

Import this module before `numba`. A user's ``NUMBA_CACHE_DIR`` takes precedence (as the parent of
this project's folders); ``NUMBA_DISABLE_JIT=1`` runs every kernel as plain Python.

Kernels take records: a record is one pointer, and an array in a record costs nothing to pass. Data
without a fixed size (a log, a row of devices) is an array in a named tuple, which only Python's
rare calls pack. A law's function is an argument of its own: in a tuple numba would type it as a
value that the disk cache cannot keep.

Numba compiles a function anew for each literal with which another kernel calls it, because the
literal 2 has its own type. Where that would compile a large function twice, the number is a
`constant`.

A call that passes arrays has a cost: an array is a structure of seven words, and its reference
count changes atomically on entry and exit. `inlined` makes a kernel part of its caller;
`kernels.numba_inside.borrowed` returns arrays whose references are not counted.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from coulombus.kernels.kernel_cache import SCOPES, alone, choose, is_cached
from coulombus.kernels.sources import source_key, source_stamp

__all__ = ["CACHE_DIR", "JIT_DISABLED", "Entry", "cacheable", "constant", "inlined", "is_warm", "kernel", "warming"]


@contextmanager
def _without(module: str) -> Iterator[None]:
    """Hide `module` while another module is imported; a loaded module stays."""
    if module in sys.modules:
        yield
        return
    sys.modules[module] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules[module]


F = TypeVar("F", bound=Callable[..., Any])

CACHE_DIR = choose(source_key())
"""Folder of the machine code; None if no place is writable."""

with _without("coverage"):  # numba would import it to see whether it measures, which delays the start
    import numba  # numba reads NUMBA_CACHE_DIR only now
import numpy as np  # noqa: E402

numba.config.CACHE_DIR = str(CACHE_DIR or "")
JIT_DISABLED = bool(numba.config.DISABLE_JIT)

from coulombus.kernels import numba_inside  # noqa: E402

numba_inside.listen()


def constant(value: int) -> int:
    """Return a number that kernels pass on as an int64, like a variable."""
    return value if JIT_DISABLED else np.int64(value)  # type: ignore[return-value]


def cacheable(function: Callable[..., Any]) -> bool:
    """Tell whether the machine code of `function` can be cached: it is defined in a file, and there is a
    cache folder.
    """
    return CACHE_DIR is not None and os.path.isfile(function.__code__.co_filename)


def kernel(function: F) -> F:
    """Compile `function` on its first call: no GIL, cached on disk, C's arithmetic errors (no
    exceptions).

    Inside a kernel all integers are int64: mixing int64 with uint64 gives float64.
    """
    return _compiled(function)


def inlined(function: F) -> F:
    """Compile `function` as `kernel` does; LLVM makes it part of each of its callers.

    Numba's own inlining copies code before it has types, and is slow to compile.
    """
    return _compiled(function, forceinline=True)


def _compiled(function: F, **options: Any) -> F:
    compiled: F = numba.njit(nogil=True, error_model="numpy", cache=cacheable(function), **options)(function)
    return compiled


def _name(function: Callable[..., Any]) -> str:
    return f"{function.__module__}.{function.__qualname__}"


def _warmed(scope: str) -> str:
    return f"warm-{scope}-{source_stamp()}"


def is_warm(scope: str = SCOPES[-1]) -> bool:
    """Tell whether `warming` has ended for these sources, so that no start of this scope compiles."""
    return JIT_DISABLED or any(is_cached(CACHE_DIR, _warmed(wider)) for wider in SCOPES[SCOPES.index(scope) :])


@contextmanager
def warming(scope: str = SCOPES[-1]) -> Iterator[None]:
    """Compile the kernels of a scope in this context, by processes of `kernels.kernel_cache.leave_lock_to_parent`.

    Every other process that needs a kernel waits for its end.
    """
    with alone(CACHE_DIR, _warmed(scope)):
        yield


_loaded: dict[tuple[Any, ...], Callable[..., Any]] = {}
"""Compiled functions, by kernel and kinds of arguments: `numba.typeof` takes milliseconds for a world's records."""


def _kind_of(argument: Any) -> Any:
    """Return what decides the type of an argument."""
    if isinstance(argument, tuple):
        return type(argument), *map(_kind_of, argument)
    if isinstance(argument, np.ndarray):
        flags = argument.flags
        layout = flags.c_contiguous, flags.f_contiguous, flags.writeable, flags.aligned
        return type(argument), argument.dtype, argument.ndim, *layout
    if isinstance(argument, np.generic):
        return type(argument), argument.dtype
    return type(argument) if isinstance(argument, bool | int | float | None) else numba.typeof(argument)


class Entry:
    """A kernel that Python calls often, always with arguments of the same types.

    Numba's dispatcher examines the type of each argument at each call, which is slow for arrays of
    records; after the first call an entry bypasses the dispatcher.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._entry: Callable[..., Any] | None = function if JIT_DISABLED else None

    def load(self, *arguments: Any) -> Callable[..., Any]:
        """Compile the kernel for arguments like these, or load it from the cache.

        Return the compiled function without calling it. If several processes need a kernel that is not
        in the cache, only one of them compiles it.
        """
        if self._entry is None:
            dispatcher: Any = self._function
            key = dispatcher, *map(_kind_of, arguments)
            if key not in _loaded:
                with alone(CACHE_DIR, _name(self._function)):
                    _loaded[key] = dispatcher.compile(tuple(map(numba.typeof, arguments)))
            self._entry = _loaded[key]
        assert self._entry is not None
        return self._entry

    def __call__(self, *arguments: Any) -> Any:
        """Call the kernel."""
        return (self._entry or self.load(*arguments))(*arguments)
