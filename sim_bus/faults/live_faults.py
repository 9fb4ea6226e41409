"""Faults that other programs inject into a running bus: their request, what acts, and what the bus could have."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from typing import Any

from coulombus.rigs.errors import nearest
from coulombus.sim_bus.can_bus.cable_cut import SEVERAL
from coulombus.sim_bus.faults.fault_file import FaultError, FaultPlan, faults_of
from coulombus.sim_bus.faults.fault_kinds import KINDS, NodeFault, OtherNodeId, effect_of
from coulombus.sim_bus.faults.injection import Injection
from coulombus.sim_bus.network.device_faults import device_faults_of
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.system.errors import CoulombusError

__all__ = ["BUS", "FaultRefused", "LiveFaults", "NodeUnknown", "catalogue", "kind_of"]

BUS = "bus"
"""Place of a fault of the whole bus."""
_PLACE = re.compile(r"^inject:\d+: (fault\.0\.)?", re.MULTILINE)


class FaultRefused(CoulombusError):
    """A fault that cannot be injected; the text says why."""

    exit_status = 2


class NodeUnknown(FaultRefused):
    """There is no such node on the bus; the text has those that are."""

    exit_status = 5


def kind_of(name: str) -> str:
    """Return the kind of a name, with hyphens or underscores; FaultRefused with the nearest kind if there is none."""
    kind = name.lower().replace("-", "_")
    if kind not in KINDS:
        raise FaultRefused(f"there is no fault '{name}'{nearest(kind, KINDS)}; coulombus inject --list has all")
    return kind


def catalogue() -> list[dict[str, str]]:
    """Return name, effect and places of each kind."""
    rows = []
    for kind, model in KINDS.items():
        places = ("a node" if model.place else "", BUS if model.wire else "")
        rows.append({"fault": kind, "effect": effect_of(kind), "on": " or ".join(filter(None, places))})
    return rows


def plan_of(kind: str, where: str, lasts_s: float | None, values: Mapping[str, str]) -> FaultPlan:
    """Return the fault file with one fault.

    Parameters
    ----------
    where : a node, by its name or its node id, or `BUS`
    lasts_s : None: until it is cleared
    values : further keys of the kind, as TOML; a word without quotes is a text

    Raises
    ------
    FaultRefused
        the fault cannot act there, or a key is wrong
    """
    model = KINDS[kind]
    if where == BUS and not model.wire:
        raise FaultRefused(f"{kind} is a fault of one node; expected --on NODE")
    if where != BUS and not model.place:
        raise FaultRefused(f"{kind} is a fault of the wire; expected --on {BUS}")
    node = where if where.isdigit() else json.dumps(where)
    keys = {name: json.dumps(value) for name, value in model.usual.items()} | {"kind": json.dumps(kind)}
    selects = model.place == "sender"
    options = {"kind": "the FAULT", "duration_s": "--for", "bus": "--bus"}
    if where != BUS and not selects:
        options[model.place] = "--on"
    for name in values:
        if name in options:
            raise FaultRefused(f"{kind}: {name} is stated by {options[name]}; leave --set {name} out")
        if not re.fullmatch(r"\w+", name, re.ASCII):
            raise FaultRefused(f"{kind}: {name!r} is no key; expected KEY=V, as in rate=1e-4")
    if where != BUS and not selects:
        keys[model.place] = node
    elif where != BUS and "on" not in values:
        keys["on"] = f"{{ sender = {node}, every = 1 }}"
    if lasts_s is not None:
        keys["duration_s"] = str(float(lasts_s))
    keys |= {name: _toml(text) for name, text in values.items()}
    try:
        return faults_of("[[fault]]\n" + "".join(f"{name} = {text}\n" for name, text in keys.items()), "inject")
    except FaultError as error:
        raise FaultRefused(f"{kind}: " + _PLACE.sub("", str(error))) from None


def _toml(text: str) -> str:
    """Return a value as TOML: a number, a table, a list or a quoted text as it is, another text in quotes."""
    plain = re.fullmatch(r'[-+]?(0x[0-9a-fA-F]+|[0-9][0-9_.eE+-]*)|true|false|["\[{].*', text)
    return text if plain else json.dumps(text)


class LiveFaults:
    """The faults of a world that runs; called in its thread, at the present.

    Parameters
    ----------
    mark : called with the time and the text of each fault that begins, strikes or ends
    """

    def __init__(self, world: VirtualNetwork, mark: Callable[[int, str], None] | None, seed: int = 0) -> None:
        self._world, self._mark, self._seed = world, mark, seed

    @property
    def _injection(self) -> Injection | None:
        injection = self._world.injection
        return injection if isinstance(injection, Injection) else None

    @property
    def acts(self) -> bool:
        """Whether a fault acts."""
        return self._injection is not None and bool(self._injection.standing())

    def state(self) -> dict[str, Any]:
        """Return nodes with their possible faults, faults of the wire, and the faults that act now."""
        world, injection = self._world, self._injection
        simulated = int(world.bus[0].bit_rate) > 0 and world.bus[0].cut != SEVERAL
        wire = [kind for kind, model in KINDS.items() if not issubclass(model, NodeFault | OtherNodeId)]
        at_node = [kind for kind in wire if KINDS[kind].place] if simulated else []
        nodes = [
            {
                "name": name,
                "node_id": world.devices[row].node_id,
                "powered": bool(world.nodes[row]["powered"]),
                "faults": [*device_faults_of(world, row), "other_node_id", *at_node],
            }
            for name, row in world.rows.items()
        ]
        return {
            "nodes": nodes,
            "wire": [kind for kind in wire if KINDS[kind].wire] if simulated else [],
            "acting": [] if injection is None else injection.standing(),
        }

    def inject(self, kind: str, where: str, lasts_s: float | None, values: Mapping[str, str]) -> str:
        """Inject a fault, and return its text.

        Raises
        ------
        FaultRefused
            there is no such fault or node, or it cannot act there now
        """
        kind = kind_of(kind)
        where = self._name(where)
        plan = plan_of(kind, where, lasts_s, values)
        if plan.file.fault[0].after != "start":
            raise FaultRefused(f"{kind}: after counts from a time that is over; leave it out")
        injection = self._injection or Injection(self._world, None, self._seed, self._mark)
        try:
            return injection.add(plan, where)
        except FaultError as error:
            raise FaultRefused(_PLACE.sub("", str(error))) from None

    def clear(self, kind: str, where: str) -> list[str]:
        """End the faults of a kind, at a place, or all (empty texts); return their texts."""
        kind, where = kind and kind_of(kind), where and self._name(where)
        return [] if self._injection is None else self._injection.clear(kind, where)

    def _name(self, where: str) -> str:
        """Return the name of a node that is given by its name or its node id, or `BUS`."""
        if where in (BUS, *self._world.rows):
            return where
        for name, row in self._world.rows.items():
            if where == str(self._world.devices[row].node_id):
                return name
        nodes = ", ".join(f"{name} ({self._world.devices[row].node_id})" for name, row in self._world.rows.items())
        raise NodeUnknown(
            f"there is no node '{where}' here{nearest(where, self._world.rows)}; it has {nodes or 'none'}"
        )
