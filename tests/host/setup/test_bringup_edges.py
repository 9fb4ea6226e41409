"""Bring-up over SDO against devices that are tables: what is sent in which order, what is refused,
and how each answer that differs is told.
"""

from __future__ import annotations

from collections import deque

import pytest

from coulombus.eds.cia301 import NmtCommand, NmtState
from coulombus.eds.reader import parse_eds
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import Image, Phase, Trip
from coulombus.host.errors import AnswerUntrusted, DeviceMismatch, NodeMissing, SdoAborted
from coulombus.host.sdo.sdo_client import BusAnswers
from coulombus.host.setup import bringup
from coulombus.host.setup.bringup import (
    bring_up,
    check_plan,
    configure,
    meet,
    plans_of,
    release,
    shut_down,
    wait_operational,
)
from coulombus.host.setup.settings import Setting
from coulombus.rigs.rig import RigError, load_rig
from coulombus.wire.bus_link import BusFrame
from eds_edit import edit, gone
from foreign_eds import BRAKE, MOTOR
from foreign_rigs import Part, brake, drive, rig_of

MS = 1_000_000
SETTLE, BEAT = ("wait", 50 * MS), ("wait", 50 * MS)
PRE_OPERATIONAL, START = ("nmt", 0x80), ("nmt", 0x01)
OURS = {(0x1000, 0): b"\x92\x01\x02\x00", (0x1018, 1): b"\xc0\x04\x00\x00", (0x1018, 2): b"\x02\x04\x00\x00"}


REFUSED = 0x06090030
SILENT = b""
"""A fault of a server is its abort code, or the bytes that it answers: none here."""


class Device:
    """An SDO server that keeps what is written; the test changes what it answers."""

    def __init__(self, node_id, log, identity):
        self.node_id, self.log, self.values, self.faults = node_id, log, dict(identity), {}
        self.transfer, self.left, self.toggle = "segmented", b"", 0
        self.second = None  # what a second device of this node id refuses: an index, with its sub-index

    def download(self, index, subindex, data):
        self.values[index, subindex] = data

    def answer(self, request):
        """Return the messages that answer a request."""
        command, index, subindex = request[0], int.from_bytes(request[1:3], "little"), request[3]
        if command >> 5 == 3:
            return [self.segment()]
        if command >> 5 not in (1, 2):
            return []
        writes, data = command >> 5 == 1, request[4 : 8 - (command >> 2 & 3)]
        self.log.append((self.node_id, *(("write", index, subindex, data) if writes else ("read", index, subindex))))
        fault = self.faults.get(("write" if writes else "read", index))
        if isinstance(fault, int):
            return [b"\x80" + request[1:4] + fault.to_bytes(4, "little")]
        if fault is not None:
            return [fault] if fault else []
        if writes:
            self.download(index, subindex, data)
            return [b"\x60" + request[1:4] + bytes(4)]
        return [self.upload(request[1:4], self.values[index, subindex])]

    def upload(self, place, data):
        if "expedited" in self.transfer and 0 < len(data) <= 4:
            command = 0x42 if "unsized" in self.transfer else 0x43 | (4 - len(data)) << 2
            return bytes((command,)) + place + data.ljust(4, b"\0")
        self.left, self.toggle = data, 0
        size = b"\x40" + place + bytes(4), b"\x41" + place + len(data).to_bytes(4, "little")
        return size["unsized" not in self.transfer]

    def segment(self):
        part, self.left = self.left[:7], self.left[7:]
        command = self.toggle | (7 - len(part)) << 1 | (not self.left)
        self.toggle ^= 0x10
        return bytes((command,)) + part.ljust(7, b"\0")


class Wire:
    """A control plane whose nodes are tables, and whose time only is asked for."""

    sdo_timeout_s = 0.125

    def __init__(self, *plans):
        self.log, self.states, self.later = [], {}, []
        self.devices, self.t, self.waiting = {}, 0, deque()
        self.late_ns, self.late = 0, deque()  # of a second device's answers
        for plan in plans:
            identity = {(0x1018, sub): value.to_bytes(4, "little") for sub, _, value in plan.identity}
            identity[0x1000, 0] = (plan.description.default(0x1000, 0, 0) or 0).to_bytes(4, "little")
            self.devices[plan.node_id] = Device(plan.node_id, self.log, identity)
            self.states[plan.node_id] = NmtState.OPERATIONAL

    def now_ns(self):
        return self.t

    def send(self, can_id, data=b"", length=None):
        if can_id == 0x000:
            self.log.append(("nmt", data[0]))
            assert data[1] == 0
            return
        node_id = can_id - 0x600
        device = self.devices[node_id]
        for answer in device.answer(data):
            self.put(0x580 + node_id, answer)
        index = int.from_bytes(data[1:3], "little")
        if data[0] == 0x40 and device.second in (index, (index, data[3])):
            (self.put_late if self.late_ns else self.put)(0x580 + node_id, b"\x80" + data[1:4] + b"\0\0\2\6")

    def put(self, can_id, answer):
        self.waiting.append(BusFrame(self.t, can_id, answer, len(answer)))

    def put_late(self, can_id, answer):
        self.late.append(BusFrame(self.t + self.late_ns, can_id, answer, len(answer)))

    def receive(self, until_ns):
        if self.waiting:
            return self.waiting.popleft()
        if self.late and self.late[0].t_ns <= until_ns:
            return self.late.popleft()
        if until_ns > self.t:
            self.log.append(("wait", until_ns - self.t))
            self.t = until_ns
        return None

    def wait_ns(self, duration_ns):
        assert isinstance(duration_ns, int)
        self.log.append(("wait", duration_ns))
        self.t += duration_ns
        if self.later:
            self.later.pop(0)()

    def nmt_state(self, node_id):
        return self.states[node_id]


def plans(motor=MOTOR, brake_=BRAKE, *overrides):
    return plans_of(Controllers(rig_of(Part(motor), Part(brake_), *overrides), "hybrid"))


def device_of(motor=MOTOR, *overrides, writes=None, read_backs=None):
    """Return the motor as bring-up sees it, known to be ours, and its server."""
    plan = plans(motor, BRAKE, *overrides)[0]
    if writes is not None:
        object.__setattr__(plan, "writes", tuple(writes))
    if read_backs is not None:
        object.__setattr__(plan, "read_backs", tuple(read_backs))
    wire = Wire(plan)
    device = bringup._DeviceAccess(wire, plan, BusAnswers())
    device.identity = (0x4C0, 0x402)
    return device, wire.devices[1]


# one device


def test_a_device_waits_as_long_as_the_rig_file_says_and_is_nobody_s_yet():
    device, server = device_of()
    assert (device.name, device.node_id, device.losses) == ("motor", 1, [])
    server.faults["read", 0x6071] = SILENT
    with pytest.raises(NodeMissing):
        device.upload(0x6071, 0)
    assert server.log == [(1, "read", 0x6071, 0), ("wait", 125 * MS)]
    assert bringup._DeviceAccess(Wire(), device.plan, BusAnswers()).identity == (0, 0)


@pytest.mark.parametrize(
    ("fault", "kind", "text"),
    [
        (REFUSED, SdoAborted, "motor (node 1), object 6071h:00 Target torque: abort 06090030h, "),
        (
            SILENT,
            NodeMissing,
            "motor (node 1) does not answer SDO: check power, cable, bit rate and node id",
        ),
        (
            b"\x43\x18\x10\x02\x00\x00\x00\x00",
            AnswerUntrusted,
            "motor (node 1), object 6071h:00 Target torque: it answers about 1018h:02: does another SDO client ask it now, "
            "or have two devices this node id?",
        ),
        (
            b"\xc1\x71\x60\x00\x00\x00\x00\x00",
            AnswerUntrusted,
            "motor (node 1), object 6071h:00 Target torque: command C1h",
        ),
    ],
)
def test_what_an_answer_is_that_is_none(fault, kind, text):
    device, server = device_of()
    server.faults["read", 0x6071] = server.faults["write", 0x6071] = fault
    for ask in (lambda: device.upload(0x6071, 0), lambda: device.write(Setting(0x6071, 0, 5))):
        with pytest.raises(kind) as told:
            ask()
        assert str(told.value).startswith(text)
        if kind is AnswerUntrusted:
            assert str(told.value).endswith(": does another SDO client ask it now, or have two devices this node id?")


def test_an_object_that_the_file_lacks_is_named_by_its_number():
    device, server = device_of()
    server.faults["read", 0x5FFF] = b"\x60\xff\x5f\x01" + bytes(4)
    with pytest.raises(AnswerUntrusted, match=r"^motor \(node 1\), object 5FFFh:01: command 60h is no upload "):
        device.upload(0x5FFF, 1)


@pytest.mark.parametrize("transfer", ["segmented", "unsized segmented", "expedited", "unsized expedited"])
def test_bytes_behind_an_object_are_cut_only_of_four_bytes_whose_number_is_not_told(transfer):
    device, server = device_of()
    server.transfer = transfer
    server.values |= {(0x6071, 0): b"\xfe\xff\xff\xff", (0x5FFF, 1): b"\x01\0\0\0"}
    assert device.upload(0x6071, 0) == (b"\xfe\xff" if transfer == "unsized expedited" else b"\xfe\xff\xff\xff")
    assert device.upload(0x5FFF, 1) == b"\x01\0\0\0"


@pytest.mark.parametrize("length", [0, 3, 4, 5])
def test_an_identity_has_four_bytes(length):
    device, server = device_of()
    server.values[0x1018, 1] = bytes(range(1, length + 1))
    if length == 4:
        assert device.number(0x1018, 1) == 0x04030201
        return
    with pytest.raises(DeviceMismatch) as told:
        device.number(0x1018, 1)
    text = f"has {length} bytes in the device; expected 4, an UNSIGNED32"
    assert str(told.value) == f"motor (node 1), object 1018h:01 Vendor-ID {text}"


@pytest.mark.parametrize(
    ("index", "identity", "listed", "written"),
    [
        (0x2001, (0x4C0, 0x402), False, True),
        (0x2001, (0x4C0, 0x404), False, False),
        (0x2001, (0x99, 0x402), False, False),
        (0x2001, (0x99, 0x402), True, True),
        (0x1017, (0x99, 0x402), False, True),
        (0x6071, (0x99, 0x402), False, True),
    ],
)
def test_a_maker_s_own_object_is_written_in_our_device_or_where_it_is_listed(index, identity, listed, written):
    device, server = device_of()
    device.identity = identity
    setting = Setting(index, 0, 5, listed=listed)
    if written:
        device.write(setting)
        assert [row[1:4] for row in server.log] == [("write", index, 0)]
        return
    with pytest.raises(DeviceMismatch) as told:
        device.write(setting)
    assert str(told.value) == (
        "motor (node 1), object 2001h:00 Set-point zero time-out us is the maker's own object, and the device is not ours "
        f"(1018h: vendor {identity[0]:#010x}, product {identity[1]:#010x}); take the EDS file of this very device"
    )
    assert server.log == []


@pytest.mark.parametrize(
    ("unless_equal", "there", "log"),
    [
        (False, b"\x05\x00", ["write"]),
        (True, b"\x05\x00", ["read"]),
        (True, b"\x06\x00", ["read", "write"]),
        (True, b"\x05\x00\x00", ["read", "write"]),
    ],
)
def test_what_a_device_has_already_is_not_written_where_it_is_read_first(unless_equal, there, log):
    device, server = device_of()
    server.values[0x6071, 0] = there
    device.write(Setting(0x6071, 0, 5, unless_equal=unless_equal))
    assert [row[1] for row in server.log] == log
    assert server.values[0x6071, 0] == b"\x05\x00"


def test_a_device_is_known_by_its_type_and_its_identity():
    device, server = device_of()
    device.identity = (0, 0)
    assert device.identify() == []
    assert device.identity == (0x4C0, 0x402)
    server.values |= {
        (0x1000, 0): b"\x91\x01\0\0",
        (0x1018, 1): b"\x99\0\0\0",
        (0x1018, 2): b"\x03\x04\0\0",
    }
    assert device.identify() == [
        "motor (node 1): device type 1000h:00 is 0x00000191, the EDS file says 0x00020192",
        "motor (node 1): vendor id 1018h:01 is 0x00000099, the rig file says 0x000004c0",
        "motor (node 1): product code 1018h:02 is 0x00000403, the rig file says 0x00000402",
    ]
    assert device.identity == (0x99, 0x403)


def test_what_nobody_tells_of_a_device_is_not_compared():
    device, server = device_of(gone(edit(MOTOR, "1000", DefaultValue=""), "1018sub2"))
    server.values[0x1000, 0] = b"\x01\x02\x03\x04"
    assert device.identify() == []
    assert device.identity == (0x4C0, 0)
    lean, _ = device_of(gone(MOTOR, "1018sub1"))
    assert lean.identify() == []
    assert lean.identity == (0, 0x402)


@pytest.mark.parametrize(("modes", "refused"), [(b"\0\x02\0\0", False), (b"\xff\xfd\xff\xff", True)])
def test_a_drive_is_asked_for_its_modes(modes, refused):
    device, server = device_of()
    server.values[0x6502, 0] = modes
    if not refused:
        device.check_modes()
        assert server.log == [(1, "read", 0x6502, 0)]
        return
    with pytest.raises(DeviceMismatch) as told:
        device.check_modes()
    text = "motor: supported drive modes 6502h = 0xfffffdff do not include cyclic synchronous torque"
    assert str(told.value) == text


def test_a_device_without_modes_is_not_asked_for_them():
    device, server = device_of(gone(MOTOR, "6502"))
    device.check_modes()
    object.__setattr__(device.plan, "mode", None)
    device.description = parse_eds(MOTOR.encode(), "motor.eds")
    device.check_modes()
    assert server.log == []


def test_what_is_written_is_read_back_whole_and_each_difference_is_told():
    """The text of the whole configuration comes at once."""
    rows = [Setting(0x6071, 0, 5), Setting(0x6072, 0, 97), Setting(0x1017, 0, 50)]
    backs = [((s.index, s.subindex), s.value) for s in rows]
    device, server = device_of(writes=rows, read_backs=backs)
    assert device.configure() == []
    assert [row[1:3] for row in server.log] == [(way, s.index) for way in ("write", "read") for s in rows]
    device, server = device_of(writes=(), read_backs=backs)
    server.values |= {(0x6071, 0): b"\x05", (0x6072, 0): b"\x62\0", (0x1017, 0): b"\x32\0"}
    assert device.configure() == [
        "motor (node 1), object 6071h:00 Target torque has 1 bytes in the device, 2 in motor.eds",
        "motor (node 1), object 6072h:00 Max torque: wrote 0x61, reads back 0x62",
    ]


@pytest.mark.parametrize(("lost", "why", "told"), [("a loss", "a reason", "a loss"), ("", "a reason", "a reason")])
def test_what_a_device_refuses_and_the_host_can_do_without_is_a_loss(lost, why, told):
    rows = [Setting(0x6071, 0, 5, soft=True, lost=lost, why=why), Setting(0x6072, 0, 97, soft=True)]
    device, server = device_of(writes=rows, read_backs=[((0x6071, 0), 5), ((0x6072, 0), 97)])
    server.faults["write", 0x6071] = REFUSED
    assert device.configure() == []
    (loss,) = device.losses
    assert loss.startswith("motor (node 1), object 6071h:00 Target torque: abort 06090030h")
    assert loss.endswith(f"; {told}")
    assert [row[1:3] for row in server.log] == [("write", 0x6071), ("write", 0x6072), ("read", 0x6072)]


def test_what_a_device_refuses_and_the_host_needs_ends_bring_up():
    device, server = device_of(writes=[Setting(0x6071, 0, 5), Setting(0x6072, 0, 97)], read_backs=())
    server.faults["write", 0x6071] = REFUSED
    with pytest.raises(SdoAborted, match="6071h:00 Target torque: abort 06090030h"):
        device.configure()
    assert len(server.log) == 1
    assert device.losses == []


def test_an_object_that_only_the_rig_file_describes_is_read_back_in_its_type():
    row = Setting(0x5FFF, 1, -5, type="INTEGER16", listed=True)
    device, server = device_of(writes=[row], read_backs=[((0x5FFF, 1), -5)])
    assert device.configure() == []
    assert server.values[0x5FFF, 1] == b"\xfb\xff"


# all devices


def test_a_cycle_that_does_not_fit_on_its_bus_is_refused():
    check_plan(load_rig("bench"))
    with pytest.raises(DeviceMismatch, match="the cycle does not fit on the bus"):
        check_plan(load_rig("bench", ("bus.bitrate_bit_s=125000",)))


def test_the_plans_of_all_axes_are_made_once():
    k = Controllers(load_rig("two_axes"), "hybrid")
    found = plans_of(k)
    assert [plan.name for plan in found] == ["left.motor", "left.brake", "right.motor", "right.brake"]
    assert plans_of(k) is found


def test_devices_that_are_set_up_already_are_met():
    k = Controllers(load_rig("bench"), "hybrid")
    found = list(plans_of(Controllers(load_rig("bench"), "active")))
    meet(found, k)
    assert plans_of(k) == tuple(found)


def prepared(*overrides):
    k = Controllers(load_rig("bench", overrides), "hybrid")
    wire = Wire(*plans_of(k))
    for plan, device in zip(plans_of(k), wire.devices.values(), strict=True):
        device.transfer = "expedited"
        device.values |= {(0x6502, 0): b"\0\x02\0\0", (0x1014, 0): (0x80 + plan.node_id).to_bytes(4, "little")}
    return k, wire


def test_bring_up_knows_all_devices_before_it_writes_to_one_and_starts_them_last():
    k, wire = prepared()
    assert bring_up(k, wire) == ()
    assert wire.log[:2] == [PRE_OPERATIONAL, SETTLE]
    steps = wire.log[2:]
    known = [(node, "read", *at) for node in (1, 2) for at in ((0x1000, 0), (0x1018, 1), (0x1018, 2))]
    assert steps[:7] == [*known, (1, "read", 0x6502, 0)]
    assert {row[0] for row in steps[7:-2]} == {1, 2}
    assert steps[-2:] == [START, ("wait", 150 * MS)]
    assert [row for row in steps if row[0] == "nmt"] == [START]


def test_what_bring_up_leaves_out_is_told_device_by_device():
    k = Controllers(rig_of(drive("A"), brake("404")), "hybrid")
    wire = Wire(*plans_of(k))
    for device in wire.devices.values():
        device.values[0x6502, 0] = b"\0\x02\0\0"
        device.values[0x6061, 0] = b"\x0a"
        device.values |= {(0x608F, 1): b"\0\x20\0\0", (0x608F, 2): b"\x01\0\0\0"}
        device.values |= {(s.index, s.subindex): b"" for plan in plans_of(k) for s in plan.writes if s.unless_equal}
    refused = REFUSED
    wire.devices[1].faults["write", 0x6007] = wire.devices[2].faults["write", 0x6340] = refused
    losses = bring_up(k, wire)
    motor, brake_ = plans_of(k)
    assert losses[: len(motor.losses)] == motor.losses
    assert losses[len(motor.losses)].startswith("motor (node 1), object 6007h:00")
    assert losses[len(motor.losses) + 1 : -1] == brake_.losses
    assert losses[-1].startswith("brake (node 2), object 6340h:01")


@pytest.mark.parametrize(
    ("override", "error"),
    [("bus.bitrate_bit_s=125000", DeviceMismatch), ("limits.brake_torque_Nm=1.0", RigError)],
)
def test_a_rig_that_cannot_run_is_refused_before_anything_is_sent(override, error):
    k, wire = prepared(override)
    with pytest.raises(error):
        bring_up(k, wire)
    assert wire.log == []


def test_all_that_is_wrong_with_the_plans_is_told_before_anything_is_sent():
    found = plans(gone(MOTOR, "1000"), gone(BRAKE, "1000"))
    wire = Wire(*plans())
    with pytest.raises(DeviceMismatch) as told:
        configure(found, wire)
    first, second = (str(plan.problems[0]) for plan in found)
    assert str(told.value) == f"{first}; {second}"
    assert wire.log == []


def test_all_that_differs_in_the_devices_is_told_before_anything_is_written():
    k, wire = prepared()
    for device in wire.devices.values():
        device.values[0x1018, 2] = b"\x01\0\0\0"
    with pytest.raises(DeviceMismatch) as told:
        bring_up(k, wire)
    assert str(told.value) == (
        "motor (node 1): product code 1018h:02 is 0x00000001, the rig file says 0x00000402; "
        "brake (node 2): product code 1018h:02 is 0x00000001, the rig file says 0x00000404"
    )
    assert not [row for row in wire.log if "write" in row]
    assert wire.log[-1] == SETTLE  # a second device may answer yet
    assert START not in wire.log


def test_all_that_is_read_back_otherwise_is_told_and_nothing_is_started():
    k, wire = prepared()
    for device in wire.devices.values():
        keep = device.download

        def cut(index, subindex, data, keep=keep):
            keep(index, subindex, b"\x07\0" if index == 0x1017 else data)

        device.download = cut
    with pytest.raises(DeviceMismatch) as told:
        bring_up(k, wire)
    text = "({}), object 1017h:00 Producer heartbeat time: wrote 0x32, reads back 0x7"
    assert str(told.value) == f"motor {text.format('node 1')}; brake {text.format('node 2')}"
    assert START not in wire.log


TWO_DEVICES = "two devices answer as node {}: take one off the bus, and give the other another id (coulombus lss)"


@pytest.mark.parametrize(("node", "name"), [(1, "motor"), (2, "brake")])
def test_a_second_device_is_refused_before_anything_is_written(node, name):
    k, wire = prepared()
    wire.devices[node].second = 0x1000
    with pytest.raises(DeviceMismatch) as told:
        bring_up(k, wire)
    assert str(told.value) == TWO_DEVICES.format(f"{node} ({name})")
    assert not [row for row in wire.log if "write" in row]
    assert wire.log[-1] == SETTLE
    assert START not in wire.log


def test_a_second_device_explains_what_differs():
    """Its answer comes behind that of the first device, which is another one than the rig's."""
    k, wire = prepared()
    wire.devices[2].values[0x1018, 2] = b"\x01\0\0\0"
    wire.devices[2].second, wire.late_ns = 0x1018, 20 * MS
    with pytest.raises(DeviceMismatch) as told:
        bring_up(k, wire)
    assert str(told.value) == TWO_DEVICES.format("2 (brake)")


def test_a_second_device_that_answers_the_last_request_only_is_refused():
    k, plain = prepared()
    bring_up(k, plain)
    node, _, *last = [row for row in plain.log if "read" in row][-1]
    k, wire = prepared()
    wire.devices[node].second = tuple(last)
    with pytest.raises(DeviceMismatch, match=f"two devices answer as node {node}"):
        bring_up(k, wire)
    assert START not in wire.log


# after the start


def beating(*seconds):
    return plans(
        MOTOR, BRAKE, *(f"{node}.heartbeat_s={s}" for node, s in zip(("motor", "brake"), seconds, strict=True))
    )


def test_the_slowest_heartbeat_is_waited_for_twice():
    for seconds in ((0.02, 0.07), (0.07, 0.02)):
        found = beating(*seconds)
        wire = Wire(*found)
        wait_operational(found, wire)
        assert wire.log == [("wait", 190 * MS)]


@pytest.mark.parametrize("late", range(1, 8))
@pytest.mark.parametrize("node", [1, 2])
def test_five_more_heartbeats_are_waited_for(late, node):
    found = plans()
    wire = Wire(*found)
    wire.states[node] = NmtState.PRE_OPERATIONAL
    wire.later = [lambda: None] * late + [lambda: wire.states.update({node: NmtState.OPERATIONAL})]
    if late <= 5:
        wait_operational(found, wire)
        assert wire.log == [("wait", 150 * MS), *([BEAT] * late)]
        return
    with pytest.raises(NodeMissing) as told:
        wait_operational(found, wire)
    assert wire.log == [("wait", 150 * MS), *([BEAT] * 5)]
    text = f"(node {node}) says PRE_OPERATIONAL after NMT start; OPERATIONAL is expected"
    assert str(told.value) == f"{('motor', 'brake')[node - 1]} {text}"


def test_a_node_that_was_not_heard_is_missing():
    found = plans()
    wire = Wire(*found)
    wire.states[2] = None
    with pytest.raises(NodeMissing, match=r"^brake \(node 2\) was not heard after NMT start; OPERATIONAL is expected$"):
        wait_operational(found, wire)


@pytest.mark.parametrize("gone_", [("1017", "100C"), ("1017",)], ids=["mute", "guarded"])
def test_a_node_that_has_no_heartbeat_is_not_waited_for(gone_):
    found = plans(gone(MOTOR, *gone_))
    wire = Wire(*found)
    wire.states[1] = None
    wait_operational(found, wire)
    assert wire.log == [("wait", 150 * MS)]


# the end


def takes_off(node_id):
    return node_id, "write", 0x1016, 1, bytes(4)


def ended(k, states, phase=Phase.DONE, trip=Trip.NONE):
    for axis, state in enumerate(states):
        k.host["phase"][axis], k.host["trip"][axis] = phase, trip
        k.host["image"][axis, Image.STATUSWORD] = state
    return k


DISABLED, ENABLED = 0x0250, 0x0237


@pytest.mark.parametrize(
    ("states", "taken_off"),
    [
        ((DISABLED, DISABLED), True),
        ((DISABLED, ENABLED), False),
        ((ENABLED, DISABLED), False),
        ((0xFFD0, 0xFF8F), False),
        ((0x0251, DISABLED), False),
    ],
)
def test_the_watch_is_taken_off_where_every_drive_is_disabled(states, taken_off):
    k = ended(Controllers(load_rig("two_axes"), "hybrid"), states)
    wire = Wire(*plans_of(k))
    release(k, wire)
    assert wire.log == [PRE_OPERATIONAL, *(takes_off(plan.node_id) for plan in plans_of(k) if taken_off)]


@pytest.mark.parametrize(("phase", "trip"), [(Phase.DISABLE, Trip.NONE), (Phase.DONE, Trip.SPEED)])
def test_the_watch_stays_where_the_end_is_not_a_normal_one(phase, trip):
    k = ended(Controllers(load_rig("bench"), "hybrid"), (DISABLED,), phase, trip)
    wire = Wire(*plans_of(k))
    release(k, wire)
    assert wire.log == [PRE_OPERATIONAL]


@pytest.mark.parametrize("fault", [REFUSED, SILENT])
def test_a_node_that_does_not_answer_at_the_end_keeps_none_from_its_own(fault):
    k = ended(Controllers(load_rig("bench"), "hybrid"), (DISABLED,))
    wire = Wire(*plans_of(k))
    wire.devices[1].faults["write", 0x1016] = fault
    release(k, wire)
    assert [row for row in wire.log if "write" in row] == [takes_off(1), takes_off(2)]


def test_only_a_watch_that_bring_up_has_set_is_taken_off():
    k = ended(Controllers(rig_of(Part(gone(MOTOR, "1016sub1")), Part(BRAKE)), "hybrid"), (DISABLED,))
    wire = Wire(*plans_of(k))
    release(k, wire)
    assert wire.log[1:] == [takes_off(2)]


def test_a_watch_that_only_the_rig_file_describes_is_taken_off_too():
    text = '\n[[motor.sdo]]\nindex = 0x1016\nsub = 1\ntype = "UNSIGNED32"\nvalue = 0x7F0096\n'
    rig = rig_of(Part(gone(MOTOR, "1016sub1")), Part(BRAKE), text=text)
    k = ended(Controllers(rig, "hybrid"), (DISABLED,))
    wire = Wire(*plans_of(k))
    release(k, wire)
    assert wire.log[1:] == [takes_off(1), takes_off(2)]


def test_the_nodes_are_left_where_no_pdo_acts():
    wire = Wire()
    shut_down(wire)
    assert wire.log == [PRE_OPERATIONAL, SETTLE]
    assert NmtCommand.ENTER_PRE_OPERATIONAL == 0x80
