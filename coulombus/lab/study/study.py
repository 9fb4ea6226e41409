"""A study file: what is shown to whom, in which order, and what is asked (docs/experiment.md).

::

    name = "friction-jnd"
    rig = "bench"                        # a packaged rig, or a path beside this file
    seconds = 3.0                        # of each display
    seed = 1
    reference = 2.0                      # two displays a trial, this one and a level; without it: one
    question = "Which one had more friction?"

    [level]                              # rig key -> its value for each unit of the level
    "mode.{mode}.F_s_Nm" = 1.0
    "mode.{mode}.F_d_Nm" = 0.85

    [method]
    kind = "constant"                    # or staircase, quest, magnitude, free
    levels = [1.4, 1.7, 2.0, 2.3, 2.6]
    repeats = 20

    [[condition]]
    name = "hybrid"
    mode = "hybrid"
    set = ["mechanics.viscous_Nms_rad=0.01"]
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

from pydantic import Field, ValidationError

from coulombus.host.laws.laws import LawError, load_declared
from coulombus.host.setup.law_demand import cut_off
from coulombus.lab.file_mistakes import FileMistakes, StrictTable, read_checked, rig_beside
from coulombus.lab.study.change_bounds import widened
from coulombus.lab.study.methods import mirrored
from coulombus.rigs.errors import nearest, toml_value
from coulombus.rigs.rig import Rig, RigError
from coulombus.rigs.toml_lines import Key, split_key
from coulombus.system.errors import CoulombusError

__all__ = [
    "METHODS",
    "Condition",
    "Constant",
    "Free",
    "Quest",
    "Staircase",
    "Study",
    "StudyError",
    "StudyFile",
    "read_study",
]

NAME = r"^[A-Za-z0-9][A-Za-z0-9_.=-]{0,63}$"
MOST_TRIALS, LONGEST_S = 10_000, 600.0


class StudyError(CoulombusError, ValueError):
    """A study file that cannot be used; one line for each mistake, with its place."""

    exit_status = 3


class Constant(StrictTable):
    """Constant stimuli, and magnitude estimation: each level so many times."""

    kind: Literal["constant", "magnitude"]
    levels: list[float] = Field(min_length=1, max_length=100)
    repeats: int = Field(ge=1, le=MOST_TRIALS)


class Staircase(StrictTable):
    """An adaptive staircase: down after `down` right answers, up after a wrong one. `sides` both: a
    second one is its mirror image below the reference.
    """

    kind: Literal["staircase"]
    start: float
    low: float
    high: float
    steps: list[float] = Field(min_length=1, max_length=20)
    down: int = Field(2, ge=1, le=5)
    up_ratio: float = Field(1.0, gt=0, le=20)
    trials: int = Field(ge=1, le=MOST_TRIALS)
    sides: Literal["both", "above"] = "both"


class Quest(StrictTable):
    """QUEST+ of threshold and point of subjective equality; `sides` both: down to the mirror image of `high`."""

    kind: Literal["quest"]
    low: float
    high: float
    trials: int = Field(ge=1, le=MOST_TRIALS)
    sides: Literal["both", "above"] = "both"


class Free(StrictTable):
    """Free exploration: displays without a question."""

    kind: Literal["free"]
    levels: list[float] = Field(min_length=1, max_length=100)
    repeats: int = Field(1, ge=1, le=MOST_TRIALS)


MethodTable: TypeAlias = Constant | Staircase | Quest | Free
METHODS: Mapping[str, type[MethodTable]] = {
    "constant": Constant,
    "magnitude": Constant,
    "staircase": Staircase,
    "quest": Quest,
    "free": Free,
}
"""Kind of a method -> its keys."""
COMPARED = ("constant", "staircase", "quest")
"""Methods that compare a level with the reference."""


class _Condition(StrictTable):
    name: str = Field(pattern=NAME)
    mode: Literal["active", "passive", "hybrid"] = "hybrid"
    set: list[str] = Field([])


class _Factor(StrictTable):
    name: str = Field(pattern=NAME)
    key: str = Field(min_length=1)
    values: list[Any] = Field(min_length=1, max_length=20)


class StudyFile(StrictTable):
    """The keys of a study file."""

    name: str = Field(pattern=NAME)
    rig: str = Field("bench", min_length=1)
    seconds: float = Field(gt=0, le=LONGEST_S)
    seed: int = Field(0, ge=0, lt=2**62)
    reference: float | None = None
    question: str = ""
    instructions: str = ""
    consent: str = ""
    blinded: bool = True
    order: Literal["blocked", "mixed"] = "blocked"
    training: int = Field(0, ge=0, le=1000)
    break_after: int = Field(0, ge=0, le=MOST_TRIALS)
    level: dict[str, float] = Field(min_length=1)
    method: dict[str, Any]
    condition: list[_Condition] = Field(min_length=1, max_length=100)
    factor: list[_Factor] = Field([])


@dataclass(frozen=True)
class Condition:
    """A condition: what is set of the rig beside the level, in a mode."""

    name: str
    mode: str
    settings: tuple[str, ...]


@dataclass(frozen=True)
class Study:
    """A study, checked: every level of every condition is within the rig's limits."""

    path: str
    text: str
    file: StudyFile
    rig: Rig
    method: MethodTable
    conditions: tuple[Condition, ...]

    def variant(self, condition: Condition, level: float) -> Rig:
        """Return the rig as a display of `level` uses it."""
        return self.rig.variant(*condition.settings, *_settings(self.file.level, condition.mode, level))

    def fingerprint(self) -> str:
        """Return the SHA-256 of all that the trials depend on; comments of the file do not count."""
        content = {
            "file": self.file.model_dump(mode="json"),
            "rig": self.rig.effective(),
            "eds": dict(self.rig.eds_texts),
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def _settings(table: Mapping[str, float], mode: str, level: float) -> list[str]:
    return [f"{key.replace('{mode}', mode)}={toml_value(share * level)}" for key, share in table.items()]


def read_study(path: str | os.PathLike[str]) -> Study:
    """Return the study of the file `path`.

    Raises
    ------
    StudyError
        it cannot be read, contradicts itself, or shows a level beyond the rig's limits; the text has
        a line for each mistake, with file and line
    coulombus.rigs.rig.RigError
        the rig file has a mistake
    """
    path = Path(path)
    text, file, mistakes = read_checked(path, "study", StudyFile, StudyError)
    method = _method(file, mistakes)
    conditions = _conditions(file, mistakes)
    mistakes.raise_all()
    assert method is not None
    _check_method(file, method, mistakes)
    mistakes.raise_all()
    rig = rig_beside(path, file.rig, mistakes)
    study = Study(str(path), text, file, rig, method, conditions)
    _check_on_rig(study, mistakes)
    mistakes.raise_all()
    return study


def _method(file: StudyFile, mistakes: FileMistakes) -> MethodTable | None:
    kind = file.method.get("kind")
    if not isinstance(kind, str) or kind not in METHODS:
        hint = nearest(kind, METHODS) if isinstance(kind, str) else ""
        mistakes.say(("method", "kind"), f"expected one of {', '.join(METHODS)}, not {kind!r}{hint}")
        return None
    try:
        return METHODS[kind].model_validate(file.method)
    except ValidationError as error:
        mistakes.explain(error, ("method",), METHODS[kind])
        return None


def _conditions(file: StudyFile, mistakes: FileMistakes) -> tuple[Condition, ...]:
    """Return each condition with each combination of the factors' values."""
    names: set[str] = set()
    for k, condition in enumerate(file.condition):
        if condition.name in names:
            mistakes.say(("condition", k, "name"), f"{condition.name} is given twice; expected each name once")
        names.add(condition.name)
    keys: set[str] = set()
    for k, factor in enumerate(file.factor):
        if split_key(factor.key.replace("{mode}", "hybrid")) is None:
            mistakes.say(("factor", k, "key"), "cannot be read; expected SECTION.KEY, as in plant.inertia_kg_m2")
        if factor.name in keys or factor.key in keys:
            mistakes.say(("factor", k), f"{factor.name} is given twice; expected each factor once")
        keys |= {factor.name, factor.key}
        if len(set(map(str, factor.values))) < len(factor.values):
            mistakes.say(("factor", k, "values"), "one is given twice; expected each once")
    conditions = []
    for condition in file.condition:
        for values in itertools.product(*(factor.values for factor in file.factor)):
            pairs = list(zip(file.factor, values, strict=True))
            name = "_".join([condition.name, *(f"{factor.name}={value}" for factor, value in pairs)])
            more = (f"{factor.key.replace('{mode}', condition.mode)}={toml_value(value)}" for factor, value in pairs)
            conditions.append(Condition(name, condition.mode, (*condition.set, *more)))
    return tuple(conditions)


def _check_method(file: StudyFile, method: MethodTable, mistakes: FileMistakes) -> None:
    if method.kind in COMPARED and file.reference is None:
        mistakes.say((), f'reference is missing; the method "{method.kind}" compares each level with it')
    if method.kind not in COMPARED and file.reference is not None:
        mistakes.say(("reference",), f'the method "{method.kind}" compares nothing; take it out')
    if method.kind in COMPARED and not file.question:
        mistakes.say((), 'question is missing; expected one such as "Which one had more friction?"')
    if isinstance(method, Constant | Free):
        if len(set(method.levels)) < len(method.levels):
            mistakes.say(("method", "levels"), "one is given twice; expected each once")
        if method.kind == "constant" and len(method.levels) < 2:
            mistakes.say(("method", "levels"), "expected two levels or more")
        return
    reference = file.reference
    if not method.low < method.high:
        mistakes.say(("method", "low"), f"low = {method.low:g} is not below high = {method.high:g}")
    elif reference is not None and method.low < reference:
        mistakes.say(
            ("method", "low"), f"{method.low:g} is below the reference {reference:g}: the right answer is the level"
        )
    if isinstance(method, Staircase):
        for step in method.steps:
            if step <= 0:
                mistakes.say(("method", "steps"), f"a step of {step:g}; expected steps above 0")
        if not method.low <= method.start <= method.high:
            mistakes.say(
                ("method", "start"), f"{method.start:g} is not from low = {method.low:g} to high = {method.high:g}"
            )


def _shown(study: Study) -> list[tuple[Key, float]]:
    """Return the levels whose limits are checked, each with its key: all, or both ends of what an
    adaptive method may show.
    """
    values: list[tuple[Key, float]] = []
    method = study.method
    if isinstance(method, Constant | Free):
        values += [(("method", "levels"), level) for level in method.levels]
    else:
        values += [(("method", "low"), method.low), (("method", "high"), method.high)]
        if method.sides == "both" and study.file.reference is not None:
            values.append((("method", "high"), mirrored(method.high, study.file.reference)))
    return values if study.file.reference is None else [(("reference",), study.file.reference), *values]


def _check_on_rig(study: Study, mistakes: FileMistakes) -> None:
    width = max(1, len(study.conditions) // len(study.file.condition))
    for number, condition in enumerate(study.conditions):
        place: Key = ("condition", number // width)
        if condition.mode not in study.rig.modes:
            mistakes.say((*place, "mode"), f"the rig {study.rig.name} has no mode {condition.mode!r}")
            continue
        try:
            rig = study.rig.variant(*condition.settings)
            changed = widened(study.rig, rig)
        except RigError as error:
            for text in error.errors:
                factor = _factor_of(study, condition, "{}=", text)
                of_set = any(
                    text.startswith(f"--set {override}:") for override in study.file.condition[number // width].set
                )
                where: Key = ("factor", factor) if factor is not None and not of_set else (*place, "set")
                mistakes.say(where, f"the rig refuses it: {_bare(text)}")
            continue
        for text in changed:
            factor = _factor_of(study, condition, "{}:", text)
            mistakes.say((*place, "set") if factor is None else ("factor", factor, "values"), text)
        unknown_law = _law_mistake(rig)
        if unknown_law is not None:
            factor = _factor_of(study, condition, "{}", "law.function")
            mistakes.say((*place, "set") if factor is None else ("factor", factor), unknown_law)
        if changed or unknown_law is not None or _check_level_keys(study, condition, mistakes):
            continue
        for key, level in _shown(study):
            for text in _refusals(study, condition, level):
                unknown = next(
                    (level_key for level_key in study.file.level if _names(text, level_key, condition.mode)), None
                )
                if unknown is not None:
                    mistakes.say(("level", unknown), f"the rig refuses it: {_bare(text)}")
                else:
                    mistakes.say(key, f"{level:g}{_image(study, level)} in condition {condition.name}: {_bare(text)}")


def _image(study: Study, level: float) -> str:
    """Return where a level comes from that the file does not name."""
    reference, method = study.file.reference, study.method
    if reference is None or isinstance(method, Constant | Free) or level >= reference:
        return ""
    return f' (as far below the reference as high = {method.high:g} is above; sides = "above" shows none)'


def _law_mistake(rig: Rig) -> str | None:
    """Return why a law of the rig cannot be loaded."""
    try:
        for axis in rig.axes:
            if not axis.joint:
                load_declared(axis.law.function.strip(), axis.law_directory)
    except LawError as error:
        return f"law.function: {error}"
    return None


def _factor_of(study: Study, condition: Condition, form: str, text: str) -> int | None:
    """Return which factor's key stands in a text, written as `form` says."""
    keys = (form.format(factor.key.replace("{mode}", condition.mode)) for factor in study.file.factor)
    return next((k for k, key in enumerate(keys) if key in text), None)


def _check_level_keys(study: Study, condition: Condition, mistakes: FileMistakes) -> bool:
    """Tell whether a key of [level] changes what a study may not change, at any level shown."""
    hit = False
    levels = [level for _, level in _shown(study)]
    for level in (min(levels), max(levels)):
        try:
            changed = widened(study.rig, study.variant(condition, level))
        except RigError:
            continue  # told with the level
        for text in changed:
            keys = (name for name in study.file.level if text.startswith(f"{name.replace('{mode}', condition.mode)}:"))
            mistakes.say(("level", *(key for key in [next(keys, None)] if key)), text)
            hit = True
    return hit


def _names(text: str, key: str, mode: str) -> bool:
    return (
        text.startswith(f"--set {key.replace('{mode}', mode)}=")
        and re.search("expected one of|no such", text) is not None
    )


def _bare(text: str) -> str:
    return re.sub(r"^--set \S+: ", "", text)


def _refusals(study: Study, condition: Condition, level: float) -> Sequence[str]:
    try:
        return cut_off(study.variant(condition, level), condition.mode)
    except RigError as error:
        return error.errors
    except LawError as error:
        return [str(error)]
