"""Texts from the rig file's models: accepted values of a key, and pydantic's errors in plain words."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from coulombus.rigs.errors import Source, dotted, nearest, number_hint
from coulombus.rigs.frozen_map import FrozenMap
from coulombus.rigs.toml_lines import Key, Table

__all__ = [
    "accepted_range",
    "expected",
    "explain",
    "fields_of",
    "kinds_of",
    "misspelt_sections",
    "named_in",
    "unit_of",
    "without_unit",
]

MOST_MEANT = 3
_OTHER_UNIT = re.compile(r"_(ms|us|min|h|Hz|kHz|deg|rpm|mNm|mA|V|W)$")
"""Units in which no key is given."""
UNITS = {
    "push_F_s": "F_s",
    "F_s_Nm": "Nm",
    "F_d_Nm": "Nm",
    "_kg_m2": "kg m2",
    "_Nms_rad": "Nm s/rad",
    "_Nm_rad": "Nm/rad",
    "_m_rad": "m/rad",
    "_Nm_s": "Nm/s",
    "_Ns_m": "N s/m",
    "_N_m": "N/m",
    "_A_Nm": "A/Nm",
    "_1_K": "1/K",
    "_1_s": "1/s",
    "_J_K": "J/K",
    "_s_rad": "s/rad",
    "_bit_s": "bit/s",
    "_rad_s": "rad/s",
    "_counts_rev": "counts",
    "_counts": "counts",
    "_cycles": "cycles",
    "_degC": "degC",
    "_us": "us",
    "_K_W": "K/W",
    "_ohm": "ohm",
    "_rad": "rad",
    "_Nm": "Nm",
    "_N": "N",
    "_m": "m",
    "_kg": "kg",
    "_Hz": "Hz",
    "_A": "A",
    "_J": "J",
    "_s": "s",
}


def unit_of(name: str) -> str:
    """Return the unit in a key's name, or ""."""
    return next((unit for suffix, unit in UNITS.items() if name.endswith(suffix)), "")


def without_unit(name: str) -> str:
    """Return a key's name without the unit in it: ``F_s`` of ``F_s_Nm``."""
    return next((name.removesuffix(suffix) for suffix in UNITS if suffix[0] == "_" and name.endswith(suffix)), name)


def fields_of(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return a model's fields by their names in the file."""
    return {info.alias or name: info for name, info in model.model_fields.items()}


def named_in(info: FieldInfo | None) -> type[BaseModel] | None:
    """Return the model of a table of user-named tables ([sensor.NAME]); None for other fields."""
    if info is None or get_origin(info.annotation) is not FrozenMap:
        return None
    model: type[BaseModel] = get_args(info.annotation)[0]
    return model


def kinds_of(info: FieldInfo | None) -> dict[str, type[BaseModel]]:
    """Return the models of an array of tables by kind; a plain section has the kind ""."""
    kinds: dict[str, type[BaseModel]] = {}
    if named_in(info) is not None:
        return kinds
    pending: list[Any] = [info.annotation] if info is not None else []
    while pending:
        candidate = pending.pop(0)
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            kind = candidate.model_fields.get("kind")
            kinds.update((word, candidate) for word in ((kind and get_args(kind.annotation)) or ("",)))
        else:
            pending = [*get_args(candidate), *pending]
    return kinds


def _extra(info: FieldInfo) -> Mapping[str, Any]:
    return info.json_schema_extra if isinstance(info.json_schema_extra, dict) else {}


def _choices(info: FieldInfo | None) -> tuple[str, ...]:
    words = get_args(info.annotation) if info is not None else ()
    return words if words and all(isinstance(word, str) for word in words) else ()


def _spelled(bound: float) -> str:
    return str(bound) if isinstance(bound, int) else f"{bound:g}".replace("e+0", "e").replace("e-0", "e-")


def accepted_range(info: FieldInfo) -> str:
    """Return the accepted values of a key in short: bounds of a number, words of a choice."""
    extra = _extra(info)
    if "range" in extra or "expected" in extra:
        return str(extra.get("range", extra.get("expected")))
    if _choices(info):
        return ", ".join(f'"{word}"' for word in _choices(info))
    bounds = {name: getattr(item, name) for item in info.metadata for name in ("gt", "ge", "le") if hasattr(item, name)}
    if "ge" in bounds and "le" in bounds:
        return f"{_spelled(bounds['ge'])} to {_spelled(bounds['le'])}"
    words = {"gt": "above", "ge": "at least", "le": "at most"}
    return ", ".join(f"{words[name]} {_spelled(bound)}" for name, bound in bounds.items())


def expected(name: str, info: FieldInfo) -> str:
    """Return the accepted values of a key, with its unit and its meaning."""
    extra, unit = _extra(info), unit_of(name)
    if "expected" in extra:
        text = str(extra["expected"])
    elif _choices(info):
        text = f"one of {accepted_range(info)}"
    elif info.annotation in (int, float, int | None, float | None):
        limits = accepted_range(info)
        between = "from " if " to " in limits else ""
        text = f"{'an integer' if info.annotation in (int, int | None) else 'a number'} {between}{limits}".rstrip()
        text += (f", in {unit}" if unit else "") + (f", {extra['grid']}" if "grid" in extra else "")
    elif info.annotation is str:
        text = "a text in double quotes"
    elif kinds_of(info):
        text = "a section"
    elif named_in(info) is not None:
        text = f"[{name}.NAME], once for each"
    else:
        longest = next(item.max_length for item in info.metadata if hasattr(item, "max_length"))
        text = f"a list of at most {longest} numbers" + (f", in {unit}" if unit else "")
    return f"{text} ({info.description})" if info.description else text


def misspelt_sections(values: Table, schema: type[BaseModel], source: Source) -> None:
    """Note each unknown section whose name is close to a missing one: one error, not two."""
    sections = fields_of(schema)
    for name in [name for name in values if name not in sections]:
        meant = difflib.get_close_matches(name, sections.keys() - values.keys(), 1, 0.75)
        if meant:
            source.say((name,), f"unknown section; did you mean [{meant[0]}]?")
            source.wrong.add((meant[0],))


def explain(error: ValidationError, values: Table, schema: type[BaseModel], source: Source) -> None:
    """Note every pydantic error in `values`, once per key."""
    for detail in error.errors():
        key, holder, info = _follow(detail["loc"], values, schema)
        if isinstance(key[-1], int) and not kinds_of(info):
            key = key[:-1]  # a number of a list: the list is shown
        if source.is_wrong(key):
            continue
        name = next(part for part in reversed(key) if isinstance(part, str))
        if detail["type"] == "missing" and info is not None:
            if len(key) > 1:
                source.lacks(key, expected(name, info))
            else:
                source.say(key, f"the section is missing; expected [{name}] ({info.description})")
        elif detail["type"] == "extra_forbidden" or info is None:
            _unknown(key, holder, schema, source)
        elif detail["type"].startswith("union_tag"):
            kinds = kinds_of(info)
            kinds_text = "one of " + ", ".join(f'"{kind}"' for kind in kinds)
            if "kind" in detail["input"]:
                source.stands((*key, "kind"), detail["input"]["kind"], kinds_text, kinds)
            elif not source.is_wrong((*key, "kind")):
                source.say((*key, "kind"), f"missing in [[{name}]]; expected {kinds_text}")
        else:
            value, kinds_text = _value(values, key), expected(name, info)
            if info.annotation in (int, float) and isinstance(value, str):
                kinds_text += number_hint(value, unit_of(name))
            source.stands(key, value, kinds_text, _choices(info))


def _value(values: Any, key: Key) -> Any:
    for part in key:
        values = values[part]
    return values


def _follow(
    loc: Sequence[str | int], values: Any, schema: type[BaseModel]
) -> tuple[Key, type[BaseModel], FieldInfo | None]:
    """Turn pydantic's location into a key (without union tags), its model, and its field."""
    key: Key = ()
    holder: type[BaseModel] = schema
    here: type[BaseModel] | None = schema
    info: FieldInfo | None = None
    named: type[BaseModel] | None = None
    for part in loc:
        if isinstance(part, int):
            values = values[part] if part < len(values) else None  # a list that is too short
            kinds = kinds_of(info)
            kind = values.get("kind", "") if isinstance(values, Mapping) else ""
            here = kinds.get(kind) if isinstance(kind, str) else None
        elif here is not None and (part in fields_of(here) or (isinstance(values, Mapping) and part in values)):
            holder, info = here, fields_of(here).get(part)
            values = values.get(part) if isinstance(values, Mapping) else None
            here, named = kinds_of(info).get(""), named_in(info)
        elif named is not None and isinstance(values, Mapping) and part in values:
            values = values[part]
            here, named, info = named, None, None
        else:
            continue
        key = (*key, part)
    return key, holder, info


def _unknown(key: Key, holder: type[BaseModel], schema: type[BaseModel], source: Source) -> None:
    """Note an unknown key: the keys of its section, and where the same name is known, or the nearest name here."""
    name, section = str(key[-1]), dotted(key[:-1])
    keys = list(fields_of(holder))
    paths = list(_paths(schema))
    homes = [path for path in paths if path.rpartition(".")[2] == name]
    hint = _or(homes) or nearest(name, keys) or _or(_similar(name, paths))
    expected = f"one of the keys of [{section}]" if section else "one of the sections"
    kind = "key" if section else "section"
    source.say(key, f"unknown {kind}; expected {expected}: {', '.join(keys)}{hint}")


def _or(paths: Sequence[str]) -> str:
    """Return "; did you mean ... or ...?" for at most three paths, or ""."""
    *first, last = [f"'{path}'" for path in paths[:MOST_MEANT]] or [""]
    return last and f"; did you mean {', '.join(first)}{' or ' * bool(first)}{last}?"


def _similar(name: str, paths: Iterable[str]) -> list[str]:
    """Return the paths whose last part has the same name with another unit, else those with the nearest one."""
    by_stem: dict[str, list[str]] = {}
    for path in paths:
        by_stem.setdefault(without_unit(path.rpartition(".")[2]).lower(), []).append(path)
    stems = [name.lower(), _OTHER_UNIT.sub("", without_unit(name)).lower()]
    near = [stem for stem in stems if stem in by_stem] or difflib.get_close_matches(stems[1], by_stem, 1, 0.75)
    return [path for stem in near[:1] for path in by_stem[stem]]


def _paths(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Yield every key below `model`, as ``--set`` takes it (phases left out)."""
    for name, info in fields_of(model).items():
        if (named := named_in(info)) is not None:
            yield from _paths(named, f"{prefix}{name}.NAME.")
            continue
        section = kinds_of(info).get("")
        if section is not None:
            yield from _paths(section, f"{prefix}{name}.")
        elif not kinds_of(info):
            yield f"{prefix}{name}"
