"""Friction you can feel, over a CAN bus.

What a script needs, imported only when it is asked for::

    from coulombus import Device, read, simulate

Four of the packages below are links to the folders beside this one: `coulombus.node` is ``node/``,
and so are `host`, `eds` and `sim_bus`. Import them by this name only.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from coulombus.lab.simulate import simulate
    from coulombus.monitor.callbacks import live
    from coulombus.recording.reading import read
    from coulombus.rigs.rig import load_rig
    from coulombus.sim_bus.network.network import VirtualNetwork
    from coulombus.sim_bus.server.own_device import Device
    from coulombus.system.errors import CoulombusError

__all__ = ["CoulombusError", "Device", "VirtualNetwork", "live", "load_rig", "read", "simulate"]

_PLACES = {
    "CoulombusError": "coulombus.system.errors",
    "Device": "coulombus.sim_bus.server.own_device",
    "VirtualNetwork": "coulombus.sim_bus.network.network",
    "live": "coulombus.monitor.callbacks",
    "load_rig": "coulombus.rigs.rig",
    "read": "coulombus.recording.reading",
    "simulate": "coulombus.lab.simulate",
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'coulombus' has no attribute {name!r}")
    return getattr(import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
