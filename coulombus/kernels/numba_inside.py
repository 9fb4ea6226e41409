"""The only module that uses numba's internals (`numba.core`).

`borrowed` has no public counterpart: without it each call that passes arrays changes their
reference counts, atomically. `listen` uses numba's event listeners, which its manual describes, but
which are part of `numba.core`.

LLVM calls back into Python; an exception that a signal's handler raises there is printed and lost.
So such an exception is stored during the compilation of a kernel, and raised after it.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba.core import event, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from coulombus.kernels.compile_notice import compiling, count

__all__ = ["Compilations", "borrowed", "listen"]


if numba.config.DISABLE_JIT:

    def borrowed(arrays: Any) -> Any:
        """Return the arrays unchanged."""
        return arrays

else:

    @intrinsic  # type: ignore[untyped-decorator]
    def borrowed(typingctx: Any, arrays: Any) -> Any:
        """Return the same array, or named tuple of arrays, without counting references.

        The caller's own references keep them alive.
        """

        def without_count(context: Any, builder: Any, kind: Any, value: Any) -> Any:
            view = make_array(kind)(context, builder, value=value)
            view.meminfo = ir.Constant(view.meminfo.type, None)
            return view._getvalue()

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            value = args[0]
            if isinstance(arrays, types.Array):
                return without_count(context, builder, arrays, value)
            for k, kind in enumerate(arrays):
                if isinstance(kind, types.Array):
                    item = without_count(context, builder, kind, builder.extract_value(value, k))
                    value = builder.insert_value(value, item, k)
            return value

        if not isinstance(arrays, (types.Array, types.BaseTuple)):  # type: ignore[attr-defined]
            return None
        return arrays(arrays), codegen


class Compilations(event.Listener):  # type: ignore[misc]
    """Reports the first compilation, and stores exceptions that a signal's handler raised during a
    compilation, where nothing could catch them.
    """

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
        """A compilation begins, perhaps nested in another."""
        compiling()
        count()
        if threading.current_thread() is not threading.main_thread():
            return  # handlers run in the main thread only
        if self._depth == 0:
            self._before, sys.unraisablehook = sys.unraisablehook, self._hook
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """A compilation ends: raise the stored exception."""
        if threading.current_thread() is not threading.main_thread():
            return
        self._depth -= 1
        if self._depth == 0:
            sys.unraisablehook = self._before
        lost, self._lost = self._lost, None
        if lost is not None:
            raise lost


def listen() -> None:
    """Listen to numba's compilations from now on."""
    event.register("numba:compile", Compilations())
