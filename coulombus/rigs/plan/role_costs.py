"""Bus time of each role of a rig, and remedies if the plan does not fit.

A PDO's longest frame is divided among its entries in proportion to their bits, so that the roles' times add up to the
frames of the cycle. The saving without a role differs: the other roles are allocated anew, and the saving is the
difference of the cycles' frames.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import lcm

from coulombus.rigs.axis import Axis
from coulombus.rigs.errors import RigError
from coulombus.rigs.model import to_ns
from coulombus.rigs.plan.response_times import bit_ns
from coulombus.rigs.plan.rig_plan import RigPlan, plan_again
from coulombus.rigs.rig import Rig
from coulombus.rigs.roles import ROLES, RoleKind
from coulombus.rigs.signals import RigPdo
from coulombus.wire.bits import worst_case_bits

__all__ = ["Remedy", "RoleCost", "longer_period", "role_costs", "without_roles"]

SPARED = ("velocity", "coil_temperature", "torque", "coil_current", "handle_torque")
"""Optional roles in the order of removal: those only recorded, then those that a watch needs."""
RASTER_NS = 50_000
"""Periods are proposed in whole multiples of this and of plant.step_s."""
MOST_PERIODS = 20
"""Number of raster periods to try, upwards from the shortest that would fit."""
KINDS = {kind.name: kind for kind in ROLES}


@dataclass(frozen=True)
class RoleCost:
    """Bus time of a role in each cycle.

    Attributes
    ----------
    role : its name; "deadman"; "" for another entry of a fixed map
    node : its device, with the axis as prefix if the rig has several
    place : the object, as "6064h:00"
    pdo : the PDO that carries it, as "TPDO1"
    bits : width of the entry
    wire_ns : its share of the PDO's longest frame
    saved_ns : saving per cycle without it; None: the host needs it
    """

    role: str
    node: str
    place: str
    pdo: str
    bits: int
    wire_ns: int
    saved_ns: int | None


@dataclass(frozen=True)
class Remedy:
    """A change of the rig file that makes the plan fit.

    Attributes
    ----------
    overrides : the changes, as ``--set`` takes them
    period_ns : the resulting period
    roles : roles removed, with the axis as prefix if the rig has several
    lost : resulting loss for the host
    """

    overrides: tuple[str, ...]
    period_ns: int
    roles: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()


def role_costs(rig: Rig, bitrate_bit_s: int) -> tuple[RoleCost, ...]:
    """Return the cost of each role of the rig at a bit rate, in the order of the PDOs; only PDOs of the rig's own axes."""
    return tuple(cost for axis in rig.axes for cost in _of_axis(axis, bitrate_bit_s))


def _of_axis(axis: Axis, rate: int) -> Iterator[RoleCost]:
    names = {axis.prefix + kind.signal: kind.name for kind in ROLES}
    whole = _busy_ns(axis.pdos(), rate)
    saved = {name: _saved_ns(axis, name, whole, rate) for name in SPARED}
    for pdo in axis.pdos():
        layout = pdo.layout
        frame_ns, data_bits = _frame_ns(pdo, rate), sum(entry.bits for entry in layout.entries)
        for entry, signal in zip(layout.entries, pdo.signals, strict=True):
            role = names.get(signal.name, "deadman" if signal.name.endswith(".deadman") else "")
            place = f"{entry.index:04X}h:{entry.subindex:02X}"
            share = round(frame_ns * entry.bits / data_bits)
            yield RoleCost(role, pdo.node, place, pdo.name, entry.bits, share, saved.get(role))


def _frame_ns(pdo: RigPdo, rate: int) -> int:
    return bit_ns(worst_case_bits(pdo.layout.length), rate)


def _busy_ns(pdos: Sequence[RigPdo], rate: int) -> int:
    return sum(_frame_ns(pdo, rate) for pdo in pdos)


def _saved_ns(axis: Axis, role: str, whole_ns: int, rate: int) -> int | None:
    if axis.allocation.bound.get(role) is None:
        return None
    other = axis.without(role)
    return None if other.allocation.problems else whole_ns - _busy_ns(other.pdos(), rate)


def longer_period(rig: Rig, plan: RigPlan, shortest: int | None) -> Remedy | None:
    """Return the shortest period of the raster at which the plan would fit with a scaled TPDO window and nothing else
    changed, or None.

    `shortest` is the result of `shortest_period_ns`.
    """
    if shortest is None:
        return None
    steps = [to_ns(axis.plant.step_s) for axis in rig.axes if axis.plant is not None]
    raster = lcm(RASTER_NS, *steps)
    first = -(-shortest // raster)
    for period_ns in (number * raster for number in range(first, first + MOST_PERIODS)):
        window_s = rig.bus.tpdo_window_s * period_ns / to_ns(rig.bus.period_s)
        overrides = (f"bus.period_s={period_ns * 1e-9:.9g}", f"bus.tpdo_window_s={window_s:.6g}")
        if _fits(rig, plan, overrides, period_ns):
            return Remedy(overrides, period_ns)
    return None


def without_roles(rig: Rig, plan: RigPlan) -> Remedy | None:
    """Return the optional roles to remove so that the plan fits, the least needed first; None if that is not enough."""
    left: list[tuple[Axis, RoleKind]] = []
    for name in SPARED:
        left += [(axis, KINDS[name]) for axis in rig.axes if axis.allocation.bound.get(name) is not None]
        if left and plan_again(_lean(rig, left), plan).fits:
            break
    else:
        return None
    for role in reversed(tuple(left)):  # perhaps fewer suffice: try to keep the most valuable first
        fewer = [other for other in left if other is not role]
        if fewer and plan_again(_lean(rig, fewer), plan).fits:
            left = fewer
    overrides = tuple(
        f'{f"axis.{axis.name}." if axis.name else ""}role.{kind.name}.object="none"' for axis, kind in left
    )
    if not _fits(rig, plan, overrides, plan.timing.period_ns):
        return None
    lost = tuple(dict.fromkeys(kind.lost for _, kind in left if kind.lost))
    return Remedy(overrides, plan.timing.period_ns, tuple(axis.prefix + kind.name for axis, kind in left), lost)


def _lean(rig: Rig, left: Sequence[tuple[Axis, RoleKind]]) -> Rig:
    """Return the rig without these roles, for its plan only."""
    gone = [axis.without(*(kind.name for other, kind in left if other is axis)) for axis in rig.axes]
    return replace(rig, axes=tuple(gone))


def _fits(rig: Rig, plan: RigPlan, overrides: tuple[str, ...], period_ns: int) -> bool:
    """Return whether the changed rig file is accepted and fits."""
    try:
        changed = rig.variant(*overrides)
    except RigError:
        return False
    return plan_again(changed, plan, period_ns=period_ns).fits
