"""The worst case of a rate: the mildest rig for which its condition does not hold, as a rig file.

The search starts with the failing run that deviates least from the rig's own values
(`ranges.Vary.deviation`, root of the sum of squares). Then each key in turn moves back as far as
possible: to the rig's own value if the condition fails there, too; else, for a number, by
`HALVINGS` bisections between a passing and a failing value. Mode and seed are those of the run.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from coulombus.eds.reader import EdsError
from coulombus.lab.sweep.one_run import Job, RunRequest, carry_out
from coulombus.lab.sweep.ranges import Vary
from coulombus.rigs.axes import device_keys
from coulombus.rigs.errors import Source, dotted, toml_value
from coulombus.rigs.files import read_descriptions
from coulombus.rigs.rig import Rig
from coulombus.rigs.toml_lines import Document, Key, read_toml

__all__ = ["Worst", "deviation", "nearest_failing", "rig_files", "shrunk"]

HALVINGS = 6
"""Bisections per key: 1/64 of the interval remains."""


@dataclass(frozen=True)
class Worst:
    """The mildest rig for which a condition does not hold.

    Attributes
    ----------
    run : the starting run
    order : its mode, seed and values
    values : varied key -> value, for keys that differ from the rig's own
    tried : number of simulations
    """

    rate: str
    run: int
    order: RunRequest
    values: Mapping[str, Any]
    tried: int

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values for JSON."""
        return {
            "rate": self.rate,
            "run": self.run,
            "mode": self.order.mode,
            "seed": self.order.seed,
            "values": dict(self.values),
            "simulations": self.tried,
        }


def deviation(vary: Sequence[Vary], values: Sequence[Any]) -> float:
    """Return the distance of a point from the rig's own values."""
    return math.sqrt(sum(variation.deviation(value) ** 2 for variation, value in zip(vary, values, strict=True)))


def nearest_failing(vary: Sequence[Vary], failing: Sequence[RunRequest]) -> RunRequest | None:
    """Return the run that deviates least; the first of equals."""
    return min(failing, key=lambda request: (deviation(vary, request.values), request.run), default=None)


def shrunk(job: Job, rate: str, start: RunRequest, progress: Callable[[int], None] = lambda tried: None) -> Worst:
    """Return the mildest failing rig between the run `start`, which violates the condition of
    `rate`, and the rig's own values.
    """
    alone = replace(job, rates={rate: job.rates[rate]}, keep="none")
    tried = 0

    def fails(values: Sequence[Any]) -> bool:
        nonlocal tried
        tried += 1
        progress(tried)
        row = carry_out(alone, replace(start, values=tuple(values))).row
        return row["rig"] is not None and not _refused(row) and not row[f"rates.{rate}"]

    values = list(start.values)
    for k, variation in enumerate(job.vary):
        if variation.own is None or values[k] == variation.own:
            continue
        bad = values[k]
        values[k] = variation.own
        if fails(values):
            continue
        if variation.numeric and not variation.values:
            bad = _bisected(variation, bad, lambda value, k=k: fails([*values[:k], value, *values[k + 1 :]]))  # type: ignore[misc]
        values[k] = bad
    changes = {
        variation.key: value for variation, value in zip(job.vary, values, strict=True) if value != variation.own
    }
    return Worst(rate, start.run, replace(start, values=tuple(values)), changes, tried)


def _refused(row: Mapping[str, Any]) -> bool:
    return row["error"] is not None and row["cycles"] is None


def _bisected(variation: Vary, bad: Any, fails: Callable[[Any], bool]) -> Any:
    """Return the failing value nearest to the rig's own, starting at `bad`."""
    good = variation.own
    for _ in range(HALVINGS):
        middle = variation.between(good, bad, 0.5)
        if middle in (good, bad):
            break
        if fails(middle):
            bad = middle
        else:
            good = middle
    return bad


def rig_files(rig: Rig, folder: Path, name: str) -> dict[str, str]:
    """Return the files of a rig for `folder`, by name: the rig file, and the EDS files that are not found from there.

    The file of a law is not copied; the rig file names it relative to the folder.
    """
    values = read_toml(rig.effective()).values
    files: dict[str, str] = {}
    changes: list[str] = []
    for above, table in _parts(values):
        descriptions = _descriptions_of(table, folder / name)
        for key in device_keys(table):
            section: Any = table
            for part in key:
                section = section.get(part, {})
            eds = section.get("eds")
            if eds is None or descriptions.get(eds) == rig.eds_texts.get(eds):
                continue
            file_name = f"{Path(name).stem}-{len(files) + 1}{Path(eds).suffix or '.eds'}"
            files[file_name] = rig.eds_texts[eds]
            changes.append(f"{dotted((*above, *key, 'eds'))}={toml_value(file_name)}")
        law = table.get("law", {}).get("function", "")
        file, _, function = law.rpartition(":")
        if file.endswith(".py") and not Path(file).is_absolute() and (rig.law_directory / file).exists():
            file_name = os.path.relpath(rig.law_directory / file, folder)
            changes.append(f"{dotted((*above, 'law', 'function'))}={toml_value(f'{file_name}:{function}')}")
    text = _changed(values, changes) if changes else rig.effective()
    return {name: text, **files}


def _parts(values: Mapping[str, Any]) -> list[tuple[Key, Mapping[str, Any]]]:
    """Return the tables that may name files: the shared one, and each axis' own."""
    return [((), values), *((("axis", name), table) for name, table in values.get("axis", {}).items())]


def _descriptions_of(table: Mapping[str, Any], path: Path) -> dict[str, str]:
    """Return the texts of the EDS files that a rig file at `path` would find, by their names."""
    try:
        descriptions = read_descriptions(table, Source(str(path), Document()), None)
    except (EdsError, OSError):
        return {}
    names = {}
    for key in device_keys(table):
        section: Any = table
        for part in key:
            section = section.get(part, {})
        if str(key[-1]) in descriptions and "eds" in section:
            names[section["eds"]] = descriptions[str(key[-1])].text
    return names


def _changed(values: dict[str, Any], changes: Sequence[str]) -> str:
    from coulombus.rigs.text import apply_override, emit

    for change in changes:
        apply_override(values, change, Source("", Document()))
    return emit(values, "The rig as it was used, overrides included.")
