"""Measurement of the host's time from a cycle's last TPDO to its last RPDO, on this PC and without a bus.

The process of a real run (`host.realtime.data_plane`) is measured, with its real-time rights, its law and
the PDOs of the rig. The present process simulates the devices at the other end of a socket. They are
enabled and at rest, so the law is evaluated in each cycle. The time runs from the kernel's stamp of the
last TPDO to the hand-over of the last RPDO: wake-up, decoding, monitors, law, encoding and sending.
"""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from coulombus.eds.cia301 import CobId, NmtState
from coulombus.eds.cia402 import STATUSWORD, VOLTAGE_ENABLED, PowerState
from coulombus.eds.codec import pack
from coulombus.host.cycle.controller import Controller
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import HostRecord, Image, Phase
from coulombus.host.cycle.step import SOURCE_HOST
from coulombus.host.realtime.data_plane import PRIORITY, DataPlane
from coulombus.kernels.records import Records, new_records
from coulombus.rigs.rig import Rig
from coulombus.system.realtime import default_cpu
from coulombus.wire.address import BusAddress
from coulombus.wire.ancillary import SO_TIMESTAMPNS
from coulombus.wire.client import pack_frame
from coulombus.wire.frame import data_bytes

__all__ = ["compute_times_ns", "measure_compute"]

LEAD_NS, BATCH_S = 20_000_000, 0.05
REST_S = 100e-6
"""Response time of the simulated devices, so that the cycle sleeps when their TPDOs come, as on a bus."""
BEAT_CYCLES = 16
HELD_NS = 3600 * 1_000_000_000
PATIENCE_S = 20.0


def measure_compute(
    rig: Rig,
    mode: str,
    cycles: int,
    *,
    priority: int | None = PRIORITY,
    cpu: int | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> tuple[tuple[int, ...], list[dict[str, Any]]]:
    """Return the times [ns] of `cycles` cycles, for all axes, and the real-time rights with their grants.

    Parameters
    ----------
    rig : a rig on one bus
    progress : called with the number of finished cycles; an exception from it ends the measurement

    Raises
    ------
    coulombus.host.realtime.data_plane.PlaneError
        the process of the cycle did not start
    coulombus.rigs.rig.RigError
        the law cannot be loaded
    """
    controllers = Controllers(rig, mode)
    host_end, device_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    host_end.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    host_end.setblocking(False)
    devices = _Devices(controllers, device_end)
    try:
        plane = DataPlane(
            controllers,
            BusAddress("coulombus", "compute"),
            priority=priority,
            cpu=default_cpu() if cpu is None else cpu,
            line=host_end,
        )
    except BaseException:
        host_end.close()
        device_end.close()
        raise
    try:
        plane.wait_ready()
        devices.start()
        return _cycle(plane, controllers, cycles, progress), plane.real_time
    finally:
        plane.close()
        devices.close()


def _cycle(plane: DataPlane, controllers: Controllers, cycles: int, progress: Callable[[int], None]) -> tuple[int, ...]:
    """Run the data plane's cycle, and compute the times from its log."""
    period = int(controllers.control["period_ns"][0])
    plane.hold_deadman(time.monotonic_ns() + HELD_NS)
    plane.start_cycle((time.monotonic_ns() + LEAD_NS) // period * period)
    _stand_still(controllers)
    batches: list[Records] = []
    ends = time.monotonic() + PATIENCE_S + cycles * period * 1e-9
    while plane.cycles < cycles and plane.alive and time.monotonic() < ends:
        time.sleep(BATCH_S)
        plane.attend()
        batches.append(plane.take_frames())
        progress(min(plane.cycles, cycles))
    plane.end_cycle()
    time.sleep(BATCH_S)
    batches.append(plane.take_frames())
    log = np.concatenate(batches).view(np.recarray)
    return compute_times_ns(
        log, [(_identifiers(controller.tpdos), _identifiers(controller.rpdos)) for controller in controllers]
    )


def _identifiers(pdos: Records) -> set[int]:
    return {int(pdo["cob_id"]) for pdo in pdos if pdo["cob_id"] >= 0}


def _stand_still(controllers: Controllers) -> None:
    """Set each axis to phase RUN with its handle at rest, so that the law is evaluated from the first
    cycle on.
    """
    now = time.monotonic_ns()
    for controller in controllers:
        host = controller.host
        host["has_position"], host["gain"], host["sign_direction"] = 1, 1.0, 1
        host["enabled_ns"] = host["armed_ns"] = now
        host["phase"] = Phase.RUN
        controller.state["stuck"] = 1


def compute_times_ns(log: Records, axes: Sequence[tuple[set[int], set[int]]]) -> tuple[int, ...]:
    """Return the times from the last TPDO of an axis to its last RPDO [ns], for each axis and cycle.

    A cycle with a late or missing TPDO is left out, because the host waited for it.

    Parameters
    ----------
    axes : identifiers of each axis' TPDOs and of its RPDOs
    """
    times_ns: list[int] = []
    columns = (log[name].tolist() for name in ("t_ns", "can_id", "source"))
    came: list[dict[int, int]] = [{} for _ in axes]
    sent: list[dict[int, int]] = [{} for _ in axes]

    def close() -> None:
        for (tpdos, rpdos), arrived, setpoints in zip(axes, came, sent, strict=True):
            if tpdos and arrived.keys() == tpdos and setpoints.keys() == rpdos:
                times_ns.append(max(max(setpoints.values()) - max(arrived.values()), 0))
            arrived.clear()
            setpoints.clear()

    for t_ns, can_id, source in zip(*columns, strict=True):
        if source == SOURCE_HOST and can_id == CobId.SYNC:
            close()
        for (tpdos, rpdos), arrived, setpoints in zip(axes, came, sent, strict=True):
            if source == SOURCE_HOST and can_id in rpdos:
                setpoints[can_id] = t_ns
            elif source != SOURCE_HOST and can_id in tpdos and not setpoints:
                arrived[can_id] = t_ns
    close()
    return tuple(times_ns)


class _Devices:
    """All devices of the rig, simulated by a thread at the other end of a socket.

    They answer each SYNC by all TPDOs, and every `BEAT_CYCLES` cycles also by heartbeats.
    """

    def __init__(self, controllers: Controllers, line: socket.socket) -> None:
        self.line = line
        self.frames = [frame for controller in controllers for frame in _tpdos(controller)]
        nodes = sorted({node.node_id for node in controllers.rig.nodes})
        self.beats = [pack_frame(CobId.HEARTBEAT + node, bytes((NmtState.OPERATIONAL,))) for node in nodes]
        self.quit = threading.Event()
        self.thread = threading.Thread(target=self._serve, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self.thread.start()

    def close(self) -> None:
        """End the thread, and close the socket."""
        self.quit.set()
        if self.thread.is_alive():
            self.thread.join()
        self.line.close()

    def _serve(self) -> None:
        sync, cycle = pack_frame(CobId.SYNC), 0
        with suppress(OSError):  # the other end has closed
            while not self.quit.is_set():
                if not select.select([self.line], [], [], BATCH_S)[0]:
                    continue
                message = self.line.recv(1 << 16)
                if not message:
                    return
                if any(message[at : at + 4] == sync[:4] for at in range(0, len(message), len(sync))):
                    time.sleep(REST_S)
                    for frame in (*(self.beats if cycle % BEAT_CYCLES == 0 else ()), *self.frames):
                        self.line.send(frame)
                    cycle += 1


def _tpdos(controller: Controller) -> list[bytes]:
    """Return the TPDOs of devices that are enabled and at rest, with the dead man's switch held and all
    other inputs 0.
    """
    values = new_records(HostRecord)[0].image.copy()
    enabled = int(STATUSWORD[PowerState.OPERATION_ENABLED]) | VOLTAGE_ENABLED
    values[Image.STATUSWORD] = values[Image.BRAKE_STATUSWORD] = enabled
    values[Image.DEADMAN] = -1
    return [
        pack_frame(int(pdo["cob_id"]), data_bytes(int(pack(pdo, values)), int(pdo["length"])))
        for pdo in controller.tpdos
        if pdo["cob_id"] >= 0
    ]
