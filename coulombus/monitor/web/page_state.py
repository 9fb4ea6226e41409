"""State document of the page, five times a second, from the bus and the host's status."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from coulombus.eds.cia301 import NmtState
from coulombus.eds.cia402 import PowerState
from coulombus.monitor.live_incidents import IncidentRow
from coulombus.monitor.services import STATES
from coulombus.monitor.snapshot import NodeRow, PdoRow, Snapshot, Value
from coulombus.monitor.web.capture import LiveCapture
from coulombus.monitor.word_bits import WORDS, bits_set, meaning
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["FaultDoor", "HostDoor", "HostView", "arm_state", "document", "drive_words", "incident_dicts"]

NMT_OPERATIONAL = STATES[NmtState.OPERATIONAL]
ENABLED = PowerState.OPERATION_ENABLED.name.lower().replace("_", " ")
EVENTS_SHOWN = 40
BINS_SHOWN = 200
PHASES = {
    "off": "off",
    "still": "waiting for a still handle",
    "enable": "enabling the drive",
    "sign": "checking the signs",
    "settle": "settling",
    "run": "running",
    "safe": "safe state",
    "disable": "disabling the drive",
    "done": "done",
}
"""Texts for the phases of the host's cycle; other phases are shown by name."""


@dataclass(frozen=True)
class HostDoor:
    """Connection of the page to the host.

    `status` reads its state, `stop` requests a safe stop and waits for its end, `change` requests
    other parameters, `mark` a marker; all raise OSError or an error with a text.

    Attributes
    ----------
    ring : force of the law of an arm over the directions, x and y, in a mode with the present live
        parameters; called in the same thread
    curve : friction of an axis' law over velocities, in a mode with the present live parameters;
        called in a separate thread
    last : the final report of the ended host, or None
    entry : the runbook's section for a trip's text, a paragraph or a step in a line, or None
    keep : keeps the last page of a host that tripped (`monitor.web.last_page`)
    start : the command that starts a host on this bus
    """

    status: Callable[[], Mapping[str, Any]]
    stop: Callable[[], Mapping[str, Any]]
    change: Callable[[dict[str, Any]], Mapping[str, Any]]
    mark: Callable[[str], Mapping[str, Any]]
    curve: Callable[[Axis, str, Mapping[str, float]], tuple[tuple[float, ...], tuple[float, ...]] | None]
    last: Callable[[], Mapping[str, Any] | None] = lambda: None
    entry: Callable[[str], str | None] = lambda trip: None
    keep: Callable[[bytes], None] = lambda content: None
    start: str = "coulombus run"
    ring: Callable[[Rig, str, Mapping[str, float]], tuple[tuple[float, ...], tuple[float, ...]] | None] = (
        lambda rig, mode, live: None
    )


@dataclass(frozen=True)
class FaultDoor:
    """Connection of the page to the faults of a simulated bus; all functions raise OSError or an error with a text.

    Attributes
    ----------
    state : nodes with their possible faults, faults of the wire, and what acts
    inject : begins a fault, by its kind, at a node or "bus"; returns its text
    clear : ends the faults of a kind, at a place, or all (empty texts); returns a text
    effects : effect of each kind of fault
    """

    state: Callable[[], Mapping[str, Any]]
    inject: Callable[[str, str], str]
    clear: Callable[[str, str], str]
    effects: Mapping[str, str]


KILLED = "it left no word: its process was killed, or its machine stopped"


class HostView:
    """The host's last status and its end, kept after it has ended.

    Parameters
    ----------
    entry : of a `HostDoor`
    """

    def __init__(self, entry: Callable[[str], str | None] = lambda trip: None) -> None:
        self._entry = entry
        self._status: Mapping[str, Any] | None = None
        self._runs = False
        self._trip: str | None = None
        self._word: Mapping[str, Any] | None = None
        self.mode = ""

    def update(self, status: Mapping[str, Any] | None, word: Mapping[str, Any] | None = None) -> None:
        """Process the host's status; None: no host runs, `word` is the final report of the last one.

        Values of a wrong type are ignored.
        """
        if status is not None:
            fresh = not self._runs
            self._status, self._word = status, None
            self.mode = text(status.get("mode"))
            if trip := text(status.get("trip")):
                self._trip = trip
            elif fresh:  # a new run: the last trip is over
                self._trip = None
        elif word is not None:
            self.ended(word)
        self._runs = status is not None

    def ended(self, word: Mapping[str, Any]) -> None:
        """Process the host's report of its end."""
        self._word = word
        self._trip = text(word.get("trip")) or self._trip

    def _end(self) -> dict[str, Any] | None:
        """Return the host's end; None while it runs, or without a host."""
        if self._runs or (self._status is None and self._word is None):
            return None
        word = self._word or {}
        stopped_by = text(word.get("stopped_by"))
        if self._trip:
            kind, why = "tripped", f"trip {self._trip}"
        elif self._word is None:
            kind, why = "lost", KILLED
        else:
            kind, why = "ended", f"stopped by {stopped_by}" if stopped_by else "its display was over"
        return {"kind": kind, "why": why, "at": text(word.get("tripped")) or text(word.get("ended"))}

    @property
    def runs(self) -> bool:
        """Whether the host runs."""
        return self._runs

    @property
    def tripped_ns(self) -> int | None:
        """Time of the trip [ns since 1970]; None without one, or if the host did not say it."""
        trip_times = (text(place.get("tripped")) for place in (self._word or {}, self._status or {}))
        at = next(filter(None, trip_times), "") if self._trip else ""
        try:
            return round(datetime.fromisoformat(at).timestamp() * 1e6) * 1000
        except ValueError:
            return None

    def _axes(self) -> list[Mapping[str, Any]]:
        return [entry for entry in _list((self._status or {}).get("axes")) if isinstance(entry, Mapping)]

    def _parameters(self) -> list[dict[str, Any]]:
        return [row for entry in self._axes() for row in map(_parameter, _list(entry.get("parameters"))) if row]

    def _parameters_now(self) -> list[dict[str, Any]]:
        """Return the changeable parameters of a running host."""
        return self._parameters() if self._runs else []

    def live(self, axis: str) -> dict[str, float]:
        """Return the present live parameters of an axis, by name."""
        return {row["name"]: row["now"] for row in self._parameters() if row["axis"] == axis}

    def positions(self) -> dict[str, float]:
        """Return the positions since the running host's start, by axis, of those that are known [rad]."""
        rows = self._axes() if self._runs else []
        axis_positions = ((text(row.get("axis")), _number(row.get("position_rad"))) for row in rows)
        return {name: position for name, position in axis_positions if position is not None}

    def as_dict(self) -> dict[str, Any]:
        """Return the host's part of the document."""
        status, axes = self._status or {}, self._axes()
        meta, counted = _map(status.get("meta")), _map(status.get("histograms_us"))
        words = [(text(entry.get("axis")), text(entry.get("phase"))) for entry in axes]
        phases = [f"{axis} {PHASES.get(phase, phase)}".strip() for axis, phase in words]
        counters, word = _map(status.get("counters")), self._word or {}
        lost = [n for n in (_number(entry.get("lost_pdos")) for entry in axes) if n is not None]
        return {
            "runs": self._runs,
            "end": self._end(),
            "lost_pdos": _first(_number(word.get("lost_pdos")), sum(lost) if lost else None),
            "missed": _first(_number(word.get("missed_deadlines")), _number(counters.get("missed_deadlines"))),
            "mode": self.mode,
            "phase": ", ".join(phases),
            "display_s": _number(status.get("display_s")),
            "cycles": _number(status.get("cycles")),
            "trip": self._trip or "",
            "entry": (self._entry(self._trip) or "") if self._trip else "",
            "tripped_s": None if self.tripped_ns is None else self.tripped_ns * 1e-9,
            "recording": text(status.get("recording")),
            "subject": text(meta.get("subject")),
            "trial": text(meta.get("trial")),
            "parameters": self._parameters_now(),
            "arm_key": self._runs and status.get("arm_key") is True,
            "wakeup_us": _spread(status.get("wakeup_us")),
            "sync_to_rpdo_us": _spread(status.get("sync_to_rpdo_us")),
            "histograms": {name: _histogram(counted.get(name)) for name in ("wakeup", "sync_to_rpdo")},
            "deadline_us": _number(counted.get("deadline")),
        }


def document(
    capture: LiveCapture,
    snapshot: Snapshot,
    facts: Mapping[str, Any],
    host: HostView,
    incidents: Sequence[IncidentRow] = (),
) -> dict[str, Any]:
    """Return the document: top line, PDOs, nodes, events, incidents.

    Parameters
    ----------
    facts : of the reader: bus, bitrate_bit_s, lost, malformed
    """
    load = capture.load(snapshot.t_ns, int(facts["bitrate_bit_s"]) or capture.rig.bus.bitrate_bit_s)
    return {
        "rig": capture.rig.name,
        "bus": str(facts["bus"]),
        "load_percent": round(100 * load, 1),
        "frames_per_s": round(snapshot.frames_per_s),
        "sync_per_s": round(snapshot.sync_per_s, 1),
        "lost": int(facts["lost"]),
        "malformed": int(facts["malformed"]) + sum(row.malformed for row in snapshot.pdos),
        "error_frames": snapshot.error_frames,
        "unknown": snapshot.unknown,
        "arm": arm_state(snapshot),
        "drives": drive_words(snapshot),
        "host": host.as_dict(),
        "incidents": incident_dicts(incidents),
        "pdos": [_pdo(capture, row, snapshot.t_ns) for row in snapshot.pdos],
        "nodes": [_node(row) for row in snapshot.nodes],
        "events": [[event.t_ns / 1e9, event.text, event.grave] for event in list(capture.events)[-EVENTS_SHOWN:]],
    }


def arm_state(snapshot: Snapshot) -> str:
    """Return "armed" if a drive on the bus is enabled, "disarmed" if all drives report that they
    are not, "unknown" if a drive was never or not recently heard, or no longer sends its statusword.

    It follows from the bus, because the host may run on another machine.
    """
    drives = [node for node in snapshot.nodes if node.power_state is not None]
    if any(node.power_state == ENABLED and not _stale(node) for node in drives):
        return "armed"
    return "disarmed" if drives and not any(map(_stale, drives)) else "unknown"


def _stale(node: NodeRow) -> bool:
    """Return whether a drive's statusword is an old one: a node that is not OPERATIONAL sends no PDO."""
    return node.silent or node.state not in (None, NMT_OPERATIONAL)


def drive_words(snapshot: Snapshot) -> str:
    """Return the drives' states and their last EMCY as text: the reason for being armed or not."""
    drives = [node for node in snapshot.nodes if node.power_state is not None]
    several = len(drives) > 1
    words = []
    for node in drives:
        state = _power(node)
        state = f"silent, {state}" if node.silent else state
        words.append((f"{node.name} " if several else "") + state + (f", {node.emergency}" if node.emergency else ""))
    return "; ".join(words)


def _power(node: NodeRow) -> str:
    """Return a drive's state, or the last one seen; empty of another node."""
    return f"{'last seen ' if _stale(node) else ''}{node.power_state}" if node.power_state else ""


def incident_dicts(rows: Sequence[IncidentRow], epoch_ns: int = 0) -> list[dict[str, Any]]:
    """Return incidents for the page; its times are s since `epoch_ns`.

    Those with the same title and state are one, with their count and with the details of the first.
    """
    groups: dict[tuple[str, str], list[IncidentRow]] = {}
    for row in rows:
        groups.setdefault((row.title, row.status), []).append(row)
    return [_incident(group, epoch_ns) for group in groups.values()]


def _incident(group: Sequence[IncidentRow], epoch_ns: int) -> dict[str, Any]:
    row = group[0]
    ends = [member.end_ns for member in group]
    end_ns = None if None in ends else max(end for end in ends if end is not None)
    return {
        "number": row.number,
        "key": min(group, key=lambda member: member.begin_ns).key,
        "status": row.status,
        "title": row.title,
        "count": len(group),
        "t": (min(member.begin_ns for member in group) - epoch_ns) / 1e9,
        "end": None if end_ns is None else (end_ns - epoch_ns) / 1e9,
        "cause": row.cause,
        "sure": row.sure,
        "checks": list(row.checks),
        "course": [[(t_ns - epoch_ns) / 1e9, role, words] for t_ns, role, words in row.course],
    }


def _first(*values: float | None) -> float | None:
    return next((value for value in values if value is not None), None)


def text(value: object) -> str:
    """Return a value of any type if it is a string, else ""."""
    return value if isinstance(value, str) else ""


def _list(value: object) -> list[Any]:
    return list(value) if isinstance(value, (list, tuple)) else []


def _map(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _number(value: object) -> float | None:
    right = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    return value if right else None  # type: ignore[return-value]  # mypy does not follow `right`


def _parameter(row: object) -> dict[str, Any] | None:
    """Return a live parameter for the page; None if invalid."""
    if not isinstance(row, Mapping):
        return None
    names = {name: text(row.get(name)) for name in ("axis", "name", "unit")}
    numbers = {name: _number(row.get(name)) for name in ("value", "now", "low", "high")}
    more = {"step": _number(row.get("step")), "above_low": row.get("above_low") is True}
    return {**names, **numbers, **more} if names["name"] and None not in numbers.values() else None


def _histogram(histogram: object) -> dict[str, list[float]] | None:
    """Return edges [us] and counts of a histogram; None if absent or invalid."""
    table = _map(histogram)
    edges, counts = _list(table.get("edges"))[: BINS_SHOWN + 1], _list(table.get("counts"))[:BINS_SHOWN]
    right = len(edges) == len(counts) + 1 and None not in map(_number, [*edges, *counts])
    return {"edges": edges, "counts": counts} if right else None


def _spread(spread: object) -> list[float] | None:
    """Return median, 99th percentile and maximum of a time [us]; None if absent."""
    quantiles = [_number(spread.get(name)) for name in ("p50", "p99", "max")] if isinstance(spread, Mapping) else [None]
    return None if None in quantiles else quantiles  # type: ignore[return-value]  # mypy does not see that none is None


def _pdo(capture: LiveCapture, row: PdoRow, now_ns: int) -> dict[str, Any]:
    period = capture.period(row.can_id, now_ns)
    data = capture.last_data(row.can_id)
    return {
        "name": row.name,
        "id": f"{row.can_id:03X}h",
        "raw": "" if data is None else data.hex(" ").upper(),
        "rate": round(row.rate_per_s, 1),
        "jitter_ms": None if period is None else round(period.jitter_ms, 3),
        "stale": row.age_s is None or row.age_s > 0.1,
        "signals": [_signal(value, place) for value, place in zip(row.values, capture.places(row.can_id), strict=True)],
    }


def _signal(value: Value, place: str) -> dict[str, Any]:
    word = not value.unit and value.name.rpartition(".")[2] in WORDS
    shown = value.value if value.value is None or not word else f"{int(value.value):04X}h"
    words = "; ".join(filter(None, (meaning(value), bits_set(value))))
    return {"name": value.name, "value": shown, "unit": value.unit, "bits": place, "meaning": words}


def _node(row: NodeRow) -> dict[str, Any]:
    return {
        "name": row.name,
        "id": row.node_id,
        "state": row.state or "",
        "silent": row.silent,
        "power": _power(row),
        "emergency": row.emergency or "",
    }
