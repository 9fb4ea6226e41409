"""A real-time run of the rig on a bus."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from coulombus.host.run.client_requests import Progress
from coulombus.host.run.preflight import check_no_delay, check_no_guess, check_no_rehearsal, refusing
from coulombus.host.run.realtime_sequence import RealCourse
from coulombus.host.run.result import RunResult
from coulombus.host.run.run import Run
from coulombus.host.setup.bringup import check_plan
from coulombus.host.setup.law_demand import check_demand
from coulombus.recording.output_file import new_file
from coulombus.rigs.buses import bus_addresses
from coulombus.system.exit import say
from coulombus.system.realtime import default_cpu
from coulombus.system.stop_signals import Signals
from coulombus.wire.address import BusAddress

__all__ = ["real_run"]


def real_run(
    run: Run,
    *,
    bus: BusAddress | Sequence[BusAddress] | None = None,
    signals: Signals | None = None,
    progress: Progress | None = None,
    cpu: int | None = None,
) -> RunResult:
    """Run the host on a bus and return the result.

    Parameters
    ----------
    run : the display's figures are computed from its recording; with a `world` a program outside is let in
        (docs/worlds.md), and a rig without [world] gets the section
    bus : the bus, or a bus for each of `Rig.channels`; default is the virtual bus with the rig's name, or
        those of its buses (`rigs.buses`)
    signals : entered by the caller; a signal then ends the run safely
    progress : called with the display's time in s and each axis' state (`client_requests.axis_state`)
    cpu : CPU of the data plane; default is the last CPU that this process may use

    Raises
    ------
    coulombus.wire.address.BusUnavailable, coulombus.host.errors.HostError
        nothing was armed
    coulombus.rigs.rig.RigError
        the law cannot be loaded, or a limit would clip it; a rehearsal's file or a marked guess on a real
        bus; an artificial delay; a limit that the drive cannot take
    coulombus.recording.pcapng_blocks.RecordingError
        the recording cannot be created, or exists
    """
    rig = run.rig.with_world() if run.world else run.rig
    run = replace(run, rig=rig, virtual=False)
    if bus is None:
        bus = tuple(bus_addresses(rig).values())
    addresses = (bus,) if isinstance(bus, BusAddress) else tuple(bus)
    with refusing():
        for address in addresses:
            check_no_rehearsal(rig, address)
            check_no_guess(rig, address)
            check_no_delay(rig, address)
        check_plan(rig)
        check_demand(rig, run.mode)
        course = RealCourse(
            run,
            addresses,
            signals=signals or Signals(),
            progress=progress,
            cpu=default_cpu() if cpu is None else cpu,
        )
    try:
        result = course.run(run.seconds)
        picture = run.outputs.histogram
        if picture is not None:
            from coulombus.host.run.histogram import draw_histograms

            try:
                with new_file(picture, force=run.outputs.force) as path:
                    bins = course.plane.shared
                    draw_histograms(bins.wakeup_bins, bins.latency_bins, rig.bus.period_s * 1e6, path)
            except OSError as error:
                if result.exit_status == 0:
                    raise
                say(
                    f"coulombus: {picture}: cannot be written ({error.strerror})"
                )  # a missing figure must not hide a trip
        return result
    finally:
        course.close()
