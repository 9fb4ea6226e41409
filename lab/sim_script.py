"""What happens to the nodes of ``coulombus sim``, and when: its script file.

::

    [[at]]
    t_s = 5.0
    node = "motor"            # or "brake"
    action = "power_off"      # or "power_on", "reset" (as by the NMT command)
    after = "enabled"         # t_s counts from the drive's first Operation Enabled; default: "start" of the sim
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eds.cia301 import NmtCommand
from lab.kernel import BRAKE, MOTOR
from lab.sim_server import PacedRig

__all__ = ["Entry", "ScriptError", "read_script"]

NODES = {"motor": MOTOR, "brake": BRAKE}
ACTIONS = ("power_off", "power_on", "reset")
ORIGINS = ("start", "enabled")


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

    def act(self, world: PacedRig) -> None:
        """Do it now."""
        row = NODES[self.node]
        device = (world.motor, world.brake)[row]
        if self.action == "power_off":
            world.power_off(row)
        elif self.action == "power_on":
            world.power_on(row)
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
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ScriptError(f"{path}: {error}") from None
    entries = table.pop("at", [])
    if table or not isinstance(entries, list):
        raise ScriptError(f"{path}: {', '.join(table) or 'at'}; expected nothing but entries [[at]]")
    return tuple(_entry(f"{path}: entry {n} of [[at]]", given) for n, given in enumerate(entries, 1))


def _entry(where: str, given: Any) -> Entry:
    if not isinstance(given, dict) or not {"t_s", "node", "action"} <= set(given) <= {"t_s", "node", "action", "after"}:
        raise ScriptError(f"{where}: {given}; expected the keys t_s, node, action, and perhaps after")
    t_s = given["t_s"]
    if isinstance(t_s, bool) or not isinstance(t_s, int | float) or not 0 <= t_s < 1e9:
        raise ScriptError(f"{where}: t_s = {t_s!r}; expected seconds, 0 or more")
    for key, allowed in (("node", tuple(NODES)), ("action", ACTIONS), ("after", ORIGINS)):
        if key in given and given[key] not in allowed:
            raise ScriptError(
                f"{where}: {key} = {given[key]!r}; expected " + " or ".join(f'"{one}"' for one in allowed)
            )
    return Entry(round(t_s * 1e9), given["node"], given["action"], given.get("after", "start"))
