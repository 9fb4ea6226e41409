"""A real-time run of the rig on a bus."""

from __future__ import annotations

from collections.abc import Sequence

from coulombus.host.run.outputs import Outputs
from coulombus.host.run.preflight import check_no_delay, check_no_guess, check_no_rehearsal, refusing
from coulombus.host.run.realtime_sequence import RealCourse
from coulombus.host.run.result import RunResult
from coulombus.host.run.run_state import Progress
from coulombus.host.setup.bringup import check_plan
from coulombus.host.setup.law_demand import check_demand
from coulombus.recording.output_file import new_file
from coulombus.rigs.buses import bus_addresses
from coulombus.rigs.rig import Rig
from coulombus.system.exit import say
from coulombus.system.realtime import default_cpu
from coulombus.system.stop_signals import Signals
from coulombus.wire.address import BusAddress

__all__ = ["real_run"]

NOTHING = Outputs()


def real_run(
    rig: Rig,
    mode: str,
    seconds: float | None,
    *,
    bus: BusAddress | Sequence[BusAddress] | None = None,
    outputs: Outputs = NOTHING,
    signals: Signals | None = None,
    progress: Progress | None = None,
    cpu: int | None = None,
    world: bool = False,
) -> RunResult:
    """Run the host on a bus and return the result.

    Parameters
    ----------
    mode : ``active``, ``passive`` or ``hybrid``
    seconds : length of the display, from Operation Enabled on; None: until it is stopped
    bus : the bus, or a bus for each of `Rig.channels`; default is the virtual bus with the rig's name, or
        those of its buses (`rigs.buses`)
    outputs : output files; the display's figures are computed from the recording
    signals : entered by the caller; a signal then ends the run safely
    progress : called with the display's time in s and each axis' state (`run_state.axis_state`)
    cpu : CPU of the data plane; default is the last CPU that this process may use
    world : let a world outside in (docs/worlds.md); a rig without [world] gets the section

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
    addresses = (
        tuple(bus_addresses(rig).values()) if bus is None else (bus,) if isinstance(bus, BusAddress) else tuple(bus)
    )
    rig = rig.with_world() if world else rig
    with refusing():
        for address in addresses:
            check_no_rehearsal(rig, address)
            check_no_guess(rig, address)
            check_no_delay(rig, address)
        check_plan(rig)
        check_demand(rig, mode)
        run = RealCourse(
            rig,
            mode,
            addresses,
            outputs,
            signals=signals or Signals(),
            progress=progress,
            cpu=default_cpu() if cpu is None else cpu,
            world=world,
        )
    try:
        try:
            with refusing():
                run.prepare()
                run.course(seconds)
        finally:
            run.end()
        result = run.concluded()
        picture = outputs.histogram
        if picture is not None:
            from coulombus.host.run.histogram import draw_histograms

            try:
                with new_file(picture, force=outputs.force) as path:
                    draw_histograms(*run.histograms(), rig.bus.period_s * 1e6, path)
            except OSError as error:
                if result.exit_status == 0:
                    raise
                say(
                    f"coulombus: {picture}: cannot be written ({error.strerror})"
                )  # a missing figure must not hide a trip
        return result
    finally:
        run.close()
