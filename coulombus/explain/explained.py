"""Explain a log: from frames to verdict, nodes and incidents."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from coulombus.eds.eds_folder import EdsFiles
from coulombus.explain.bus import Bus
from coulombus.explain.bus_load import BusLoad
from coulombus.explain.bus_services import Services
from coulombus.explain.disturbances import Disturbances
from coulombus.explain.drive_states import Drives
from coulombus.explain.drive_values import DriveValues
from coulombus.explain.frames import BLOCK, ERROR, EXTENDED, Block, Integers
from coulombus.explain.host_markers import HostMarkers
from coulombus.explain.identifier_table import IdentifierRow, Identifiers
from coulombus.explain.incident_words import KINDS
from coulombus.explain.incidents import Incident, join
from coulombus.explain.lengths import Lengths
from coulombus.explain.log_stamps import OF_TIMES, StampBatches, StraightTimes
from coulombus.explain.nmt_orders import Orders
from coulombus.explain.node_summary import NodeSummary, summary_of
from coulombus.explain.pdo_timing import PdoTimers, PdoTiming
from coulombus.explain.rare import RareFrames
from coulombus.explain.sync_timing import SyncTiming
from coulombus.kernels.records import Records
from coulombus.recording.bus_match import Channel
from coulombus.recording.captures import captures_of_bus
from coulombus.recording.file_content import Capture
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.recording.reading import HOST, RIG
from coulombus.recording.time_search import SpanError
from coulombus.rigs.rig import Rig, RigError, load_rig_text
from coulombus.wire.frame import data_bytes

__all__ = ["Explainer", "Explanation", "NodeSummary", "explain"]

AT_ONCE_NS = 100_000_000
"""Time within which losses of several nodes have one cause."""
POLLED = 50
"""SDO transfers of a node that is polled."""
OMITTED = "left out:"
"""Part of the remark of a reader on rows that it could not read."""
VERDICTS = ("unresolved", "recovered", "warning")


@dataclass(frozen=True)
class Explanation:
    """The explanation of a log; times are ns like the frames' stamps, `epoch_ns` is time 0."""

    verdict: str
    nodes: tuple[NodeSummary, ...]
    incidents: tuple[Incident, ...]
    epoch_ns: int
    end_ns: int
    frames: int
    remarks: tuple[str, ...]
    shown: dict[int, tuple[int, int, bytes]]
    """Time [ns], identifier and data of the frames that incidents name, by number."""
    bus: Bus
    whole: bool = True
    """Whether every row of the file was read."""
    identifiers: tuple[IdentifierRow, ...] = ()
    """Identifiers of a log that is not CANopen, the most frequent first."""

    def at_s(self, t_ns: int | None) -> float | None:
        """Return a time [s] since the log's beginning; None for None."""
        return None if t_ns is None else round((t_ns - self.epoch_ns) / 1e9, 6)


class Explainer:
    """Explains frames in one pass; memory depends on nodes and incidents only.

    Parameters
    ----------
    known
        Names and PDO maps of a rig, and EDS files; None: as learned from the log.
    span
        Begin and end [s] of the examined part; None: open.
    epoch_ns
        Time 0 [ns]; None: that of the first frame.
    """

    def __init__(
        self,
        known_bus: KnownBus | None = None,
        span: tuple[float | None, float | None] = (None, None),
        epoch_ns: int | None = None,
    ) -> None:
        self.bus = Bus(known_bus or KnownBus())
        self._rare = RareFrames(self.bus)
        self._drives, self._sync, self._pdos = Drives(self.bus), SyncTiming(self.bus), PdoTiming(self.bus)
        self._load = BusLoad(self.bus)
        self._disturbances, self._services = Disturbances(self.bus), Services(self.bus)
        self._host, self._identifiers, self._batches = HostMarkers(self.bus), Identifiers(), StampBatches()
        self._others = (  # drives first: others ask whether a drive is enabled
            *(self._host, self._drives, Orders(self.bus), self._disturbances, self._services, self._load),
            *(self._sync, self._pdos, PdoTimers(self.bus), Lengths(self.bus), DriveValues(self.bus), self._identifiers),
            self._batches,
        )
        self._span = span
        self._axis = StraightTimes()
        self._epoch_ns = epoch_ns
        self._shown: dict[int, tuple[int, int, bytes]] = {}
        self._recent: list[Block] = []
        self._late: list[tuple[int, str]] = []

    def add_frames(
        self,
        frames: Records,
        comments: Iterable[tuple[int, str]] = (),
        inside: Records | None = None,
        late: Iterable[tuple[int, str]] = (),
    ) -> None:
        """Process frames; `comments`: (row of `frames`, text), `inside`: the host's telemetry of the same time, `late`:
        time [ns] and text of the markers that no frame follows.
        """
        self._late += late
        if inside is not None:
            self._host.take_inside(inside)
        remarks = list(comments)
        inner, remarks = self._inside(frames, remarks)
        inner = self._axis.straight(inner)
        whole = Block(inner, self.bus.frames, tuple(remarks))
        for start in range(0, max(len(inner), 1), BLOCK):
            self._block(whole.part(start, min(start + BLOCK, len(inner))))

    def note_overdue(self, now_ns: int = -1) -> None:
        """Note overdue events at the last frame, or at a later time [ns] up to which all frames were taken."""
        t_ns = max(self.bus.last_ns, now_ns)
        self._rare.note_overdue(None, t_ns)
        for observer in (self._disturbances, self._services, self._drives, self._sync, self._pdos):
            observer.note_overdue(t_ns)

    def end(self) -> None:
        """Process the remaining markers and error frames."""
        self._disturbances.end()
        for t_ns, text in self._late:
            if self._is_in_span(np.array([t_ns])).all():
                self._host.mark(t_ns, text, self.bus.frames - 1)
        self.note_overdue()

    def explanation(self, remarks: Sequence[str] = ()) -> Explanation:
        """Return the explanation so far; `remarks`: those of the log's reader."""
        clues = [*self.bus.clues.all, *self._rare.sdo.missing()]
        batch_ns = self._batches.period_ns
        if batch_ns:
            clues = [clue for clue in clues if clue.kind not in OF_TIMES]
        if not self._is_canopen:
            clues = [clue for clue in clues if KINDS[clue.kind].group == "bus"]
        incidents = tuple(join(clues))
        states = {incident.status for incident in incidents}
        verdict = next((word for word in VERDICTS if word in states), "ok")
        return Explanation(
            verdict="warnings" if verdict == "warning" else verdict,
            nodes=tuple(
                summary_of(self.bus, number, self._is_well(number, incidents))
                for number in sorted(self.bus.nodes)
                if self._is_canopen
            ),
            incidents=incidents,
            epoch_ns=self._epoch_ns or 0,
            end_ns=self.bus.last_ns,
            frames=self.bus.frames,
            remarks=(*remarks, *self._remarks(batch_ns), *_together(incidents)),
            whole=not any(OMITTED in remark for remark in remarks),
            shown=dict(self._shown),
            bus=self.bus,
            identifiers=() if self._is_canopen else self._identifiers.rows(),
        )

    @property
    def _is_canopen(self) -> bool:
        """Whether a frame exists that occurs only in CANopen, or SYNC."""
        return bool(self.bus.canopen or 0x080 in self.bus.counts)

    def _inside(self, frames: Records, comments: list[tuple[int, str]]) -> tuple[Records, list[tuple[int, str]]]:
        """Return the frames within the span; time 0 is that of the log."""
        if self._epoch_ns is None and len(frames):
            first = int(frames["t_ns"][0])
            self._epoch_ns = first if first >= 10**17 else 0
        begin, end = self._span
        if begin is None and end is None:
            return frames, comments
        keep = self._is_in_span(frames["t_ns"])
        behind = np.cumsum(keep)
        comments_inside = [(int(behind[row]) - 1, text) for row, text in comments if row < len(keep) and keep[row]]
        return frames[keep], comments_inside

    def _is_in_span(self, t_ns: Integers) -> npt.NDArray[np.bool_]:
        """Return whether each of these times is within the span."""
        begin, end = self._span
        t_s = (t_ns - (self._epoch_ns or 0)) / 1e9
        inside: npt.NDArray[np.bool_] = (t_s >= (-np.inf if begin is None else begin)) & (
            t_s < (np.inf if end is None else end)
        )
        return inside

    def _block(self, block: Block) -> None:
        self.bus.add_frames(block)
        for part in self._rare.parts(block):
            self.bus.doubt(part)
            for observer in self._others:
                observer.add_frames(part)
        self._keep(block)

    def _keep(self, block: Block) -> None:
        """Keep the frames referenced by clues; they may be of blocks before."""
        self._recent.append(block)
        while sum(len(recent.t_ns) for recent in self._recent[1:]) > BLOCK:
            del self._recent[0]
        rows = {row for clue in self.bus.clues.all[-200:] for row in clue.rows} - self._shown.keys()
        for recent in self._recent if rows else ():
            first = recent.first_row
            for row in [row for row in rows if first <= row < first + len(recent.t_ns)]:
                frame = recent.frames[row - first]
                data = data_bytes(int(frame["word"]), int(frame["length"]))
                self._shown[row] = (int(frame["t_ns"]), int(frame["can_id"]), data)

    def _is_well(self, number: int, incidents: tuple[Incident, ...]) -> bool:
        """Return whether no incident concerns a node."""
        well = not any(clue.node == number for incident in incidents for clue in incident.clues)
        return well and (number != self.bus.host or not (self.bus.tripped or self._is_cut))

    @property
    def _is_cut(self) -> bool:
        """Whether the recording has the beginning of the host's run and not its end, which is within the span."""
        return self.bus.host_runs and self._span[1] is None

    def _polls(self) -> list[str]:
        """Return a remark on SDO transfers that wait for one node after the other."""
        nodes = [node for node in self.bus.nodes.values() if node.sdo_response.count >= POLLED]
        duration_ns = self.bus.last_ns - self.bus.first_ns
        waiting = sum(node.sdo_response.total for node in nodes) / max(duration_ns, 1)
        if len(nodes) < 2 or waiting < 0.5:
            return []
        round_ms = sum(node.sdo_response.total / node.sdo_response.count for node in nodes) / 1e6
        load = self._load.share(duration_ns)
        idle = f", and the bus is {1 - load:.0%} idle" if load else ""
        return [
            f"SDO asks {len(nodes)} nodes in turn: a round waits {len(nodes)} x {round_ms / len(nodes):.2g} ms for answers, "
            f"{waiting:.0%} of the time{idle}; PDOs come without a request"
        ]

    def _remarks(self, batch_ns: int) -> list[str]:
        bus = self.bus
        remarks = []
        if self._is_cut:
            remarks.append("the end of the host's run is not recorded: its processes were killed, or the run goes on")
        extended = bus.counts.get(EXTENDED, 0)
        if bus.frames and not self._is_canopen:
            what = (
                "29-bit identifiers, as J1939 has them"
                if extended > bus.frames / 2
                else "no NMT, heartbeat, SDO or SYNC"
            )
            remarks.append(f"this does not look like CANopen: {what}; only the wire is looked at")
        elif extended:
            remarks.append(f"{extended} frames have 29-bit identifiers, which CANopen does not use: left out")
        errors = bus.counts.get(ERROR, 0)
        if errors:
            remarks.append(f"{errors} error frames")
        if bus.others:
            nodes = ", ".join(f"node {number}" for number in sorted(bus.others))
            remarks.append(f"{nodes}: another device than the rig's (1018h), so the rig says nothing of it")
        if batch_ns:
            remarks.append(
                f"frames come in batches, {batch_ns / 1e6:.3g} ms apart, as adapters hand them over: "
                "times between frames are unknown, and nothing is said of them"
            )
        remarks += self._polls()
        assumed = sorted(
            {
                pdo_map.node
                for pdo_map in bus.maps.values()
                if pdo_map.source == "assumed" and pdo_map.can_id in bus.counts
            }
        )
        if assumed:
            nodes = ", ".join(map(str, assumed))
            remarks.append(
                f"PDO maps of node {nodes} are assumed (the defaults of CiA 402 and 404): give --eds NODE=FILE to be sure"
            )
        return remarks


def _together(incidents: tuple[Incident, ...]) -> Iterator[str]:
    """Yield a remark for nodes that were lost or restarted at once: they share something."""
    for kind, what in (("restarted", "restarted"), ("node_lost", "fell silent")):
        roots = sorted((i.root for i in incidents if i.root.kind == kind), key=lambda clue: clue.begin_ns)
        for first in range(len(roots)):
            some = [clue for clue in roots if 0 <= clue.begin_ns - roots[first].begin_ns <= AT_ONCE_NS]
            if len(some) > 1 and (first == 0 or roots[first].begin_ns - roots[first - 1].begin_ns > AT_ONCE_NS):
                nodes = ", ".join(str(clue.node) for clue in some)
                yield f"nodes {nodes} {what} within {AT_ONCE_NS // 1_000_000} ms: look at the supply and cable that they share"


def explain(
    path: str | os.PathLike[str],
    *,
    rig: Rig | None = None,
    eds: EdsFiles | None = None,
    span: tuple[float | None, float | None] = (None, None),
    channel: Channel = None,
) -> Explanation:
    """Explain a recording or another tool's log.

    Parameters
    ----------
    path
        A file that `coulombus.recording.reading.captures` reads.
    rig
        Rig with names and PDO maps; None: from the log and EDS files.
    eds
        EDS files of nodes, or files to be matched by identity.
    span
        Begin and end [s], None: open.
    channel
        Bus of a file with several, as ``"can0"``.

    Raises
    ------
    coulombus.recording.pcapng_blocks.PcapngError, coulombus.recording.log_files.LogError
        The file is damaged, is of another kind, or has no frame.
    coulombus.recording.bus_match.ChannelError
        The file has several buses, and `channel` names none of them.
    coulombus.recording.time_search.SpanError
        There is no frame in the span.
    """
    remarks: list[str] = []
    explainer: Explainer | None = None
    first_ns = last_ns = -1
    for capture in captures_of_bus(Path(path), channel, remarks):
        if explainer is None:
            known_bus = KnownBus(rig or attached_rig(capture, remarks), eds or EdsFiles())
            explainer = Explainer(known_bus, span, capture.origin_ns)
        explainer.add_frames(capture.frames, capture.comments, capture.inside, capture.late)
        first_ns = int(capture.frames["t_ns"][0]) if first_ns < 0 and len(capture.frames) else first_ns
        last_ns = int(capture.frames["t_ns"][-1]) if len(capture.frames) else last_ns
    assert explainer is not None  # a log without a frame is refused
    if not explainer.bus.frames:
        first_s, last_s = map(explainer.explanation().at_s, (first_ns, last_ns))
        raise SpanError(f"{path}: there is no frame in the span: it goes from {first_s:.3f} s to {last_s:.3f} s")
    explainer.end()
    return explainer.explanation(remarks)


def attached_rig(capture: Capture, remarks: list[str]) -> Rig | None:
    """Return the rig attached to a coulombus recording; None if absent or unreadable."""
    texts = {
        name: raw.decode(errors="replace") for name, raw in capture.attachments.items() if not name.startswith(HOST)
    }
    if RIG not in texts:
        return None
    try:
        return load_rig_text(texts.pop(RIG), f"{capture.path}[{RIG}]", texts, attached=True)
    except RigError:
        remarks.append("the attached rig cannot be read by this version: nodes have numbers for names")
        return None
