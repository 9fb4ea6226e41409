"""Measurement of the devices' response times from SYNC to their TPDOs, on the bus.

The devices are configured as for a run. One device at a time is made OPERATIONAL, so no other device's
TPDO delays its own. The host sends SYNC repeatedly, and no RPDO: no controlword and no set-point, so no
drive is enabled. With the time stamps t of the frames' ends, and the bit time tau::

    response = t(TPDO) - t(SYNC) - (bits(TPDO) - 3) tau - sum of bits tau of the frames in between

which is the time from SYNC's end to the device's transmission request, as the planner uses it
(`rigs.plan.worst_cycle`). bits are the bits of the actual frames, with stuff bits and the three bits of
the inter-frame space.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from coulombus.eds.cia301 import CobId, NmtCommand
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.errors import NodeMissing, SafetyTrip
from coulombus.host.setup.bringup import ControlPlane, configure, plans_of, wait_operational
from coulombus.host.setup.device_plan import DevicePlan
from coulombus.rigs.device_services import emcy_identifier
from coulombus.rigs.signals import RigPdo
from coulombus.wire.address import BusUnavailable
from coulombus.wire.bits import frame_bits
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG

__all__ = ["DeviceTimes", "PdoTimes", "Stamped", "Wire", "measure_devices", "responses_ns"]

INTER_FRAME_BITS = 3
ROUND_NS = 250_000_000
"""Longest wait for a TPDO; a later TPDO counts as missed for this SYNC."""
LATE_NS = 1_000_000_000
"""Longest further wait for a late TPDO, so that it is not assigned to the next SYNC."""
SILENT_ROUNDS = 4
"""Number of rounds in a row without a TPDO after which the measurement is refused."""


class Stamped(NamedTuple):
    """A received frame with the time stamp of its end; `can_id` has Linux's flags."""

    t_ns: int
    can_id: int
    data: bytes


class Wire(Protocol):
    """A station on the bus that also receives its own frames."""

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame."""

    def listen(self, duration_ns: int, until: Collection[int] = ()) -> list[Stamped]:
        """Return the frames received within `duration_ns`, and those not returned yet; stop early if each
        identifier of `until` has arrived.
        """


@dataclass(frozen=True)
class PdoTimes:
    """The response times of one TPDO [ns] in the order of time, and the number of SYNCs without it."""

    name: str
    can_id: int
    times_ns: tuple[int, ...]
    missed: int


@dataclass(frozen=True)
class DeviceTimes:
    """Measured times of one device; `why` is the reason if nothing was measured."""

    plan: DevicePlan
    pdos: tuple[PdoTimes, ...]
    emergencies: tuple[int, ...] = ()
    why: str = ""


def responses_ns(heard: Sequence[Stamped], can_ids: Collection[int], bitrate_bit_s: int) -> dict[int, int]:
    """Return the response time [ns] of each of `can_ids` to the first SYNC in `heard`.

    Identifiers without a frame are left out; no time is below 0.
    """
    responses: dict[int, int] = {}
    sync_ns, between_bits = -1, 0
    for frame in heard:
        if frame.can_id & CAN_ERR_FLAG:
            continue
        if sync_ns < 0:
            sync_ns = frame.t_ns if frame.can_id == CobId.SYNC else -1
            continue
        bits = frame_bits(
            frame.can_id & 0x1FFFFFFF,
            frame.data,
            extended=bool(frame.can_id & CAN_EFF_FLAG),
            remote=bool(frame.can_id & CAN_RTR_FLAG),
        )
        if frame.can_id in can_ids:
            taken_ns = round((bits - INTER_FRAME_BITS + between_bits) * 1e9 / bitrate_bit_s)
            responses.setdefault(frame.can_id, max(frame.t_ns - sync_ns - taken_ns, 0))
        between_bits += bits
    return responses


def measure_devices(
    controllers: Controllers,
    plane: ControlPlane,
    wire: Wire,
    rounds: int,
    progress: Callable[[str, int], None] = lambda name, done: None,
) -> tuple[DeviceTimes, ...]:
    """Configure the devices, measure each `rounds` times, and leave them in PRE-OPERATIONAL.

    Parameters
    ----------
    progress : called with a device's name and its number of finished rounds; an exception from it ends
        the measurement

    Raises
    ------
    NodeMissing, SdoAborted, DeviceMismatch
        as `bring_up`, or a synchronous TPDO does not arrive
    SafetyTrip
        another host is active on the bus
    coulombus.wire.address.BusUnavailable
        no SYNC reaches the bus
    """
    plans = plans_of(controllers)
    try:
        configure(plans, plane)
        return tuple(_MeasuredDevice(controllers, plan, plane, wire).measure(rounds, progress) for plan in plans)
    finally:
        plane.send(CobId.NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, 0)))


class _MeasuredDevice:
    """One device during its measurement."""

    def __init__(self, controllers: Controllers, plan: DevicePlan, plane: ControlPlane, wire: Wire) -> None:
        self.plan, self.plane, self.wire = plan, plane, wire
        bus = controllers.rig.bus
        self.period_ns, self.rate = bus.period_ns, bus.bitrate_bit_s
        pdos = [pdo for pdo in controllers.rig.pdos() if pdo.node == plan.name and pdo.layout.direction == "tpdo"]
        self.pdos: list[RigPdo] = [pdo for pdo in pdos if pdo.every_cycle]
        self.why = "" if self.pdos else "no TPDO follows SYNC" if pdos else "it has no TPDO"
        self.emergencies: set[int] = set()
        self.awaited = 0  # SYNCs that were sent and not received back yet

    def measure(self, rounds: int, progress: Callable[[str, int], None]) -> DeviceTimes:
        """Return the device's times; it is OPERATIONAL during the measurement."""
        name = self.plan.name
        progress(name, 0)
        if not self.pdos:
            return DeviceTimes(self.plan, (), why=self.why)
        self._command(NmtCommand.START)
        wait_operational([self.plan], self.plane)
        times: dict[int, list[int]] = {pdo.layout.cob_id: [] for pdo in self.pdos}
        last = dict.fromkeys(times, 0)
        for done in range(1, rounds + 1):
            for can_id, time_ns in self._round(times).items():
                times[can_id].append(time_ns)
                last[can_id] = done
            progress(name, done)
            self._refuse_silent({can_id for can_id, came in last.items() if done - came >= SILENT_ROUNDS})
        self._command(NmtCommand.ENTER_PRE_OPERATIONAL)
        results = (
            PdoTimes(
                pdo.name, pdo.layout.cob_id, tuple(times[pdo.layout.cob_id]), rounds - len(times[pdo.layout.cob_id])
            )
            for pdo in self.pdos
        )
        return DeviceTimes(self.plan, tuple(results), tuple(sorted(self.emergencies)))

    def _command(self, command: NmtCommand) -> None:
        self.plane.send(CobId.NMT, bytes((command, self.plan.node_id)))

    def _round(self, can_ids: Collection[int]) -> dict[int, int]:
        """Send SYNC; return the response time of each TPDO that arrived; then wait for a period."""
        self._observe(self.wire.listen(0))
        self.wire.send(CobId.SYNC, b"")
        self.awaited += 1
        heard = self.wire.listen(ROUND_NS, (CobId.SYNC, *can_ids))
        self._observe(heard)
        responses = responses_ns(heard, can_ids, self.rate)
        missing = set(can_ids) - set(responses)
        self._observe(self.wire.listen(LATE_NS, missing) if missing else self.wire.listen(self.period_ns))
        return responses

    def _observe(self, heard: Sequence[Stamped]) -> None:
        """Store the codes of EMCYs; refuse a SYNC of another host."""
        self.awaited -= sum(frame.can_id == CobId.SYNC for frame in heard)
        if self.awaited < 0:
            raise SafetyTrip("another host is on the bus: a SYNC was heard that is not this one's; end it first")
        for frame in heard:
            code = int.from_bytes(frame.data[:2], "little")
            if frame.can_id == emcy_identifier(self.plan.description, self.plan.node_id) and code:
                self.emergencies.add(code)

    def _refuse_silent(self, silent: Collection[int]) -> None:
        if not silent:
            return
        if self.awaited >= SILENT_ROUNDS:
            raise BusUnavailable("no SYNC gets through to the bus: look at bit rate, cable and termination")
        names = ", ".join(f"{pdo.name} ({pdo.layout.cob_id:03X}h)" for pdo in self.pdos if pdo.layout.cob_id in silent)
        codes = ", ".join(f"{code:04X}h" for code in sorted(self.emergencies))
        raise NodeMissing(
            f"{self.plan.name} (node {self.plan.node_id}) is OPERATIONAL and sends no {names} within {ROUND_NS / 1e6:g} ms of a SYNC"
            + (f"; its EMCYs: {codes}" if codes else "")
            + "; see its transmission type, its faults and its supply"
        )
