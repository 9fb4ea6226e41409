"""Scan of a bus: its nodes and their identities, without a write to any device.

The scan requests the device type (1000h) of every node id once, with one request per millisecond. Then it
reads further objects of the nodes that answered, in parallel. Nodes that only send heartbeats or boot-ups
are found by these. `host.devices.lss` finds devices without a node id.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from coulombus.eds.cia301 import CobId, NmtState
from coulombus.eds.data import decode
from coulombus.eds.drive_axis import of_axis
from coulombus.eds.drive_scale import POLARITY, SCALE_OBJECTS, VELOCITY_UNIT
from coulombus.eds.reader import Variable
from coulombus.eds.sdo_frames import head
from coulombus.host.devices.running_host import FILTERS, check_alone
from coulombus.host.errors import AnswerUntrusted, HostError
from coulombus.host.sdo.sdo_client import BusAnswers, run_transfers
from coulombus.host.sdo.transfers import SdoSilent, Transfer, upload
from coulombus.wire.address import BusAddress
from coulombus.wire.bus_link import BusFrame, BusLink, FrameLink

__all__ = ["ASKED", "IDENTITY", "TIMEOUT_S", "TOLD", "NodeAnswers", "scan", "survey", "trouble"]

IDENTITY = ((0x1000, 0), (0x1018, 1), (0x1018, 2), (0x1018, 3), (0x1018, 4))
"""Numeric objects: device type, identity."""
ASKED = (
    *IDENTITY,
    *((0x6502, 0), (0x6075, 0), (0x6076, 0), (0x6410, 1), *SCALE_OBJECTS, (VELOCITY_UNIT, 0), POLARITY),
    *((0x6301, 1), (0x6302, 1), (0x6131, 1), (0x6132, 1)),
)
"""Numeric objects for a rig file: identity, a drive's modes, rated current and torque, scale and polarity,
units of CiA 404.
"""
TOLD = ((0x1008, 0), (0x1009, 0), (0x100A, 0))
"""Text objects: the device's name, hardware version and software version."""
VISIBLE_STRING = 0x0009
NODES = range(1, 128)
TIMEOUT_S, PACE_S = 0.5, 1e-3
"""Time-out of an answer; time between requests to two node ids."""
SILENT = 2
"""Number of requests in a row without an answer after which a node is no longer read."""
MOST_TEXT = 1000
TEXT = Variable(0x1008, 0, "", VISIBLE_STRING, "const", None, False, None, None, False, 0)

ACKNOWLEDGE, BUS_OFF, WIRE = 0x020, 0x040, 0x188
"""Classes of error frames (``linux/can/error.h``): no acknowledge; bus off; violations."""


@dataclass(frozen=True)
class NodeAnswers:
    """Answers of one node, without the objects that it lacks.

    Attributes
    ----------
    state : its NMT state; None without a heartbeat
    answers_sdo : whether the node answers SDO; else only its heartbeat or boot-up was heard
    twice : two devices have this node id (`host.sdo.sdo_client`)
    doubt : reason why its type and identity are not reliable, or ""
    """

    node_id: int
    numbers: Mapping[tuple[int, int], int] = field(default_factory=dict)
    texts: Mapping[tuple[int, int], str] = field(default_factory=dict)
    state: NmtState | None = None
    answers_sdo: bool = True
    twice: bool = False
    doubt: str = ""

    @property
    def identity(self) -> tuple[int, int]:
        """Vendor id and product code, 1018h:01 and :02; 0 for missing ones."""
        return self.numbers.get((0x1018, 1), 0), self.numbers.get((0x1018, 2), 0)

    @property
    def profile(self) -> int:
        """The CANopen profile in 1000h, 402 for a drive."""
        return self.numbers.get((0x1000, 0), 0) & 0xFFFF

    @property
    def name(self) -> str:
        """The device's name and versions, or ""."""
        return " ".join(self.texts[place] for place in TOLD if place in self.texts)

    @property
    def remark(self) -> str:
        """Problem of the node, or ""."""
        if self.twice:
            return f"node {self.node_id} answers requests twice, or differently: two devices have this node id"
        if self.doubt:
            return self.doubt if self.doubt.startswith(f"node {self.node_id}") else f"node {self.node_id}: {self.doubt}"
        if not self.answers_sdo:
            state = f"its heartbeat says {self.state.name}" if self.state is not None else "it was heard"
            return f"node {self.node_id} answers no SDO; {state}"
        return ""

    def __str__(self) -> str:
        vendor, product = self.identity
        return (
            f"node {self.node_id}: {self.name or 'no name'}, CiA {self.profile}, 1018h {vendor:#010x} {product:#010x}"
        )


@dataclass
class _Heard:
    """Received heartbeats and SDO responses of each node."""

    states: dict[int, NmtState] = field(default_factory=dict)
    answers: BusAnswers = field(default_factory=BusAnswers)
    answering: set[int] = field(default_factory=set)

    def hear(self, frame: BusFrame) -> None:
        """Handle a frame: heartbeat, boot-up, or SDO response."""
        node_id = frame.can_id & 0x7F
        if frame.can_id == CobId.HEARTBEAT + node_id and node_id and frame.length == 1 and frame.data:
            state = frame.data[0] & 0x7F
            if state in tuple(NmtState):  # a boot-up is followed by PRE-OPERATIONAL
                self.states[node_id] = NmtState(state) if state else NmtState.PRE_OPERATIONAL
        elif frame.can_id == CobId.SDO_TX + node_id and node_id:
            self.answering.add(node_id)
            self.answers.hear(frame)

    def listen(self, link: FrameLink, seconds: float) -> None:
        """Handle all frames for `seconds`."""
        until_ns = link.now_ns() + round(seconds * 1e9)
        while (frame := link.receive(until_ns)) is not None:
            self.hear(frame)


def _nothing(label: str, done: float, total: float) -> None:
    pass


def scan(
    link: FrameLink,
    *,
    numbers: Sequence[tuple[int, int]] = IDENTITY,
    listen_s: float = 0.0,
    timeout_s: float = TIMEOUT_S,
    progress: Callable[[str, float, float], None] = _nothing,
) -> tuple[NodeAnswers, ...]:
    """Return the answers of each node on a bus, ordered by node id.

    Parameters
    ----------
    numbers : objects of at most four bytes to read, besides the texts `TOLD`
    listen_s : time from the beginning for heartbeats and boot-ups [s]
    timeout_s : time-out of an answer [s]
    progress : called with a label, finished seconds or node ids, and their total
    """
    heard, begin_ns = _Heard(), link.now_ns()
    for node_id in NODES:
        heard.answers.node(node_id).ask(head(0x40, 0x1000, 0))
        link.send(CobId.SDO_RX + node_id, head(0x40, 0x1000, 0))
        heard.listen(link, PACE_S)
        progress("asking", node_id, NODES[-1])
    heard.listen(link, timeout_s)
    values: dict[int, dict[tuple[int, int], bytes]] = {node_id: {} for node_id in sorted(heard.answering)}
    silent = dict.fromkeys(values, 0)
    places = dict.fromkeys(values, (*numbers, *TOLD))
    current: dict[int, tuple[int, int]] = {}
    doubts: dict[int, str] = {}

    def transfers(node_id: int) -> Iterator[Transfer[bytes]]:
        for place in places[node_id]:
            if silent[node_id] >= SILENT:
                return
            current[node_id] = place
            yield upload(*place, most=MOST_TEXT, block=False)

    def record(node_id: int, value: bytes | HostError) -> None:
        if isinstance(value, bytes):
            values[node_id][current[node_id]] = value
            silent[node_id] = 0
        else:
            if isinstance(value, AnswerUntrusted) and current[node_id] in IDENTITY:
                doubts.setdefault(node_id, str(value))
            silent[node_id] += isinstance(value, SdoSilent | AnswerUntrusted)

    run_transfers(
        link, {node_id: transfers(node_id) for node_id in values}, timeout_s, record, heard.answers, heard.hear
    )
    while (left_s := listen_s - (link.now_ns() - begin_ns) / 1e9) > 0:
        progress("listening", listen_s - left_s, listen_s)
        heard.listen(link, min(left_s, 0.2))
    twice = heard.answers.duplicate_node_ids
    return tuple(
        NodeAnswers(
            node_id,
            {p: int.from_bytes(raw, "little") for p, raw in contents.items() if p in numbers and 0 < len(raw) <= 4},
            {p: text for p, raw in contents.items() if p in TOLD and (text := _text(raw))},
            heard.states.get(node_id),
            node_id in values,
            node_id in values and node_id in twice,
            doubts.get(node_id, ""),
        )
        for node_id in sorted(heard.answering | heard.states.keys())
        for contents in (values.get(node_id, {}),)
    )


def _text(raw: bytes) -> str:
    text = decode(TEXT, raw)
    assert isinstance(text, str)
    return "".join(letter for letter in text if letter.isprintable()).strip()[:60]


def survey(address: BusAddress, drive_axis: int = 1) -> tuple[NodeAnswers, ...]:
    """Return the answers of all nodes that answer SDO, with the objects for a rig file.

    Parameters
    ----------
    drive_axis : axis of a multi-axis drive, whose objects are read besides those of the first axis

    Raises
    ------
    BusUnavailable
        the bus does not exist
    SafetyTrip
        a host is active on the bus, and a hand may be on the handle
    """
    numbers = tuple(dict.fromkeys((*ASKED, *((of_axis(index, drive_axis), sub) for index, sub in ASKED))))
    with BusLink(address, FILTERS) as link:
        check_alone(link, address)
        return tuple(answers for answers in scan(link, numbers=numbers) if answers.answers_sdo)


def trouble(error_frames: int, classes: int, anybody: bool) -> str:
    """Return the likely cause of error frames; "" without any.

    Parameters
    ----------
    classes : classes of all error frames, bits of ``linux/can/error.h``
    anybody : whether a node was heard
    """
    if not error_frames:
        return ""
    if classes & BUS_OFF:
        return f"{error_frames} error frames, and this controller went bus-off: a wrong bit rate or a short circuit is likely"
    if classes & ACKNOWLEDGE and not anybody:
        return "nothing acknowledges: is a device powered and connected, at this bit rate, and the bus terminated?"
    if classes & WIRE or not anybody:
        return (
            f"{error_frames} error frames: a wrong bit rate or a missing termination (120 ohm at both ends) is likely"
        )
    return f"{error_frames} error frames"
