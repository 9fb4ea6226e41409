"""Time stamps of other tools' logs, in ns."""

from __future__ import annotations

from datetime import UTC, datetime
from decimal import Decimal

__all__ = [
    "DAY_NS",
    "LATEST_NS",
    "WALL_CLOCK_NS",
    "bus_clock_ns",
    "busmaster_start_ns",
    "candump_ns",
    "clock_ns",
    "clock_us",
    "float_ns",
    "hex_ms_ns",
    "ms_ns",
    "stamp_ns",
    "trc_start_ns",
    "us_ns",
]

SECOND_NS = 10**9
DAY_NS = 86_400 * SECOND_NS
EXACT_CHARACTERS = 20
POWERS: tuple[int, ...] = tuple(10**digits for digits in range(EXACT_CHARACTERS + 1))
LATEST_NS = 2**63 - 1
WALL_CLOCK_NS = 10**17
"""Stamps beyond this (1973) are wall-clock times; smaller ones count from the run's start."""
EPOCH_DAYS = 25_569
"""Days from 1899-12-30, from which the start of a .trc counts, to 1970."""


def stamp_ns(text: str, scale: int = 10**9) -> int:
    """Return a time in units of `scale` ns, as text with a point or a comma, in ns.

    Raises
    ------
    ValueError
        It is not a number, or exceeds an INTEGER64 of nanoseconds (the year 2262).
    """
    whole, _, decimals = text.partition(".")
    if decimals.isdigit() and whole.isdigit() and len(text) <= EXACT_CHARACTERS:  # most stamps, in less time
        unit_ns, rest = divmod(scale, POWERS[len(decimals)])
        t_ns = int(whole + decimals) * unit_ns
        if not rest and t_ns < LATEST_NS:
            return t_ns
    try:
        exact_ns = Decimal(text.replace(",", ".")) * scale
        if abs(exact_ns) < LATEST_NS:  # false for NaN
            return round(exact_ns)
    except ArithmeticError:
        pass
    raise ValueError(f"got the stamp {text}, expected a number before the year 2262")


def clock_us(t_ns: int) -> int:
    """Return a stamp that a tool stored as a float of seconds: wall-clock times in whole
    microseconds, the precision of such a float.
    """
    return (t_ns + 500) // 1000 * 1000 if t_ns >= WALL_CLOCK_NS else t_ns


def float_ns(text: str) -> int:
    """Return a stamp in seconds, written by a tool that has it as a float."""
    return clock_us(stamp_ns(text))


def ms_ns(text: str) -> int:
    """Return a stamp in milliseconds."""
    return stamp_ns(text, 10**6)


def us_ns(text: str) -> int:
    """Return a stamp in microseconds."""
    return stamp_ns(text, 1000)


def hex_ms_ns(text: str) -> int:
    """Return a stamp in milliseconds, in hexadecimal (slcan)."""
    return int(text, 16) * 10**6


def candump_ns(text: str) -> int:
    """Return a stamp of candump: seconds, or with ``-t A`` date and time, read as UTC."""
    if "-" not in text.strip("-"):
        return stamp_ns(text)
    moment = datetime.fromisoformat(text).replace(tzinfo=UTC)
    return int(moment.replace(microsecond=0).timestamp()) * 10**9 + moment.microsecond * 1000


def clock_ns(text: str) -> int:
    """Return a stamp as ``h:m:s`` with decimals."""
    hours, minutes, seconds = text.split(":")
    return (int(hours) * 60 + int(minutes)) * 60 * 10**9 + stamp_ns(seconds)


def bus_clock_ns(text: str) -> int:
    """Return a stamp of BUSMASTER: ``h:m:s:f``, `f` being the decimals of the second."""
    whole, _, decimals = text.rpartition(":")
    return clock_ns(f"{whole}.{decimals}")


def trc_start_ns(text: str) -> int:
    """Return the start of a .trc in ns since 1970: days since 1899-12-30, read as UTC."""
    return round((stamp_ns(text, DAY_NS) - EPOCH_DAYS * DAY_NS) / 1000) * 1000


def busmaster_start_ns(text: str) -> int:
    """Return the start of a BUSMASTER log in ns since 1970: ``d:m:y h:m:s:ms``, read as UTC."""
    date, _, clock = text.strip().partition(" ")
    day, month, year = map(int, date.split(":"))
    whole, _, ms = clock.strip().rpartition(":")
    midnight = int(datetime(year, month, day, tzinfo=UTC).timestamp()) * 10**9
    return midnight + clock_ns(whole) + int(ms or "0") * 10**6
