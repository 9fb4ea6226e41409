"""What happens to the nodes of ``coulombus sim`` and ``coulombus simulate``, and when: the script
file.

::

    [[at]]
    t_s = 5.0
    node = "motor"            # or "brake"
    action = "power_off"      # or "power_on", "reset" (as by the NMT command), "fault", "clear"
    fault = "over_current"    # with "fault" and "clear": one of FAULTS; "clear" without it ends all of the node
    after = "enabled"         # t_s counts from the drive's first Operation Enabled; default: "start", the power-on

A node has the faults that FAULTS names for it. "clear" takes the cause away; the device then wants
its own reset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coulombus.eds.cia301 import NmtCommand
from coulombus.eds.regular_file import read_regular
from coulombus.rigs.toml_lines import MOST_CHARACTERS, read_toml
from coulombus.sim_bus.network.kernel import BRAKE, MOTOR

if TYPE_CHECKING:
    from coulombus.sim_bus.network.virtual_rig import VirtualRig

__all__ = ["Entry", "ScriptError", "read_script"]

NODES = {"motor": MOTOR, "brake": BRAKE}
ACTIONS = ("power_off", "power_on", "reset", "fault", "clear")
FAULTS = {
    "motor": ("over_current", "over_temperature", "encoder_lost", "supply_low"),
    "brake": ("over_current", "over_temperature", "supply_low", "coil_open", "coil_short"),
}
"""Device faults by node."""

ORIGINS = ("start", "enabled")
REQUIRED, OPTIONAL = frozenset(("t_s", "node", "action")), frozenset(("after", "fault"))


class ScriptError(ValueError):
    """A script that cannot be read; the text says which entry, and what is expected."""

    exit_status = 3


@dataclass(frozen=True)
class Entry:
    """One entry of a script."""

    t_ns: int
    node: str
    action: str
    after: str = "start"
    fault: str | None = None

    def act(self, world: VirtualRig) -> None:
        """Do it now."""
        row = NODES[self.node]
        device = (world.motor, world.brake)[row]
        if self.action == "power_off":
            world.power_off(row)
        elif self.action == "power_on":
            world.power_on(row)
        elif self.action in ("fault", "clear"):
            for fault in FAULTS[self.node] if self.fault is None else (self.fault,):
                world.inject(row, fault, self.action == "fault")
        elif device.record["powered"]:
            world.nmt_command(row, NmtCommand.RESET_NODE)


def read_script(path: Path) -> tuple[Entry, ...]:
    """Return the entries of the script `path`.

    Raises
    ------
    ScriptError
        The file is no TOML, or an entry is not as above.
    """
    try:
        document = read_toml(read_regular(path, MOST_CHARACTERS).decode())
    except OSError as error:
        raise ScriptError(f"{path}: the script cannot be read ({error.strerror or error})") from None
    except UnicodeDecodeError as error:
        raise ScriptError(f"{path}: {error}; save the file as UTF-8") from None
    if document.problems:
        raise ScriptError("\n".join(f"{path}:{line}: {problem}" for line, problem in document.problems))
    table = document.values
    entries = table.pop("at", [])
    if table or not isinstance(entries, list):
        other = "; a fault file is given by --faults" if {"fault", "noise", "seed"} & set(table) else ""
        raise ScriptError(f"{path}: {', '.join(table) or 'at'}; expected nothing but entries [[at]]{other}")
    if not entries:
        raise ScriptError(
            f"{path}: there is no entry in it; expected [[at]] with t_s, node and action, once for each thing that happens"
        )
    return tuple(_entry(f"{path}: entry {n} of [[at]]", given) for n, given in enumerate(entries, 1))


def _entry(where: str, given: Any) -> Entry:
    if not isinstance(given, dict) or not REQUIRED <= set(given) <= REQUIRED | OPTIONAL:
        raise ScriptError(f"{where}: {given}; expected the keys t_s, node, action, and perhaps after and fault")
    t_s = given["t_s"]
    if isinstance(t_s, bool) or not isinstance(t_s, int | float) or not 0 <= t_s < 1e9:
        raise ScriptError(f"{where}: t_s = {t_s!r}; expected seconds, 0 or more")
    for key, allowed in (("node", tuple(NODES)), ("action", ACTIONS), ("after", ORIGINS)):
        if key in given and given[key] not in allowed:
            raise ScriptError(f"{where}: {key} = {given[key]!r}; expected {_either(allowed)}")
    node, action, fault = given["node"], given["action"], given.get("fault")
    if fault is None and action == "fault":
        raise ScriptError(f"{where}: the key fault is missing; expected {_either(FAULTS[node])}")
    if fault is not None and action not in ("fault", "clear"):
        raise ScriptError(f'{where}: fault = {fault!r}; expected with action = "fault" or "clear" only')
    if fault is not None and fault not in FAULTS[node]:
        raise ScriptError(f'{where}: fault = {fault!r}; expected for node = "{node}": {_either(FAULTS[node])}')
    return Entry(round(t_s * 1e9), node, action, given.get("after", "start"), fault)


def _either(allowed: Sequence[str]) -> str:
    return " or ".join(f'"{one}"' for one in allowed)
