"""``coulombus replay FILE --virtual``: recompute nodes and bus in virtual time and compare the frames.

The host's frames are requested again at the instants at which they started on the wire; the
simulated nodes, the rig and the hand are recomputed from the attached rig, mode and seed. Every
frame must match: the same order, the same bytes, and the same end of frame to the nanosecond.

This requires stamps of the bus's own time, as recorded by `coulombus simulate --record` and, in
real time, by `coulombus emulate --record`. A recording of `coulombus run` has the host's reception
times instead, so it is refused here; `--host` checks it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from coulombus.eds.cia301 import CobId
from coulombus.host.cycle.step import SOURCE_HOST
from coulombus.host.laws.plane.plane_laws import builtin_laws
from coulombus.kernels.records import Records
from coulombus.lab.replay.host_replay import ReplayError
from coulombus.recording.frame_sender import senders
from coulombus.recording.reading import read
from coulombus.recording.signals import Recording
from coulombus.rigs.rig import Rig
from coulombus.sim_bus.can_bus.arbiter import INTER_FRAME_BITS
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.sim_bus.server.rig_server import PacedRig
from coulombus.wire.bits import data_frame_bits
from coulombus.wire.frame import data_bytes, push

__all__ = ["VirtualReplay", "virtual_replay"]

BATCH = 32
"""Frames of the host that are requested ahead."""
FIELDS = ("t_ns", "can_id", "length", "word")


@dataclass
class VirtualReplay:
    """The result; `recorded` and `computed` are the first difference."""

    file: str
    frames: int
    """Frames of the recording."""
    asked: int
    """Frames that the host sent."""
    same: int
    """Matching frames from the beginning."""
    t_s: float | None = None
    recorded: str | None = None
    computed: str | None = None
    remarks: tuple[str, ...] = ()

    @property
    def identical(self) -> bool:
        """Whether all frames match."""
        return self.t_s is None

    @property
    def exit_status(self) -> int:
        """Exit status: 1 if a frame differs."""
        return 0 if self.identical else 1

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"identical": self.identical, **asdict(self)}

    def lines(self) -> list[str]:
        """Return the result as text."""
        origin = f"{self.asked} of them from the host, the others computed"
        if self.identical:
            return [f"identical: {self.frames} frames ({origin}), order, data and end of frame"]
        return [
            f"FAIL at {self.t_s:.9f} s, after {self.same} of {self.frames} frames ({origin})",
            f"  recorded  {self.recorded or 'no more frames'}",
            f"  computed  {self.computed or 'no frame'}",
        ]


def virtual_replay(path: str | Path, rig: Rig | None = None) -> VirtualReplay:
    """Recompute a recording's frames from its host's frames.

    Raises
    ------
    coulombus.lab.replay.host_replay.ReplayError
        The recording's stamps are not the bus's time, it lacks mode and seed, or there were faults.
    coulombus.rigs.rig.RigError, coulombus.recording.pcapng_blocks.PcapngError
    """
    recording = read(path, rig=rig)
    attachments = recording.capture.attachments
    if "seed" not in attachments or "mode" not in attachments:
        raise ReplayError(
            f"{path}: its stamps are not the bus's own time (no attachment 'seed'): --virtual checks recordings of `coulombus simulate "
            "--record` and `coulombus emulate --record`; --host checks those of `coulombus run --record` too"
        )
    struck = next((text for _, text in recording.markers if text.startswith("fault ")), None)
    if struck is not None:
        raise ReplayError(
            f"{path}: faults of a fault file struck in it ({struck}), and what they did to the bits is not in a recording: --virtual checks "
            "recordings without faults; --host checks this one"
        )
    if recording.rig.law_of_recording and recording.rig.law_function not in builtin_laws(recording.rig):
        recording = replace(
            recording, known_rig=recording.rig.with_law(next(iter(builtin_laws(recording.rig))))
        )  # unused: the host's frames are the recorded ones
    seed, mode = (attachments[name].decode(errors="replace") for name in ("seed", "mode"))
    if not seed.isdecimal() or mode not in recording.rig.modes:
        raise ReplayError(
            f"{path}: its attachments 'seed' and 'mode' are {seed!r} and {mode!r}, expected a number and a mode of its rig"
        )
    frames = recording.frames
    if not len(frames) or recording.epoch_ns:
        why = "its stamps are a clock's, and not the bus's own time" if len(frames) else "it has no frame"
        raise ReplayError(
            f"{path}: {why}: take a recording of `coulombus simulate --record` or `coulombus emulate --record`"
        )
    sent = senders(frames["can_id"], recording.rig) <= 0
    compared = _Comparison(frames)
    with suppress(_DifferentError):
        _compute(recording, mode, int(seed), sent & ~_copies(recording), compared.go_on)
    result = VirtualReplay(recording.path, len(frames), int(sent.sum()), compared.same, remarks=recording.remarks)
    if compared.same < len(frames) or len(compared.other):
        rows = frames[compared.same : compared.same + 1], compared.other
        result.t_s = min(int(row["t_ns"][0]) for row in rows if len(row)) / 1e9
        result.recorded, result.computed = (_text(row) for row in rows)
    return result


def _copies(recording: Recording) -> npt.NDArray[np.bool_]:
    """Return which frames the host had sent on another bus before: it requests SYNC, NMT commands and its heartbeat
    once for all its buses, and a bus that was busy then has them later.
    """
    frames, copies = recording.frames, np.zeros(len(recording.frames), np.bool_)
    if not recording.capture.channels or "bus" in recording.capture.attachments:
        return copies
    once_for_all = np.isin(frames["can_id"], [CobId.NMT, CobId.SYNC, CobId.HEARTBEAT + recording.rig.host.node_id])
    sent: Counter[int] = Counter()  # by identifier: requests so far
    on_bus: Counter[tuple[int, int]] = Counter()  # of them, those that the bus has had
    for row in np.flatnonzero(once_for_all).tolist():
        can_id, bus = int(frames["can_id"][row]), int(frames["source"][row])
        on_bus[can_id, bus] += 1
        copies[row] = on_bus[can_id, bus] <= sent[can_id]
        sent[can_id] = max(sent[can_id], on_bus[can_id, bus])
    return copies


class _DifferentError(Exception):
    """A frame differs: ends the computation."""


class _Comparison:
    """Compares computed frames with the recorded ones as they arrive, up to the first difference (`other`)."""

    def __init__(self, frames: Records) -> None:
        self.frames, self.same, self.other = frames, 0, frames[:0]

    def go_on(self, computed: Records) -> None:
        """Compare a batch."""
        recorded = self.frames[self.same : self.same + len(computed)]
        both = len(recorded)
        equal = np.logical_and.reduce([recorded[name] == computed[name][:both] for name in FIELDS])
        same = both if equal.all() else int(np.argmin(equal))
        self.same += same
        if same < len(computed):
            self.other = computed[same : same + 1].copy()
            raise _DifferentError


class _NodesOfRig(VirtualRig):
    """The rig with its nodes, and a host that only listens: receiving a frame makes the devices
    sample, and sampling consumes random noise.
    """

    def ask(self, frames: Records) -> None:
        """Enter frames of the host into arbitration from their start times."""
        requests = [(_start_ns(frame, self.rig.bus.bitrate_bit_s), *frame[1:4]) for frame in frames.tolist()]
        requests.sort(key=itemgetter(0))  # on several buses a frame that ends later may have begun earlier
        for begin in range(0, len(requests), BATCH):
            self.run_until(max(self.t_ns, requests[begin][0] - 1))
            for request in requests[begin : begin + BATCH]:
                push(self._out, SOURCE_HOST, *request)


def _compute(
    recording: Recording, mode: str, seed: int, sent: npt.NDArray[np.bool_], on_frames: Callable[[Records], None]
) -> None:
    if "bus" in recording.capture.attachments:
        _compute_paced(recording, mode, seed, sent, on_frames)
        return
    world = _NodesOfRig(recording.rig, mode, seed=seed, on_frames=on_frames)
    frames = recording.frames
    marked = [row for row, text in recording.capture.comments if text.startswith("run ")]
    begin = marked[0] if marked else len(frames)
    world.power_on()
    world.ask(frames[:begin][sent[:begin]])
    if marked:
        world.run_until(_start_ns(frames[begin].tolist(), recording.rig.bus.bitrate_bit_s) - 1)
        world.controllers.start(world.t_ns)  # from here it knows the nodes' NMT states
    world.ask(frames[begin:][sent[begin:]])
    world.run_until(int(frames["t_ns"][-1]))
    world.flush()


def _compute_paced(
    recording: Recording, mode: str, seed: int, sent: npt.NDArray[np.bool_], on_frames: Callable[[Records], None]
) -> None:
    """As `_compute`, for a recording of a bus in real time: its clients are external, and the hand
    rests when the drive does.
    """
    rate = recording.rig.bus.bitrate_bit_s
    world = PacedRig(recording.rig, mode, seed, rate, on_frames)
    world.power_on()
    for frame, of_a_client in zip(recording.frames.tolist(), sent.tolist(), strict=True):
        if of_a_client:
            world.ask(frame[4], _start_ns(frame, rate), *frame[1:4])
        world.run_until(frame[0])
        world.rest()
    world.flush()


def _start_ns(frame: tuple[int, ...], bitrate_bit_s: int) -> int:
    end_ns, can_id, length, word = frame[:4]
    return end_ns - (data_frame_bits(can_id, length, word) - INTER_FRAME_BITS) * 1_000_000_000 // bitrate_bit_s


def _text(row: Records) -> str | None:
    if not len(row):
        return None
    t_ns, can_id, length, word = (int(row[name][0]) for name in FIELDS)
    return f"{t_ns / 1e9:.9f} s  {can_id:03X}h  [{length}]  {data_bytes(word, length).hex(' ')}"
