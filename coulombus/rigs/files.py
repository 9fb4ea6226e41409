"""The files that a rig file names: EDS files, and the schedules of phases of kind "file"."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from coulombus.eds.reader import Description, EdsError, parse_eds, read_eds
from coulombus.eds.regular_file import read_regular
from coulombus.rigs.axes import device_keys
from coulombus.rigs.errors import Source, nearest
from coulombus.rigs.pdo_records import with_accepted
from coulombus.rigs.signals import Node
from coulombus.rigs.toml_lines import Table

__all__ = ["COLUMNS", "read_descriptions", "read_schedules"]

COLUMNS = {"file": ("t_s", "torque_Nm"), "motion": ("t_s", "x_rad")}
"""Columns of the CSV file, by the kind of the phase."""
MOST_ERRORS = 10


def _find(name: str, rig_path: str, package: Path | None) -> tuple[Path | None, list[Path]]:
    """Look for a file beside the rig file, in the package, in the current folder.

    Return it and the paths tried.
    """
    folders = [Path(rig_path).parent, *([package] if package else []), Path()]
    tried = list(dict.fromkeys(folder / name for folder in folders))
    return next((path for path in tried if path.exists()), None), tried  # a FIFO is found, and refused when it is read


def read_descriptions(
    values: Table, source: Source, eds_texts: Mapping[str, str] | None, prefix: str = ""
) -> dict[Node, Description]:
    """Return the devices' EDS files by "motor", "brake" and the sensors' names.

    Errors are noted in `source`. Mappings acknowledged in host.accept are applied; `prefix` is the axis', before the
    names of its devices.
    """
    descriptions: dict[Node, Description] = {}
    host = values.get("host")
    accept = host.get("accept") if isinstance(host, Mapping) else None
    sentences = [text for text in accept if isinstance(text, str)] if isinstance(accept, list | tuple) else []
    for key in device_keys(values):
        section: Any = values
        for part in key:
            section = section.get(part) if isinstance(section, Mapping) else None
        name = section.get("eds") if isinstance(section, Mapping) else None
        if not isinstance(name, str) or source.is_wrong((*key, "eds")):
            continue
        try:
            described = _from_file(name, source.path) if eds_texts is None else _from_text(name, eds_texts)
            descriptions[str(key[-1])] = with_accepted(described, f"{prefix}{key[-1]}", sentences)
        except EdsError as error:
            source.say((*key, "eds"), f"got '{name}', but {error}")
    return descriptions


def _from_text(name: str, eds_texts: Mapping[str, str]) -> Description:
    if name not in eds_texts:
        raise EdsError(f"its text is not given; expected one of {', '.join(eds_texts) or 'nothing'}")
    return parse_eds(eds_texts[name].encode(), name)


def _from_file(name: str, rig_path: str) -> Description:
    package = Path(str(resources.files("coulombus.eds")))
    path, tried = _find(name, rig_path, package)
    if path is not None:
        return read_eds(path)
    packaged = sorted(entry.name for entry in package.glob("*.eds"))
    looked = ", ".join(map(str, tried))
    raise EdsError(
        f"there is no such file; looked for {looked}; expected a path, or one of {', '.join(packaged)}{nearest(name, packaged)}"
    )


def read_schedules(values: Table, source: Source, *, attached: bool = False) -> None:
    """Fill in `t_s`, `torque_Nm` and `duration_s` of the phases of kind "file", `t_s`,
    `x_rad` and `duration_s` of those of kind "motion".

    Mistakes are noted in `source`.

    For a rig `attached` to a recording no file is read: the recording has the schedule's values.
    """
    phases = values.get("phase")
    for i, phase in enumerate(phases if isinstance(phases, list) else ()):
        kind = phase.get("kind") if isinstance(phase, dict) else None
        if not isinstance(phase, dict) or not isinstance(kind, str) or kind not in COLUMNS:
            continue
        names = COLUMNS[kind]
        if not phase.keys() & set(names) and attached:
            expected = " and ".join(names)
            source.say(("phase", i, "path"), f"the schedule's values are not attached; expected {expected}")
            source.wrong.update(("phase", i, column) for column in (*names, *({"duration_s"} - phase.keys())))
        elif not phase.keys() & set(names):
            _read_schedule(phase, ("phase", i), source)
        times = phase.get("t_s")
        if "duration_s" not in phase and isinstance(times, list) and times and type(times[-1]) in (int, float):
            phase["duration_s"] = float(times[-1])


def _read_schedule(phase: dict[str, Any], key: tuple[str, int], source: Source) -> None:
    name, names = phase.get("path"), COLUMNS[phase["kind"]]
    header = ",".join(names)
    if not isinstance(name, str):
        if "path" not in phase:
            source.say((*key, "path"), f"missing in [[phase]]; expected a CSV file with the columns {header}")
    else:
        path, tried = _find(name, source.path, None)
        if path is None:
            looked = ", ".join(map(str, tried))
            source.stands((*key, "path"), name, f"a CSV file with the columns {header}; looked for {looked}")
        else:
            columns: tuple[list[float], list[float]] = ([], [])
            mistakes = list(_rows(path, columns, names))
            place, _ = source.where((*key, "path"))
            source.found += [(place, mistake) for mistake in mistakes[:MOST_ERRORS]]
            if len(mistakes) > MOST_ERRORS:
                source.found.append((place, f"{path}: {len(mistakes) - MOST_ERRORS} further lines cannot be read"))
            if not mistakes:
                phase[names[0]], phase[names[1]] = columns
                return
    source.wrong.update((*key, column) for column in (*names, *({"duration_s"} - phase.keys())))


def _rows(path: Path, columns: tuple[list[float], list[float]], names: tuple[str, str]) -> Iterator[str]:
    """Read a schedule into `columns`; yield the errors, each with file:line."""
    header = ",".join(names)
    try:
        lines = read_regular(path).decode("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no UTF-8"
        yield f"{path}:1: cannot be read ({reason}); expected a CSV file with the columns {header}"
        return
    rows = [(n, line.strip()) for n, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    if not rows or [cell.strip() for cell in rows[0][1].split(",")] != list(names):
        number, head = rows[0] if rows else (1, "")
        yield f"{path}:{number}: got '{head[:60]}', expected the header {header}"
        return
    before = -math.inf
    for number, line in rows[1:]:
        cells = line.split(",")
        row = [_number(cell) for cell in cells]
        if len(cells) != 2 or any(cell is None for cell in row):
            yield f"{path}:{number}: got '{line[:60]}', expected two finite numbers, {header}"
            continue
        t, torque = (cell for cell in row if cell is not None)
        if t <= before or t < 0:
            yield f"{path}:{number}: t_s: got '{cells[0].strip()}', expected times that grow, from 0 on"
        before = t
        columns[0].append(t)
        columns[1].append(torque)
    if len(rows) < 3:
        yield f"{path}:{rows[-1][0]}: the file has {len(rows) - 1} rows; expected at least two"


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
