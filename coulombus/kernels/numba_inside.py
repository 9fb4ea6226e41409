"""The one file that uses what stands inside numba, `numba.core`, beyond its public interface.

`borrowed` has no public counterpart: without it each call that passes arrays counts their references,
atomically. `listen` uses numba's event listeners, which its
manual describes, and which stand in `numba.core`.

LLVM calls back into Python; an exception of a signal's handler that is raised there is printed and
lost. While a kernel is compiled such an exception is kept, and raised behind it.
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

from coulombus.kernels.compile_notice import compiling

__all__ = ["Compilations", "borrowed", "listen"]


if numba.config.DISABLE_JIT:

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
    """Tells of the first of them, and keeps what a signal's handler raised where nobody could catch
    it.
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
        """A compilation begins, maybe within another one."""
        compiling()
        if threading.current_thread() is not threading.main_thread():
            return  # handlers run in the main thread only
        if self._depth == 0:
            self._before, sys.unraisablehook = sys.unraisablehook, self._hook
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """It is over: raise what was kept."""
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
