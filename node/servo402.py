"""Compiled part of a CiA 402 drive that only a servo drive has: position modes, homing, touch probes, 607Bh, 60FDh.

It is one function, which the drive's other kernels call by its address in the record: a rig whose
drives have none of these compiles none of it.

In the kernels: `n` the node's record (`node.record`).
"""

from __future__ import annotations

from coulombus.eds import cia402
from coulombus.eds.codec import nearest_integer
from coulombus.kernels.by_address import call_part, part_address
from coulombus.kernels.decorator import kernel
from coulombus.node import axis402, homing402, motion402, position402, slots402
from coulombus.node.record import NODE, NodeRecord

__all__ = ["ACTUATE", "CONTROLWORD", "PROBE", "SAMPLE", "TARGET", "serve", "servo_address"]

CONTROLWORD, TARGET, ACTUATE, SAMPLE, PROBE = range(5)
"""Parts of the function: a new controlword, 607Ah or 60C1h, 60B8h; the torque; the objects of the position and
the bits of the statusword.
"""

_HOMING = cia402.OPERATION_MODE_HOMING
_ENABLED = cia402.PowerState.OPERATION_ENABLED


@kernel
def serve(n: NodeRecord, part: int, t_ns: int, value: int) -> int:
    """Call a part: with the last controlword for `CONTROLWORD`, the elapsed ns for `ACTUATE`, else 0.

    It returns bits 10, 12 and 13 of the statusword for `SAMPLE`, else whether a position mode gives the torque.
    """
    result: int = call_part(n.servo, n, part, t_ns, value)
    return result


def _servo(n: NodeRecord, part: int, t_ns: int, value: int) -> int:
    controls = n.power_state == _ENABLED and motion402.is_position_mode(n)
    if part == SAMPLE:
        return _sample(n, controls)
    if part == PROBE:
        axis402.new_probe_function(n)
    elif part == ACTUATE:
        axis402.look_at_probes(n)
        if controls and n.in_supply_ok and not n.slowing:
            _actuate(n, t_ns, value)
            return 1
    elif controls and not n.slowing:
        if part == TARGET:
            position402.new_target(n, t_ns)
        elif n.mode == _HOMING:
            homing402.new_controlword(n, t_ns, value)
        else:
            position402.new_controlword(n, t_ns, value)
    return 0


@kernel
def _actuate(n: NodeRecord, t_ns: int, elapsed_ns: int) -> None:
    if n.mode == _HOMING:
        homing402.actuate(n, t_ns, elapsed_ns)
    else:
        position402.actuate(n, t_ns, elapsed_ns)
    motion402.put_out(n)


@kernel
def _sample(n: NodeRecord, controls: bool) -> int:
    values = n.values
    position = float(n.in_position_counts)
    values[slots402.POSITION] = axis402.user_position(n, position)
    values[slots402.DIGITAL_INPUTS] = axis402.digital_inputs(n, position)
    demand = n.position_demand if controls else position
    values[slots402.POSITION_DEMAND] = axis402.user_position(n, demand)
    values[slots402.FOLLOWING_ERROR] = nearest_integer(demand - position, 32)
    if not controls or n.slowing:
        return 0
    return homing402.status_bits(n) if n.mode == _HOMING else position402.status_bits(n)


def servo_address() -> int:
    """Return the function's address, for the records of servo drives."""
    return part_address(_servo, NODE)
