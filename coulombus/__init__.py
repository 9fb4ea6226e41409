"""Friction you can feel, over a CAN bus.

What a script needs, imported only when it is asked for::

    from coulombus import Device, read, simulate

`coulombus.analysis`, `coulombus.lab` and `coulombus.recording` have further public names. docs/api.md
lists them all, and promises which of them stay.

Four of the packages below are links to the folders beside this one: `coulombus.node` is ``node/``,
and so are `host`, `eds` and `sim_bus`. Import them by this name only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from coulombus.system.lazy_names import lazy_names

if TYPE_CHECKING:
    from coulombus.host.laws.along import given_law
    from coulombus.host.laws.law import friction_law
    from coulombus.host.world.hand import connect
    from coulombus.host.world.model_parts import (
        LinearField,
        Model,
        PlaneField,
        PlaneProfile,
        PlaneSpring,
        PlaneWall,
        Spring,
        TorqueProfile,
        Wall,
    )
    from coulombus.lab.commissioning import commission
    from coulombus.lab.simulate import repeat, simulate
    from coulombus.lab.sweep.sweep import run_sweep
    from coulombus.lab.sweep.sweep_file import read_sweep
    from coulombus.lab.virtual_experiment import experiment
    from coulombus.monitor.callbacks import live
    from coulombus.recording.friction.identify import identify
    from coulombus.recording.reading import read
    from coulombus.rigs.rig import load_rig
    from coulombus.sim_bus.network.network import VirtualNetwork
    from coulombus.sim_bus.server.own_device import Device
    from coulombus.system.errors import CoulombusError

__all__ = [
    "CoulombusError",
    "Device",
    "LinearField",
    "Model",
    "PlaneField",
    "PlaneProfile",
    "PlaneSpring",
    "PlaneWall",
    "Spring",
    "TorqueProfile",
    "VirtualNetwork",
    "Wall",
    "commission",
    "connect",
    "experiment",
    "friction_law",
    "given_law",
    "identify",
    "live",
    "load_rig",
    "read",
    "read_sweep",
    "repeat",
    "run_sweep",
    "simulate",
]

_PLACES = {
    "CoulombusError": "coulombus.system.errors",
    "Device": "coulombus.sim_bus.server.own_device",
    "LinearField": "coulombus.host.world.model_parts",
    "Model": "coulombus.host.world.model_parts",
    "PlaneField": "coulombus.host.world.model_parts",
    "PlaneProfile": "coulombus.host.world.model_parts",
    "PlaneSpring": "coulombus.host.world.model_parts",
    "PlaneWall": "coulombus.host.world.model_parts",
    "Spring": "coulombus.host.world.model_parts",
    "TorqueProfile": "coulombus.host.world.model_parts",
    "VirtualNetwork": "coulombus.sim_bus.network.network",
    "Wall": "coulombus.host.world.model_parts",
    "commission": "coulombus.lab.commissioning",
    "connect": "coulombus.host.world.hand",
    "experiment": "coulombus.lab.virtual_experiment",
    "friction_law": "coulombus.host.laws.law",
    "given_law": "coulombus.host.laws.along",
    "identify": "coulombus.recording.friction.identify",
    "live": "coulombus.monitor.callbacks",
    "load_rig": "coulombus.rigs.rig",
    "read": "coulombus.recording.reading",
    "read_sweep": "coulombus.lab.sweep.sweep_file",
    "repeat": "coulombus.lab.simulate",
    "run_sweep": "coulombus.lab.sweep.sweep",
    "simulate": "coulombus.lab.simulate",
}

__getattr__, __dir__ = lazy_names(__name__, _PLACES)
