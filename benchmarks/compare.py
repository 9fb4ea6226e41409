"""``python -m benchmarks compare A B``: what became slower from A to B, beyond the noise.

A and B are files of ``out/bench``, or folders of them. A figure has changed if its medians differ by
more than both spreads together (half the interquartile range of the rounds), and by more than 2 %. A
figure of one round has no spread: it has changed if it differs by more than 10 %.
"""

from __future__ import annotations

import json
import statistics
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["Change", "changes", "compare"]

LEAST, ONE_ROUND = 0.02, 0.10


@dataclass(frozen=True)
class Change:
    """A figure in A and in B."""

    what: str
    before: float
    after: float
    noise: float
    """Relative to `before`."""
    more_is_better: bool

    @property
    def gain(self) -> float:
        """How much better B is, relative to A."""
        change = self.after / self.before - 1.0
        return change if self.more_is_better else -change

    @property
    def verdict(self) -> str:
        """Return "slower", "faster", or "" within the noise."""
        return "" if abs(self.gain) <= self.noise else "faster" if self.gain > 0 else "slower"


def _lines(path: Path) -> dict[tuple[str, str], dict[str, Any]]:
    files = sorted(path.glob("*.json")) if path.is_dir() else [path]
    contents = [json.loads(file.read_text()) for file in files]
    return {(content["benchmark"], line["what"]): line for content in contents for line in content["lines"]}


def _median(line: dict[str, Any]) -> float:
    return statistics.median(line["rounds"]) if line["rounds"] else float(line["value"])


def _spread(line: dict[str, Any]) -> float | None:
    """Return half the interquartile range of the rounds; None for less than three of them."""
    if len(line["rounds"]) < 3:
        return None
    low, _, high = statistics.quantiles(line["rounds"], n=4, method="inclusive")
    return (high - low) / 2


def changes(a: Path, b: Path) -> list[Change]:
    """Return the figures with a goal that A and B have in common."""
    before, after = _lines(a), _lines(b)
    shared = []
    for key in before.keys() & after.keys():
        one, other = before[key], after[key]
        if one["more_is_better"] is None or not one["value"] or other["value"] is None:
            continue
        spreads = _spread(one), _spread(other)
        middle = _median(one)
        noises = [spread for spread in spreads if spread is not None]
        noise = max(LEAST, sum(noises) / middle) if len(noises) == 2 else ONE_ROUND
        shared.append(Change(": ".join(key), middle, _median(other), noise, one["more_is_better"]))
    return sorted(shared, key=lambda change: change.gain)


def compare(a: Path, b: Path) -> int:
    """Print the changes, the worst first; return 1 if a figure became slower, else 0."""
    all_changes = changes(a, b)
    for change in all_changes:
        end = change.verdict or "within the noise"
        figures = f"{change.before:>10.4g} {change.after:>10.4g} {change.gain:>+7.1%} +-{change.noise:.1%}"
        print(f"{change.what:<100} {figures}   {end}")
    slower = sum(change.verdict == "slower" for change in all_changes)
    print(f"{slower} of {len(all_changes)} figures became slower beyond the noise")
    return int(slower > 0)
