"""Models of a world outside on their way to the cycle: checked, numbered, and written into the ring.

One writer serves all axes. It never writes into the row of the model in use, nor into rows of models that
the cycle has not taken: a world that sends more between two cycles is refused, and may send again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.parameter_changes import ChangeRefused, LiveParameters
from coulombus.host.cycle.records import SLOTS, Slot
from coulombus.host.world.model_check import ModelRefused, why_not
from coulombus.host.world.recorded import key_of, row_of
from coulombus.host.world.records import OFFERS, PARAMETERS, ModelParts

__all__ = ["Models"]

assert SLOTS == PARAMETERS


class Models:
    """Writes models into the rings of the axes of `controllers`.

    Attributes
    ----------
    accepted, refused : numbers of models
    """

    def __init__(self, controllers: Controllers, parameters: LiveParameters) -> None:
        self._worlds, self._parameters = controllers.axes["world"], parameters
        self._number = [0] * len(controllers.each)
        self._is_arm = controllers.rig.in_plane is not None
        sections = [axis.world for axis in controllers.rig.axes]
        self.is_on = all(section is not None for section in sections)
        self.longest_life_ns = min((round(s.longest_life_s * 1e9) for s in sections if s is not None), default=0)
        self.slots: tuple[Mapping[str, int], ...] = tuple(
            {name: slot for name, slot in table.items() if slot != Slot.COMPENSATION} for table in parameters.slots()
        )
        """Slots of the parameters that a world may set, by name, for each axis."""
        self._rows: deque[bytes] = deque()
        self.accepted = self.refused = 0

    def write(self, model: Any) -> int:
        """Check a `ModelRecord`, and write it into its axis' ring; return its number on the axis.

        The caller publishes the number.

        Raises
        ------
        ModelRefused
            the cycle never sees the model; the text gives the reason
        """
        try:
            return self._write(model.copy())
        except ModelRefused:
            self.refused += 1
            raise

    def _write(self, model: Any) -> int:
        if not self.is_on:
            raise ModelRefused("the rig file has no [world]: start with --world")
        reason = why_not(model, len(self._number), self.longest_life_ns, arm=self._is_arm)
        if reason is not None:
            raise ModelRefused(reason)
        axis = int(model["axis"])
        if model["parts"] & ModelParts.PARAMETERS:
            self._fill_parameters(model, axis)
        else:  # unchecked: 0 times an infinite one is no number
            model["parameters"], model["parameter"] = 0, 0.0
        number = self._number[axis] + 1
        if number - int(self._worlds["taken"][axis]) >= OFFERS:
            raise ModelRefused(f"more than {OFFERS - 1} models in a cycle", again=True)
        self._worlds["offered"][axis, number % OFFERS] = model
        self._number[axis] = number
        self.accepted += 1
        self._rows.append(row_of(model, number))
        return number

    def publish_now(self, axis: int, number: int) -> int:
        """Publish a model to the next cycle of a host in this process; return its key in the trace."""
        self._worlds["wanted"][axis] = number
        return key_of(number, axis)

    def publish(self, axis: int, number: int) -> None:
        """Publish a model to the data plane, which takes it in its next cycle."""
        self._worlds["published"][axis] = number

    def take_rows(self) -> bytes:
        """Return the accepted models since the last call, as rows of `host.world.recorded`."""
        return b"".join(self._rows.popleft() for _ in range(len(self._rows)))

    def _fill_parameters(self, model: Any, axis: int) -> None:
        """Check the parameters that the model sets, and complete them with the others' present targets, so
        that all of them fit together.
        """
        names = {slot: name for name, slot in self.slots[axis].items()}
        slots = [slot for slot in range(64) if int(model["parameters"]) >> slot & 1]
        strange = [slot for slot in slots if slot not in names]
        if strange or not slots:
            expected = ", ".join(f"{int(slot)} ({name})" for slot, name in sorted(names.items())) or "none of this law"
            raise ModelRefused(f"parameters: slot {strange[0] if strange else 'none'}: expected one of {expected}")
        try:
            values = self._parameters.targets(axis, {names[slot]: float(model["parameter"][slot]) for slot in slots})
        except ChangeRefused as error:
            raise ModelRefused(str(error)) from None
        model["parameter"] = values
        model["parameters"] = sum(1 << slot for slot in names)
