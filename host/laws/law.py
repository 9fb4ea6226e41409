r"""Definition of a friction law: a function with a fixed signature, its records, and its declaration.

`friction_law` declares a law's named parameters - a model with unit, range, default and meaning of
each, as in the rig file - and its state::

    class MyLaw(Parameters):
        F_c_Nm: float = Field(1.0, gt=0, le=1e4, description="Coulomb friction")

    @friction_law(MyLaw, state=("z_rad",))
    def my_law(motion, law, state):
        return law.F_c_Nm * math.copysign(1.0, motion.v_rad_s)

The parameters are in ``[law.my_law]`` of the rig file. In the records `LAW` and `LAW_STATE`, parameters
and state are stored in the field ``user``: the names are a view of these 16 numbers. So all laws have the
same signature, and a recording, a replay and the shared memory do not depend on the names.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, TypeAlias, TypeVar, get_args

import numpy as np
from pydantic import Field

from coulombus.kernels.records import FloatField, Record, dtype_of
from coulombus.rigs.field_help import accepted_range, unit_of
from coulombus.rigs.model import Section

__all__ = [
    "LAW",
    "LAW_STATE",
    "MOTION",
    "ON_AXIS",
    "Declaration",
    "Field",
    "LawFunction",
    "LawKind",
    "LawRecord",
    "LawStateRecord",
    "MotionRecord",
    "Parameters",
    "declaration_of",
    "described",
    "friction_law",
    "state_fields",
]


class MotionRecord(Record):
    """Input of a law."""

    x_rad: float  # the handle's angle [rad]
    v_rad_s: float  # backward difference of the position, or its mean over up to law.velocity_window_cycles
    v_counts: float  # the same in encoder counts a cycle
    dt_s: float  # period of the cycle [s]
    handle_Nm: float  # the hand's torque on the handle, from the torque transducer


MOTION = dtype_of(MotionRecord)

USER = 16
"""Number of values for a law's own parameters, and for its state."""


class LawRecord(Record):
    """A law's parameters."""

    K_p: float  # Nm/rad
    F_s: float  # Nm
    F_d: float  # Nm
    velocity_band_counts: float  # Delta v, in encoder counts a cycle: the rig file's key divided by the window's cycles
    paper_entry: int  # 1: x_stuck = x at stick entry, as printed in the paper
    brake_spring: int  # 1: the brake displays |K_p (x - x_stuck)| when stuck, as printed in the paper
    user: Annotated[FloatField, USER]  # a law's own parameters, in the order of its declaration


LAW = dtype_of(LawRecord)


class LawStateRecord(Record):
    """State of a law, kept from cycle to cycle, and its further outputs."""

    stuck: int  # 1: the handle sticks
    x_stuck: float  # position at which the stick spring is at rest [rad]
    psi_Nm: float  # last result of the law; stored by the host
    brake_Nm: float  # the law's set-point for the brake, >= 0
    motor_Nm: float  # the law's part for the motor in mode hybrid, signed as psi; 0 except for laws that push back
    user: Annotated[FloatField, USER]  # a law's own state variables


LAW_STATE = dtype_of(LawStateRecord)

LawFunction: TypeAlias = Callable[[MotionRecord, LawRecord, LawStateRecord], float]
"""A compiled law (`host.laws.laws`), which returns the friction torque psi [Nm]."""

FIELD_OF_MODE: Mapping[str, str] = MappingProxyType(
    {
        "K_p_Nm_rad": "K_p",
        "F_s_Nm": "F_s",
        "F_d_Nm": "F_d",
        "velocity_band_counts": "velocity_band_counts",
        "stick_entry": "paper_entry",
        "brake_stick": "brake_spring",
    }
)
"""Keys of [mode.*] and [law] -> fields of `LAW`."""


class Parameters(Section):
    """A law's named parameters: frozen and strict, like the sections of the rig file.

    A parameter is a number with its unit at the end of its name, or a choice of words (`Literal`), of
    which the law gets the index, from 0.
    """

    at_least: ClassVar[Mapping[str, str]] = MappingProxyType({})
    """Parameter -> its lower bound, another parameter."""
    above: ClassVar[Mapping[str, str]] = MappingProxyType({})
    """Parameter -> another parameter that it must exceed."""


F = TypeVar("F", bound=Callable[..., float])


def _view(base: np.dtype[Any], names: Iterable[tuple[str, int]]) -> np.dtype[Any]:
    """Return `base` with `names` instead of its field ``user``."""
    assert base.fields is not None
    assert base.names is not None
    shared = [name for name in base.names if name != "user"]
    offset = base.fields["user"][1]
    fields = {name: (base.fields[name][0], base.fields[name][1]) for name in shared}
    for name, size in names:
        fields[name] = (np.dtype((np.float64, (size,))) if size > 1 else np.dtype(np.float64), offset)
        offset += 8 * size
    return np.dtype(
        {
            "names": list(fields),
            "formats": [kind for kind, _ in fields.values()],
            "offsets": [place for _, place in fields.values()],
            "itemsize": base.itemsize,
        },
        align=True,
    )


class _Named:
    """A record with the names of a declaration, for plain Python; compiled code has a type of its own."""

    __slots__ = ("_places", "_record")

    def __init__(self, record: Record, places: Mapping[str, tuple[int, int]]) -> None:
        object.__setattr__(self, "_record", record)
        object.__setattr__(self, "_places", places)

    def __getattr__(self, name: str) -> Any:
        if name not in self._places:
            return getattr(self._record, name)
        first, size = self._places[name]
        return self._record.user[first : first + size] if size > 1 else float(self._record.user[first])

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self._places:
            setattr(self._record, name, value)
        else:
            self._record.user[self._places[name][0]] = value


def _places(names: Iterable[tuple[str, int]]) -> dict[str, tuple[int, int]]:
    places, first = {}, 0
    for name, size in names:
        places[name] = first, size
        first += size
    return places


@dataclass(frozen=True)
class LawKind:
    """A signature of laws: on one axis, or in the plane (`host.laws.plane.plane_law`).

    Attributes
    ----------
    motion, law, state : the records of a law's input, its parameters and its state, without a law's own names
    returns : number of values that a law returns
    place, decorator, page : text for errors: where such a law acts, how it is declared, where it is described
    built_in : the built-in laws of this kind by their names; their tables may stand beside another law's
    """

    motion: np.dtype[Any]
    law: np.dtype[Any]
    state: np.dtype[Any]
    returns: int
    place: str
    decorator: str
    page: str
    built_in: dict[str, Declaration] = field(default_factory=dict, compare=False)


ON_AXIS = LawKind(MOTION, LAW, LAW_STATE, 1, "one axis", "friction_law", "docs/laws.md")


@dataclass(frozen=True)
class Declaration:
    """A law: its function, its named parameters, and its state.

    Attributes
    ----------
    function : the plain Python function
    parameters : the model of its parameters
    state : names of its state variables, each with its number of values
    extremes : the parameters that set its peak output [Nm]; none if the peak depends on the motion
    uses_mode_keys : whether the parameters are keys of [mode.*] and [law], as for karnopp and coulomb
    pushes : whether the motor displays ``state.motor_Nm`` in mode hybrid
    kind : its signature
    """

    function: Callable[..., Any]
    parameters: type[Parameters]
    state: tuple[tuple[str, int], ...] = ()
    extremes: tuple[str, ...] = ()
    uses_mode_keys: bool = False
    pushes: bool = False
    kind: LawKind = ON_AXIS

    def __post_init__(self) -> None:
        names, size = self.names, sum(length for _, length in self.state)
        clashes = {*(self.kind.law.names or ()), *(self.kind.state.names or ())} & {
            *names,
            *(name for name, _ in self.state),
        }
        if not self.uses_mode_keys and (len(names) > USER or size > USER or clashes):
            what = (
                f"{', '.join(sorted(clashes))}: taken"
                if clashes
                else f"{len(names)} parameters and {size} numbers kept"
            )
            raise ValueError(f"law {self.name}: {what}; expected names of its own, at most {USER} numbers of each kind")

    @property
    def name(self) -> str:
        """The function's name; the table of its parameters is [law.NAME]."""
        return self.function.__name__

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its parameters."""
        return tuple(self.parameters.model_fields)

    @property
    def law_dtype(self) -> np.dtype[Any]:
        """The parameters' record with their names."""
        law = self.kind.law
        return law if self.uses_mode_keys else _view(law, ((name, 1) for name in self.names))

    @property
    def state_dtype(self) -> np.dtype[Any]:
        """The state's record with the names of the state variables."""
        return _view(self.kind.state, self.state) if self.state else self.kind.state

    @property
    def title(self) -> str:
        """The first sentence of its docstring."""
        lines = (inspect.getdoc(self.function) or "").partition("\n\n")[0].splitlines()
        return re.split(r"\.(?=\s+[A-Z])|: :math|[.:]$", " ".join(map(str.strip, lines)))[0]

    @property
    def dois(self) -> tuple[str, ...]:
        """The DOIs in its docstring."""
        return tuple(doi.rstrip(".,;") for doi in re.findall(r"doi:(\S+)", inspect.getdoc(self.function) or ""))

    def fill(self, record: Record, values: Parameters) -> None:
        """Write the parameters into a record of the kind's parameters (`LawKind.law`); a choice becomes its index."""
        for k, (name, info) in enumerate(self.parameters.model_fields.items()):
            value = getattr(values, name)
            number = float(get_args(info.annotation).index(value) if isinstance(value, str) else value)
            if self.uses_mode_keys:
                record[FIELD_OF_MODE[name]] = number
            else:
                record["user"][k] = number

    def plain(self) -> Callable[..., Any]:
        """Return the law as a plain Python function of records without these names."""
        if self.uses_mode_keys:
            return self.function
        of_law, of_state = _places((name, 1) for name in self.names), _places(self.state)

        def law(motion: MotionRecord, law: LawRecord, state: LawStateRecord) -> Any:
            return self.function(motion, _Named(law, of_law), _Named(state, of_state))

        return law


def friction_law(
    parameters: type[Parameters],
    state: type[LawStateRecord] | Iterable[str | tuple[str, int]] = (),
    extremes: Iterable[str] = (),
    *,
    pushes: bool = False,
) -> Callable[[F], F]:
    """Declare a friction law with named parameters.

    Parameters
    ----------
    parameters : the model of its parameters
    state : the state that the law keeps from cycle to cycle: a subclass of `LawStateRecord` with further
        fields, or their names, where ("F_Nm", 4) is an array
    extremes : the parameters that set the law's peak output [Nm]
    pushes : whether the motor displays ``state.motor_Nm`` in mode hybrid. For built-in laws only, this
        lifts hybrid's limit of the motor (`host.cycle.output_limits.motor_limit_Nm`).

    Raises
    ------
    ValueError
        more than 16 numbers, or a name that the records already have
    """
    if isinstance(state, type):
        variables = tuple(state_fields(state, LAW_STATE))
    else:
        variables = tuple((name, 1) if isinstance(name, str) else name for name in state)

    def declare(function: F) -> F:
        function.declaration = Declaration(function, parameters, variables, tuple(extremes), pushes=pushes)  # type: ignore[attr-defined]
        return function

    return declare


def state_fields(state: type[Record], base: np.dtype[Any]) -> Iterator[tuple[str, int]]:
    """Yield name and length of each field of a law's state that `base`, the state of all laws, lacks."""
    dtype = dtype_of(state)
    assert dtype.names is not None
    for name in dtype.names:
        if name not in (base.names or ()):
            yield name, int(np.prod(dtype[name].shape))


def declaration_of(function: Any) -> Declaration | None:
    """Return the declaration of a law; None for a law without named parameters."""
    declaration = getattr(function, "declaration", None)
    return declaration if isinstance(declaration, Declaration) else None


def described(law: Declaration) -> dict[str, Any]:
    """Return the declaration of a law as plain values, for tables and JSON."""
    parameters = [
        {
            "name": name,
            "default": info.default,
            "unit": unit_of(name),
            "accepted": accepted_range(info),
            "meaning": info.description,
        }
        for name, info in law.parameters.model_fields.items()
    ]
    for row in parameters:
        for words, others in (("at least", law.parameters.at_least), ("more than", law.parameters.above)):
            if row["name"] in others:
                row["accepted"] = f"{row['accepted']}, {words} {others[row['name']]}"
    return {
        "title": law.title,
        "doi": list(law.dois),
        "section": "mode.NAME and law" if law.uses_mode_keys else f"law.{law.name}",
        "parameters": parameters,
    }
