"""Check of the disk space for recordings."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

from coulombus.host.doctor.finding import Check, Outcome
from coulombus.host.doctor.machine import CannotRead
from coulombus.host.doctor.wanted import RigDemands

__all__ = ["bytes_s", "checks"]

PACKET_BYTES, TRACE_BYTES = 48, 12
"""Size of a frame and of a cycle's trace in a recording, rounded up."""
ENOUGH_H = 8.0
"""Required recording time [h]: a working day."""


def bytes_s(demands: RigDemands) -> float:
    """Return the data rate of a recording [bytes/s]."""
    return (PACKET_BYTES * demands.frames + TRACE_BYTES) / demands.period_s


def checks(folder: Path, demands: RigDemands) -> list[Check]:
    """Return the checks of the folder for recordings."""
    return [("disk.free", partial(free, folder, demands))]


def free(folder: Path, demands: RigDemands) -> Outcome:
    """Check that the disk has room for a day's recordings."""
    try:
        volume = os.statvfs(folder)
    except OSError as error:
        raise CannotRead(f"{folder} cannot be read: {error.strerror}") from None
    left = volume.f_bavail * volume.f_frsize
    hours = left / bytes_s(demands) / 3600
    text = f"{left / 1e9:.1f} GB in {folder.absolute()}: {hours:.0f} h of recording"
    if not os.access(folder, os.W_OK):
        return Outcome(False, f"{folder.absolute()} cannot be written", "# record to another folder")
    return Outcome(hours >= ENOUGH_H, text, "# free some space, or record with --rotate and --keep")
