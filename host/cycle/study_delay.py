"""A longer delay for study, compiled: what the law asks for is held back for whole cycles.

With ``bus.delay_cycles`` = n an RPDO still acts on the next SYNC, which is one cycle. What is held
back for the other n - 1 is what the *law* asks for: the sense of the compensation, the motor's
torque, the brake's level. All that makes it safe comes behind that and acts at once: the observer's
share, the gain, the limits, the rate, the speed's taper. No phase but RUN holds anything back, so a
trip, a stop and the dead man's switch take the torque away in their own cycle, and arming is as
fast as ever.

    c : the CONTROL record of an axis        h : its HOST record
"""

from __future__ import annotations

from coulombus.host.cycle.records import ASKED, ControlRecord, HostRecord
from coulombus.kernels.decorator import kernel

__all__ = ["forget", "hold_back"]


@kernel
def forget(h: HostRecord) -> None:
    """Hold nothing back: what a display before this one asked for is gone."""
    h.asked_row = 0
    for k in range(ASKED):
        h.asked_sense[k] = h.asked_psi_Nm[k] = h.asked_brake_Nm[k] = 0.0


@kernel
def hold_back(
    c: ControlRecord, h: HostRecord, sense: float, psi_Nm: float, level_Nm: float
) -> tuple[float, float, float]:
    """Return what the law asked for `delay_cycles` - 1 cycles ago - the sense of the compensation, the motor's
    torque [Nm], the brake's level [Nm] - and keep what it asks for now. Nothing before the first.
    """
    if c.delay_cycles <= 1:
        return sense, psi_Nm, level_Nm
    row = h.asked_row
    was = h.asked_sense[row], h.asked_psi_Nm[row], h.asked_brake_Nm[row]
    h.asked_sense[row], h.asked_psi_Nm[row], h.asked_brake_Nm[row] = sense, psi_Nm, level_Nm
    h.asked_row = (row + 1) % min(c.delay_cycles - 1, ASKED)
    return was
