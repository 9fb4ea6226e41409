"""What a program outside says: wall, spring, field, torque profile, and values of the law's parameters.

A program makes these objects. They become a `ModelRecord`, which is the message of the socket and the
record that the cycle uses. Values are SI at the handle. Torques are those that act on the handle, and forces
those that act on the tip of an arm in the plane.
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

__all__ = [
    "LIFE_S",
    "LinearField",
    "Model",
    "Part",
    "PlaneField",
    "PlaneProfile",
    "PlaneSpring",
    "PlaneWall",
    "Spring",
    "TorqueProfile",
    "Wall",
    "model_of",
]

LIFE_S = 0.1
"""Default time to live of a model [s]."""
VECTORS = ("point_m", "normal", "N", "N_m", "Ns_m", "direction", "force_N")
"""Fields of parts in the plane that are no plain numbers."""
HEAD = 2 | MODEL.itemsize << 16
"""Kind and size of the record (`host.world.protocol`)."""


def _check(part: object, *at_least_zero: str) -> None:
    """Refuse values that are no finite numbers, and negative ones of `at_least_zero`."""
    kind = type(part).__name__
    for name in (item.name for item in fields(part)):  # type: ignore[arg-type]
        value = getattr(part, name)
        if name in ("side", "torque_Nm", *VECTORS):
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


def _samples(part: Any, values: tuple[float, ...]) -> tuple[float, ...]:
    """Return a profile's samples as floats, and check its `sample_s`."""
    samples, kind = tuple(float(value) for value in values), type(part).__name__
    _check(part)
    if not 1 <= len(samples) <= MOST_SAMPLES or not all(map(math.isfinite, samples)):
        name = "torque_Nm" if kind == "TorqueProfile" else "force_N"
        raise WrongCall(f"{kind}({name}): expected 1 to {MOST_SAMPLES} finite numbers, got {len(samples)}")
    if not 0 < part.sample_s <= 1:
        raise WrongCall(f"{kind}(sample_s={part.sample_s!r}): expected more than 0 and at most 1 s")
    return samples


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
        object.__setattr__(self, "torque_Nm", _samples(self, self.torque_Nm))


def _set_vectors(part: object, *units: str, shape: tuple[int, ...] = (2,), names: tuple[str, ...] = ()) -> None:
    """Convert vectors to tuples of floats; those of `units` get the length 1.

    Raises
    ------
    WrongCall
        not `shape` finite numbers, or a unit vector of length 0
    """
    for name in (*names, *units):
        try:
            numbers = np.asarray(getattr(part, name), dtype=object).astype(float)
        except (TypeError, ValueError):
            numbers = np.full(1, math.nan)
        if numbers.shape != shape or not np.isfinite(numbers).all():
            size = " x ".join(map(str, shape))
            raise WrongCall(f"{type(part).__name__}({name}={getattr(part, name)!r}): expected {size} finite numbers")
        if name in units:
            length = float(np.hypot(*numbers))
            if not 0 < length < math.inf:
                raise WrongCall(f"{type(part).__name__}({name}={getattr(part, name)!r}): expected a direction")
            numbers = numbers / length
        value = tuple(numbers.tolist()) if numbers.ndim == 1 else tuple(map(tuple, numbers.tolist()))
        object.__setattr__(part, name, value)


@dataclass(frozen=True)
class PlaneWall:
    """A unilateral wall in the plane: it resists motion into it, and never pulls.

    Attributes
    ----------
    point_m : a point of its face
    normal : direction out of the wall, at right angles to its face; any length but 0
    K_N_m, B_Ns_m : stiffness and damping, 0 or more
    """

    point_m: tuple[float, float]
    normal: tuple[float, float]
    K_N_m: float
    B_Ns_m: float = 0.0

    def __post_init__(self) -> None:
        _check(self, "K_N_m", "B_Ns_m")
        _set_vectors(self, "normal", names=("point_m",))


@dataclass(frozen=True)
class PlaneSpring:
    """A spring from the tip to a point, as to a proxy.

    Attributes
    ----------
    point_m : the point
    K_N_m, B_Ns_m : stiffness and damping, 0 or more
    most_N : largest force of each of the two
    """

    point_m: tuple[float, float]
    K_N_m: float
    B_Ns_m: float = 0.0
    most_N: float = 1e4

    def __post_init__(self) -> None:
        _check(self, "K_N_m", "B_Ns_m", "most_N")
        _set_vectors(self, names=("point_m",))


@dataclass(frozen=True)
class PlaneField:
    """A force on the tip, linear in position and velocity: ``N + N_m @ x + Ns_m @ v``.

    `N_m` and `Ns_m` are matrices, by rows. A negative definite `N_m` pulls towards (0, 0); a negative definite
    `Ns_m` damps. A matrix `N_m` that is not symmetric gives energy on a closed path.
    """

    N: tuple[float, float] = (0.0, 0.0)
    N_m: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    Ns_m: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))

    def __post_init__(self) -> None:
        _set_vectors(self, names=("N",))
        _set_vectors(self, names=("N_m", "Ns_m"), shape=(2, 2))


@dataclass(frozen=True, eq=False)
class PlaneProfile:
    """A short course of the force on the tip, as for a click; an object is played once.

    Attributes
    ----------
    force_N : 1 to 64 samples, each held for `sample_s`
    direction : of the force; any length but 0
    sample_s : time of a sample [s]
    """

    force_N: tuple[float, ...]
    direction: tuple[float, float]
    sample_s: float = 0.001

    def __post_init__(self) -> None:
        _set_vectors(self, "direction")
        object.__setattr__(self, "force_N", _samples(self, self.force_N))


Part: TypeAlias = Wall | Spring | LinearField | TorqueProfile | PlaneWall | PlaneSpring | PlaneField | PlaneProfile
"""A part of a model."""

NAMES: Mapping[type, str] = MappingProxyType(
    {Wall: "wall", Spring: "spring", LinearField: "field", TorqueProfile: "profile"}
)
PLANE_NAMES: Mapping[type, str] = MappingProxyType(
    {PlaneWall: "wall", PlaneSpring: "spring", PlaneField: "field", PlaneProfile: "profile"}
)
"""Name of each part in `Model`, on one axis and in the plane."""
BITS = MappingProxyType(
    {
        "wall": ModelParts.WALL,
        "spring": ModelParts.SPRING,
        "field": ModelParts.FIELD,
        "profile": ModelParts.PROFILE,
    }
)


@dataclass(frozen=True)
class Model:
    """All that the handle meets until the next model, or until `life_s` is over.

    Attributes
    ----------
    wall, spring, field, profile : the parts, all on one axis or all in the plane; None: without
    law : share of the rig's law that is displayed beside them, 0 to 1
    parameters : name -> value of the law's parameters, within the bounds of `coulombus set`
    life_s : time to live [s]
    """

    wall: Wall | PlaneWall | None = None
    spring: Spring | PlaneSpring | None = None
    field: LinearField | PlaneField | None = None
    profile: TorqueProfile | PlaneProfile | None = None
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
        kinds = [type(part) for part in self._parts().values()]
        if any(kind in NAMES for kind in kinds) and any(kind in PLANE_NAMES for kind in kinds):
            raise WrongCall(f"Model: {', '.join(kind.__name__ for kind in kinds)}: some are in the plane, and some not")

    def _parts(self) -> dict[str, Part]:
        """Return the parts that there are, by their names."""
        return {name: getattr(self, name) for name in BITS if getattr(self, name) is not None}

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
        for name, part in self._parts().items():
            parts |= BITS[name] | (ModelParts.PLANE if type(part) in PLANE_NAMES else 0)
            if isinstance(part, TorqueProfile | PlaneProfile):
                record["profile"] = profile
                _fill_profile(record, part)
            else:
                _fill(record, f"plane_{name}_" if type(part) in PLANE_NAMES else f"{name}_", part)
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
        parts_by_name: dict[str, Any] = dict.fromkeys(NAMES.values())
        for part in parts:
            name = NAMES.get(type(part)) or PLANE_NAMES.get(type(part))
            if name is None or parts_by_name[name] is not None:
                reason = "is given twice" if name else "is no part of a model"
                kinds = ", ".join(kind.__name__ for kind in (PLANE_NAMES if type(part) in PLANE_NAMES else NAMES))
                raise WrongCall(f"{part!r} {reason}: expected at most one each of {kinds}")
            parts_by_name[name] = part
        return replace(self, **parts_by_name)


def _fill(record: Any, prefix: str, part: Part) -> None:
    for item in fields(part):
        value = getattr(part, item.name)
        if item.name == "side":
            record["wall_side"] = 1 if value == "above" else -1
        else:
            record[prefix + item.name] = np.ravel(value) if item.name in VECTORS else value


def _fill_profile(record: Any, part: TorqueProfile | PlaneProfile) -> None:
    samples = part.torque_Nm if isinstance(part, TorqueProfile) else part.force_N
    if isinstance(part, PlaneProfile):
        record["profile_direction"] = part.direction
    record["samples"], record["sample_ns"] = len(samples), round(part.sample_s * 1e9)
    record["sample"][: len(samples)] = samples


def _slot(name: str, slots: Mapping[str, int]) -> int:
    if name in slots:
        return slots[name]
    parameters = ", ".join(slots) or "none"
    raise WrongCall(f"{name}: the law has no parameter of this name that a world may set; it has {parameters}")


def model_of(returned: Any) -> Model | None:
    """Return what a world's function has returned as a model: a model, a part, several parts, or None."""
    if returned is None or isinstance(returned, Model):
        return returned
    parts = returned if isinstance(returned, (tuple, list)) else (returned,)
    return Model().with_parts(*parts)
