"""Text of a fault file's mistakes: pydantic's errors, each with its position, expectation and value."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from coulombus.rigs.errors import nearest, shown
from coulombus.rigs.toml_lines import Document, Key

__all__ = ["mistakes"]

WANTED = {
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_type": "an integer",
    "int_from_float": "an integer",
    "bool_type": "true or false",
    "string_type": "a text in double quotes",
    "list_type": "a list",
    "tuple_type": 'two lists of nodes, as in [["host", "brake"], ["motor"]]',
    "greater_than": "a number above {gt:.12g}",
    "greater_than_equal": "a number of at least {ge:.12g}",
    "less_than": "a number below {lt:.12g}",
    "less_than_equal": "a number of at most {le:.12g}",
    "literal_error": "{expected}",
    "string_pattern_mismatch": 'at most eight bytes in hexadecimal, as in "12 34"',
}
"""Expected values by pydantic's error type."""
OF_KEYS = {
    "on": 'a text such as "3rd TPDO1 of node 2", or a table such as { frame = "TPDO1", node = 2, nth = 3 }',
    "node": 'a node by its name, as in "motor", or by its node id',
    "sender": 'a node by its name, as in "motor", or by its node id',
    "seen_by": 'a node by its name, as in "motor", or by its node id',
    "lost_for": 'a node by its name, as in "motor", or by its node id',
    "fault": "tables [[fault]], in double brackets",
    "controller": "tables [[controller]], in double brackets",
}
"""Expected values by key, if more specific than the type."""
OF_TYPES = ("model_type", "dict_type", "model_attributes_type", "int_type", "string_type", "list_type")
WRAPPERS = ("constrained-", "function-", "literal[")


def mistakes(
    path: str,
    document: Document,
    error: ValidationError,
    schema: type[BaseModel],
    by_kind: Mapping[str, type[BaseModel]],
) -> list[str]:
    """Return a line for each key that pydantic rejects; `by_kind` has the models of `schema`'s faults, selected
    by ``kind``.
    """
    findings: dict[tuple[int, str], tuple[list[str], str]] = {}
    for finding in error.errors():
        names = tuple(
            part
            for n, part in enumerate(finding["loc"])
            if isinstance(part, int)
            or not (part in ("int", "str", "float") or part.startswith(WRAPPERS) or (n == 2 and part in by_kind))
        )
        expected, input_text = "", ""
        if finding["type"] == "extra_forbidden":
            text = f"no such key here{nearest(str(names[-1]), _keys_beside(finding['loc'], schema, by_kind))}"
            text += "" if "mean" in text else "; remove it, or see docs/bus.md for the keys of this kind"
        elif finding["type"] == "missing":
            text = "is missing"
        elif finding["type"].startswith("union_tag"):
            names = (*names, "kind")
            kind = finding["input"].get("kind")
            text = "expected one of " + ", ".join(sorted(by_kind))
            if kind is not None:
                text += (nearest(kind, by_kind) if isinstance(kind, str) else "") + f", not {shown(kind)}"
        elif finding["type"] in WANTED or finding["type"] in OF_TYPES:
            description = WANTED.get(finding["type"], "a table").format(**finding.get("ctx", {}))
            text = expected = OF_KEYS.get(str(names[-1]), description) if finding["type"] in OF_TYPES else description
            input_text = f", not {shown(finding['input'])}"
        else:
            text = finding["msg"].removeprefix("Value error, ")
            text += "" if isinstance(finding["input"], dict) else f", not {shown(finding['input'])}"
        line = document.line(names)
        key = line, f"{path}:{line}: {'.'.join(map(str, names))}"
        if not expected:
            findings[key] = [text], ""
        else:  # a key with several types has an error for each
            texts = findings.setdefault(key, ([], input_text))[0]
            texts += [] if expected in texts else [expected]
    return [
        f"{where}: {'expected ' if input_text else ''}{' or '.join(texts)}{input_text}"
        for (_, where), (texts, input_text) in sorted(findings.items(), key=lambda item: item[0])
    ]


def _keys_beside(place: Key, schema: type[BaseModel], by_kind: Mapping[str, type[BaseModel]]) -> list[str]:
    """Return the valid keys of the table in which pydantic found an unknown key at `place`."""
    model: type[BaseModel] = schema
    for part in place[:-1]:
        if isinstance(part, str) and part in by_kind and model is schema:
            model = by_kind[part]
        elif isinstance(part, str) and part in model.model_fields:
            inner = [
                member for member in _models(model.model_fields[part].annotation) if member not in by_kind.values()
            ]
            model = inner[0] if inner else model
    return list(model.model_fields)


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]
