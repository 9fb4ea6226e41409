"""A sweep file: the simulated rigs and hands, and the rates to count (docs/sweep.md).

::

    rig = "bench"                        # a packaged rig, or a path relative to this file
    mode = "hybrid"                      # or modes = ["active", "hybrid"]: every point in each of them
    seconds = 13.0                       # of each display; default: the rig's schedule
    seed = 1
    design = "latin_hypercube"           # or sobol, random, grid
    runs = 1000                          # points; a grid has as many as its values make

    [vary]                               # any key of the rig file, as --set takes it
    operator.inertia_kg_m2 = { low = 1e-4, high = 0.1, scale = "log" }
    mode.hybrid.F_s_Nm = { values = [1.0, 2.0, 3.5] }

    [rates]                              # comparisons of the figures that simulate --json prints
    still = "hold_counts_p2p <= 2"
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from coulombus.host.laws.law_source import law_attachments
from coulombus.lab.file_mistakes import FileMistakes, StrictTable, read_checked, rig_beside
from coulombus.lab.sweep.expressions import ConditionError, RunCondition
from coulombus.lab.sweep.figures import known_figures
from coulombus.lab.sweep.ranges import Vary, points
from coulombus.recording.recorder import project_version
from coulombus.rigs.errors import nearest, shown, toml_value
from coulombus.rigs.rig import Rig, RigError
from coulombus.rigs.toml_lines import Key, read_toml, split_key
from coulombus.system.errors import CoulombusError

__all__ = ["Sweep", "SweepError", "read_sweep"]

YEAR_S = 31_557_600
MOST_RUNS = 1_000_000
RATE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
LEAF = ("values", "low", "high", "scale", "count")
"""Keys of a variation: their parent is the varied key."""
CONTRADICTIONS = (
    ("grid", "runs", "a grid has as many runs as its values make; take runs out, or choose another design"),
    ("grid", None, "a grid of nothing; expected [vary] with the keys that are varied"),
    ("latin_hypercube", None, "there is nothing to spread; expected [vary] with the keys that are varied"),
    ("sobol", None, "there is nothing to spread; expected [vary] with the keys that are varied"),
)


class SweepError(CoulombusError, ValueError):
    """The sweep file is invalid; the text has a line for each error, with its place."""

    exit_status = 3


class _Choice(StrictTable):
    values: list[Any] = Field(min_length=1, max_length=10_000)


class _Range(StrictTable):
    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"
    count: int | None = Field(None, ge=2, le=MOST_RUNS)


_Mode = Literal["active", "passive", "hybrid"]


class _SweepFile(StrictTable):
    rig: str = Field("bench", min_length=1)
    mode: _Mode | None = None
    modes: Annotated[list[_Mode], Field(min_length=1)] | None = None
    seconds: float | None = Field(None, gt=0, le=YEAR_S)
    seed: int = Field(0, ge=0, lt=2**62)
    design: Literal["grid", "latin_hypercube", "sobol", "random"]
    runs: int | None = Field(None, ge=1, le=MOST_RUNS)
    set: list[str] = Field([])
    vary: dict[str, Any] = Field({})
    rates: dict[str, str] = Field({})


@dataclass(frozen=True)
class Sweep:
    """A checked sweep: fully determined.

    Attributes
    ----------
    path, text : the file
    rig : with the file's settings, without the variations
    modes : of every point
    seconds : of each display; None: the rig's schedule
    points : the values of the keys `vary`, in their order
    rates : name -> counted condition
    """

    path: str
    text: str
    rig: Rig
    modes: tuple[str, ...]
    seconds: float | None
    seed: int
    design: str
    vary: tuple[Vary, ...]
    points: tuple[tuple[Any, ...], ...]
    rates: Mapping[str, RunCondition]

    @property
    def runs(self) -> int:
        """The number of runs: each point in each mode."""
        return len(self.points) * len(self.modes)

    def fingerprint(self) -> str:
        """Return the SHA-256 of all inputs of the runs, and of the rates."""
        content = {
            "version": project_version(),
            "rig": self.rig.effective(),
            "eds": dict(self.rig.eds_texts),
            "law": {name: hashlib.sha256(source).hexdigest() for name, source in law_attachments(self.rig).items()},
            "modes": self.modes,
            "seconds": self.seconds,
            "seed": self.seed,
            "keys": [variation.key for variation in self.vary],
            "points": self.points,
            "rates": {name: condition.text for name, condition in self.rates.items()},
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def read_sweep(path: str | os.PathLike[str]) -> Sweep:
    """Return the sweep of the file `path`.

    Raises
    ------
    SweepError
        it cannot be read, or has errors; the text has a line for each, with file and line
    coulombus.rigs.rig.RigError
        the rig file has an error
    """
    path = Path(path)
    text, file, mistakes = read_checked(path, "sweep", _SweepFile, SweepError)
    vary = _vary(file, mistakes)
    _check_design(file, vary, mistakes)
    mistakes.raise_all()
    rig = _with_settings(rig_beside(path, file.rig, mistakes), file, mistakes)
    mistakes.raise_all()
    modes = _modes(file, rig, mistakes)
    if file.seconds is None and not rig.schedule_s > 0:
        mistakes.say(("seconds",), f"is missing; the rig {rig.name} has no schedule ([[phase]]) that would tell")
    rates = _rates(file, rig, mistakes)
    checked = tuple(_on_rig(key, variation, rig, mistakes) for key, variation in vary.items())
    mistakes.raise_all()
    return Sweep(
        path=str(path),
        text=text,
        rig=rig,
        modes=modes,
        seconds=None if file.seconds is None else float(file.seconds),
        seed=file.seed,
        design=file.design,
        vary=checked,
        points=tuple(points(file.design, checked, file.runs or 0, file.seed)),
        rates=rates,
    )


def _with_settings(rig: Rig, file: _SweepFile, mistakes: FileMistakes) -> Rig:
    """Return the rig with the file's settings; the keys of `set` are applied together."""
    if not file.set:
        return rig
    try:
        return rig.variant(*file.set)
    except RigError as error:
        for text in error.errors:
            mistakes.say(("set",), f"the rig refuses it: {text.removeprefix('--set ')}")
        return rig


def _leaves(table: Mapping[str, Any], above: tuple[str, ...] = ("vary",)) -> Iterator[tuple[Key, Any]]:
    """Yield the place of each varied key in the file, and its variation."""
    for name, value in table.items():
        key = (*above, name)
        if isinstance(value, Mapping) and value and not _is_leaf(value):
            yield from _leaves(value, key)
        else:
            yield key, value


def _is_leaf(value: Mapping[str, Any]) -> bool:
    """Return whether a table is a variation, perhaps misspelled, and not a section of keys."""
    return any(nearest(name, LEAF) and not isinstance(entry, Mapping) for name, entry in value.items())


def _vary(file: _SweepFile, mistakes: FileMistakes) -> dict[Key, Vary]:
    variations: dict[Key, Vary] = {}
    for place, value in _leaves(file.vary):
        key = ".".join(str(part) for part in place[1:])
        if split_key(key) is None or "=" in key:
            mistakes.say(place, "cannot be read; expected SECTION.KEY, as in plant.inertia_kg_m2")
        elif any(variation.key == key for variation in variations.values()):
            mistakes.say(place, f"{key} is given twice; expected each key once")
        elif not isinstance(value, Mapping):
            mistakes.say(place, f"expected {{ values = [...] }} or {{ low = ..., high = ... }}, not {shown(value)}")
        elif "values" in value and {"low", "high"} & value.keys():
            mistakes.say(place, "has values, and low and high; expected either")
        else:
            variation = _leaf(place, key, value, mistakes)
            if variation is not None:
                variations[place] = variation
    return variations


def _leaf(place: Key, key: str, table: Mapping[str, Any], mistakes: FileMistakes) -> Vary | None:
    model: type[_Choice] | type[_Range] = _Range if {"low", "high"} & table.keys() else _Choice
    try:
        tried = model.model_validate(table)
    except ValidationError as error:
        mistakes.explain(error, place, model)
        return None
    if isinstance(tried, _Choice):
        strange = [value for value in tried.values if not isinstance(value, bool | int | float | str | list | dict)]
        if strange or any(isinstance(value, float) and not math.isfinite(value) for value in tried.values):
            mistakes.say(place, "values: expected finite numbers, texts, true or false")
            return None
        if len(set(map(toml_value, tried.values))) < len(tried.values):
            mistakes.say(place, "values: one is given twice; expected each once")
            return None
        return Vary(key, values=tuple(tried.values))
    if not tried.low < tried.high:
        mistakes.say(place, f"low = {tried.low:g} is not below high = {tried.high:g}")
        return None
    if tried.scale == "log" and tried.low <= 0:
        mistakes.say(place, f'low = {tried.low:g}; scale = "log" wants it above 0')
        return None
    return Vary(
        key,
        low=float(tried.low),
        high=float(tried.high),
        logarithmic=tried.scale == "log",
        count=tried.count or 0,
    )


def _check_design(file: _SweepFile, vary: Mapping[Key, Vary], mistakes: FileMistakes) -> None:
    for design, key, text in CONTRADICTIONS:
        if file.design == design and (not file.vary if key is None else getattr(file, key) is not None):
            mistakes.say(("design",) if key is None else (key,), text)
    if file.design != "grid" and file.runs is None:
        mistakes.say((), f'runs is missing; expected how many points the design "{file.design}" has')
    for place, variation in vary.items():
        if variation.values:
            continue
        if file.design == "grid" and not variation.count:
            mistakes.say(place, "of a grid; expected count = N, or values = [...]")
        if file.design != "grid" and variation.count:
            mistakes.say(
                (*place, "count"), f'is of a grid; take it out, or choose design = "grid" (it is "{file.design}")'
            )
    size = math.prod(len(variation.values) or variation.count for variation in vary.values())
    if file.design == "grid" and size > MOST_RUNS:
        mistakes.say(("vary",), f"a grid of {size} points; expected at most {MOST_RUNS}")


def _modes(file: _SweepFile, rig: Rig, mistakes: FileMistakes) -> tuple[str, ...]:
    if file.mode is not None and file.modes is not None:
        mistakes.say(("modes",), "mode is given there, too; expected either")
    modes = tuple(file.modes or (file.mode or "hybrid",))
    key = "mode" if file.modes is None else "modes"
    if len(set(modes)) < len(modes):
        mistakes.say((key,), "a mode is given twice; expected each once")
    for mode in modes:
        if mode not in rig.modes:
            mistakes.say((key,), f"the rig {rig.name} has no mode {mode!r}; it has {', '.join(rig.modes)}")
    return modes


def _rates(file: _SweepFile, rig: Rig, mistakes: FileMistakes) -> dict[str, RunCondition]:
    figures, conditions = known_figures(rig), {}
    for name, text in file.rates.items():
        if not RATE_NAME.fullmatch(name):
            mistakes.say(("rates", name), "expected a name of letters, digits, _ and -")
            continue
        try:
            conditions[name] = RunCondition.from_text(text, figures)
        except ConditionError as error:
            mistakes.say(("rates", name), str(error))
    return conditions


def _on_rig(place: Key, vary: Vary, rig: Rig, mistakes: FileMistakes) -> Vary:
    """Return the key with the rig's own value; a key of which the rig refuses every value is an error."""
    try:
        whole = vary.on(_rig_value(rig, vary.key))
    except ValueError as error:
        mistakes.say(place, str(error))
        return vary
    refused: list[str] = []
    lacking: tuple[str, ...] = ()
    for value in whole.tried():
        try:
            rig.variant(whole.override(value))
            return whole
        except RigError as error:
            lacking = lacking or error.lacking
            refused.append(error.errors[0].removeprefix(f"--set {whole.override(value)}: "))
    mistakes.say(place, f"the rig refuses it: {refused[0]}{_beside(vary.key, lacking)}")
    return whole


def _beside(key: str, lacking: tuple[str, ...]) -> str:
    """Return a hint for a key that needs other keys of its section."""
    if not lacking:
        return ""
    section, settings = lacking[0].rpartition(".")[0], ", ".join(f'"{name}=..."' for name in (key, *lacking))
    return f"; give what is not varied of [{section}] beside [vary]: set = [{settings}]"


def _rig_value(rig: Rig, key: str) -> Any:
    """Return the rig's own value of a key; None if absent or not a single value."""
    here: Any = read_toml(rig.effective()).values
    for part in split_key(key) or ():
        if isinstance(here, list) and part.isdecimal() and int(part) < len(here):
            here = here[int(part)]
        elif isinstance(here, Mapping) and part in here:
            here = here[part]
        else:
            return None
    return here if isinstance(here, bool | int | float | str) else None
