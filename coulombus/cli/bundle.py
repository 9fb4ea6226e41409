"""Bundle related options into one parameter of a verb."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import fields
from functools import update_wrapper
from typing import Any, TypeVar

__all__ = ["bundle", "repeated"]

F = TypeVar("F", bound=Callable[..., Any])


def bundle(name: str, made: type[Any], *options: Callable[[F], F]) -> Callable[[F], F]:
    """Return a decorator that adds `options` to a verb and passes their values as the parameter `name`.

    Parameters
    ----------
    made : a dataclass; its fields have the names of the options' parameters
    """
    names = [field.name for field in fields(made)]

    def add(function: F) -> F:
        def verb(*args: Any, **values: Any) -> Any:
            own = {key: values.pop(key) for key in names}
            return function(*args, **values, **{name: made(**own)})

        decorated: Any = update_wrapper(verb, function)
        for option in reversed(options):
            decorated = option(decorated)
        return decorated  # type: ignore[no-any-return]

    return add


def repeated(option: str, texts: Iterable[str]) -> list[str]:
    """Return command-line words that repeat an option for each text, for another process."""
    return [word for text in texts for word in (option, text)]
