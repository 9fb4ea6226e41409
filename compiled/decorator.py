"""The one way this project compiles a function, and where the machine code is kept.

What is kept of a kernel is bound to its own source file and to all that it imports
(`compiled.sources`); `compiled.kernel_cache` says where it stands, and what is removed;
`compiled.kernel_files` lets no two processes compile the same.

Import this module before `numba`. ``NUMBA_CACHE_DIR`` set by the user wins (ours are
sub-directories of it all the same); ``NUMBA_DISABLE_JIT=1`` runs every kernel as plain Python.

Kernels take records: a record is one pointer, and an array in a record costs nothing to pass. What
has no fixed size (a log, a row of devices) comes as an array in a named tuple; 23 of them take
`Entry` 10 us (6 us one by one), which only Python's rare calls pay. A law's function stands beside
the tuples: in a tuple numba would type it as a value that the disk cache cannot keep.

Two ways make a call cheap for the few calls that every frame makes. A call that passes five arrays
costs about 25 ns: an array is a structure of seven words, and its reference is counted atomically
on the way in and out. `inlined` makes a kernel part of its caller; `borrowed` returns arrays whose
references are not counted.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from coulombus.compiled.kernel_cache import choose
from coulombus.compiled.notice import compiling
from coulombus.compiled.sources import ROOT, source_key

__all__ = [
    "CACHE_DIR",
    "JIT_DISABLED",
    "Entry",
    "borrowed",
    "cached",
    "compile_together",
    "inlined",
    "kept",
    "kernel",
    "taken",
]


@contextmanager
def _without(module: str) -> Iterator[None]:
    """Let `module` be absent while another one is imported; one that is loaded stays."""
    if module in sys.modules:
        yield
        return
    sys.modules[module] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules[module]


F = TypeVar("F", bound=Callable[..., Any])

CACHE_DIR = choose(source_key(ROOT))
"""Where the machine code is kept; None where no place can be written."""

with _without("coverage"):  # numba would load it, a tenth of a start, to ask whether it measures
    import numba  # only now does numba read NUMBA_CACHE_DIR
import numpy as np  # noqa: E402
from numba.core import cgutils, event, types  # noqa: E402
from numba.core.imputils import impl_ret_untracked  # noqa: E402
from numba.extending import intrinsic  # noqa: E402
from numba.np.arrayobj import make_array  # noqa: E402

from coulombus.compiled.dispatcher import BodyCache, KernelDispatcher, fits  # noqa: E402
from coulombus.compiled.kernel_files import KernelCache, keep_interrupts  # noqa: E402
from coulombus.compiled.record_pointer import read_by_address  # noqa: E402

numba.config.CACHE_DIR = str(CACHE_DIR or "")
keep_interrupts()
JIT_DISABLED = bool(numba.config.DISABLE_JIT)
if not JIT_DISABLED:
    read_by_address()


class _Compilations(event.Listener):  # type: ignore[misc]
    """Tells of the first of them."""

    def on_start(self, event: Any) -> None:
        compiling()

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Compilations())


def cached(compiled: F) -> F:
    """Let what `numba.njit` returned be kept on disk; return it."""
    dispatcher: Any = compiled
    if not JIT_DISABLED and CACHE_DIR is not None:
        dispatcher._cache = KernelCache(dispatcher.py_func, dispatcher.targetoptions)
    return compiled


OPTIONS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""Of all kernels. Nobody takes a kernel's address, so its wrapper for C is left out."""


def kernel(function: F) -> F:
    """Compile `function` on its first call: no GIL, cached on disk, C's arithmetic errors (no
    exceptions). What is compiled of it, and when: `compiled.dispatcher`.

    Inside a kernel all integers are int64: mixing int64 with uint64 gives float64.
    """
    return _compiled(function, OPTIONS)


def _compiled(function: F, options: Mapping[str, Any]) -> F:
    if JIT_DISABLED or "<locals>" in function.__qualname__ or not fits():
        plain: F = numba.njit(**options)(function)
        return cached(plain)
    dispatcher: Any = KernelDispatcher(function, targetoptions={**options, "nopython": True, "boundscheck": None})
    if CACHE_DIR is not None:
        dispatcher.body_cache = KernelCache(function, {**options, "part": "body"}, BodyCache)
    compiled: F = cached(dispatcher)
    return compiled


def inlined(function: F) -> F:
    """Compile `function` as `kernel` does; LLVM makes it part of each of its callers.

    Numba's own way copies a caller once for each call: a third of what `run` took.
    """
    return _compiled(function, {**OPTIONS, "forceinline": True})


if JIT_DISABLED:

    def borrowed(arrays: Any) -> Any:
        """Return the arrays as they are."""
        return arrays

else:

    @intrinsic  # type: ignore[untyped-decorator]
    def borrowed(typingctx: Any, arrays: Any) -> Any:
        """Return the same array, or named tuple of arrays, without counting references.

        The caller's own keep them alive.
        """

        def without_count(context: Any, builder: Any, kind: Any, value: Any) -> Any:
            view = make_array(kind)(context, builder, value=value)
            view.meminfo = cgutils.get_null_value(view.meminfo.type)
            return view._getvalue()

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            value = args[0]
            if isinstance(arrays, types.Array):
                value = without_count(context, builder, arrays, value)
            else:
                for k, kind in enumerate(arrays):
                    if isinstance(kind, types.Array):
                        item = without_count(context, builder, kind, builder.extract_value(value, k))
                        value = builder.insert_value(value, item, k)
            return impl_ret_untracked(context, builder, arrays, value)

        if not isinstance(arrays, (types.Array, types.BaseTuple)):  # type: ignore[attr-defined]
            return None
        return arrays(arrays), codegen


def _kind(argument: Any) -> Any:
    """Return what an argument's numba type follows from: equal for two arguments only if their
    types are the same.
    """
    if isinstance(argument, np.ndarray):
        flags = argument.flags
        return (
            type(argument),
            argument.dtype,
            argument.ndim,
            flags.c_contiguous,
            flags.f_contiguous,
            flags.writeable,
            flags.aligned,
        )
    if isinstance(argument, np.void):
        return type(argument), argument.dtype
    if isinstance(argument, tuple):
        return type(argument), tuple(map(_kind, argument))
    return numba.typeof(argument)


_entry_points: dict[Any, Callable[..., Any]] = {}
"""By function and kinds of its arguments."""


def _entry_point(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Callable[..., Any]:
    """Return the compiled function for arguments like these.

    Numba's types of a world's records take 5 ms: once a process.
    """
    key = function, tuple(map(_kind, arguments))
    if key not in _entry_points:
        dispatcher: Any = function
        types_of = tuple(map(numba.typeof, arguments))
        dispatcher.compile(types_of)
        _entry_points[key] = dispatcher.overloads[types_of].entry_point
    return _entry_points[key]


class Entry:
    """A kernel that Python calls often, always with arguments of the same types.

    The dispatcher looks at the type of each argument at each call, which takes 40 us for a dozen
    arrays of records; after the first call this goes past it.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._entry: Callable[..., Any] | None = function if JIT_DISABLED else None

    def load(self, *arguments: Any) -> Callable[..., Any]:
        """Compile the kernel for arguments like these, or load it out of the cache.

        It is not called. Return what is called then.
        """
        if self._entry is None:
            self._entry = _entry_point(self._function, arguments)
        return self._entry

    def __call__(self, *arguments: Any) -> Any:
        """Call the kernel."""
        return (self._entry or self.load(*arguments))(*arguments)


def kept(whole: Callable[..., Any]) -> bool:
    """Tell whether nothing is to be compiled for the kernel `whole`, or nothing can be kept."""
    dispatcher: Any = whole
    return JIT_DISABLED or CACHE_DIR is None or bool(dispatcher._cache.kept)


def taken(whole: Callable[..., Any]) -> bool:
    """Tell whether another process compiles the kernel `whole` now."""
    dispatcher: Any = whole
    return not kept(whole) and bool(dispatcher._cache.taken)


def compile_together(whole: Callable[..., Any], parts: Sequence[tuple[Callable[..., Any], tuple[Any, ...]]]) -> bool:
    """Compile what the kernel `whole` calls, each for arguments like these; none is called. Where
    `whole` is kept, its parts are not needed.

    What another process compiles at the moment is left for later. So processes that start at the
    same time share the work: each takes what is not taken. Return whether this one had to wait for
    the last part: then another one goes on with `whole`.
    """
    if kept(whole):
        return False
    left: list[tuple[Any, tuple[Any, ...]]] = [part for part in parts if hasattr(part[0], "body_cache")]
    behind = False
    while left:
        free = next((k for k, (dispatcher, _) in enumerate(left) if not dispatcher.body_cache.taken), None)
        behind = free is None
        dispatcher, arguments = left.pop(free or 0)
        dispatcher.body(tuple(map(numba.typeof, arguments)))
    return behind
