"""Who notices the loss of the host, within what time, and what happens then: of each device, from
what bring-up sets in it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from coulombus.eds.own_devices import is_own, told_identity
from coulombus.host.setup.settings import Setting
from coulombus.rigs.axis import Axis
from coulombus.rigs.devices import Brake, Motor
from coulombus.rigs.guarding import is_guarded
from coulombus.rigs.roles import CIA402, profile_of

__all__ = ["NO_REACTION", "Reaction", "reactions_of"]

NO_REACTION = "no reaction to the host's loss"
FAULTS = ("host dies", "bus cut", "host hangs")
"""In each of them set-points, SYNC, heartbeats and guarding end: the cycle sends them all."""


class Reaction(NamedTuple):
    """A device, a fault, by what the device notices it ("" where by nothing), within what time [s],
    and what happens.
    """

    device: str
    fault: str
    who: str
    within_s: float | None
    what: str


def reactions_of(axis: Axis, node: str, settings: Iterable[Setting]) -> tuple[Reaction, ...]:
    """Return what motor or brake does when the host is lost, with these `settings`: the fastest of
    its watches acts.
    """
    part, description = axis.part(node), axis.description(node)
    assert isinstance(part, Motor | Brake)
    set_there = {(s.index, s.subindex) for s in settings}
    rpdos = [pdo for pdo in axis.pdos() if pdo.node == axis.prefix + node and pdo.layout.direction == "rpdo"]
    found = [
        (part.setpoint_fault_s, f"RPDO deadline {0x1400 + pdo.layout.number - 1:04X}h:05")
        for pdo in rpdos
        if (0x1400 + pdo.layout.number - 1, 5) in set_there
    ]
    if is_guarded(description):
        found.append((part.heartbeat_timeout_s, "life guarding 100Ch, 100Dh"))
    elif (0x1016, 1) in set_there:
        found.append((part.heartbeat_timeout_s, "heartbeat consumer 1016h:01"))
    told = is_own(node, told_identity(description)) or (0x6007, 0) in set_there
    what = "torque 0, drive disabled" if told else "the drive's own reaction"
    if node == "brake" and profile_of(description, "brake") != CIA402:
        fault_value = {(0x7341, 0x6340), (0x6444, 0x6443)}
        subs = {sub for _, sub in set_there}
        taken = any(
            (value, sub) in set_there and (mode, sub) in set_there for value, mode in fault_value for sub in subs
        )
        found = found if taken else []
        what = "ramped off" if (0x2005, 0) in set_there else "the fault value: off"
    if not found:
        return tuple(Reaction(axis.prefix + node, fault, "", None, "its last set-point stays") for fault in FAULTS)
    within_s, who = min(found)
    return tuple(Reaction(axis.prefix + node, fault, who, within_s, what) for fault in FAULTS)
