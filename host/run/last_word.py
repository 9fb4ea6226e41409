"""Final report of a host: mode, cycles, time and reason of its end; and the page that was open at a trip.

The report is a file in the folder of the host's socket. Observers read it after the host's end, until
the next host begins. A killed host leaves no report. The page's server keeps its last page beside it.
The ten newest reports stay.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from coulombus.host.run.control_socket import address_of, control_path
from coulombus.recording.wall_clock import utc
from coulombus.system.unfinished_file import write_whole
from coulombus.wire.address import HOST_SUFFIX, BusAddress

__all__ = ["ending", "forget_word", "keep_page", "last_page", "last_word", "leave_word", "newest_word", "wall_time"]

SUFFIX, PAGE_SUFFIX = ".last", ".last-page"
MOST_BYTES, MOST_PAGE_BYTES = 1 << 16, 1 << 24
KEPT = 10
"""Number of newest reports that stay."""
KINDS = {
    "mode": (str,),
    "cycles": (int,),
    "trip": (str, type(None)),
    "stopped_by": (str, type(None)),
    "ended": (str,),
    "tripped": (str, type(None)),
    "lost_pdos": (int,),
    "missed_deadlines": (int,),
}
"""The entries and their types."""


def _path(address: BusAddress) -> Path:
    host = control_path(address)
    return host.with_name(host.name + SUFFIX)


def leave_word(
    addresses: Iterable[BusAddress], outcome: Mapping[str, Any] | None, recording: Path | None = None
) -> None:
    """Write the report of a run for each of its buses, with the present time; does nothing for None. Never raises.

    Parameters
    ----------
    outcome : the entries of `KINDS` except ``ended``
    recording : its path, the entry ``recording``
    """
    if outcome is None:
        return
    for address in addresses:
        with suppress(Exception):  # an error here must not change the run's result
            path, file = _path(address), None if recording is None else str(recording.absolute())
            write_whole(path, json.dumps({**outcome, "recording": file, "ended": utc(time.time_ns())}).encode())
            _remove_old(path.parent)


def keep_page(address: BusAddress, content: bytes) -> None:
    """Keep the page of a host that tripped, until the next host begins.

    Raises
    ------
    OSError
        the file cannot be written
    """
    write_whole(_path(address).with_suffix(PAGE_SUFFIX), content)


def last_page(address: BusAddress) -> bytes | None:
    """Return the kept page of the last host on a bus; None if no page was open at its trip."""
    with suppress(OSError), _path(address).with_suffix(PAGE_SUFFIX).open("rb") as file:
        return file.read(MOST_PAGE_BYTES)
    return None


def wall_time(monotonic_ns: int) -> str | None:
    """Return a time of the monotonic clock as that of the wall clock; None for 0."""
    return utc(time.time_ns() - time.monotonic_ns() + monotonic_ns) if monotonic_ns else None


def _remove_old(folder: Path) -> None:
    """Remove all reports except the `KEPT` newest."""
    reports = sorted(folder.glob(f"*{SUFFIX}"), key=lambda path: path.stat().st_mtime_ns, reverse=True)
    for report in reports[KEPT:]:
        report.unlink(missing_ok=True)
        report.with_suffix(PAGE_SUFFIX).unlink(missing_ok=True)


def forget_word(addresses: Iterable[BusAddress]) -> None:
    """Remove the reports of earlier hosts. Never raises."""
    for address in addresses:
        with suppress(Exception):
            _path(address).unlink(missing_ok=True)
            _path(address).with_suffix(PAGE_SUFFIX).unlink(missing_ok=True)


def last_word(address: BusAddress) -> dict[str, Any] | None:
    """Return the report of the last host on a bus; None if there is no readable one."""
    try:
        with _path(address).open("rb") as file:
            word = json.loads(file.read(MOST_BYTES))
    except (OSError, ValueError, RecursionError):
        return None
    right = isinstance(word, dict) and all(isinstance(word.get(name), kinds) for name, kinds in KINDS.items())
    return word if right else None


def newest_word() -> tuple[BusAddress, dict[str, Any]] | None:
    """Return the bus and the report of the host of this user that ended last; None if there is no readable one."""
    with suppress(Exception):  # the folder is gone, or another user's
        folder = _path(BusAddress("coulombus", "any")).parent
        names = [path.name.removesuffix(f"{HOST_SUFFIX}{SUFFIX}") for path in folder.glob(f"*{HOST_SUFFIX}{SUFFIX}")]
        words = [(address, word) for address in map(address_of, names) if (word := last_word(address))]
        return max(words, key=lambda entry: str(entry[1]["ended"]), default=None)
    return None


def ending(word: Mapping[str, Any]) -> str:
    """Return time and reason of a host's end as text: "2026-11-27 10:31:02, stopped by coulombus stop".

    The time is that of the trip, where there was one.
    """
    trip, stopped_by = word["trip"], word["stopped_by"]
    why = f"trip {trip}" if trip else f"stopped by {stopped_by}" if stopped_by else "its display was over"
    try:
        at = datetime.fromisoformat(word.get("tripped") or word["ended"]).astimezone().strftime("%Y-%m-%d %H:%M:%S")
    except ValueError:
        return str(why)
    return f"{at}, {why}"
