"""Reactions of motor and brake to the loss of the host: monitor, time, effect, from bring-up's settings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from coulombus.eds.drive_axis import of_axis
from coulombus.eds.own_devices import identity_from_1018h, is_own
from coulombus.host.setup.settings import Setting
from coulombus.rigs.axis import Axis
from coulombus.rigs.device_services import is_guarded, life_of
from coulombus.rigs.devices import Brake, Motor, drive_axis_of
from coulombus.rigs.roles import CIA402, profile_of

__all__ = ["NO_REACTION", "Reaction", "reactions_of"]

NO_REACTION = "no reaction to the host's loss"
FAULTS = ("host dies", "bus cut", "host hangs")
"""In each of these faults set-points, SYNC, heartbeats and guarding end, because the cycle sends them all."""
FAULT_VALUES = ((0x7341, 0x6340), (0x6444, 0x6443))
"""Objects of an output's fault value and of its enable: CiA 404, CiA 401."""


class Reaction(NamedTuple):
    """Reaction of a device to a fault: the monitor that detects it ("": none), its time [s], and the effect.

    `safe_s` is the time from the fault to torque 0 [s]; None if no object sets it.
    """

    device: str
    fault: str
    who: str
    within_s: float | None
    what: str
    safe_s: float | None = None


def reactions_of(axis: Axis, node: str, settings: Iterable[Setting]) -> tuple[Reaction, ...]:
    """Return the reactions of motor or brake to the loss of the host, with these `settings`.

    The fastest of its monitors acts.
    """
    part, description = axis.part(node), axis.description(node)
    assert isinstance(part, Motor | Brake)
    set_there = {(s.index, s.subindex): s.value for s in settings}
    ours = is_own(node, identity_from_1018h(description))
    watches = [*_watches(axis, node, part, set_there)]
    acts = ours or (of_axis(0x6007, drive_axis_of(part)), 0) in set_there
    what, ramp_s = "torque 0, disabled" if acts else "the drive's own reaction", 0.0
    if node == "brake" and profile_of(description, "brake") != CIA402:
        acts = any(
            {(value, sub), (mode, sub)} <= set(set_there) for value, mode in FAULT_VALUES for _, sub in set_there
        )
        what = "the fault value: off"
        if ours:
            what, ramp_s = "ramped off", set_there.get((0x2005, 0), 0) / 1e6
            watches = _brakes_own(watches, set_there)
        watches = watches if acts else []
    if not watches:
        return tuple(Reaction(axis.prefix + node, fault, "", None, "its last set-point stays") for fault in FAULTS)
    within_s, who = min(watches)
    safe_s = within_s + ramp_s if acts else None
    return tuple(Reaction(axis.prefix + node, fault, who, within_s, what, safe_s) for fault in FAULTS)


def _watches(
    axis: Axis, node: str, part: Motor | Brake, set_there: Mapping[tuple[int, int], int]
) -> Iterator[tuple[float, str]]:
    """Yield the time [s] and the name of each monitor by which a device detects the host's loss."""
    for pdo in axis.pdos():
        communication = 0x1400 + pdo.layout.number - 1
        mine = pdo.node == axis.prefix + node and pdo.layout.direction == "rpdo"
        if mine and (communication, 5) in set_there:
            yield part.setpoint_fault_s, f"RPDO deadline {communication:04X}h:05"
    if is_guarded(axis.description(node)):
        guard_ms, factor = life_of(axis.host.heartbeat_s, part.heartbeat_timeout_s)
        yield guard_ms * factor / 1e3, "life guarding 100Ch, 100Dh"
    elif (0x1016, 1) in set_there:
        yield part.heartbeat_timeout_s, "heartbeat consumer 1016h:01"
    own_drive = node == "motor" and is_own(node, identity_from_1018h(axis.description(node)))
    if own_drive and set_there.get((0x2002, 0)):  # in a third-party drive 2002h has another meaning
        yield part.sync_timeout_s, "SYNC time-out 2002h"


def _brakes_own(
    watches: Sequence[tuple[float, str]], set_there: Mapping[tuple[int, int], int]
) -> list[tuple[float, str]]:
    """Return the monitors that start the ramp of this project's brake.

    The age of its set-point starts it; without that monitor, the loss of the host's heartbeat. Its RPDO
    deadline only reports (docs/devices.md).
    """
    hold_us = set_there.get((0x2001, 0), 0)
    return (
        [(hold_us / 1e6, "set-point age 2001h")] if hold_us else [watch for watch in watches if "RPDO" not in watch[1]]
    )
