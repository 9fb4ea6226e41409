"""Artificial delay for studies, compiled: the law's output is held back for whole cycles.

With ``bus.delay_cycles`` = n an RPDO still acts on the next SYNC, after one cycle. For the other n - 1
cycles the *law's* output is held back: the direction of the compensation, the motor's torque, the
brake's level. The safety functions act after the delay and at once: the observer's share, the gain, the
limits, the rate, the taper near the speed limit. Only phase RUN holds outputs back. So a trip, a stop
and the dead man's switch remove the torque in their own cycle, and arming takes no longer.

    c : the CONTROL record of an axis        h : its HOST record
"""

from __future__ import annotations

from coulombus.host.cycle.records import ASKED, ControlRecord, HostRecord
from coulombus.kernels.decorator import kernel

__all__ = ["forget", "hold_back"]


@kernel
def forget(h: HostRecord) -> None:
    """Clear the held back outputs of an earlier phase RUN."""
    h.asked_row = 0
    for k in range(ASKED):
        h.asked_sense[k] = h.asked_psi_Nm[k] = h.asked_brake_Nm[k] = 0.0


@kernel
def hold_back(
    c: ControlRecord, h: HostRecord, sense: float, psi_Nm: float, level_Nm: float
) -> tuple[float, float, float]:
    """Return the law's output of `delay_cycles` - 1 cycles ago, and store the present output.

    An output is the direction of the compensation, the motor's torque [Nm] and the brake's level [Nm]. It
    is 0 for cycles before the first.
    """
    if c.delay_cycles <= 1:
        return sense, psi_Nm, level_Nm
    row = h.asked_row
    was = h.asked_sense[row], h.asked_psi_Nm[row], h.asked_brake_Nm[row]
    h.asked_sense[row], h.asked_psi_Nm[row], h.asked_brake_Nm[row] = sense, psi_Nm, level_Nm
    h.asked_row = (row + 1) % min(c.delay_cycles - 1, ASKED)
    return was
