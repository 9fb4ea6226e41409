"""What a script hands over, looked at where it comes in: an error names the right call."""

from __future__ import annotations

import os
from collections.abc import Iterable
from numbers import Integral, Real
from typing import Any

from coulombus.system.errors import CoulombusError

__all__ = ["WrongCall", "a_number", "path_text", "texts"]


class WrongCall(CoulombusError, TypeError):
    """An argument is of a type that the call does not take; the text says how to call."""

    exit_status = 2


def path_text(value: Any, name: str, call: str) -> str:
    """Return a file's name as text.

    Parameters
    ----------
    value
        A text, or any os.PathLike of one.
    name, call
        What the argument is called, and the right call: both are told.

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
    """Return a list of texts as a tuple.

    Parameters
    ----------
    values
        The list.
    name, example
        What the argument is called, and an entry that it could have: both are told.

    Raises
    ------
    WrongCall
        It is one text, no list, or an entry is no text.
    """
    if isinstance(values, str):
        raise WrongCall(f"{name} is {values!r}: expected a list, as in {name}=[{values!r}]")
    entries = tuple(values) if isinstance(values, Iterable) and not isinstance(values, (bytes, dict)) else None
    if entries is None:
        raise WrongCall(f"{name} is {values!r}: expected a list, as in {name}=[{example!r}]")
    wrong = next((entry for entry in entries if not isinstance(entry, str)), None)
    if wrong is not None:
        raise WrongCall(f"{name} has {wrong!r} in it: expected texts alone, as in {name}=[{example!r}]")
    return entries


def a_number(value: Any, name: str, example: str, *, whole: bool = False) -> None:
    """Refuse what is no number.

    Parameters
    ----------
    value
        The number; NumPy's are numbers, too. True and False are none.
    name, example
        What the argument is called, and a value that it could have: both are told.
    whole
        Whether it has to be an integer.

    Raises
    ------
    WrongCall
        It is something else.
    """
    if isinstance(value, bool) or not isinstance(value, Integral if whole else Real):
        kind = "an integer" if whole else "a number"
        raise WrongCall(f"{name} is {value!r}: expected {kind}, as in {name}={example}")
