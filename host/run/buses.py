"""Runs on a rig with several buses: one process for each bus (`rigs.buses` has their addresses).

Every bus has its own cycle, its own SYNC and its own process, started with ``--channel``. The buses
share no thread and no lock. The supervisor forwards signals. When a process fails, the supervisor stops
the others safely.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from coulombus.system.realtime import die_with_parent
from coulombus.system.stop_signals import status_of, taken

__all__ = ["BusProcess", "merged", "path_on", "supervise"]

SIGN_CHECKS = ("not_run", "agreed", "no_hand", "refused")
"""Outcomes of the sign check, the worst last, as in `host.cycle.records.SignResult`."""


def path_on(path: Path, channel: str) -> Path:
    """Return the file of one bus: ``run.pcapng`` becomes ``run.CHANNEL.pcapng``."""
    return path.with_name(f"{path.stem}.{channel}{path.suffix}")


@dataclass
class BusProcess:
    """The process of one bus, and its output."""

    channel: str
    process: subprocess.Popen[str]
    lines: list[str] = field(default_factory=list)
    ended_by_us: bool = False

    @property
    def status(self) -> int:
        """The exit status of an ended process, as a shell reports it."""
        code: int = self.process.returncode
        return code if code >= 0 else 128 - code

    @property
    def result(self) -> dict[str, Any] | None:
        """The JSON object that the process printed; None if it printed none."""
        try:
            result = json.loads("".join(self.lines))
        except ValueError:
            return None
        return result if isinstance(result, dict) else None


def _environment() -> dict[str, str]:
    """Return the environment for a process, with this project's location in PYTHONPATH."""
    root = str(Path(__file__).parents[__name__.count(".")])
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))}


def supervise(
    channels: Sequence[str], arguments: Callable[[str], Sequence[str]], tell: Callable[[str, str], None] | None = None
) -> list[BusProcess]:
    """Run ``coulombus ARGUMENTS`` once for each channel, and return when all have ended.

    Parameters
    ----------
    arguments : channel -> the command's arguments
    tell : called with (channel, line) for each line of output; default keeps them in
        `BusProcess.lines`
    """
    buses: list[BusProcess] = []
    signal_number = 0

    def end(number: int) -> None:
        for bus in buses:
            if bus.process.poll() is None:
                bus.ended_by_us = True
                bus.process.send_signal(number)

    def on_signal(number: int, frame: FrameType | None) -> None:
        nonlocal signal_number
        signal_number = number
        end(number)

    def read(bus: BusProcess) -> None:
        assert bus.process.stdout is not None
        for line in bus.process.stdout:
            if tell is None:
                bus.lines.append(line)
            else:
                tell(bus.channel, line.rstrip("\n"))

    parent = os.getpid()
    with taken(on_signal), ExitStack() as at_the_end:
        at_the_end.callback(end, signal.SIGTERM)
        for channel in channels:
            command = [
                sys.executable,
                "-P",
                "-m",
                "coulombus",
                *arguments(channel),
            ]  # -P: no module of the current folder
            process = subprocess.Popen(
                command,
                stdout=subprocess.PIPE,
                text=True,
                start_new_session=True,
                env=_environment(),
                preexec_fn=lambda: die_with_parent(parent, signal.SIGTERM),  # ends safely if this process is killed
            )
            buses.append(BusProcess(channel, process))
            if signal_number:
                end(signal_number)
        readers = [threading.Thread(target=read, args=(bus,)) for bus in buses]
        for reader in readers:
            reader.start()
        while any(bus.process.poll() is None for bus in buses):
            if any(bus.process.returncode for bus in buses) and not any(bus.ended_by_us for bus in buses):
                end(signal.SIGTERM)
            for bus in buses:
                try:
                    bus.process.wait(0.02)
                except subprocess.TimeoutExpired:
                    continue
        for reader in readers:
            reader.join()
    return buses


def merged(results: Mapping[str, Mapping[str, Any] | None], statuses: Mapping[str, int]) -> dict[str, Any]:
    """Return the merged results of several buses.

    It has the figures of the first bus with a result, the axes of all, the sums of the counters, the
    worst sign check, the remarks of all, the first trip, and every bus' own result under ``buses``. Exit
    status and error are those of the first bus that failed by itself.
    """
    reported = {channel: result for channel, result in results.items() if result is not None}
    whole: dict[str, Any] = dict(next((result for result in reported.values() if "error" not in result), {}))
    axes: dict[str, Any] = {}
    for result in reported.values():
        axes |= result.get("axes") or {}
    whole["axes"] = axes
    for name in ("lost_pdos", "missed_deadlines"):
        whole[name] = sum(result.get(name) or 0 for result in reported.values())
    counters = [result.get("counters") or {} for result in reported.values()]
    if any(counters):
        whole["counters"] = {
            name: sum(counts.get(name, 0) for counts in counters) for counts in counters for name in counts
        }
    checks = [SIGN_CHECKS.index(check) for result in reported.values() if (check := result.get("sign_check"))]
    if checks:
        whole["sign_check"] = SIGN_CHECKS[max(checks)]
    if "remarks" in whole:
        whole["remarks"] = [text for result in reported.values() for text in result.get("remarks") or ()]
        gains: list[Any] = [result.get("full_gain_s") for result in reported.values()]
        whole["full_gain_s"] = None if None in gains else max(gains)
    trips = [result["trip"] for result in reported.values() if result.get("trip")]
    whole["trip"] = next((trip for trip in trips if "OTHER_AXIS" not in trip), trips[0] if trips else None)
    bad = next((channel for channel, status in statuses.items() if status not in (0, status_of(signal.SIGTERM))), None)
    whole["exit_status"] = max(statuses.values(), default=0) if bad is None else statuses[bad]
    if bad is not None and "error" in reported.get(bad, {}):
        whole["error"] = reported[bad]["error"]
    if any(result.get("faults") for result in reported.values()):
        whole["faults"] = [
            {**fault, "bus": c} for c, result in reported.items() for fault in result.get("faults") or ()
        ]
        whole["controllers"] = {
            f"{c}.{name}": summary
            for c, result in reported.items()
            for name, summary in (result.get("controllers") or {}).items()
        }
    whole["buses"] = dict(reported)
    return whole
