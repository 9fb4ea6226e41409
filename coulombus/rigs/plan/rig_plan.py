"""Bus plan of a rig: its messages, whether they fit, and changes with which they would.

`messages_of` composes the messages of any number of devices and one host, so that a bus with
several axes is the same call with more devices.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from coulombus.eds.cia301 import CobId
from coulombus.rigs.device_services import is_guarded
from coulombus.rigs.model import CIA_301_BIT_RATES, to_ns
from coulombus.rigs.plan.response_times import (
    NO_ERRORS,
    Errors,
    Message,
    ResponseTime,
    bit_ns,
    response_times,
    utilisation,
)
from coulombus.rigs.plan.worst_cycle import Cycle, CycleTiming, worst_cycle
from coulombus.rigs.rig import Rig
from coulombus.wire.can_flags import CAN_RTR_FLAG

__all__ = [
    "Assumptions",
    "DeviceTraffic",
    "Pdo",
    "RigPlan",
    "bitrates_that_fit",
    "devices_of",
    "largest_axes",
    "messages_of",
    "plan",
    "plan_again",
    "plans",
    "shortest_period_ns",
]

MOST_NAMED = 40
"""Maximum number of late frames named in one sentence; `plan` has a row for each."""
SPORADIC_PERIODS = 10
LAST_NODE_ID = 127
MAX_AXES = 16
"""Maximum number of axes of a rig file."""
SHORTEST_NS, LONGEST_NS, STEP_NS = 100_000, 1_000_000_000, 1_000
"""The rig file's range of bus.period_s, and the grid of object 1006h."""


@dataclass(frozen=True)
class Assumptions:
    """Assumptions beyond the rig file.

    Attributes
    ----------
    node_ns : int or None
        Longest computing time of a device between SYNC and its TPDOs; None: the rig file's `response_us` of each.
    host_ns : int or None
        Longest computing time of the host between the last TPDO and its RPDOs; None: the rig file's `host.compute_s`.
    sporadic_ns : int or None
        Least interval between two EMCYs of a node, two SDO transfers with a node, two NMT commands;
        None: ten periods.
    """

    node_ns: int | None = None
    host_ns: int | None = None
    sporadic_ns: int | None = None
    errors: Errors = NO_ERRORS


@dataclass(frozen=True)
class Pdo:
    """A PDO from the device's side: "tpdo" or "rpdo", its number, identifier and bytes."""

    direction: str
    number: int
    cob_id: int
    length: int


@dataclass(frozen=True)
class DeviceTraffic:
    """Frames sent by and to a device, and the time-outs that trip when they are late."""

    name: str
    axis: int
    node_id: int
    pdos: tuple[Pdo, ...]
    heartbeat_ns: int
    heartbeat_timeout_ns: int
    tpdo_deadline_ns: int
    rpdo_deadline_ns: int
    sync_timeout_ns: int
    response_ns: int = 0
    guard_ns: int = 0
    """Period of node guarding by the host; 0: it has a heartbeat.
    """

    def moved(self, axis: int, node_id: int, name: str) -> DeviceTraffic:
        """Return a copy for another axis, with another node id."""
        step = node_id - self.node_id
        pdos = tuple(replace(pdo, cob_id=pdo.cob_id + step) for pdo in self.pdos)
        return replace(self, name=name, axis=axis, node_id=node_id, pdos=pdos)


def devices_of(rig: Rig, period_ns: int, axes: int | None = None) -> tuple[DeviceTraffic, ...]:
    """Return the devices of the first `axes` axes on one bus; axes beyond the rig's are copies with the next free node
    ids.

    With another period, the time-outs of PDOs and SYNC scale with it.

    Raises
    ------
    ValueError
        There are not enough node ids.
    """
    scale = period_ns / rig.bus.period_ns
    pdos: dict[str, list[Pdo]] = {}
    for pdo in rig.pdos():
        layout = pdo.layout
        pdos.setdefault(pdo.node, []).append(Pdo(layout.direction, layout.number, layout.cob_id, layout.length))
    of_rig = [
        DeviceTraffic(
            axis.prefix + node,
            number,
            axis.part(node).node_id,
            tuple(pdos.get(axis.prefix + node, ())),
            to_ns(axis.part(node).heartbeat_s),
            to_ns(axis.part(node).heartbeat_timeout_s),
            axis.limits.missed_tpdo_cycles * period_ns,
            rpdo_deadline_ns,
            round(to_ns(sync_timeout_s) * scale),
            round(axis.part(node).response_us * 1e3),
            to_ns(rig.host.heartbeat_s) if is_guarded(axis.description(node)) else 0,
        )
        for number, axis in enumerate(rig.axes)
        for node, rpdo_deadline_ns, sync_timeout_s in (
            ("motor", axis.motor.setpoint_zero_cycles * period_ns, axis.motor.sync_timeout_s),
            ("brake", round(to_ns(axis.brake.setpoint_fault_s) * scale), axis.brake.sync_timeout_s),
            *((name, period_ns, axis.motor.sync_timeout_s) for name in axis.sensor),
        )
    ]
    count = len(rig.axes) if axes is None else axes
    node_ids = {rig.host.node_id, *(device.node_id for device in of_rig)}
    free = (node_id for node_id in range(1, LAST_NODE_ID + 1) if node_id not in node_ids)
    devices = [device for device in of_rig if device.axis < count]
    for number in range(len(rig.axes), count):
        for device in of_rig:
            if device.axis == number % len(rig.axes):
                node_id = next(free, None)
                if node_id is None:
                    raise ValueError(f"{count} axes need more node ids than the {LAST_NODE_ID} that there are")
                role = device.name.rpartition(".")[2]
                devices.append(device.moved(number, node_id, f"axis{number + 1}.{role}"))
    return tuple(devices)


def messages_of(
    devices: Sequence[DeviceTraffic],
    *,
    host_id: int,
    host_heartbeat_ns: int,
    sdo_timeout_ns: int,
    timing: CycleTiming,
    sporadic_ns: int,
) -> tuple[Message, ...]:
    """Return every message of a bus with one host and these devices.

    SYNC and PDOs once a period; a heartbeat of every node; of each device an SDO request and its response, and an EMCY;
    NMT commands. EMCY and NMT are not part of ordinary operation. Deadlines are the time-outs: a later frame causes a
    trip.
    """
    period = timing.period_ns
    after_sync = max(min(device.sync_timeout_ns for device in devices) - period, timing.window_ns)
    watch = min(device.heartbeat_timeout_ns for device in devices) - host_heartbeat_ns

    def each() -> Iterator[Message]:
        yield Message("NMT", CobId.NMT, 2, sporadic_ns, sporadic_ns, emergency=True)
        yield Message("SYNC", CobId.SYNC, 0, period, after_sync, stage="sync")
        for device in devices:
            name, node = device.name, device.node_id
            yield Message(f"{name} EMCY", CobId.EMCY + node, 8, sporadic_ns, sporadic_ns, emergency=True)
            for pdo in device.pdos:
                label = f"{name} {pdo.direction.upper()}{pdo.number}"
                if pdo.direction == "tpdo":
                    deadline, late, follows = device.tpdo_deadline_ns, device.response_ns, "SYNC"
                    yield Message(label, pdo.cob_id, pdo.length, period, deadline, late, follows, "tpdo", device.axis)
                else:  # the host sends it at the window's end at the latest
                    deadline, late = device.rpdo_deadline_ns, timing.window_ns + timing.host_ns
                    yield Message(label, pdo.cob_id, pdo.length, period, deadline, late, stage="rpdo", axis=device.axis)
            request = f"{name} SDO request"
            yield Message(request, CobId.SDO_RX + node, 8, sporadic_ns, sdo_timeout_ns)
            yield Message(
                f"{name} SDO response", CobId.SDO_TX + node, 8, sporadic_ns, sdo_timeout_ns, device.response_ns, request
            )
            beat = device.guard_ns or device.heartbeat_ns
            if device.guard_ns:
                yield Message(
                    f"{name} guard request",
                    CAN_RTR_FLAG | (CobId.HEARTBEAT + node),
                    1,
                    beat,
                    device.heartbeat_timeout_ns - beat,
                )
            yield Message(f"{name} heartbeat", CobId.HEARTBEAT + node, 1, beat, device.heartbeat_timeout_ns - beat)
        yield Message("host heartbeat", CobId.HEARTBEAT + host_id, 1, host_heartbeat_ns, watch)

    return tuple(each())


@dataclass(frozen=True)
class RigPlan:
    """The result: every message's response, and the cycle's worst case."""

    timing: CycleTiming
    assumptions: Assumptions
    messages: tuple[Message, ...]
    axes: int

    @cached_property
    def responses(self) -> tuple[ResponseTime, ...]:
        """Worst-case response times under all traffic; the highest priority first.

        The deadline of a frame of the cycle is the cycle's, that of any other its time-out.
        """
        late = {frame.message.name: frame.deadline_ns for frame in self.cycle.frames if not frame.fits}
        messages = [replace(m, deadline_ns=min(m.deadline_ns, late.get(m.name, m.deadline_ns))) for m in self.messages]
        return response_times(messages, self.timing.bitrate_bit_s, self.assumptions.errors)

    @cached_property
    def cycle(self) -> Cycle:
        """The worst cycle of ordinary operation: heartbeats and SDO interfere, EMCY and NMT
        do not.
        """
        return self.cycle_under(lambda message: not message.emergency)

    def cycle_under(self, interferes: Callable[[Message], bool]) -> Cycle:
        """Return the worst cycle when only some of the messages outside it are sent."""
        messages = [message for message in self.messages if message.stage or interferes(message)]
        return worst_cycle(messages, self.timing, self.assumptions.errors)

    @property
    def utilisation(self) -> float:
        """Share of the bus that all messages take."""
        return utilisation(self.messages, self.timing.bitrate_bit_s)

    @property
    def cyclic(self) -> tuple[Message, ...]:
        """The messages of the cycle, in order of priority."""
        return tuple(response.message for response in self.responses if response.message.stage)

    @property
    def busy_ns(self) -> int:
        """Time that the frames of one cycle take."""
        return sum(bit_ns(message.bits, self.timing.bitrate_bit_s) for message in self.cyclic)

    @property
    def latest_rpdo_ns(self) -> int:
        """Latest end of the last RPDO in ordinary operation, from SYNC's release."""
        return self.cycle.latest_ns("rpdo")

    @property
    def interference_ns(self) -> dict[str, int]:
        """Latest end of the last RPDO as traffic is added: the cyclic frames alone, heartbeats, SDO, EMCY and NMT."""
        return {
            "cycle": self.cycle_under(lambda m: False).latest_ns("rpdo"),
            "heartbeats": self.cycle_under(lambda m: "heartbeat" in m.name).latest_ns("rpdo"),
            "sdo": self.latest_rpdo_ns,
            "emcy_nmt": self.cycle_under(lambda m: True).latest_ns("rpdo"),
        }

    @property
    def fits(self) -> bool:
        """Whether every message meets its cycle and its time-out."""
        return self.utilisation < 1.0 and all(response.fits for response in self.responses)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons why it does not fit: each frame by name, those of the cycle first."""
        slow = {response.message.name: response for response in self.responses if not response.fits}
        ends = [frame for frame in self.cycle.frames if not frame.fits and frame.message.name in slow]
        for frame in ends:
            del slow[frame.message.name]
        texts = [
            f"{_label(frame.message)} is through {frame.end_ns / 1e3:.0f} us after SYNC's release and due at {frame.deadline_ns / 1e3:g} us"
            for frame in ends
        ]
        texts += [
            f"{_label(r.message)} takes {r.response_ns / 1e3:.0f} us, its deadline is {r.message.deadline_ns / 1e3:g} us"
            for r in slow.values()
            if r.bounded
        ]
        endless = [_label(r.message) for r in slow.values() if not r.bounded]
        if endless:
            texts.append(f"the bus is full, so that nothing bounds {_some(endless, ', ')}")
        return tuple(texts)

    def verdict(self) -> str:
        """Return whether it fits, and the remedy if not, as a text."""
        if self.fits:
            return "the plan fits"
        head = (
            f"the cycle does not fit on the bus: {self.busy_ns / 1e3:.0f} us of frames in the worst case, "
            f"every {self.timing.period_ns / 1e3:g} us, at {self.timing.bitrate_bit_s} bit/s"
        )
        return f"{head}; {_some(self.reasons, '; ')}; raise bus.bitrate_bit_s or bus.period_s (see coulombus plan)"


def _some(texts: Sequence[str], comma: str) -> str:
    """Return the first names of a list and the number of the others."""
    more = len(texts) - MOST_NAMED
    return comma.join(texts[:MOST_NAMED]) + (f"{comma}and {more} more" if more > 0 else "")


def _label(message: Message) -> str:
    return f"{message.name} ({message.can_id:03X}h)"


def plan(
    rig: Rig,
    *,
    bitrate_bit_s: int | None = None,
    period_ns: int | None = None,
    axes: int | None = None,
    assumptions: Assumptions | None = None,
) -> RigPlan:
    """Plan the bus of all axes of `rig` (`Rig.on` selects those of one bus).

    With another period, the TPDO window and the time-outs of PDOs and SYNC scale with it.

    Raises
    ------
    ValueError
        More axes than there are node ids, or axes on several buses.
    """
    if len(rig.channels) > 1:
        raise ValueError(f"the axes hang on the buses {', '.join(rig.channels)}; take those of one with Rig.on")
    assumed = assumptions or Assumptions()
    period = rig.bus.period_ns if period_ns is None else period_ns
    window = round(to_ns(rig.bus.tpdo_window_s) * period / rig.bus.period_ns)
    host = to_ns(rig.host.compute_s) if assumed.host_ns is None else assumed.host_ns
    devices = devices_of(rig, period, axes)
    if assumed.node_ns is not None:
        devices = tuple(replace(device, response_ns=assumed.node_ns) for device in devices)
    slowest = max(device.response_ns for device in devices)
    timing = CycleTiming(bitrate_bit_s or rig.bus.bitrate_bit_s, period, window, slowest, host)
    messages = messages_of(
        devices,
        host_id=rig.host.node_id,
        host_heartbeat_ns=to_ns(rig.host.heartbeat_s),
        sdo_timeout_ns=to_ns(rig.host.sdo_timeout_s),
        timing=timing,
        sporadic_ns=assumed.sporadic_ns or SPORADIC_PERIODS * period,
    )
    return RigPlan(timing, assumed, messages, len(rig.axes) if axes is None else axes)


def plans(rig: Rig, **options: Any) -> dict[str, RigPlan]:
    """Return `plan` for each bus of the rig, by the bus' name ("" for a single unnamed bus)."""
    return {channel: plan(rig.on(channel), **options) for channel in rig.channels}


def plan_again(rig: Rig, plan_before: RigPlan, **changed: Any) -> RigPlan:
    """Return the plan of `rig` with the arguments of `plan_before`, except those `changed`."""
    same: dict[str, Any] = {
        "bitrate_bit_s": plan_before.timing.bitrate_bit_s,
        "period_ns": plan_before.timing.period_ns,
        "axes": plan_before.axes,
        "assumptions": plan_before.assumptions,
    }
    return plan(rig, **{**same, **changed})


def bitrates_that_fit(rig: Rig, plan_before: RigPlan) -> tuple[int, ...]:
    """Return the bit rates of CiA 301 at which the plan `plan_before` of `rig` would fit."""
    return tuple(rate for rate in CIA_301_BIT_RATES if plan_again(rig, plan_before, bitrate_bit_s=rate).fits)


def shortest_period_ns(rig: Rig, plan_before: RigPlan) -> int | None:
    """Return the shortest period, in whole microseconds, at which the plan would fit; None if none up to 1 s does."""
    steps = range(SHORTEST_NS // STEP_NS, LONGEST_NS // STEP_NS + 1)
    at = bisect_left(steps, True, key=lambda step: plan_again(rig, plan_before, period_ns=step * STEP_NS).fits)
    return steps[at] * STEP_NS if at < len(steps) else None


def largest_axes(rig: Rig, plan_before: RigPlan) -> int:
    """Return the number of such axes that the bus can carry, at most 16."""
    return bisect_left(range(1, MAX_AXES + 1), True, key=lambda axes: not plan_again(rig, plan_before, axes=axes).fits)
