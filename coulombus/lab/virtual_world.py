"""A world outside in virtual time: a function that says, cycle by cycle, what the handle meets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

from coulombus.host.cycle.display_state import describe
from coulombus.host.world.model_parts import Model, PlaneProfile, TorqueProfile, model_of
from coulombus.host.world.records import StateRecord
from coulombus.host.world.state import RUN, State, state_of
from coulombus.kernels.records import new_records
from coulombus.rigs.arguments import WrongCall
from coulombus.rigs.rig import Rig
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.wire.clock import bus_ns

__all__ = ["VirtualWorld", "WorldFunction", "with_world"]

WorldFunction: TypeAlias = Callable[[State], Any]
"""Returns a `Model`, a part of one, several parts, or None: the last model lives on, or fades."""


def with_world(rig: Rig) -> Rig:
    """Return the rig with [world] (`Rig.with_world`).

    Raises
    ------
    coulombus.rigs.arguments.WrongCall
        the rig has several buses
    """
    if len(rig.channels) > 1:
        buses = ", ".join(rig.channels)
        raise WrongCall(
            f"the rig {rig.name} has the buses {buses}: a world is of one bus, so take the rig's part: rig.on(...)"
        )
    return rig.with_world()


class _AxisModels:
    """The models that the function has returned for an axis."""

    def __init__(self) -> None:
        self.sequence = self.profiles = 0
        self.profile: TorqueProfile | PlaneProfile | None = None

    def record(self, model: Model, axis: int, slots: Any) -> Any:
        """Return the model as the next message."""
        if model.profile is not self.profile:
            self.profile, self.profiles = model.profile, self.profiles + 1
        self.sequence += 1
        record = model.record(slots, profile=self.profiles)
        record["sequence"], record["axis"] = self.sequence, axis
        return record


class VirtualWorld:
    """Calls a function between two cycles of the display, and lets the host render what it returns.

    Parameters
    ----------
    function : called with the state of each axis, of an arm with that of its first joint
    every : number of cycles between two calls
    """

    def __init__(self, function: WorldFunction, every: int = 1) -> None:
        self._function, self._every = function, every
        self._record = new_records(StateRecord)[0]
        self._models: list[_AxisModels] = []
        self._due_ns = 0

    def begin(self, world: VirtualRig) -> None:
        """Follow the host's cycles from its first one on."""
        self._models = [_AxisModels() for _ in world.controllers][: 1 if world.rig.in_plane else None]
        self._due_ns = int(world.controllers.host["next_ns"].min())
        self._wait(world)

    def _wait(self, world: VirtualRig) -> None:
        """Continue when the next cycle is about to begin: at its instant, a script comes before the host."""
        world.at(max(int(bus_ns(world.host_clock, self._due_ns)), world.t_ns), self._before_cycle)

    def _before_cycle(self, world: Any) -> None:
        k = world.controllers
        if k.ending:
            return
        self._due_ns += int(k.control["period_ns"][0])
        cycle = int(k.host["cycle"][0])
        joints = len(k.each) if world.rig.in_plane else 1  # an arm displays when all its joints do
        for number, models in enumerate(self._models):
            finished = int(k.host["waiting"][number]) == 0  # else its window is longer than the period
            of_axes = k.host[number : number + joints]
            displayed = (of_axes["phase"] == RUN).all() and not of_axes["end_cycles"].any()
            if finished and displayed and cycle % self._every == 0:
                self._ask(world, number, models)
        self._wait(world)

    def _ask(self, world: VirtualRig, number: int, models: _AxisModels) -> None:
        describe(world.controllers.axes, number, 0, self._record)
        model = model_of(self._function(state_of(self._record)))
        if model is not None:
            world.render(models.record(model, number, world.models.slots[number]))
