"""Functions that kernels call by their address in a record.

A kernel contains the machine code of each kernel that it calls, and is compiled with it. A function
that few records need is compiled apart from them, on its first use: `part_address` returns its
address for a field of a record, and `call_part` calls it.

A part has four arguments: each is a record or an integer.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, TypeAlias

import numpy as np

from coulombus.kernels.decorator import CACHE_DIR, JIT_DISABLED, cacheable
from coulombus.kernels.kernel_cache import alone

import numba  # isort: skip  (after kernels.decorator, which sets the cache directory)

__all__ = ["PartFunction", "call_part", "part_address"]

PartFunction: TypeAlias = Callable[[Any, Any, Any, Any], int]

_plain: dict[int, PartFunction] = {}
_compiled: dict[int, Any] = {}
"""Functions by address; one that has an address is never freed."""


@cache
def part_address(function: PartFunction, *records: np.dtype[np.void]) -> int:
    """Return the address of `function`, compiled or loaded from the cache for these types of its first
    arguments; the others are integers.

    It is valid in this process and in those that it forks.
    """
    if JIT_DISABLED:
        _plain[id(function)] = function
        return id(function)
    dispatcher: Any = numba.njit(nogil=True, error_model="numpy", cache=cacheable(function))(function)
    i8 = numba.int64
    types = (*map(numba.from_dtype, records), i8, i8, i8)[:4]
    with alone(CACHE_DIR, f"{function.__module__}.{function.__qualname__}"):
        dispatcher.compile(i8(*types).args)
    pointer = numba.types.CompileResultWAP(dispatcher.overloads[dispatcher.signatures[0]])
    _compiled[pointer.address] = pointer
    return int(pointer.address)


if JIT_DISABLED:

    def call_part(address: int, a: Any, b: Any, c: Any, d: Any) -> int:
        """Call the function at an address."""
        return _plain[int(address)](a, b, c, d)

else:
    from llvmlite import ir
    from numba.extending import intrinsic

    @intrinsic  # type: ignore[untyped-decorator]
    def call_part(typingctx: Any, address: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
        """Call the function at an address."""

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            shape = ir.FunctionType(ir.IntType(64), [value.type for value in args[1:]])
            return builder.call(builder.inttoptr(args[0], shape.as_pointer()), args[1:])

        i8 = numba.int64
        types = [kind if isinstance(kind, numba.types.Record) else i8 for kind in (a, b, c, d)]
        return i8(i8, *types), codegen
