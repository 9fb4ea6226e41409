"""Fault file: faults on the bus, and their times (docs/bus.md).

::

    seed = 7                             # of the noise; default: the run's seed

    [[fault]]
    kind = "flip"                        # FaultKind, in small letters
    on = "3rd TPDO1 of node 2"           # or { frame = "TPDO1", node = 2, nth = 3, every = 10 }
    bit = 30

    [[fault]]
    kind = "noise"
    at_s = 1.5                           # from power-on; with after = "enabled" from the drive's Operation Enabled
    duration_s = 10.0
    rate = 1e-4

    [[controller]]
    node = "motor"
    restart_ms = 100                     # bus-off to the begin of recovery; "manual": never
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import Field, TypeAdapter, ValidationError

from coulombus.rigs.toml_lines import Document, Key, of_another_kind, read_text, read_toml
from coulombus.sim_bus.can_bus.records import MAX_FAULTS
from coulombus.sim_bus.faults.error_text import mistakes
from coulombus.sim_bus.faults.fault_kinds import KINDS, AnyFault, Controller, Strict
from coulombus.system.errors import CoulombusError

__all__ = ["FaultError", "FaultPlan", "faults_of", "injected_lines", "read_faults"]


class FaultError(CoulombusError, ValueError):
    """An unusable fault file; one line for each mistake, with its position."""

    exit_status = 3


class _FaultFile(Strict):
    seed: int | None = Field(None, ge=0, lt=2**62)
    fault: list[AnyFault] = Field(default_factory=list)
    controller: list[Controller] = Field(default_factory=list)


@dataclass(frozen=True)
class FaultPlan:
    """Contents of a fault file, or its part for one bus; `faults` and `controllers` map to the positions in
    the file, `lines` to the line numbers; `text` is the whole file.
    """

    path: str
    text: str
    file: _FaultFile
    lines: tuple[int, ...]
    document: Document
    faults: tuple[int, ...]
    controllers: tuple[int, ...]

    def on(self, channel: str, channels: Collection[str]) -> FaultPlan:
        """Return the plan of one of the buses `channels` of a rig.

        Raises
        ------
        FaultError
            an entry names an unknown bus, or none although the rig has several
        """
        selected: dict[str, list[int]] = {"fault": [], "controller": []}
        bus_names = ", ".join(f'"{bus}"' for bus in channels if bus) or "one without a name; leave the key out"
        for section, entries in (("fault", self.file.fault), ("controller", self.file.controller)):
            for n, entry in enumerate(entries):
                if entry.bus is None and len(channels) > 1:
                    raise self.mistake((section, n), f"the rig has several buses; expected bus = one of {bus_names}")
                if entry.bus is not None and entry.bus not in channels:
                    raise self.mistake((section, n, "bus"), f"there is no bus '{entry.bus}'; the rig has {bus_names}")
                if entry.bus in (None, channel):
                    selected[section].append(n)
        return replace(
            self,
            file=self.file.model_copy(
                update={
                    "fault": [self.file.fault[n] for n in selected["fault"]],
                    "controller": [self.file.controller[n] for n in selected["controller"]],
                }
            ),
            lines=tuple(self.lines[n] for n in selected["fault"]),
            faults=tuple(selected["fault"]),
            controllers=tuple(selected["controller"]),
        )

    def on_one(self, channels: Sequence[str]) -> FaultPlan:
        """Return the plan of the buses of one host.

        Raises
        ------
        FaultError
            the host has several buses, or as from `on`
        """
        if len(channels) > 1:
            buses = ", ".join(channels)
            raise FaultError(
                f"{self.path}: faults strike a host's only bus, and the arm has the buses {buses}: put its joints on one"
            )
        return self.on(channels[0], channels)

    def mistake(self, key: Key, text: str) -> FaultError:
        """Return the error for a value, with its position."""
        return FaultError(f"{self.path}:{self.document.line(key)}: {'.'.join(str(part) for part in key)}: {text}")


def read_faults(path: Path) -> FaultPlan:
    """Return the faults of the file `path`.

    Raises
    ------
    FaultError
        the file is unreadable, or has mistakes; the text has a line for each, with file and line
    """
    return faults_of(read_text(path, "fault file", FaultError), str(path))


def faults_of(text: str, path: str) -> FaultPlan:
    """Return the faults of a fault file's text; errors name it `path`.

    Raises
    ------
    FaultError
        the text has mistakes, a line for each
    """
    document = read_toml(text)
    if document.problems:
        raise FaultError("\n".join(f"{path}:{line}: {problem}" for line, problem in document.problems))
    if other := of_another_kind(document.values, "faults"):
        raise FaultError(f"{path}: {other}")
    try:
        file = TypeAdapter(_FaultFile).validate_python(document.values)
    except ValidationError as error:
        raise FaultError("\n".join(mistakes(path, document, error, _FaultFile, KINDS))) from None
    if len(file.fault) > MAX_FAULTS:
        line = document.line(("fault", MAX_FAULTS))
        raise FaultError(f"{path}:{line}: {len(file.fault)} faults; a file may have {MAX_FAULTS}")
    if not file.fault and not file.controller:
        raise FaultError(f"{path}: it has no fault; expected [[fault]] or [[controller]], once for each (docs/bus.md)")
    lines = tuple(document.line(("fault", n)) for n in range(len(file.fault)))
    return FaultPlan(path, text, file, lines, document, tuple(range(len(lines))), tuple(range(len(file.controller))))


def injected_lines(
    faults: Sequence[Mapping[str, Any]] | None, controllers: Mapping[str, Mapping[str, Any]] | None
) -> Iterator[str]:
    """Yield a line for each fault of a fault file, and for each CAN controller, including faults that never
    struck.
    """
    for fault in faults or ():
        bus = f"bus {fault['bus']}, " if "bus" in fault else ""
        if not fault["times"]:
            when = "never struck: what it waits for did not come"
        elif fault["times"] == 1:
            when = f"once, at {fault['first_s']:.6f} s"
        else:
            when = f"{fault['times']} times, from {fault['first_s']:.6f} s to {fault['last_s']:.6f} s"
        place = "injected" if fault["line"] is None else f"line {fault['line']}"
        yield f"fault {fault['kind']} ({bus}{place}): {when}"
    for name, c in (controllers or {}).items():
        counts = {
            "errors": sum(c["errors"].values()),
            "frames sent again": c["retransmissions"],
            "dropped": c["dropped"],
        }
        counts |= {"times error passive": c["passives"], "times bus-off": c["bus_offs"]}
        rest = "".join(f", {n} {what}" for what, n in counts.items() if n)
        yield f"controller {name}: {c['state'].upper()} (berr-counter tx {c['tec']} rx {c['rec']}){rest}"
