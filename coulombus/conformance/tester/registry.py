"""Registry of test functions: ``@case("2.5")`` above the function, with parameters if several cases share it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

from coulombus.conformance.tester.unit import Unit

__all__ = ["FROM_DEFAULTS", "FUNCTIONS", "Test", "case"]

Test: TypeAlias = Callable[[Unit], str | None]
"""A case: raises if the device fails or the case does not apply; returns a remark, or None."""

FUNCTIONS: dict[str, Test] = {}

FROM_DEFAULTS: set[str] = set()
"""Cases that compare with defaults, or store: they start from the device's defaults."""


def case(
    number: str, *, defaults: bool = False, **parameters: Any
) -> Callable[[Callable[..., str | None]], Callable[..., str | None]]:
    """Register the function below as the case `number`; with `defaults` it starts from them."""

    def register(function: Callable[..., str | None]) -> Callable[..., str | None]:
        if number in FUNCTIONS:
            raise ValueError(f"case {number} has two functions")
        FUNCTIONS[number] = partial(function, **parameters)
        if defaults:
            FROM_DEFAULTS.add(number)
        return function

    return register
