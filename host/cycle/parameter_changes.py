"""Live parameters of a run: the parameters that may change during it, their bounds, and their changes.

`parameters_of` is the only table of them. `LiveParameters.change` either refuses a change as a whole,
with the reason, or writes it as an order for the compiled step (`host.cycle.live_parameters`). Each
change is recorded as a marker,

    set F_s_Nm 3.5 -> 2 Nm in 0.5 s [1: F_s_Nm=0x1.c000000000000p+1>0x1.0000000000000p+1 in 500]

whose brackets hold the order's number, every value to its last bit, and the number of cycles. With
the cycle in which the order was taken (`recording.trace`), a replay repeats it bit for bit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coulombus.host.cycle.controller import Controller
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.live_parameters import offer
from coulombus.host.cycle.output_limits import brake_limit, motor_limit, torque_step_Nm
from coulombus.host.cycle.records import Slot
from coulombus.host.errors import HostError
from coulombus.rigs.errors import nearest
from coulombus.rigs.field_help import UNITS, unit_of
from coulombus.rigs.model import Section

__all__ = [
    "MARKER",
    "OVER_S",
    "Change",
    "ChangeRefused",
    "LiveParameters",
    "Parameter",
    "ParameterOrder",
    "orders_of",
    "parameters_of",
]

OVER_S, LEAST_S, MOST_S = 0.5, 0.1, 60.0
"""Default, shortest and longest duration of a change."""
MARKER = "set "
ORDER_TEXT = re.compile(r"set .* \[(\d+): (.+) in (\d+)\]")
LEAST_POSITIVE = 1e-9
"""Smallest value of a parameter that must be more than 0: a law may divide by it, and the quotient stays finite."""
OF_MODE = {"K_p_Nm_rad": Slot.K_P, "F_s_Nm": Slot.F_S, "F_d_Nm": Slot.F_D}
"""Keys of [mode.NAME] that are parameters of a law."""
TORQUES = ("F_s_Nm", "F_d_Nm")
"""Those of them that set the size of the displayed torque."""
ANYTHING = math.inf, ""
UNDONE = 1000
"""Largest number of changes that can be undone."""

Floats = npt.NDArray[np.float64]


class ChangeRefused(HostError):
    """A change was refused; the text gives the reason."""

    exit_status = 2


class NotTaken(ChangeRefused):
    """The step has not taken the last order, because no cycle has begun since."""


@dataclass(frozen=True)
class Parameter:
    """A live parameter: its name in the rig file, its bounds and its value."""

    name: str
    unit: str
    slot: int
    scale: float
    """Factor from the parameter to the step's value."""
    low: float
    high: float
    above_low: bool
    """Whether the value must be above `low`."""
    whose: str
    """Name of the limit that sets `high`."""
    value: float
    """Value in the rig file."""

    @property
    def step(self) -> float:
        """Step of a slider: 1, 2 or 5 times a power of ten, at most a hundredth of the likely range.

        The likely range ends at the upper bound, or at ten times the rig file's value if the bound is far
        above.
        """
        likely = 10 * self.value if 0 < 20 * self.value < self.high else self.high - max(self.low, 0.0)
        exponent = math.floor(math.log10(likely / 100)) if likely > 0 else -2
        share = likely / 100 / 10.0**exponent
        return (
            float(f"{next(digit for digit in (5, 2, 1) if digit <= share * (1 + 1e-9))}e{exponent}")
            if likely > 0
            else 0.01
        )

    def why_not(self, value: float) -> str | None:
        """Return the reason why `value` is refused; None if it is allowed."""
        lowest = self.low + LEAST_POSITIVE if self.above_low else self.low
        if lowest <= value <= self.high:  # no NaN
            return None
        begin = f"more than {self.low:g}" if self.above_low else f"from {self.low:g}"
        if self.low < value < lowest:
            begin = f"from {lowest:g}"
        ends = f" ({self.whose} ends there)" if value > self.high else ""
        return f"{self.name}={value:g}: expected {begin} to {self.high:g} {self.unit}".rstrip() + ends


def parameters_of(controller: Controller) -> tuple[Parameter, ...]:
    """Return the live parameters of an axis: the law's numeric parameters that have a range (those of the
    mode, or those that the law names), and the compensation.

    Bounds are those of the rig file's key. A parameter that sets the size of the torque is also bounded by
    the actuator that displays it: the motor in mode active, else the brake.
    """
    axis, mode, law = controller.axis, controller.mode, controller.declaration
    motor_Nm, motor_whose = motor_limit(axis, mode)
    shown = (motor_Nm, motor_whose) if mode == "active" else brake_limit(axis)
    keys_of_mode, friction_Nm = axis.mode[mode], axis.mechanics.friction_Nm
    share = (motor_Nm / friction_Nm if friction_Nm > 0 else math.inf, motor_whose)
    parameters = []
    if not axis.joint and (law is None or law.uses_mode_keys):
        names = OF_MODE if law is None else {name: slot for name, slot in OF_MODE.items() if name in law.names}
        parameters = [
            _parameter(keys_of_mode, name, slot, shown if name in TORQUES else ANYTHING) for name, slot in names.items()
        ]
    elif law is not None and controller.parameters is not None:
        for k, name in enumerate(law.names):
            end = shown if name in law.extremes and not axis.joint else ANYTHING
            if law.parameters.model_fields[name].annotation is float:
                parameters.append(_parameter(controller.parameters, name, Slot.USER + k, end))
    parameters.append(_parameter(keys_of_mode, "compensation", Slot.COMPENSATION, share, friction_Nm))
    return tuple(
        parameter for parameter in parameters if math.isfinite(parameter.low) and math.isfinite(parameter.high)
    )


def _parameter(section: Section, name: str, slot: int, end: tuple[float, str], scale: float = 1.0) -> Parameter:
    low, high, above = -math.inf, math.inf, False
    for bound in type(section).model_fields[name].metadata:
        above = above or hasattr(bound, "gt")
        low = float(getattr(bound, "gt", getattr(bound, "ge", low)))
        high = float(getattr(bound, "le", high))
    high, whose = min((high, "the rig file's range"), end)
    present = float(getattr(section, name))  # `check_demand` permits an excess below one count
    return Parameter(name, unit_of(name), slot, scale, low, max(high, present), above, whose, present)


class Changed(NamedTuple):
    """Old and new value of a parameter in a change."""

    name: str
    unit: str
    old: float
    new: float


@dataclass(frozen=True)
class Change:
    """An accepted change: its order's number, its axis, and the old and new values."""

    number: int
    axis: str
    index: int
    values: tuple[Changed, ...]
    over_s: float
    cycles: int
    undo: bool = False

    @property
    def marker(self) -> str:
        """The change's marker, from which a replay repeats it."""
        names = [f"{self.axis}.{value.name}" if self.axis else value.name for value in self.values]
        shown = ", ".join(
            f"{name} {value.old:g} -> {value.new:g} {value.unit}".rstrip()
            for name, value in zip(names, self.values, strict=True)
        )
        exact = " ".join(
            f"{name}={value.old.hex()}>{value.new.hex()}" for name, value in zip(names, self.values, strict=True)
        )
        undo = " (undo)" if self.undo else ""
        return f"{MARKER}{shown} in {self.over_s:g} s{undo} [{self.number}: {exact} in {self.cycles}]"

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        values = [value._asdict() for value in self.values]
        return {"axis": self.axis, "changes": values, "over_s": self.over_s, "undo": self.undo, "marker": self.marker}


class _Axis:
    """The live parameters of one axis, with their target values."""

    def __init__(self, controller: Controller) -> None:
        self.controller, self.name = controller, controller.axis.name
        self.table = {parameter.name: parameter for parameter in parameters_of(controller)}
        self.value = {name: parameter.value for name, parameter in self.table.items()}
        self.number = 0

    def full_record(self, values: Mapping[str, float]) -> Floats:
        """Return the full record of an order: `values`, and the present targets of all other parameters."""
        record = self._present()
        for name, parameter in self.table.items():
            record[parameter.slot] = values.get(name, self.value[name]) * parameter.scale
        return record

    def rows(self) -> list[dict[str, Any]]:
        """Return the law's parameters as plain values; `now` is the value during a transition."""
        present = self._present()
        return [
            {
                "axis": self.name,
                "name": parameter.name,
                "unit": parameter.unit,
                "value": self.value[parameter.name],
                "now": float(present[parameter.slot]) / parameter.scale
                if parameter.scale
                else self.value[parameter.name],
                "low": parameter.low,
                "high": parameter.high,
                "above_low": parameter.above_low,
                "step": parameter.step,
            }
            for parameter in self.table.values()
        ]

    def _present(self) -> Floats:
        """Return the values that the step uses now, in the order of `Slot`."""
        law, c = self.controller.law[0], self.controller.control[0]
        return np.array([law["K_p"], law["F_s"], law["F_d"], c["compensation_Nm"], *law["user"]], np.float64)


class LiveParameters:
    """The live parameters of all axes of a run, and their changes."""

    def __init__(self, controllers: Controllers) -> None:
        self._axes = tuple(_Axis(controller) for controller in controllers)
        self._period_s = float(controllers.control["period_ns"][0]) * 1e-9
        self._number = 0
        self._made: list[tuple[int, dict[str, float]]] = []

    def rows(self) -> list[list[dict[str, Any]]]:
        """Return the parameters of each axis as plain values."""
        return [axis.rows() for axis in self._axes]

    def slots(self) -> tuple[dict[str, int], ...]:
        """Return the slot of each parameter by its name, for each axis."""
        return tuple({name: parameter.slot for name, parameter in axis.table.items()} for axis in self._axes)

    def targets(self, index: int, values: Mapping[str, float]) -> Floats:
        """Return the values of all parameters of axis `index`, with `values`; nothing is changed.

        Raises
        ------
        ChangeRefused
            a value is out of its bounds, or does not fit the others
        """
        axis = self._axes[index]
        reasons = (axis.table[name].why_not(value) for name, value in values.items())
        reason = next(filter(None, reasons), None) or _pairs(axis, {**axis.value, **values}, values)
        if reason is not None:
            raise ChangeRefused(reason)
        return axis.full_record(values)

    def change(self, values: Mapping[str, float], axis: str = "", over_s: float = OVER_S) -> Change:
        """Write the order that brings an axis to other values within `over_s`.

        The caller publishes the order's number to the step.

        Parameters
        ----------
        values : name -> value; a name may lack its unit ("F_s")
        axis : name of the axis, in a rig with several axes
        over_s : requested duration of the transition [s]; a falling torque may take longer

        Raises
        ------
        ChangeRefused
            nothing is changed; the text gives the reason
        """
        index = self._index(axis)
        live_axis = self._axes[index]
        if not values:
            raise ChangeRefused("no value is given: expected NAME=VALUE, as in F_s=2.0")
        goals: dict[str, float] = {}
        for key, value in values.items():
            name = _name(key, live_axis)
            if name in goals:
                raise ChangeRefused(f"{name} is given twice")
            goals[name] = float(value)
        change = self._offer(index, goals, over_s, {name: live_axis.value[name] for name in goals})
        self._made = [*self._made, (index, {changed.name: changed.old for changed in change.values})][-UNDONE:]
        return change

    def undo(self, over_s: float = OVER_S) -> Change:
        """Write the order that undoes the last change; a repeated call undoes the change before it.

        Raises
        ------
        ChangeRefused
            no change is left to undo, or as `change`
        """
        if not self._made:
            raise ChangeRefused("there is no change to undo")
        index, old = self._made[-1]
        change = self._offer(index, old, over_s, {name: self._axes[index].value[name] for name in old}, undo=True)
        self._made.pop()
        return change

    def _offer(
        self, index: int, goals: Mapping[str, float], over_s: float, old: Mapping[str, float], *, undo: bool = False
    ) -> Change:
        axis = self._axes[index]
        if not LEAST_S <= over_s <= MOST_S:
            raise ChangeRefused(f"within {over_s:g} s: expected {LEAST_S:g} to {MOST_S:g} s")
        if not undo:  # the old values were accepted before
            reasons = (axis.table[name].why_not(value) for name, value in goals.items())
            reason = next(filter(None, reasons), None) or _pairs(axis, {**axis.value, **goals}, goals)
            if reason is not None:
                raise ChangeRefused(reason)
        if any(int(other.controller.live["taken"][0]) != other.number for other in self._axes):
            raise NotTaken("the change before has not been taken yet: the host does not cycle")
        over_s = max(over_s, self._gentle_s(index, goals, old))
        number, cycles = self._number + 1, max(1, round(over_s / self._period_s))
        offer(axis.controller.live[0], number, axis.full_record(goals), cycles)
        self._number = axis.number = number
        axis.value.update(goals)
        values = tuple(Changed(name, axis.table[name].unit, old[name], value) for name, value in goals.items())
        return Change(number, axis.name, index, values, over_s, cycles, undo)

    def _gentle_s(self, index: int, goals: Mapping[str, float], old: Mapping[str, float]) -> float:
        """Return the shortest duration of a falling torque [s], at the safe state's rate: a hand may lean
        on it.

        A falling force of the tip is a falling torque of each joint of the arm, by its lever in this pose.
        """
        table = self._axes[index].table

        def largest_fall(unit: str) -> float:
            return max([0.0, *(old[name] - value for name, value in goals.items() if table[name].unit == unit)])

        falls_Nm, fall_N = np.zeros(len(self._axes)), largest_fall("N")
        falls_Nm[index] = largest_fall("Nm")
        if fall_N > 0.0:
            falls_Nm += fall_N * np.hypot(*self._axes[0].controller.records["plane"]["pose"]["jacobian"][0])
        rates_Nm_s = np.array([axis.controller.control["release_Nm"][0] for axis in self._axes]) / self._period_s
        durations_s = np.divide(falls_Nm, rates_Nm_s, out=np.zeros_like(falls_Nm), where=rates_Nm_s > 0.0)
        return min(math.ceil(float(durations_s.max()) * 1000 - 1e-6) / 1000, MOST_S)

    def _index(self, name: str) -> int:
        names = [axis.name for axis in self._axes]
        if not name and len(names) == 1:
            return 0
        if name in names:
            return names.index(name)
        if names == [""]:
            raise ChangeRefused(f"axis {name!r}: the rig has no named axes")
        raise ChangeRefused(f"axis {name!r}: expected one of {', '.join(names)}{nearest(name, names)}")


def _short(name: str) -> str:
    """Return a parameter's name without its unit."""
    return name.removesuffix(next((end for end in UNITS if end.startswith("_") and name.endswith(end)), ""))


def _name(key: str, axis: _Axis) -> str:
    """Return the full name of a parameter that is given with or without its unit."""
    names, short = list(axis.table), {_short(name): name for name in axis.table}
    if key in names:
        return key
    if key in short:
        return short[key]
    law, parameters = axis.controller.axis.law.function, ", ".join(names)
    if key in OF_MODE or key in map(_short, OF_MODE):
        raise ChangeRefused(f"{key}: the law {law} has none; there is {parameters}")
    raise ChangeRefused(f"{key}: no parameter of this name; there is {parameters}{nearest(key, (*names, *short))}")


def _pairs(axis: _Axis, values: Mapping[str, float], goals: Mapping[str, float]) -> str | None:
    """Return the reason why values are inconsistent; None if they are consistent, or `goals` has none of
    them.
    """
    law = axis.controller.declaration
    relations = [("F_s_Nm", "F_d_Nm", False)] if law is None or law.uses_mode_keys else []
    if law is not None:
        relations += [(first, second, False) for first, second in law.parameters.at_least.items()]
        relations += [(first, second, True) for first, second in law.parameters.above.items()]
    for first, second, above in relations:
        if not {first, second} <= values.keys() or goals.keys().isdisjoint((first, second)):
            continue
        value, other = values[first], values[second]
        if other > value or (above and other == value):
            words = "less than" if above else "at most"
            return f"{second}={other:g} with {first}={value:g}: expected {second} {words} {first}; change both at once"
    believed, mode = axis.controller.axis, axis.controller.mode
    if mode != "active" or "F_d_Nm" not in values or goals.keys().isdisjoint(("F_d_Nm", "compensation")):
        return None
    limit_Nm, whose = motor_limit(believed, mode)
    compensation_Nm = values["compensation"] * axis.table["compensation"].scale
    if values["F_d_Nm"] - compensation_Nm <= limit_Nm + torque_step_Nm(believed):
        return None
    shown = f"F_d_Nm={values['F_d_Nm']:g} with compensation={values['compensation']:g}"
    return f"{shown}: {whose} ends at {limit_Nm:g} Nm"


class ParameterOrder(NamedTuple):
    """An order from a recording's marker; `axis` counts from 0."""

    axis: int
    values: Floats
    cycles: int


def orders_of(markers: Iterable[str], controllers: Controllers) -> dict[int, ParameterOrder]:
    """Return the orders in a recording's markers, by their numbers, for new `controllers`.

    Raises
    ------
    ChangeRefused
        a marker names a parameter or an axis that the controllers do not have
    """
    axes = {axis.name: (index, axis) for index, axis in enumerate(map(_Axis, controllers))}
    orders = {}
    for text in markers:
        match = ORDER_TEXT.fullmatch(text)
        if match is None:
            continue
        goals: dict[str, dict[str, float]] = {}
        for part in match[2].split(" "):
            name, _, exact = part.partition("=")
            owner, _, plain = name.rpartition(".")
            if owner not in axes or plain not in axes[owner][1].table:
                raise ChangeRefused(f"the marker '{text}' names {name}, which the rig does not have")
            goals.setdefault(owner, {})[plain] = float.fromhex(exact.rpartition(">")[2])
        for owner, values in goals.items():
            index, axis = axes[owner]
            orders[int(match[1])] = ParameterOrder(index, axis.full_record(values), int(match[3]))
            axis.value.update(values)
    return orders
