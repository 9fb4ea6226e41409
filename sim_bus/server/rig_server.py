"""``coulombus emulate``: bus, nodes and rig as one process in real time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from coulombus.eds.cia402 import PowerState
from coulombus.host.cycle.step import SOURCE_HOST
from coulombus.kernels.records import Records
from coulombus.recording.recorder import PACED, About, Recorder
from coulombus.recording.wall_clock import wall_clock
from coulombus.rigs.rig import Rig
from coulombus.sim_bus.can_bus.stations import detach
from coulombus.sim_bus.faults.fault_file import FaultError, FaultPlan
from coulombus.sim_bus.faults.injection import Injection, controllers_of
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.sim_bus.rig.records import NOT_BEGUN
from coulombus.sim_bus.server.clients import STATION
from coulombus.sim_bus.server.realtime_loop import Serve
from coulombus.sim_bus.server.server import BusServer
from coulombus.sim_bus.server.sim_result import SimResult
from coulombus.wire.address import BusAddress
from coulombus.wire.frame import push

if TYPE_CHECKING:
    from coulombus.sim_bus.network.script import ScriptEntry

__all__ = ["PacedRig", "SimServer"]


class PacedRig(VirtualRig):
    """Rig of a process without a host."""

    def __init__(
        self,
        rig: Rig,
        mode: str,
        seed: int,
        bit_rate: int,
        on_frames: Callable[[Records], None] | None = None,
        numbered: bool = True,
    ) -> None:
        super().__init__(rig, mode, seed=seed, on_frames=on_frames, numbered=numbered)
        self.bus["bit_rate"] = bit_rate
        self._world["host_elsewhere"] = 1
        for wire in self.bus:
            detach(wire, SOURCE_HOST)

    def ask(self, bus: int, t_ns: int, can_id: int, length: int, word: int) -> None:
        """Let a frame of a client take part in the arbitration on a bus from `t_ns` on, as when it was recorded."""
        push(self._out, STATION + bus, t_ns, can_id, length, word)

    def rest(self) -> None:
        """End the schedule of each axis whose drive has left Operation Enabled; `sim_bus.server.realtime_loop` checks
        this after each event.
        """
        for axis, record in enumerate(self._axes):
            state = self.nodes[int(record["motor"])]["power_state"]
            if record["operator_start_ns"] >= 0 and state != PowerState.OPERATION_ENABLED:
                self._world["axis"] = axis
                self.answer(Serve.RESTED)

    def answer(self, why: int) -> None:
        """Handle an exit of the kernel, at the world's present time."""
        if why == Serve.RESTED:
            axis = int(self._world["axis"][0])
            together = self._together(axis)
            start_ns = int(self._axes["operator_start_ns"][list(together)].max())
            self._axes[axis]["operator_start_ns"] = NOT_BEGUN
            for a in together:
                self._left[a] = self._left[a] or (start_ns * 1e-9, self.t_ns * 1e-9)
                self._new_force_block(a)
            self._actuate()
        else:
            super().answer(why)


class SimServer(BusServer):
    """A bus with the nodes and the rig of `rig` on it, in real time.

    Parameters
    ----------
    mode : mode whose F_s scales the operator's pushes
    script : timed actions on the nodes
    unpaced : frames take no time
    record : a recording of every frame, stamped with its end of frame in the bus's own time from
        power-on
    faults : faults on the bus, and their times
    force : overwrite an existing `record`
    numbered : the devices have the rig's node ids; otherwise none, and wait for an LSS master

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        (exit status 4) a live process serves this bus already, or the SocketCAN interface does not
        exist
    coulombus.sim_bus.faults.fault_file.FaultError
        (exit status 3) the file names an unknown node, or the bus has no bit times
    """

    world: PacedRig

    def __init__(
        self,
        rig: Rig,
        address: BusAddress | Sequence[BusAddress],
        *,
        mode: str = "hybrid",
        seed: int = 0,
        script: Sequence[ScriptEntry] = (),
        unpaced: bool = False,
        record: Path | None = None,
        faults: FaultPlan | None = None,
        force: bool = False,
        numbered: bool = True,
    ) -> None:
        addresses = (address,) if isinstance(address, BusAddress) else tuple(address)
        if faults is not None and (unpaced or not addresses[0].is_virtual):
            raise FaultError(f"{faults.path}: a bus without bit times has no faults; leave --unpaced and socketcan out")
        self._recorder: Recorder | None = None
        self._script, self._faults, self._seed = tuple(script), faults, seed

        def keep(frames: Records) -> None:
            if self._recorder is not None:
                self._recorder.write(frames)

        def make_world(bit_rate: int, trial: bool) -> PacedRig:
            return PacedRig(rig, mode, seed, bit_rate, None if trial or record is None else keep, trial or numbered)

        bit_rate = 0 if unpaced else rig.bus.bitrate_bit_s
        super().__init__(make_world, addresses, bit_rate, beside=faults is None)
        if record is not None:  # a refused bus creates and replaces no file
            try:
                self._recorder = Recorder(record, rig, mode, seed, about=About(bus=PACED), force=force)
            except BaseException:
                self.close()
                raise
            self.keep_frames()

    def _began(self, begin_ns: int) -> None:
        """Write the wall-clock time of its start to the recording."""
        if self._recorder is not None:
            for name, content in wall_clock(begin_ns)[1].items():
                self._recorder.attach(name, content)

    def close(self) -> None:
        """Close the sockets, remove the socket's file, close the recording."""
        with ExitStack() as left:
            if self._recorder is not None:
                left.callback(self._recorder.close)
            super().close()

    def mark(self, t_ns: int, text: str) -> None:
        """Mark the recording, if there is one, at the world's time `t_ns`."""
        if self._recorder is not None:
            self._recorder.mark(t_ns, text)

    def _plan(self) -> None:
        self.world.plan(self._script)
        if self._faults is not None:
            Injection(self.world, self._faults, self._seed, self.mark)

    def _finish(self) -> SimResult:
        result = super()._finish()
        if self.world.injection is not None:
            result.faults = self.world.injection.results()
            result.controllers = controllers_of(self.world)
        return result
