"""The data plane's process: ``python -m coulombus.host.realtime.process SETTINGS``.

`coulombus.host.realtime.data_plane` starts it with two open descriptors. The process is separate from the
parent's interpreter, so no lock, garbage collection or thread of the parent can delay a cycle. Until it
is ready, it dies with its parent (PR_SET_PDEATHSIG). From then on the loop monitors the parent: when the
parent has ended, the loop makes the rig safe as after a trip, and the process ends
(`host.realtime.loop`). Only the parent handles the signals that end a verb: this process blocks them, and
has its own session, which the terminal does not signal. It appends the marker of the trip to the recording
of a parent that has ended (`mark_trip`).

One line of JSON on the standard output reports that it is ready, with the granted and refused real-time
rights.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.host.cycle.records import Trip
from coulombus.host.cycle.trip_text import TRIP_TEXT
from coulombus.host.laws.law import LawFunction
from coulombus.host.laws.laws import load_law
from coulombus.host.laws.plane.plane_laws import load_plane_law
from coulombus.host.plane.plane_step import PlaneFunctions
from coulombus.host.realtime.bus_sockets import MESSAGE_FRAMES, Buffers
from coulombus.host.realtime.loop import run_plane
from coulombus.host.realtime.shared_memory import PlaneCommand, SharedPlane
from coulombus.host.world.records import StateRecord
from coulombus.kernels.decorator import Entry
from coulombus.kernels.records import new_records
from coulombus.recording.file_content import append_late
from coulombus.recording.host_telemetry import MOST_FRAMES
from coulombus.rigs.kinematics.kinematics_section import Kinematics
from coulombus.rigs.kinematics.load_mechanism import load_mechanism
from coulombus.system.realtime import ask_for_real_time, die_with_parent, outlive_parent
from coulombus.system.stop_signals import SIGNALS
from coulombus.wire.frame import QUEUE_CAPACITY, Frame, new_queue
from coulombus.wire.recvmsg import new_mailbox

__all__ = ["main", "mark_trip", "new_buffers", "warm_up"]


def new_buffers(fds: Sequence[int], shared: SharedPlane, world_fd: int = -1) -> Buffers:
    """Return the loop's buffers for the sockets of its buses, a shared memory, and a socket for the states."""
    box, words = new_mailbox(MESSAGE_FRAMES)
    return Buffers(
        fds=np.array(fds, np.int64),
        bus_of=shared.bus_of,
        plane=shared.plane,
        ring=shared.ring,
        trace=shared.trace,
        wakeup_bins=shared.wakeup_bins,
        latency_bins=shared.latency_bins,
        skew_bins=shared.skew_bins,
        axes=shared.axes,
        owner=shared.owner,
        box=box,
        words=words,
        tx=np.zeros(2 * QUEUE_CAPACITY, np.int64),
        sent_ns=np.zeros(len(fds), np.int64),
        overflows=np.zeros(len(fds), np.int64),
        poll=np.zeros(len(fds), np.int64),
        out=new_queue(),
        telemetry=new_records(Frame, MOST_FRAMES),
        world_fd=world_fd,
        world_state=new_records(StateRecord),
    )


def load_functions(settings: dict[str, Any]) -> tuple[LawFunction, PlaneFunctions | None]:
    """Return the compiled law of the axes, and law and mechanism of an arm whose joints they are."""
    directory = Path(settings["law_directory"])
    if settings["kinematics"] is None:
        return load_law(settings["law"], directory), None
    law = load_plane_law(settings["law"].strip(), directory=directory)
    mechanism = load_mechanism(Kinematics.model_validate(settings["kinematics"]), directory)
    return load_law("coulomb"), PlaneFunctions(law.function, mechanism.function)


def warm_up(
    shared: SharedPlane, buffers: Buffers, law_function: LawFunction, arm: PlaneFunctions | None = None
) -> None:
    """Load (or compile) the loop by a call that returns at once, and touch every page of the rings and the
    histograms.
    """
    command = int(shared.plane["command"][0])
    shared.plane["command"] = PlaneCommand.QUIT
    Entry(run_plane).load(buffers, law_function, arm)  # one process compiles it, and the others wait
    run_plane(buffers, law_function, arm)
    shared.plane["command"] = command
    shared.ring["source"] = 0
    shared.trace["kind"] = 0
    shared.wakeup_bins[:] = 0
    shared.latency_bins[:] = 0
    shared.skew_bins[:] = 0


def main(settings: dict[str, Any]) -> int:
    """Run the data plane to its end; return the exit status of the process."""
    die_with_parent(settings["parent"])
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    shared = SharedPlane(settings["memory_fd"], settings["axes"])
    law_function, arm = load_functions(settings)
    buffers = new_buffers(settings["bus_fds"], shared, settings["world_fd"])
    warm_up(shared, buffers, law_function, arm)
    report = ask_for_real_time(settings["priority"], settings["cpu"])
    shared.plane["parent"] = settings["parent"]
    outlive_parent()
    print(json.dumps({"ready": True, "real_time": report.as_dict()}), flush=True)
    run_plane(buffers, law_function, arm)
    if os.getppid() != settings["parent"]:
        mark_trip(shared)
    return 0


def mark_trip(shared: SharedPlane) -> None:
    """Append the marker of the first trip to the recording that the ended parent has left (`DataPlane.tell_recording`)."""
    name = bytes(shared.recording).rstrip(b"\0")
    trips = [(int(k.host.trip_ns), Trip(int(k.host.trip))) for k in shared.axes if k.host.trip]
    if name and trips:
        t_ns, trip = min(trips)
        text = TRIP_TEXT[trip].partition("{")[0]  # the values belong to the rig, which is not known here
        with suppress(OSError):  # the recording is gone, and there is nobody to tell
            append_late(
                Path(os.fsdecode(name)), [(t_ns - int(shared.zero_ns[0]), f"trip {trip.name}: {text}".rstrip())]
            )


if __name__ == "__main__":
    sys.exit(main(json.loads(sys.argv[1])))
