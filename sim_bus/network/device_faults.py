"""Faults of a device that begin and end while it runs: the one code of scripts, fault files and `coulombus inject`.

A fault acts until it is ended, across resets of the device. A cause inside the device (over-current ...) is reported by
the device itself: EMCY, 1001h, its fault reaction (`node.emcy`).
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from coulombus.eds.cia301 import NmtCommand
from coulombus.node.emcy import DEVICE_FAULTS, FIRST_DEVICE_CAUSE
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.rig.plant import COIL_INTACT, COIL_OPEN, COIL_SHORT
from coulombus.wire.clock import own_ns

__all__ = ["EFFECTS", "FAULTS", "OF_EVERY_NODE", "OF_MECHANICS", "SILENT", "device_faults_of", "inject", "renumber"]

FAULTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "motor": ("over_current", "over_temperature", "encoder_lost", "supply_low"),
        "brake": ("over_current", "over_temperature", "supply_low", "coil_open", "coil_short"),
    }
)
"""Faults that a device reports, by its name in a rig."""
SILENT: Mapping[str, tuple[str, ...]] = MappingProxyType({"motor": ("blocked",)})
"""Faults without an EMCY of their own, by the device's name in a rig."""
OF_MECHANICS = ("coil_open", "coil_short", "blocked")
"""Faults of what a device drives."""
OF_EVERY_NODE = ("power_off", "heartbeat_off", "pdo_length")
"""Faults that every node can have."""
EFFECTS: Mapping[str, str] = MappingProxyType(
    {
        "over_current": "The power stage detects over-current.",
        "over_temperature": "The device detects over-temperature.",
        "encoder_lost": "The drive loses its encoder: the position stands still.",
        "supply_low": "The device detects under-voltage.",
        "coil_open": "The brake's coil is open: no current flows.",
        "coil_short": "The brake's coil is a short circuit.",
        "blocked": "The axis is blocked: nothing turns it.",
        "power_off": "The node has no supply.",
        "heartbeat_off": "The node sends no heartbeat.",
        "pdo_length": "The node's TPDOs are one byte too short.",
    }
)
"""Effects of a device's faults."""
COIL_STATES = {"coil_open": COIL_OPEN, "coil_short": COIL_SHORT}
"""Faults of the coil: the driver detects them by its measurements."""
_OF_KIND = {"drive": "motor"}
"""Name in `FAULTS` of a device outside a rig, by its kind."""


def device_faults_of(world: VirtualNetwork, row: int) -> tuple[str, ...]:
    """Return the faults of `EFFECTS` that the device of a row can have."""
    name = next((name for name, other in world.rows.items() if other == row), "").rpartition(".")[2]
    kind = world.devices[row].profile.name
    device = name if name in FAULTS else _OF_KIND.get(kind, kind)
    of_device = (*FAULTS.get(device, ()), *SILENT.get(device, ()))
    axis = int(world.axis_of[row]) if row < len(world.axis_of) else -1
    return tuple(fault for fault in (*of_device, *OF_EVERY_NODE) if axis >= 0 or fault not in OF_MECHANICS)


def inject(world: VirtualNetwork, row: int, fault: str, present: bool) -> None:
    """Begin or end a fault of `EFFECTS` in the device of a row, now.

    The device detects it at once, or by its measurements.
    """
    device, record = world.devices[row], world.nodes[row]
    node_ns = int(own_ns(record, world.t_ns))
    if fault in COIL_STATES:
        plant, broken = world.plant[int(world.axis_of[row])], COIL_STATES[fault]
        if present:
            plant["coil_fault"] = broken
        elif plant["coil_fault"] == broken:
            plant["coil_fault"] = COIL_INTACT
        return
    if fault == "blocked":
        world.block(row, present)
    elif fault == "power_off":
        if present:
            world.power_off(row)
        else:
            world.power_on(row)
    elif fault == "heartbeat_off":
        device.communication.stop_heartbeat(node_ns, present)
    elif fault == "pdo_length":
        device.communication.pdos.shorten(node_ns, int(present))
    else:
        bit = 1 << DEVICE_FAULTS[fault] - FIRST_DEVICE_CAUSE
        record["in_faults"] = record["in_faults"] | bit if present else record["in_faults"] & ~bit
    if record["powered"]:
        record["next_ns"] = node_ns


def renumber(world: VirtualNetwork, row: int, node_id: int) -> None:
    """Let the device of a row boot with another node id, which it keeps; 0: the next free id."""
    device = world.devices[row]
    used = {other.node_id for other in world.devices}
    others = (*range(device.node_id + 1, 128), *range(1, device.node_id))
    device.lss.persistent_node_id = node_id or next(free for free in others if free not in used)
    device.lss.pending_node_id = device.lss.persistent_node_id
    if world.nodes[row]["powered"]:
        world.withdraw(row)
        world.nmt_command(row, NmtCommand.RESET_COMMUNICATION)
