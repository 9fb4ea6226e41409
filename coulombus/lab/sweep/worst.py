"""The worst case of a rate: the mildest rig for which its condition does not hold, as a rig file.

It begins with the run that deviates least from the rig's own values (`ranges.Vary.deviation`, the
root of the sum of squares). Then each key in turn goes back as far as it can: to the rig's own value
where the condition does not hold there either, else, for a number, to where `HALVINGS` bisections
come between a value that holds and one that does not. Mode and seed stay those of the run.
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
"""Of each key: a 64th of the way is left."""


@dataclass(frozen=True)
class Worst:
    """The mildest rig for which a condition does not hold.

    Attributes
    ----------
    run : where it began
    order : its mode, seed and values
    values : varied key -> its value, of those that are not the rig's own
    tried : simulations that it took
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
    """Return how far a point is from the rig's own values."""
    return math.sqrt(sum(variation.deviation(value) ** 2 for variation, value in zip(vary, values, strict=True)))


def nearest_failing(vary: Sequence[Vary], failing: Sequence[RunRequest]) -> RunRequest | None:
    """Return the one of these runs that deviates least; the first of several that do alike."""
    return min(failing, key=lambda order: (deviation(vary, order.values), order.run), default=None)


def shrunk(job: Job, rate: str, start: RunRequest, progress: Callable[[int], None] = lambda tried: None) -> Worst:
    """Return the mildest rig on the way from the run `start`, for which the condition of `rate` does
    not hold, to the rig's own values.
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
    """Return the value nearest to the rig's own that is found to fail, from `bad` on."""
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
    """Return the files of a rig that is to be read from `folder`, by their names there: the rig
    file, and the EDS files that are not found from there.

    The file of a law stays where it is; the rig file names it from the folder.
    """
    values = read_toml(rig.effective()).values
    files: dict[str, str] = {}
    changes: list[str] = []
    for above, own in _parts(values):
        descriptions = _descriptions_of(own, folder / name)
        for key in device_keys(own):
            section: Any = own
            for part in key:
                section = section.get(part, {})
            eds = section.get("eds")
            if eds is None or descriptions.get(eds) == rig.eds_texts.get(eds):
                continue
            there = f"{Path(name).stem}-{len(files) + 1}{Path(eds).suffix or '.eds'}"
            files[there] = rig.eds_texts[eds]
            changes.append(f"{dotted((*above, *key, 'eds'))}={toml_value(there)}")
        law = own.get("law", {}).get("function", "")
        file, _, function = law.rpartition(":")
        if file.endswith(".py") and not Path(file).is_absolute() and (rig.law_directory / file).exists():
            there = os.path.relpath(rig.law_directory / file, folder)
            changes.append(f"{dotted((*above, 'law', 'function'))}={toml_value(f'{there}:{function}')}")
    text = _changed(values, changes) if changes else rig.effective()
    return {name: text, **files}


def _parts(values: Mapping[str, Any]) -> list[tuple[Key, Mapping[str, Any]]]:
    """Return the tables that may name files: what all axes share, and each axis' own."""
    return [((), values), *((("axis", name), own) for name, own in values.get("axis", {}).items())]


def _descriptions_of(own: Mapping[str, Any], path: Path) -> dict[str, str]:
    """Return the texts of the EDS files that a rig file at `path` would find, by their names."""
    try:
        descriptions = read_descriptions(own, Source(str(path), Document()), None)
    except (EdsError, OSError):
        return {}
    names = {}
    for key in device_keys(own):
        section: Any = own
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
