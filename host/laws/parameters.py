"""A law's parameters from a rig file, checked against the law's declaration.

They are in its table [law.NAME], or in [mode.NAME] and [law].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from pydantic import Field, ValidationError, create_model

from coulombus.host.laws.law import Declaration, Parameters
from coulombus.host.laws.laws import BUILTIN_LAWS
from coulombus.rigs.axis import Axis
from coulombus.rigs.errors import Source, nearest, shown
from coulombus.rigs.field_help import explain
from coulombus.rigs.model import Section
from coulombus.rigs.text import apply_override
from coulombus.rigs.toml_lines import read_toml

__all__ = ["axis_parameters", "law_parameters", "set_parameters"]


def axis_parameters(axis: Axis, law: Declaration | None) -> Parameters | None:
    """Return the parameters in the table of an axis' law.

    None for a law without named parameters, and for a law that uses the keys of [mode.NAME] and [law].

    The tables of other built-in laws are checked, too. A table of another user's law is not checked,
    because its declaration is unknown while the law is not loaded.

    Raises
    ------
    coulombus.rigs.rig.RigError
        the text names every error with ``file:line``
    """
    sections = law_parameters(axis.law.tables, law, axis.origin.source(axis.name))
    return None if law is None or law.uses_mode_keys else sections[law.name]


def law_parameters(
    tables: Mapping[str, Mapping[str, Any]], law: Declaration | None, source: Source
) -> dict[str, Parameters]:
    """Return the parameters of the laws with tables, and of `law`, by the laws' names.

    Raises
    ------
    coulombus.rigs.rig.RigError
        the text names every error
    """
    built_in = BUILTIN_LAWS if law is None else {**law.kind.built_in, **BUILTIN_LAWS}
    declared = {name: builtin for name, builtin in built_in.items() if not builtin.uses_mode_keys}
    if law is not None and (not law.uses_mode_keys or law is not BUILTIN_LAWS.get(law.name)):
        declared[law.name] = law
    relevant: dict[str, dict[str, Any]] = {}
    for name, table in tables.items():
        if name in declared:
            relevant[name] = dict(table)
        elif name in BUILTIN_LAWS:
            source.say(
                ("law", name, *list(table)[:1]),
                f"the law {name} has no table: its parameters are in [mode.NAME] and [law]",
            )
        elif hint := nearest(name, declared):
            source.say(("law", name, *list(table)[:1]), f"there is no law '{name}'{hint}")
    if law is not None and law.name in declared:
        relevant.setdefault(law.name, {})
    values = _validated(relevant, declared, source)
    source.raise_all()
    return values


def set_parameters(law: Declaration, overrides: Sequence[str]) -> Parameters:
    """Return a law's parameters: the defaults except for "KEY=VALUE" from ``--set``.

    Raises
    ------
    coulombus.rigs.rig.RigError
        the text names every error
    """
    source = Source("", read_toml(""))
    values: dict[str, dict[str, Any]] = {"law": {law.name: {}}}
    for override in overrides:
        key = override.removeprefix(f"law.{law.name}.")
        apply_override(values, f"law.{law.name}.{key}", source)
    source.overrides = {key: text.removeprefix(f"law.{law.name}.") for key, text in source.overrides.items()}
    source.found = [
        (0.0, f"--set {override}: cannot be read; expected KEY=VALUE, such as {law.names[0]}=1.0")
        for override in overrides
        if not override.partition("=")[2].strip()
    ] or source.found
    source.raise_all()
    sections = _validated(values["law"], {law.name: law}, source)
    source.raise_all()
    return sections[law.name]


def _validated(
    relevant: Mapping[str, Mapping[str, Any]], declared: Mapping[str, Declaration], source: Source
) -> dict[str, Parameters]:
    """Return the parameters by the laws' names; errors are added to `source`."""
    schema = _schema(tuple((name, declared[name]) for name in relevant))
    try:
        model = schema.model_validate({"law": relevant})
    except ValidationError as error:
        explain(error, {"law": relevant}, schema, source)
        return {}
    values: dict[str, Parameters] = {name: getattr(model.law, name) for name in relevant}  # type: ignore[attr-defined]
    for name, section in values.items():
        _hold_together(name, section, source)
    return values


@lru_cache(64)
def _schema(laws: tuple[tuple[str, Declaration], ...]) -> type[Section]:
    """Return the model of a file with the tables of these laws (cached)."""
    models: dict[str, Any] = {name: (law.parameters, Field(description=law.title)) for name, law in laws}
    section = create_model("Laws", __base__=Section, **models)
    return create_model("File", __base__=Section, law=(section, Field(description="the laws")))


def _hold_together(name: str, values: Parameters, source: Source) -> None:
    """Add an error for each parameter that violates its relation to another parameter of the law."""
    relations = [(first, second, "at least") for first, second in values.at_least.items()]
    relations += [(first, second, "more than") for first, second in values.above.items()]
    for first, second, words in relations:
        value, other = getattr(values, first), getattr(values, second)
        if value > other or (value == other and words == "at least"):
            continue
        key = first if first in values.model_fields_set or second not in values.model_fields_set else second
        if key == first:
            source.stands(("law", name, first), value, f"{words} {second}, which is {shown(other)}")
        else:
            relation = "at most" if words == "at least" else "less than"
            source.stands(("law", name, second), other, f"{relation} {first}, which is {shown(value)}")
