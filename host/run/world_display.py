"""A real-time run as a display for a world outside (`host.world.server`)."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Any

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.models import Models
from coulombus.host.cycle.parameter_changes import LiveParameters
from coulombus.host.cycle.records import Phase
from coulombus.host.realtime.data_plane import DataPlane
from coulombus.host.run.changes import Changes
from coulombus.host.world.hand import world_path
from coulombus.host.world.model_check import ModelRefused
from coulombus.host.world.protocol import VERSION, Named, Welcome
from coulombus.host.world.server import WorldServer
from coulombus.wire.address import BusAddress

__all__ = ["WorldDisplay"]

SWITCH_S = 0.5e-3
"""Longest time for which another thread keeps this process' interpreter from the thread for worlds."""


class WorldDisplay:
    """The run for its world: passes its models to the data plane, and tells its parameters and limits.

    Parameters
    ----------
    address : the bus, with whose name the socket is made; None: no program is let in

    Raises
    ------
    coulombus.host.world.server.WorldSocketError
        the socket cannot be created
    """

    def __init__(
        self, k: Controllers, plane: DataPlane, parameters: LiveParameters, changes: Changes, address: BusAddress | None
    ) -> None:
        self._k, self._plane, self._parameters, self._changes = k, plane, parameters, changes
        self.models = Models(k, parameters)
        self._server: WorldServer | None = None
        self._switch_s = sys.getswitchinterval()
        if address is not None and plane.states is not None:
            self._server = WorldServer(world_path(address), plane.states, self)
            sys.setswitchinterval(SWITCH_S)

    def close(self) -> None:
        """Disconnect all programs; may be called again."""
        if self._server is not None:
            self._server.close()
            sys.setswitchinterval(self._switch_s)

    @property
    def controlled(self) -> bool:
        """Whether a program has control."""
        return self._server is not None and self._server.controlled

    # for the server's thread

    def welcome(self) -> Welcome:
        """Return the answer to HELLO."""
        mode = int(self._k.axes["world"]["mode"][0])
        parameters = len(self.parameters())
        period_ns = int(self._k.control["period_ns"][0])
        return Welcome(
            VERSION, len(self._k.each), parameters, period_ns, mode, self.models.longest_life_ns, time.monotonic_ns()
        )

    def parameters(self) -> Sequence[Named]:
        """Return the parameters that a model may set, then the limits (slot -1)."""
        named = []
        for axis, rows in enumerate(self._parameters.rows()):
            slots = self.models.slots[axis]
            named += [
                Named(axis, slots[row["name"]], row["low"], row["high"], row["value"], row["name"])
                for row in rows
                if row["name"] in slots
            ]
            world = self._k.axes["world"][axis]
            for name in ("motor_limit_Nm", "brake_limit_Nm"):
                limit = float(world[name])
                named.append(Named(axis, -1, limit, limit, limit, name))
        return named

    def why_not(self, key: str | None, now_ns: int) -> str | None:
        """Return the reason why a program with this arm key may send no model; None if it may."""
        return None if key is None else self._changes.key_why_not(key, now_ns)

    def render(self, model: Any) -> None:
        """Publish a model to the data plane, which takes it in its next cycle."""
        phases = self._k.host["phase"]
        if (phases > Phase.RUN).any():
            raise ModelRefused("the display has ended", again=True)
        if (phases < Phase.RUN).any():
            raise ModelRefused("the display does not run yet", again=True)
        number = self.models.write(model)
        self.models.publish(int(model["axis"]), number)
