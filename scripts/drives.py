#!/usr/bin/env python3
"""Tries every EDS file of a folder as a drive, and as a brake's driver, beside this project's other
device; prints the tables of docs/drives.md.

    .venv/bin/python scripts/drives.py FOLDER [--write]

Of each file: `coulombus init --rehearse`, `check`, and `simulate` in the modes hybrid and active (a
brake: passive), as a user runs them. With --write the tables are put into docs/drives.md, between
its markers.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from click.testing import CliRunner

from coulombus.cli.main import main as coulombus
from coulombus.eds.cia402 import OPERATION_MODE_CST, OPERATION_MODE_PROFILE_TORQUE
from coulombus.eds.drive_scale import defaults, position_scale
from coulombus.rigs.pdo_maps import mode_of
from coulombus.rigs.rig import load_rig

PAGE = Path(__file__).parents[1] / "docs" / "drives.md"
SECONDS = "2"
MODES = {"drive": ("hybrid", "active"), "brake": ("hybrid", "passive")}


class Tried(NamedTuple):
    """A row: the file, its class, the unit of a drive's position (None of a brake), what `check`
    said, in which modes it was armed, what is lost or why it is refused.
    """

    name: str
    kind: str
    unit: str | None
    check: str
    armed: str
    lost: str

    def line(self) -> str:
        """Return the row in Markdown."""
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in self if cell is not None) + " |"


def _run(*arguments: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(coulombus, list(arguments))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def _class(rig_file: str) -> str:
    """Return how a drive is commanded: A cyclic torque, B with fixed PDO maps, C profile torque, D
    a maker's own mode.
    """
    axis = load_rig(rig_file).one_axis()
    mode = mode_of(axis.motor, axis.description("motor"))
    if mode not in (OPERATION_MODE_CST, OPERATION_MODE_PROFILE_TORQUE):
        return "D"
    if mode == OPERATION_MODE_PROFILE_TORQUE:
        return "C"
    return "B" if any(pdo.fixed and pdo.device == "motor" for pdo in axis.pdos()) else "A"


def _unit(rig_file: str) -> str:
    """Return what a brake's set-point is."""
    bound = load_rig(rig_file).one_axis().allocation.bound["brake_setpoint"]
    return f"{bound.entry.index:04X}h:{bound.entry.subindex:02X}"


def _position(rig_file: str) -> str:
    """Return the counts of the position in one turn of the motor, and what tells them."""
    scale = position_scale(defaults(load_rig(rig_file).one_axis().description("motor")))
    return "not told" if scale.counts_rev is None else f"{scale.counts_rev:.9g} a turn: {scale.by}"


def _named(path: Path, after: str) -> re.Pattern[str]:
    """Return what finds a file in a message: a rig file may name it by a path of its own."""
    return re.compile(rf"\S*/{re.escape(path.name)}(?::\d+)?{after}")


def _lost(texts: Sequence[str], role: str, path: Path) -> str:
    named = _named(path, " ")
    of_role = [named.sub("the file ", text.partition(": ")[2]) for text in texts if text.startswith(role)]
    return "<br>".join(dict.fromkeys(text.rpartition("; ")[2] for text in of_role)) or "nothing"


def tried(path: Path, role: str, folder: Path) -> Tried | None:
    """Try one file as "drive" or "brake"; None where it is no brake."""
    rig_file = str(folder / f"{role}-{path.stem}.toml")
    others = {"drive": "brake", "brake": "drive"}
    status, _, errors = _run(
        "init", f"--{role}", str(path), f"--{others[role]}", "bench", "--rehearse", "--no-trials", "-o", rig_file
    )
    if status:
        if role == "brake":
            return None
        line = next(line for line in errors.splitlines() if line.startswith("coulombus: "))
        reason = _named(path, ": ").split(line, maxsplit=1)[-1].partition("; ")[0]
        return Tried(path.name, "E", "", "", "no", reason)
    status, out, _ = _run("check", "--rig", rig_file, "--json")
    checked: dict[str, Any] = json.loads(out)
    armed = []
    for mode in MODES[role]:
        ended, out, _ = _run("simulate", "--rig", rig_file, "--mode", mode, "--seconds", SECONDS, "--json")
        armed.append(f"{mode}" if ended == 0 and json.loads(out)["trip"] is None else f"{mode}: no ({ended})")
    kind = _class(rig_file) if role == "drive" else _unit(rig_file)
    check = "ok" if checked["ok"] and status == 0 else "; ".join(one["text"] for one in checked["problems"])
    return Tried(
        path.name,
        kind,
        _position(rig_file) if role == "drive" else None,
        check,
        ", ".join(armed),
        _lost(checked["losses"], "motor" if role == "drive" else "brake", path),
    )


def tables(folder: Path) -> Iterator[str]:
    """Yield the tables of the drives and of the brakes, each after its marker's name."""
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in (".eds", ".dcf", ".xdd", ".xdc"))
    with TemporaryDirectory() as place:
        for role, head in (("drive", "class"), ("brake", "set-point")):
            rows = []
            for number, path in enumerate(files, 1):
                print(f"\r{role} {number} of {len(files)}: {path.name:<50}", end="", file=sys.stderr, flush=True)
                row = tried(path, role, Path(place))
                if row is not None:
                    rows.append(row)
            rows.sort(key=lambda row: (row.kind, row.name))
            heads = ["file", head, *(["position unit"] if role == "drive" else []), "check", "armed"]
            heads.append("lost, or why it is refused" if role == "drive" else "lost")
            lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads), *(row.line() for row in rows)]
            yield "\n".join(lines)
    print(file=sys.stderr)


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--write", action="store_true", help="put the tables into docs/drives.md")
    arguments = parser.parse_args()
    contents = list(tables(arguments.folder))
    if not arguments.write:
        print("\n\n".join(contents))
        return
    text = PAGE.read_text()
    for name, table in zip(("drives", "brakes"), contents, strict=True):
        begin, end = f"<!-- {name} -->\n", f"\n<!-- end of {name} -->"
        before, _, rest = text.partition(begin)
        text = before + begin + table + end + rest.partition(end)[2]
    PAGE.write_text(text)


if __name__ == "__main__":
    main()
