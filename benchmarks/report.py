"""The lines that the benchmarks print: each a figure, its goal, and whether it is met; kept as JSON."""

from __future__ import annotations

import json
import os
import platform
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

__all__ = ["Line", "keep", "line_of", "machine", "show", "take_lines"]

FOLDER = Path("out", "bench")
_NUMBER = r"[+-]?\d[\d,]*(?:\.\d+)?"
_GOAL = re.compile(rf"(at least|at most) ({_NUMBER})")
_lines: list[Line] = []


@dataclass(frozen=True)
class Line:
    """A figure of a benchmark.

    Attributes
    ----------
    figure : as printed
    value : its number; None if it has none (skipped)
    target : what is aimed at, or a remark
    more_is_better : None: no goal
    goal, met : None: no goal, or no figure
    rounds : the value of each round; empty: one round
    """

    what: str
    figure: str
    target: str
    value: float | None
    more_is_better: bool | None
    goal: float | None
    met: bool | None
    rounds: tuple[float, ...] = ()

    @property
    def verdict(self) -> str:
        """Return whether the goal is met, or by how much it is not; "" without a goal."""
        if self.met is None or self.goal is None or self.value is None:
            return ""
        return "met" if self.met else f"missed by {abs(self.value / self.goal - 1):.0%}"


def _number(text: str) -> float | None:
    match = re.match(_NUMBER, text)
    return None if match is None else float(match[0].replace(",", ""))


def line_of(what: str, figure: str, target: str = "", rounds: Sequence[float] = ()) -> Line:
    """Return the line of a figure; a `target` that begins with "at least" or "at most" is a goal."""
    value, match = _number(figure), _GOAL.match(target)
    if match is None:
        return Line(what, figure, target, value, None, None, None, tuple(rounds))
    more, goal = match[1] == "at least", float(match[2].replace(",", ""))
    met = None if value is None else value >= goal if more else value <= goal
    return Line(what, figure, target, value, more, goal, met, tuple(rounds))


def show(what: str, figure: str, target: str = "", rounds: Sequence[float] = ()) -> None:
    """Print a figure with its goal and verdict, and collect it for `take_lines`."""
    line = line_of(what, figure, target, rounds)
    _lines.append(line)
    end = f"{target}: {line.verdict}" if line.verdict else target
    print(f"{what:<84} {figure:>12}   {end}", flush=True)


def take_lines() -> list[Line]:
    """Return the lines since the last call."""
    lines = list(_lines)
    _lines.clear()
    return lines


def machine() -> dict[str, Any]:
    """Return what the figures depend on."""
    model = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace"))
    return {
        "processor": platform.machine() if model is None else model[1],
        "cores": len(os.sched_getaffinity(0)),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "numba": version("numba"),
        "load": round(os.getloadavg()[0], 1),
    }


def keep(name: str, lines: Sequence[Line], seconds: float, folder: Path = FOLDER) -> Path:
    """Write the lines of a benchmark to ``out/bench/NAME.json``; return the path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.json"
    content = {
        "benchmark": name,
        "machine": machine(),
        "seconds": round(seconds, 1),
        "lines": [asdict(line) | {"verdict": line.verdict} for line in lines],
    }
    path.write_text(json.dumps(content, indent=1) + "\n")
    return path
