"""Wall-clock start of a recording, and the synchronisation of that clock."""

from __future__ import annotations

import ctypes
import json
import os
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from coulombus.system.c_library import c_library

__all__ = ["CLOCK", "META", "attached_object", "clock_state", "meta_attachment", "utc", "wall_clock"]

CLOCK, META = "clock.json", "meta.json"
"""Names of the attachments."""
STA_UNSYNC, TIME_ERROR = 0x40, 5
PTP = Path("/sys/class/ptp")


class _Timex(ctypes.Structure):
    """The head of ``struct timex`` of adjtimex(2), with room for the rest."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_byte * 256),
    )


def utc(t_ns: int) -> str:
    """Return CLOCK_REALTIME [ns] as ISO 8601 in UTC, with microseconds."""
    whole, rest = divmod(t_ns, 10**9)
    return f"{datetime.fromtimestamp(whole, UTC):%Y-%m-%dT%H:%M:%S}.{rest // 1000:06d}Z"


def clock_state() -> dict[str, Any]:
    """Return whether NTP (or phc2sys) synchronises the clock, its errors [us], and the PTP clocks
    of this machine; None if unknown.
    """
    state_of_clock: dict[str, Any] = {"synchronised": None, "max_error_us": None, "estimated_error_us": None}
    try:
        timex = _Timex()
        state = c_library().adjtimex(ctypes.byref(timex))
    except (AttributeError, OSError):
        state = -1
    if state >= 0:
        state_of_clock["synchronised"] = state != TIME_ERROR and not timex.status & STA_UNSYNC
        state_of_clock["max_error_us"], state_of_clock["estimated_error_us"] = int(timex.maxerror), int(timex.esterror)
    try:
        state_of_clock["ptp_clocks"] = sorted(os.listdir(PTP))
    except OSError:
        state_of_clock["ptp_clocks"] = []
    return state_of_clock


def wall_clock(zero_ns: int) -> tuple[int, dict[str, bytes], str]:
    """Return the start time of a recording, its attachment, and a readable comment.

    Parameters
    ----------
    zero_ns : CLOCK_MONOTONIC at the frames' time 0

    Returns
    -------
    CLOCK_REALTIME at time 0 [ns], attachments, comment
    """
    before = time.monotonic_ns()
    real = time.time_ns()
    started_ns = real - ((before + time.monotonic_ns()) // 2 - zero_ns)
    state = clock_state()
    document = {"start_utc": utc(started_ns), "start_ns": started_ns, **state}
    quality = {True: "synchronised", False: "not synchronised", None: "not known to be synchronised"}[
        state["synchronised"]
    ]
    comment = f"time 0 is {utc(started_ns)} (the clock was {quality})"
    return started_ns, {CLOCK: json.dumps(document).encode()}, comment


def meta_attachment(meta: Mapping[str, str]) -> dict[str, bytes]:
    """Return the attachment with the user's notes; empty if there are none."""
    return {META: json.dumps(dict(meta), ensure_ascii=False).encode()} if meta else {}


def attached_object(content: bytes | None) -> dict[str, Any]:
    """Return the JSON object of an attachment; empty if absent or unreadable."""
    try:
        values = json.loads(content or b"{}")
    except (ValueError, RecursionError):
        return {}
    return values if isinstance(values, dict) else {}
