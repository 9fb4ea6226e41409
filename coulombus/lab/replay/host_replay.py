"""``coulombus replay FILE --host``: run the controller on a recording's inputs and compare the outputs.

Without overrides every SYNC, heartbeat and RPDO must match bit for bit; the first mismatch is shown
signal by signal. The same holds for a newly named law whose source is the recorded one. A
user-defined law runs only if it is named: a recording may be untrusted, and its law is a program.
With another law, or other values of the rig file, differences are expected; then the RMS difference
of each commanded signal is given. The rig does not react to these commands, so the result shows
what another law would have commanded, not its effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coulombus.eds.cia301 import CobId
from coulombus.host.cycle.controllers import EVERY_BUS, Controllers
from coulombus.host.cycle.parameter_changes import ParameterOrder, orders_of
from coulombus.host.cycle.replay import HostFrame, Inputs, replay
from coulombus.host.laws.law_source import law_source, recorded_sha256
from coulombus.host.laws.plane.plane_laws import builtin_laws
from coulombus.host.world.recorded import models_of
from coulombus.kernels.records import Records
from coulombus.recording.pdo_columns import decode_field
from coulombus.recording.reading import read
from coulombus.recording.signals import Recording
from coulombus.recording.trace import EVENT, TRACE, Event, Moment, unpack, unpack_models, unpack_sent
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo
from coulombus.system.errors import CoulombusError

__all__ = ["HostReplay", "ReplayDifference", "ReplayError", "host_replay"]


class ReplayError(CoulombusError):
    """The recording lacks data for a replay; the text names them."""

    exit_status = 2


@dataclass(frozen=True)
class ReplayDifference:
    """The first frame that differs; `recorded` or `computed` is None if missing."""

    t_s: float
    cycle: int
    name: str
    recorded: str | None
    computed: str | None
    signals: dict[str, tuple[float | None, float | None]]
    """Name -> recorded, computed [SI]."""


@dataclass
class HostReplay:
    """The result of a replay."""

    file: str
    mode: str
    inputs: int = 0
    """Number of input frames."""
    cycles: int = 0
    frames: dict[str, int] = field(default_factory=dict)
    """Number of matching frames by name."""
    refused: int = 0
    """Frames that the step sent and the bus refused: they are not in the recording."""
    unchecked: int = 0
    """Recorded frames after the trace's end: the recording process was killed, or the file is torn."""
    difference: ReplayDifference | None = None
    rms: dict[str, float] | None = None
    """With overrides: RMS difference of each commanded signal [its unit]."""
    judged: bool = True
    """Whether all frames must match: without overrides, and with the recorded law."""
    recorded_trip: str | None = None
    computed_trip: str | None = None
    remarks: tuple[str, ...] = ()

    @property
    def exit_status(self) -> int:
        """Exit status of the command: 1 if frames that must match differ."""
        return 1 if self.judged and self.difference is not None else 0

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"identical": self.difference is None, **asdict(self)}


def host_replay(path: str | Path, overrides: Sequence[str] = (), rig: Rig | None = None) -> HostReplay:
    """Run the host on a recording's inputs.

    Parameters
    ----------
    overrides : ``SECTION.KEY=VALUE`` of the rig file; differences are then measured, not judged;
        `law.function` with the attached source does not count as an override
    rig : used instead of the attached one

    Raises
    ------
    ReplayError
        The recording lacks data; nothing was computed.
    coulombus.rigs.rig.RigError, coulombus.host.laws.laws.LawError,
    coulombus.recording.pcapng_blocks.PcapngError
    """
    recording = read(path, rig=rig)
    attachments = recording.capture.attachments
    mode = attachments.get("mode", b"").decode(errors="replace")
    if mode not in recording.rig.modes:
        raise ReplayError(
            f"{path}: it does not tell the host's mode (attachment 'mode'): --host replays what "
            "`coulombus run --record` or `coulombus simulate --record` wrote"
        )
    variant = recording.rig.variant(*overrides) if overrides else recording.rig
    if [pdo.layout for pdo in variant.pdos()] != [pdo.layout for pdo in recording.rig.pdos()]:
        raise ReplayError(f"{path}: the overrides change the PDOs, whose recorded words would mean something else")
    controllers = Controllers(variant, mode)
    host_data = _host_data(recording, controllers)
    models = _models(recording, controllers, host_data.inputs)
    host_data = host_data._replace(
        inputs=replace(host_data.inputs, orders=_orders(recording, controllers, host_data.inputs), models=models)
    )
    law_remarks, same_law = _compare_laws(recording, variant)
    others = [text for text in overrides if text.partition("=")[0].strip() != "law.function"]
    check = _Check(recording, controllers, host_data, keep=bool(overrides))
    result = check.result
    result.judged = not others and (same_law or not overrides)
    result.mode, result.inputs, result.remarks = mode, len(host_data.inputs.frames), (*recording.remarks, *law_remarks)
    check.run(host_data.inputs)
    trips = [text[len("trip ") :] for _, text in recording.markers if text.startswith("trip ")]
    result.recorded_trip = trips[0] if trips else None
    result.computed_trip = controllers.trip
    return result


def _compare_laws(recording: Recording, rig: Rig) -> tuple[tuple[str, ...], bool]:
    """Return a remark on the law, and whether its source is the recorded one."""
    now, recorded = law_source(rig), recorded_sha256(recording.capture.attachments)
    name = recording.rig.law_function
    if now is None or recorded is None:
        text = f"{recording.path}: whether {rig.law_function} is the recorded law {name} is not known: no SHA-256 of its source is attached"
        builtin = rig.law_function == name and name in builtin_laws(rig)  # a built-in law needs no attachment
        return () if builtin else (text,), builtin
    if now.sha256 == recorded:
        return (), True
    text = f"{recording.path}: the law is {rig.law_function} with the SHA-256 {now.sha256}, recorded was {name} with {recorded}"
    return (text,), False


def _traced(inputs: Inputs, event: Event, moment: Moment) -> set[int]:
    """Return the values of a kind in the trace: an `event` in virtual time, else a `moment`."""
    kind = event if inputs.virtual else moment
    return set(inputs.trace["value"][inputs.trace["kind"] == kind].tolist())


def _orders(recording: Recording, controllers: Controllers, inputs: Inputs) -> dict[int, ParameterOrder]:
    """Return the changed parameters from the markers; every change in the trace must have a marker."""
    orders = orders_of((text for _, text in recording.markers), controllers)
    missing = _traced(inputs, Event.SET, Moment.SET) - set(orders)
    if missing:
        raise ReplayError(
            f"{recording.path}: parameters were changed (order {min(missing)}), and the marker 'set' that tells which is not in it"
        )
    return orders


def _models(recording: Recording, controllers: Controllers, inputs: Inputs) -> dict[int, Any]:
    """Return the models of a world outside from the attachments; every model in the trace must be there."""
    arm = controllers.rig.in_plane is not None
    models = models_of(unpack_models(recording.capture.attachments), len(controllers.each), arm=arm)
    missing = _traced(inputs, Event.MODEL, Moment.MODEL) - set(models)
    if missing:
        raise ReplayError(
            f"{recording.path}: a world said what the handle met (model {min(missing)}), and the attachment 'host.models' that tells it is not in it"
        )
    return models


class _HostData(NamedTuple):
    """Data of the host in a recording."""

    inputs: Inputs
    sent: Records
    """Its send requests if recorded, else its frames on the bus."""
    last_ns: int
    """End of these data."""
    behind: int = 0
    """Frames of the host after that."""


def _host_data(recording: Recording, controllers: Controllers) -> _HostData:
    attachments = recording.capture.attachments
    in_virtual_time = "seed" in attachments and "bus" not in attachments
    content = unpack(attachments, EVENT if in_virtual_time else TRACE)
    if content is None:
        raise ReplayError(
            f"{recording.path}: it has no trace of the host (attachments 'host.trace.N'): what the host received, and in which cycle it did, is not "
            "known. Record with `coulombus run --record` or `coulombus simulate --record` of this version"
        )
    sent_flags, trace = content
    if in_virtual_time and not np.any(trace["kind"] == Event.START):
        raise ReplayError(f"{recording.path}: the host's cycle does not begin in it")
    of_the_host = np.isin(recording.frames["can_id"], controllers.own_identifiers)
    once = ~_copies(recording, controllers)
    frames = recording.frames[: len(sent_flags)] if in_virtual_time else recording.frames
    if not len(frames):
        raise ReplayError(
            f"{recording.path}: its trace has no frame of this recording: the recording was ended too soon"
        )
    last_ns = int(frames["t_ns"][-1])
    if in_virtual_time:
        sent = unpack_sent(attachments)
        from_host = (of_the_host & once)[: len(frames)]
        inputs = Inputs(frames[~sent_flags[: len(frames)]], trace)
        behind = int(np.sum((of_the_host & once)[len(sent_flags) :]))
        return _HostData(inputs, frames[from_host] if sent is None else sent, last_ns, behind)
    from_host = of_the_host.copy()
    from_host[: len(sent_flags)] = sent_flags[: len(from_host)]
    if len(trace) and trace["dropped"].any():
        trace = trace[: int(np.argmax(trace["dropped"] > 0))]  # the log was full: later frames are missing
    return _HostData(Inputs(recording.frames[~from_host], trace), recording.frames[from_host & once], last_ns)


def _copies(recording: Recording, controllers: Controllers) -> npt.NDArray[np.bool_]:
    """Return which frames are copies on a further bus: the host sends SYNC and its heartbeat once for all buses."""
    frames, channels = recording.frames, recording.capture.channels
    if not channels:
        return np.zeros(len(frames), np.bool_)
    further = np.array([channel != recording.rig.channels[0] for channel in channels])
    copies: npt.NDArray[np.bool_] = further[frames["source"]]
    copies &= controllers.bus_of[frames["can_id"] & 0x7FF] == EVERY_BUS
    return copies


class _Check:
    """Compares computed frames with the recording, per identifier in order."""

    def __init__(self, recording: Recording, controllers: Controllers, host_data: _HostData, *, keep: bool) -> None:
        self.recording, self.controllers, self.keep = recording, controllers, keep
        self.result = HostReplay(recording.path, controllers.mode)
        self.pdos = {pdo.layout.cob_id: pdo for pdo in recording.rig.pdos() if pdo.layout.direction == "rpdo"}
        can_ids, columns = (
            host_data.sent["can_id"],
            np.stack([host_data.sent[name] for name in ("t_ns", "length", "word")], 1),
        )
        identifiers = {*controllers.own_identifiers, *np.unique(can_ids).tolist()}
        self.streams = {can_id: columns[can_ids == can_id] for can_id in sorted(identifiers)}
        self.at = dict.fromkeys(self.streams, 0)
        self.last_ns = host_data.last_ns
        self.result.unchecked = host_data.behind
        self.period_ns = int(controllers.control["period_ns"][0])
        self.refused: dict[int, int] = {}
        self.words: dict[int, list[tuple[int, int]]] = {can_id: [] for can_id in self.pdos}

    def name(self, can_id: int) -> str:
        if can_id in self.pdos:
            return f"{self.pdos[can_id].node}.{self.pdos[can_id].name}"
        return "SYNC" if can_id == CobId.SYNC else "heartbeat"

    def run(self, inputs: Inputs) -> None:
        result = self.result
        for sent in replay(self.controllers, inputs):
            if inputs.virtual and self._ended(sent):
                break
            result.cycles = sent.cycle
            self._compare(sent)
            if result.difference is not None and not self.keep:
                return
        left = [
            (stream[self.at[identifier]].tolist(), identifier)
            for identifier, stream in self.streams.items()
            if self.at[identifier] < len(stream)
        ]
        killed = not inputs.virtual and not (len(inputs.trace) and inputs.trace["kind"][-1] == Moment.END)
        if left and killed:
            result.unchecked = sum(len(stream) - self.at[identifier] for identifier, stream in self.streams.items())
        elif left and result.difference is None:
            (t_ns, length, word), can_id = min(left)
            self._differ(t_ns, result.cycles, can_id, (length, word), None)
        if self.keep:
            result.rms = self._rms()

    def _ended(self, sent: HostFrame) -> bool:
        """Return whether this cycle is after the recording's end: in virtual time the host never ends."""
        if sent.can_id != CobId.SYNC or self.at[sent.can_id] < len(self.streams[sent.can_id]):
            return False
        if not self.controllers.done:
            where = "the recording ends" if sent.t_ns >= self.last_ns - self.period_ns else "the host's cycle ends"
            phases = ", ".join(controller.phase.name for controller in self.controllers)
            self.result.remarks += (f"{where} in phase {phases}",)
        return True

    def _compare(self, sent: HostFrame) -> None:
        can_id = sent.can_id
        stream, at = self.streams[can_id], self.at[can_id]
        if at == len(stream) or stream[at][0] > sent.until_ns:  # not in the recording
            if self.refused.get(sent.cycle, 0) < sent.refusable:
                self.refused[sent.cycle] = self.refused.get(sent.cycle, 0) + 1
                self.result.refused += 1
            elif sent.t_ns < self.last_ns - self.period_ns:  # else: the recording ends within the cycle
                self._differ(sent.t_ns, sent.cycle, can_id, None, (sent.length, sent.word))
            return
        self.at[can_id] += 1
        t_ns, length, word = stream[at].tolist()
        if self.keep and can_id in self.words:
            self.words[can_id].append((word, sent.word))
        if (length, word) == (sent.length, sent.word):
            name = self.name(can_id)
            self.result.frames[name] = self.result.frames.get(name, 0) + 1
        else:
            self._differ(t_ns, sent.cycle, can_id, (length, word), (sent.length, sent.word))

    def _differ(
        self, t_ns: int, cycle: int, can_id: int, recorded: tuple[int, int] | None, computed: tuple[int, int] | None
    ) -> None:
        if self.result.difference is not None:
            return
        texts = [_text(payload) for payload in (recorded, computed)]
        pdo = self.pdos.get(can_id)
        values = [_values(pdo, payload) for payload in (recorded, computed)]
        signals = {name: (values[0].get(name), values[1].get(name)) for name in values[0] | values[1]}
        t_s = (t_ns - self.recording.epoch_ns) / 1e9
        self.result.difference = ReplayDifference(t_s, cycle, self.name(can_id), texts[0], texts[1], signals)

    def _rms(self) -> dict[str, float]:
        rms = {}
        for can_id, pdo in self.pdos.items():
            table = np.array(self.words[can_id], np.int64).reshape(-1, 2)
            for signal, entry, start in zip(pdo.signals, pdo.layout.entries, pdo.layout.starts, strict=True):
                if not signal.unit:
                    continue
                columns = (np.ascontiguousarray(table[:, i]) for i in range(2))
                recorded, computed = (decode_field(column, start, entry) * signal.scale for column in columns)
                error = computed - recorded
                rms[signal.name] = float(np.sqrt(np.mean(error**2))) if len(error) else 0.0
        return rms


def _text(frame: tuple[int, int] | None) -> str | None:
    if frame is None:
        return None
    return int(frame[1]).to_bytes(8, "little", signed=True)[: frame[0]].hex(" ")


def _values(pdo: RigPdo | None, frame: tuple[int, int] | None) -> dict[str, float]:
    if pdo is None or frame is None or frame[0] != pdo.layout.length:
        return {}
    return {signal.name: float(pdo.value(place, frame[1])) for place, signal in enumerate(pdo.signals)}
