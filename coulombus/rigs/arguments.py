"""Argument checks of the Python API; errors show a correct call."""

from __future__ import annotations

import os
from collections.abc import Iterable
from numbers import Integral, Real
from typing import Any

from coulombus.system.errors import CoulombusError

__all__ = ["WrongCall", "a_number", "path_text", "texts"]


class WrongCall(CoulombusError, TypeError):
    """An argument has the wrong type; the text shows a correct call."""

    exit_status = 2


def path_text(value: Any, name: str, call: str) -> str:
    """Return a file's name as text.

    Parameters
    ----------
    value
        A str or os.PathLike.
    name, call
        Name of the argument and a correct call, for the message.

    Raises
    ------
    WrongCall
        It is something else.
    """
    try:
        path = os.fspath(value)
    except TypeError:
        path = None
    if isinstance(path, str):
        return path
    has = f"; this one's name is its path: {value.path!r}" if isinstance(getattr(value, "path", None), str) else ""
    raise WrongCall(f"{name} is {value!r}: expected a file's name, as in {call}{has}")


def texts(values: Any, name: str, example: str) -> tuple[str, ...]:
    """Return a list of str as a tuple.

    Parameters
    ----------
    values
        The list.
    name, example
        Name of the argument and an example entry, for the message.

    Raises
    ------
    WrongCall
        It is a single str, not a list, or an entry is not a str.
    """
    if isinstance(values, str):
        raise WrongCall(f"{name} is {values!r}: expected a list, as in {name}=[{values!r}]")
    entries = tuple(values) if isinstance(values, Iterable) and not isinstance(values, (bytes, dict)) else None
    if entries is None:
        raise WrongCall(f"{name} is {values!r}: expected a list, as in {name}=[{example!r}]")
    not_text = next((entry for entry in entries if not isinstance(entry, str)), None)
    if not_text is not None:
        raise WrongCall(f"{name} has {not_text!r} in it: expected texts alone, as in {name}=[{example!r}]")
    return entries


def a_number(value: Any, name: str, example: str, *, whole: bool = False) -> None:
    """Raise unless `value` is a number.

    Parameters
    ----------
    value
        The number, also one of NumPy's; bools are refused.
    name, example
        Name of the argument and an example value, for the message.
    whole
        Whether it must be an integer.

    Raises
    ------
    WrongCall
        It is something else.
    """
    if isinstance(value, bool) or not isinstance(value, Integral if whole else Real):
        kind = "an integer" if whole else "a number"
        raise WrongCall(f"{name} is {value!r}: expected {kind}, as in {name}={example}")
