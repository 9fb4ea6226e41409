"""What a program outside says: wall, spring, field, torque profile, and values of the law's parameters.

A program makes these objects. They become a `ModelRecord`, which is the message of the socket and the
record that the cycle uses. Values are SI at the handle. Torques are those that act on the handle.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from coulombus.host.world.records import MODEL, MOST_SAMPLES, ModelParts
from coulombus.rigs.arguments import WrongCall

__all__ = ["LIFE_S", "LinearField", "Model", "Part", "Spring", "TorqueProfile", "Wall", "model_of"]

LIFE_S = 0.1
"""Default time to live of a model [s]."""
HEAD = 2 | MODEL.itemsize << 16
"""Kind and size of the record (`host.world.protocol`)."""


def _check(part: object, *at_least_zero: str) -> None:
    """Refuse values that are no finite numbers, and negative ones of `at_least_zero`."""
    kind = type(part).__name__
    for name in (item.name for item in fields(part)):  # type: ignore[arg-type]
        value = getattr(part, name)
        if name in ("side", "torque_Nm"):
            continue
        if not isinstance(value, (int, float, np.number)) or not math.isfinite(value):
            raise WrongCall(f"{kind}({name}={value!r}): expected a finite number")
        if name in at_least_zero and value < 0:
            raise WrongCall(f"{kind}({name}={value!r}): expected 0 or more")


@dataclass(frozen=True)
class Wall:
    """A unilateral wall: it resists motion into it, and never pulls.

    Attributes
    ----------
    x_rad : where it begins
    K_Nm_rad, B_Nms_rad : stiffness and damping, 0 or more
    side : "above": the wall is at positions above `x_rad`; "below": at those below
    """

    x_rad: float
    K_Nm_rad: float
    B_Nms_rad: float = 0.0
    side: str = "above"

    def __post_init__(self) -> None:
        _check(self, "K_Nm_rad", "B_Nms_rad")
        if self.side not in ("above", "below"):
            raise WrongCall(f'Wall(side={self.side!r}): expected "above" or "below"')


@dataclass(frozen=True)
class Spring:
    """A spring from the handle to a point, as to a proxy.

    Attributes
    ----------
    x_rad : the point
    K_Nm_rad, B_Nms_rad : stiffness and damping, 0 or more
    most_Nm : largest torque of each of the two
    """

    x_rad: float
    K_Nm_rad: float
    B_Nms_rad: float = 0.0
    most_Nm: float = 1e4

    def __post_init__(self) -> None:
        _check(self, "K_Nm_rad", "B_Nms_rad", "most_Nm")


@dataclass(frozen=True)
class LinearField:
    """A torque on the handle, linear in position and velocity: ``Nm + Nm_rad * x + Nms_rad * v``.

    A negative `Nm_rad` pulls towards 0 rad; a negative `Nms_rad` damps.
    """

    Nm: float = 0.0
    Nm_rad: float = 0.0
    Nms_rad: float = 0.0

    def __post_init__(self) -> None:
        _check(self)


@dataclass(frozen=True, eq=False)
class TorqueProfile:
    """A short course of the torque on the handle, as for a click; an object is played once.

    Attributes
    ----------
    torque_Nm : 1 to 64 samples, each held for `sample_s`
    sample_s : time of a sample [s]
    """

    torque_Nm: tuple[float, ...]
    sample_s: float = 0.001

    def __post_init__(self) -> None:
        samples = tuple(float(value) for value in self.torque_Nm)
        object.__setattr__(self, "torque_Nm", samples)
        _check(self)
        if not 1 <= len(samples) <= MOST_SAMPLES or not all(map(math.isfinite, samples)):
            raise WrongCall(
                f"TorqueProfile(torque_Nm): expected 1 to {MOST_SAMPLES} finite numbers, got {len(samples)}"
            )
        if not 0 < self.sample_s <= 1:
            raise WrongCall(f"TorqueProfile(sample_s={self.sample_s!r}): expected more than 0 and at most 1 s")


Part: TypeAlias = Wall | Spring | LinearField | TorqueProfile
"""A part of a model."""

NAMES: Mapping[type, str] = MappingProxyType(
    {Wall: "wall", Spring: "spring", LinearField: "field", TorqueProfile: "profile"}
)


@dataclass(frozen=True)
class Model:
    """All that the handle meets until the next model, or until `life_s` is over.

    Attributes
    ----------
    wall, spring, field, profile : the parts; None: without
    law : share of the rig's law that is displayed beside them, 0 to 1
    parameters : name -> value of the law's parameters, within the bounds of `coulombus set`
    life_s : time to live [s]
    """

    wall: Wall | None = None
    spring: Spring | None = None
    field: LinearField | None = None
    profile: TorqueProfile | None = None
    law: float = 1.0
    parameters: Mapping[str, float] = dataclasses.field(default_factory=lambda: MappingProxyType({}))
    life_s: float = LIFE_S

    def __post_init__(self) -> None:
        for name, low, high in (("law", 0.0, 1.0), ("life_s", 0.0, 60.0)):
            value = getattr(self, name)
            if not isinstance(value, (int, float, np.number)) or not low <= value <= high:
                raise WrongCall(f"Model({name}={value!r}): expected a number from {low:g} to {high:g}")
        for name, value in self.parameters.items():
            if not isinstance(value, (int, float, np.number)) or not math.isfinite(value):
                raise WrongCall(f"Model(parameters): {name} is {value!r}, expected a finite number")

    def record(self, slots: Mapping[str, int], *, profile: int = 0) -> Any:
        """Return the model as a `ModelRecord`, without number, time and axis.

        Parameters
        ----------
        slots : name of each parameter of the axis -> its slot
        profile : number of the profile

        Raises
        ------
        coulombus.rigs.arguments.WrongCall
            the law has no parameter of such a name
        """
        record = np.zeros(1, MODEL)[0]
        record["head"] = HEAD
        record["life_ns"], record["law"], record["wall_side"] = round(self.life_s * 1e9), self.law, 1
        parts = ModelParts(0)
        if self.wall is not None:
            parts |= ModelParts.WALL
            record["wall_side"] = 1 if self.wall.side == "above" else -1
            _fill(record, "wall_", self.wall)
        if self.spring is not None:
            parts |= ModelParts.SPRING
            _fill(record, "spring_", self.spring)
        if self.field is not None:
            parts |= ModelParts.FIELD
            _fill(record, "field_", self.field)
        if self.profile is not None:
            parts |= ModelParts.PROFILE
            record["profile"], record["samples"] = profile, len(self.profile.torque_Nm)
            record["sample_ns"] = round(self.profile.sample_s * 1e9)
            record["sample_Nm"][: len(self.profile.torque_Nm)] = self.profile.torque_Nm
        if self.parameters:
            parts |= ModelParts.PARAMETERS
        for name, value in self.parameters.items():
            slot = _slot(name, slots)
            record["parameters"] |= 1 << slot
            record["parameter"][slot] = value
        record["parts"] = int(parts)
        return record

    def with_parts(self, *parts: Part) -> Model:
        """Return the model with these parts and no other."""
        given: dict[str, Any] = dict.fromkeys(NAMES.values())
        for part in parts:
            name = NAMES.get(type(part))
            if name is None or given[name] is not None:
                reason = "is given twice" if name else "is no part of a model"
                raise WrongCall(
                    f"{part!r} {reason}: expected at most one each of Wall, Spring, LinearField, TorqueProfile"
                )
            given[name] = part
        return replace(self, **given)


def _fill(record: Any, prefix: str, part: Part) -> None:
    for item in fields(part):
        if item.name != "side":
            record[prefix + item.name] = getattr(part, item.name)


def _slot(name: str, slots: Mapping[str, int]) -> int:
    if name in slots:
        return slots[name]
    there = ", ".join(slots) or "none"
    raise WrongCall(f"{name}: the law has no parameter of this name that a world may set; it has {there}")


def model_of(said: Any) -> Model | None:
    """Return what a world's function has returned as a model: a model, a part, several parts, or None."""
    if said is None or isinstance(said, Model):
        return said
    parts = said if isinstance(said, (tuple, list)) else (said,)
    return Model().with_parts(*parts)
