r"""Definition of a law in the plane: a function with a fixed signature, its records, and its declaration.

It corresponds to a law on one axis (`host.laws.law`), with vectors::

    class MyLaw(Parameters):
        F_c_N: float = Field(1.0, gt=0, le=1e4, description="Coulomb friction")

    @plane_law(MyLaw)
    def my_law(motion, law, state):
        vx, vy = motion.v_m_s[0], motion.v_m_s[1]
        speed = math.hypot(vx, vy)
        state.stuck, state.hold_N = int(speed == 0.0), law.F_c_N
        if state.stuck:
            return 0.0, 0.0
        return law.F_c_N * vx / speed, law.F_c_N * vy / speed

It returns :math:`\psi` [N], the friction to be displayed: :math:`\psi \cdot v > 0` opposes the motion.
The hand feels :math:`-\psi`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Annotated, TypeAlias, TypeVar

from coulombus.host.laws.law import USER, Declaration, Field, LawKind, Parameters, declaration_of, state_fields
from coulombus.kernels.records import FloatField, Record, dtype_of

__all__ = [
    "IN_PLANE",
    "Field",
    "Parameters",
    "PlaneLawFunction",
    "PlaneLawRecord",
    "PlaneMotionRecord",
    "PlaneStateRecord",
    "declaration_of",
    "plane_law",
]


class PlaneMotionRecord(Record):
    """Input of a law in the plane."""

    x_m: Annotated[FloatField, 2]  # position of the tip
    v_m_s: Annotated[FloatField, 2]  # velocity of the tip
    hand_N: Annotated[FloatField, 2]  # the hand's force on the tip, from the joints' transducers
    dt_s: float  # period of the cycle


class PlaneLawRecord(Record):
    """A law's parameters."""

    user: Annotated[FloatField, USER]  # the parameters in the order of the declaration


class PlaneStateRecord(Record):
    """State of a law, kept from cycle to cycle, and its further outputs."""

    stuck: int  # 1: the tip sticks, and the brakes hold it with hold_N
    psi_N: Annotated[FloatField, 2]  # last result of the law; stored by the host
    motor_N: Annotated[FloatField, 2]  # the part of psi that pushes back, for the motors alone
    hold_N: float  # force that the brakes hold at rest, in the hand's present direction; 0: none
    user: Annotated[FloatField, USER]  # a law's own state variables


PlaneLawFunction: TypeAlias = Callable[[PlaneMotionRecord, PlaneLawRecord, PlaneStateRecord], tuple[float, float]]
"""A compiled law in the plane (`host.laws.plane.plane_laws`), which returns the friction force psi [N]."""


IN_PLANE = LawKind(
    dtype_of(PlaneMotionRecord),
    dtype_of(PlaneLawRecord),
    dtype_of(PlaneStateRecord),
    2,
    "the plane",
    "plane_law",
    "docs/plane.md",
)


F = TypeVar("F", bound=Callable[..., tuple[float, float]])


def plane_law(
    parameters: type[Parameters],
    state: type[PlaneStateRecord] | None = None,
    extremes: Iterable[str] = (),
    *,
    pushes: bool = False,
) -> Callable[[F], F]:
    """Declare a law in the plane with named parameters.

    Parameters
    ----------
    parameters : the model of its parameters
    state : the state that the law keeps from cycle to cycle: a subclass of `PlaneStateRecord` with further
        fields
    extremes : the parameters that set the law's peak output [N]
    pushes : whether the motors display ``state.motor_N``

    Raises
    ------
    ValueError
        more than 16 numbers, or a name that the records already have
    """
    variables = () if state is None else tuple(state_fields(state, IN_PLANE.state))

    def declare(function: F) -> F:
        function.declaration = Declaration(  # type: ignore[attr-defined]
            function, parameters, variables, tuple(extremes), pushes=pushes, kind=IN_PLANE
        )
        return function

    return declare
