"""Script file of ``coulombus emulate`` and ``coulombus simulate``: timed actions on the nodes.

::

    [[at]]
    t_s = 5.0
    node = "motor"            # or "brake", a sensor's name, of several axes "left.motor"
    action = "fault"          # or "clear", "power_off", "power_on", "reset" (as by the NMT command)
    fault = "over_current"    # with "fault" and "clear": a fault of the node; "clear" without it ends all of the node
    after = "enabled"         # t_s counts from the drive's first Operation Enabled; default: "start", the power-on

A node has the faults that `sim_bus.network.device_faults` lists for it. "clear" removes the cause; the device
then still requires its own reset. In a rig of several axes "motor" and "brake" are those of the
first axis on its bus; entries for nodes on another bus are ignored here.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coulombus.eds.cia301 import NmtCommand
from coulombus.rigs.toml_lines import of_another_kind, read_text, read_toml
from coulombus.sim_bus.network.device_faults import FAULTS, OF_EVERY_NODE, SILENT
from coulombus.sim_bus.network.event_loop import BRAKE, MOTOR
from coulombus.system.errors import CoulombusError

if TYPE_CHECKING:
    from coulombus.sim_bus.network.virtual_rig import VirtualRig

__all__ = ["ScriptEntry", "ScriptError", "faults_of", "read_script", "script_of"]

NODES = {"motor": MOTOR, "brake": BRAKE}
ACTIONS = ("power_off", "power_on", "reset", "fault", "clear")
OF_A_SCRIPT = tuple(fault for fault in OF_EVERY_NODE if fault not in ACTIONS)

ORIGINS = ("start", "enabled")
REQUIRED, OPTIONAL = frozenset(("t_s", "node", "action")), frozenset(("after", "fault"))


class ScriptError(CoulombusError, ValueError):
    """An invalid script; the text names the entry and the expectation."""

    exit_status = 3


@dataclass(frozen=True)
class ScriptEntry:
    """One entry of a script."""

    t_ns: int
    node: str
    action: str
    after: str = "start"
    fault: str | None = None

    def act(self, world: VirtualRig) -> None:
        """Perform the entry now."""
        row = NODES.get(self.node, world.rows.get(self.node))
        if row is None:  # the node is on another bus
            return
        device = world.devices[row]
        if self.action == "power_off":
            world.power_off(row)
        elif self.action == "power_on":
            world.power_on(row)
        elif self.action in ("fault", "clear"):
            for fault in faults_of(self.node) if self.fault is None else (self.fault,):
                world.inject(row, fault, self.action == "fault")
        elif device.record["powered"]:
            world.nmt_command(row, NmtCommand.RESET_NODE)


def faults_of(node: str) -> tuple[str, ...]:
    """Return the device faults of a node, by its name with or without its axis."""
    name = node.rpartition(".")[2]
    return (*FAULTS.get(name, ()), *SILENT.get(name, ()), *OF_A_SCRIPT)


def read_script(path: Path, nodes: Collection[str] = ()) -> tuple[ScriptEntry, ...]:
    """Return the entries of the script `path`.

    Parameters
    ----------
    nodes : names of the rig's devices (`Rig.nodes`), in addition to "motor" and "brake"

    Raises
    ------
    ScriptError
        The file is no TOML, or an entry is invalid.
    """
    return script_of(read_text(path, "script", ScriptError), str(path), nodes)


def script_of(text: str, path: str, nodes: Collection[str] = ()) -> tuple[ScriptEntry, ...]:
    """Return the entries of a script's text; errors name it `path`; nodes and errors as of `read_script`."""
    document = read_toml(text)
    if document.problems:
        raise ScriptError("\n".join(f"{path}:{line}: {problem}" for line, problem in document.problems))
    table = document.values
    if other := of_another_kind(table, "script"):
        raise ScriptError(f"{path}: {other}")
    entries = table.pop("at", [])
    if table or not isinstance(entries, list):
        raise ScriptError(f"{path}: {', '.join(table) or 'at'}; expected nothing but entries [[at]]")
    if not entries:
        raise ScriptError(
            f"{path}: it has no entry; expected [[at]] with t_s, node and action, once for each thing that happens"
        )
    names = tuple(dict.fromkeys((*NODES, *nodes)))
    return tuple(_entry(f"{path}: entry {n} of [[at]]", entry, names) for n, entry in enumerate(entries, 1))


def _entry(where: str, entry: Any, names: Sequence[str]) -> ScriptEntry:
    if not isinstance(entry, dict) or not REQUIRED <= set(entry) <= REQUIRED | OPTIONAL:
        raise ScriptError(f"{where}: {entry}; expected the keys t_s, node, action, and perhaps after and fault")
    t_s = entry["t_s"]
    if isinstance(t_s, bool) or not isinstance(t_s, int | float) or not 0 <= t_s < 1e9:
        raise ScriptError(f"{where}: t_s = {t_s!r}; expected seconds, 0 or more")
    for key, allowed in (("node", names), ("action", ACTIONS), ("after", ORIGINS)):
        if key in entry and entry[key] not in allowed:
            raise ScriptError(f"{where}: {key} = {entry[key]!r}; expected {_either(allowed)}")
    node, action, fault = entry["node"], entry["action"], entry.get("fault")
    if fault is None and action == "fault":
        raise ScriptError(f"{where}: the key fault is missing; expected {_either(faults_of(node))}")
    if fault is not None and action not in ("fault", "clear"):
        raise ScriptError(f'{where}: fault = {fault!r}; expected with action = "fault" or "clear" only')
    if fault is not None and fault not in faults_of(node):
        raise ScriptError(f'{where}: fault = {fault!r}; expected for node = "{node}": {_either(faults_of(node))}')
    return ScriptEntry(round(t_s * 1e9), node, action, entry.get("after", "start"), fault)


def _either(allowed: Sequence[str]) -> str:
    return " or ".join(f'"{word}"' for word in allowed)
