"""An immutable mapping of names to models, validated by pydantic: ``[sensor.NAME]`` of the rig file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Generic, TypeVar, get_args

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

__all__ = ["FrozenMap"]

Value = TypeVar("Value")


class FrozenMap(Mapping[str, Value], Generic[Value]):
    """Immutable mapping in the file's order; hashable if its values are."""

    __slots__ = ("pairs",)
    pairs: tuple[tuple[str, Value], ...]

    def __init__(self, pairs: tuple[tuple[str, Value], ...] = ()) -> None:
        object.__setattr__(self, "pairs", pairs)

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{type(self).__name__} cannot be changed")

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.pairs,)

    def __getitem__(self, name: str) -> Value:
        for key, value in self.pairs:
            if key == name:
                return value
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        return (name for name, _ in self.pairs)

    def __len__(self) -> int:
        return len(self.pairs)

    def __hash__(self) -> int:
        return hash(self.pairs)

    def __repr__(self) -> str:
        return f"FrozenMap({dict(self.pairs)!r})"

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate a table of models, then freeze it."""
        (model,) = get_args(source)

        def frozen(value: Any, validate: Callable[[Any], dict[str, Value]]) -> FrozenMap[Value]:
            return value if isinstance(value, cls) else cls(tuple(validate(value).items()))

        def plain(value: FrozenMap[Any]) -> dict[str, Any]:
            return {name: model.model_dump(by_alias=True) for name, model in value.items()}

        return core_schema.no_info_wrap_validator_function(
            frozen,
            handler.generate_schema(dict[str, model]),  # type: ignore[valid-type]
            serialization=core_schema.plain_serializer_function_ser_schema(plain),
        )
