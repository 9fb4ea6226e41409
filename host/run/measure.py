"""Measurement of the planner's times: response of a rig's devices on their bus, and latency of the host.

The bus is claimed as for a run (`host.run.control_socket`), and refused if another host is active on it.
Nothing is armed (`host.setup.device_response`). The proposed values are the longest times with a margin.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.output_limits import motor_limit_Nm
from coulombus.host.errors import SafetyTrip
from coulombus.host.run.control_socket import HostSocket
from coulombus.host.run.host_latency import measure_compute
from coulombus.host.run.preflight import check_no_rehearsal
from coulombus.host.run.realtime_sequence import LISTEN_S
from coulombus.host.setup.control_plane import RealControlPlane
from coulombus.host.setup.device_response import DeviceTimes, Stamped, measure_devices
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig
from coulombus.rigs.toml_lines import Key
from coulombus.wire.address import BusAddress, BusUnavailable
from coulombus.wire.client import BusFull, Client, pack_frame
from coulombus.wire.handshake import Flags, Hello

__all__ = ["Measured", "TimeQuantiles", "measure_rig", "proposed_ns", "quiet_mode"]

MARGIN, LEAST_MARGIN_NS, STEP_NS = 10, 5_000, 10_000
FULL_S = 1.0


@dataclass(frozen=True)
class TimeQuantiles:
    """Number of times, and their median, 99th percentile and maximum [us]."""

    count: int
    p50: float
    p99: float
    max: float

    @classmethod
    def from_times(cls, times_ns: Collection[int]) -> TimeQuantiles:
        """Return the spread of at least one time."""
        p50, p99, longest = np.percentile(np.array(list(times_ns)) / 1e3, (50, 99, 100), method="higher")
        return cls(len(times_ns), float(p50), float(p99), float(longest))


def proposed_ns(longest_ns: float) -> int:
    """Return a time with its margin: a tenth, at least 5 us, rounded up to 10 us."""
    longest = math.ceil(longest_ns)
    return -(-(longest + max(-(-longest // MARGIN), LEAST_MARGIN_NS)) // STEP_NS) * STEP_NS


@dataclass(frozen=True)
class Measured:
    """Measured times of one bus.

    Attributes
    ----------
    host : times of the host
    real_time : the host's real-time rights, each with its grant (`system.realtime`)
    """

    devices: tuple[DeviceTimes, ...]
    host: TimeQuantiles
    real_time: tuple[dict[str, Any], ...]

    def response_us(self, device: DeviceTimes) -> float | None:
        """Return the proposed value of `response_us` of a device; None if nothing was measured."""
        longest = max((max(pdo.times_ns) for pdo in device.pdos if pdo.times_ns), default=None)
        return None if longest is None else proposed_ns(longest) / 1e3

    @property
    def compute_s(self) -> float:
        """The proposed value of `host.compute_s`."""
        return round(proposed_ns(self.host.max * 1e3) * 1e-9, 9)

    def numbers(self, rig: Rig) -> dict[Key, float]:
        """Return the proposed values by the rig file's keys; keys of named axes begin with the axis."""
        numbers: dict[Key, float] = {("host", "compute_s"): self.compute_s}
        for device in self.devices:
            value = self.response_us(device)
            axis = _axis_of(rig, device.plan.name)
            if value is not None:
                above = ("axis", axis.name) if axis.name else ()
                section = (
                    (device.plan.role,) if device.plan.role in ("motor", "brake") else ("sensor", device.plan.role)
                )
                numbers[(*above, *section, "response_us")] = value
        return numbers


def _axis_of(rig: Rig, name: str) -> Axis:
    return next(axis for axis in rig.axes if name.startswith(axis.prefix) and name[len(axis.prefix) :] in axis.devices)


def quiet_mode(rig: Rig) -> str:
    """Return the mode in which the devices are configured: the mode with the smallest motor limit."""
    return min(rig.modes, key=lambda mode: max(motor_limit_Nm(axis, mode) for axis in rig.axes))


class _BusWire:
    """The host's station on a real bus (`host.setup.device_response.Wire`), with the kernel's stamps."""

    def __init__(self, address: BusAddress) -> None:
        self.client = Client(address, Hello(Flags.OWN))

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame; wait up to `FULL_S` for room in a full queue."""
        deadline = time.monotonic() + FULL_S
        while True:
            try:
                return self.client.send(pack_frame(can_id, data))
            except BusFull:
                if time.monotonic() >= deadline:
                    raise
                time.sleep(1e-3)

    def listen(self, duration_ns: int, until: Collection[int] = ()) -> list[Stamped]:
        """Return the received frames, as `Wire.listen`."""
        frames: list[Stamped] = []
        missing = set(until)
        deadline = time.monotonic() + duration_ns * 1e-9
        while True:
            received = self.client.receive()
            for stamp, can_id, length, data in received:
                frames.append(Stamped(stamp, can_id, data[:length]))
                missing.discard(can_id)
            left = deadline - time.monotonic()
            if received and (left > 0 or not until):
                continue
            if (until and not missing) or left <= 0:
                return frames
            self.client.wait(left)

    def close(self) -> None:
        """Leave the bus."""
        self.client.close()


def measure_rig(
    rig: Rig,
    address: BusAddress,
    *,
    rounds: int,
    cycles: int,
    cpu: int | None = None,
    progress: Callable[[str, int], None] = lambda what, done: None,
) -> Measured:
    """Measure the devices of a rig on one bus, and the host's cycle on this PC.

    Parameters
    ----------
    rounds : number of SYNCs for each device
    cycles : number of cycles of the host
    progress : called with "host" or a device's name, and the number of finished cycles or rounds; an
        exception from it ends the measurement safely

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        no such bus, or it is lost
    coulombus.host.errors.HostError
        another host has the bus; or a node is missing, refuses a value, or differs from the rig file
    coulombus.rigs.rig.RigError
        a rehearsal's file on a real bus, a law that cannot be loaded, a limit that the drive cannot take
    """
    check_no_rehearsal(rig, address)
    mode = quiet_mode(rig)
    controllers = Controllers(rig, mode)
    with ExitStack() as stack:
        door = HostSocket(address)
        stack.callback(door.close)

        def report(what: str, done: int) -> None:
            if door.stop_wanted():
                raise SafetyTrip("the measurement was ended by `coulombus stop`; nothing was armed")
            control.wait_ns(0)  # raises if the bus is gone
            progress(what, done)

        try:
            control = RealControlPlane(rig, address)
            stack.callback(control.close)
            control.check_alone(time.monotonic() + LISTEN_S)
            wire = _BusWire(address)
            stack.callback(wire.close)
            devices = measure_devices(controllers, control, wire, rounds, report)
        except BusFull as error:
            text = str(error)
            raise BusUnavailable(text if text.startswith("bus ") else f"bus {address}: {text}") from None
        times, rights = measure_compute(rig, _loudest(rig), cycles, cpu=cpu, progress=lambda done: report("host", done))
        if not times:
            raise SafetyTrip("the host's cycle gave no figure: its process did not cycle; see its messages above")
    return Measured(devices, TimeQuantiles.from_times(times), tuple(rights))


def _loudest(rig: Rig) -> str:
    """Return the mode with the most work in a cycle: hybrid, else active, else passive."""
    return next(mode for mode in ("hybrid", "active", "passive") if mode in rig.modes)
