"""Functions that kernels call by their address in a record.

A kernel contains the machine code of each kernel that it calls, and is compiled with it. A function
that few records need is compiled apart from them, on its first use: `part_address` returns its
address for a field of the record, and `call_part` calls it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, TypeAlias

import numpy as np

from coulombus.kernels.decorator import JIT_DISABLED, cacheable

import numba  # isort: skip  (after kernels.decorator, which sets the cache directory)

__all__ = ["PartFunction", "call_part", "part_address"]

PartFunction: TypeAlias = Callable[[Any, int, int, int], int]
"""Function of a record and three integers."""

_plain: dict[int, PartFunction] = {}
_compiled: dict[int, Any] = {}
"""Functions by address; one that has an address is never freed."""


@cache
def part_address(function: PartFunction, dtype: np.dtype[np.void]) -> int:
    """Return the address of `function`, compiled or loaded from the cache for records of this type.

    It is valid in this process and in those that it forks.
    """
    if JIT_DISABLED:
        _plain[id(function)] = function
        return id(function)
    dispatcher: Any = numba.njit(nogil=True, error_model="numpy", cache=cacheable(function))(function)
    i8 = numba.int64
    dispatcher.compile(i8(numba.from_dtype(dtype), i8, i8, i8).args)
    pointer = numba.types.CompileResultWAP(dispatcher.overloads[dispatcher.signatures[0]])
    _compiled[pointer.address] = pointer
    return int(pointer.address)


if JIT_DISABLED:

    def call_part(address: int, record: Any, a: int, b: int, c: int) -> int:
        """Call the function at an address."""
        return _plain[int(address)](record, a, b, c)

else:
    from llvmlite import ir
    from numba.extending import intrinsic

    @intrinsic  # type: ignore[untyped-decorator]
    def call_part(typingctx: Any, address: Any, record: Any, a: Any, b: Any, c: Any) -> Any:
        """Call the function at an address."""

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            shape = ir.FunctionType(ir.IntType(64), [value.type for value in args[1:]])
            return builder.call(builder.inttoptr(args[0], shape.as_pointer()), args[1:])

        if not isinstance(record, numba.types.Record):
            return None
        i8 = numba.int64
        return i8(i8, record, i8, i8, i8), codegen
