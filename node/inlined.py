"""Two ways to make a kernel's call cheap, for the few calls that every frame of the cycle makes.

A call that passes five arrays costs about 25 ns here: each array is a structure of seven words and more, and its
reference is counted atomically on the way in and out. `inlined` makes a kernel part of its caller; `borrowed` returns
an array whose references are not counted. Together they bring a frame that is not the node's own to below 1 ns.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core import cgutils, types
from numba.core.imputils import impl_ret_untracked
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from eds.compiled import JIT_DISABLED  # imported before numba: it says where the machine code is kept

__all__ = ["borrowed", "inlined"]

F = TypeVar("F", bound=Callable[..., Any])


def inlined(function: F) -> F:
    """Compile `function` as `eds.compiled.kernel` does, but into each of its callers."""
    compiled: F = numba.njit(nogil=True, cache=True, error_model="numpy", inline="always")(function)
    return compiled


if JIT_DISABLED:

    def borrowed(array: Any) -> Any:
        """Return the array as it is."""
        return array

else:

    @intrinsic  # type: ignore[untyped-decorator]
    def borrowed(typingctx: Any, array: Any) -> Any:
        """Return the same array without counting its references; the caller's own reference keeps it alive."""

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            view = make_array(array)(context, builder, value=args[0])
            view.meminfo = cgutils.get_null_value(view.meminfo.type)
            return impl_ret_untracked(context, builder, array, view._getvalue())

        if not isinstance(array, types.Array):
            return None
        return array(array), codegen
