"""Bring-up and devices of others: what is written to which device, what is refused before anything
is sent, what is read back.
"""

from __future__ import annotations

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.eds.reader import parse_eds
from coulombus.host.cycle.controller import Controller
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.errors import DeviceMismatch, NodeMissing, SdoAborted
from coulombus.host.sdo.sdo_client import BusAnswers
from coulombus.host.sdo.transfers import SdoRefused
from coulombus.host.setup import bringup
from coulombus.host.setup.bringup import bring_up, plans_of
from coulombus.host.setup.settings import encoded
from coulombus.rigs.plan.rig_plan import plan as plan_cycle
from coulombus.rigs.rig import RigError, load_rig_text
from coulombus.sim_bus.network.virtual_rig import BOOT_NS, VirtualRig
from coulombus.wire.frame import CAN_RTR_FLAG, data_bytes
from eds_edit import edit, gone
from places import CORPUS, RIGS, ROOT, beside

MOTOR, BRAKE = ((ROOT / "eds" / name).read_text() for name in ("motor.eds", "mr_brake.eds"))
BENCH = (RIGS / "bench.toml").read_text()
OURS, FOREIGN = 0x402, 0x1234
U8, I8, U16, I16, I32, U32, REAL32, TEXT = "0x5", "0x2", "0x6", "0x3", "0x4", "0x7", "0x8", "0x9"


def identified(text, vendor=FOREIGN, product=FOREIGN):
    return edit(edit(text, "1018sub1", DefaultValue=vendor), "1018sub2", DefaultValue=product)


def rig_of(motor=MOTOR, brake=BRAKE, *overrides):
    return load_rig_text(BENCH, "bench.toml", {"motor.eds": motor, "mr_brake.eds": brake}, overrides)


IS_FOREIGN = (f"motor.vendor_id={FOREIGN}", f"motor.product_code={FOREIGN}")


class Wire:
    """A rig in virtual time whose SDO requests are kept."""

    def __init__(self, rig, mode="hybrid", host_eds=None):
        self.log = []
        self.world = VirtualRig(rig, mode, on_frames=lambda frames: self.log.append(frames.copy()))
        if host_eds is not None:
            rig._descriptions["motor"] = parse_eds(host_eds.encode(), "host.eds")

    def bring_up(self, prepare=lambda motor: None):
        self.world.power_on()
        self.world.wait_ns(BOOT_NS)
        prepare(self.world.motor)
        try:
            return bring_up(self.world.controllers, self.world)
        finally:
            self.world.flush()

    def requests(self, node, specifier):
        """(index, sub-index, data) of the SDO requests of one kind to a node, in their order: 1
        downloads, 2 uploads.
        """
        frames = np.concatenate(self.log) if self.log else []
        rows = [data_bytes(int(f["word"]), 8) for f in frames if f["can_id"] == 0x600 + node]
        return [
            (row[1] | row[2] << 8, row[3], row[4 : 8 - (row[0] >> 2 & 3)]) for row in rows if row[0] >> 5 == specifier
        ]

    def written(self, node):
        return [index for index, _, _ in self.requests(node, 1)]


def device_of(plan, client):
    """A device whose SDO client is the test's."""
    device = bringup._DeviceAccess(SimpleNamespace(sdo_timeout_s=0.1), plan, BusAnswers())
    device.client = client
    return device


def makers(indices):
    return [index for index in indices if 0x2000 <= index < 0x6000]


# other makers' devices

MOTOR_PARA = edit(identified(MOTOR), "2002", ParameterName="MotorPara", DefaultValue=0)
BIT_RATES = edit(identified(MOTOR), "2001", ParameterName="CAN bit rate", DataType=U8, DefaultValue=4)
BIT_RATES = edit(BIT_RATES, "2002", ParameterName="RS232 bit rate", DataType=U8, DefaultValue=5)


@pytest.mark.parametrize("text", [MOTOR_PARA, BIT_RATES])
def test_nothing_of_another_makers_own_objects_is_written(text):
    wire = Wire(rig_of(text, BRAKE, *IS_FOREIGN))
    before = [wire.world.motor.description.default(index, 0, 1) for index in (0x2001, 0x2002)]
    losses = wire.bring_up()
    assert makers(wire.written(1)) == []
    assert 0x6072 in wire.written(1)
    assert [wire.world.motor[index, 0] for index in (0x2001, 0x2002)] == before
    assert makers(wire.written(2)) == [0x2002, 0x2001, 0x2005]  # the brake is our own
    assert ["2002h" in losses[0], "2001h" in losses[1], len(losses)] == [True, True, 2]
    assert all("motor (node 1)" in text and "1018h of the EDS file is not ours" in text for text in losses)


@pytest.mark.parametrize("device", [OURS, FOREIGN])
@pytest.mark.parametrize("rig", [OURS, FOREIGN])
@pytest.mark.parametrize("eds", [OURS, FOREIGN, ""])
def test_a_maker_s_own_objects_are_written_where_file_and_device_are_ours(eds, rig, device):
    """Neither the EDS file alone nor the rig file alone opens 2000h to 5FFFh, nor the two of them
    against the device.
    """
    text = edit(MOTOR, "1018sub2", DefaultValue=eds)
    wire = Wire(rig_of(text, BRAKE, f"motor.product_code={rig}"))

    def identify(motor):
        motor[0x1018, 2] = device

    if rig == device and eds in (rig, ""):
        wire.bring_up(identify)
        assert makers(wire.written(1)) == ([0x2002, 0x2001] if eds == OURS == device else [])
    else:
        with pytest.raises(DeviceMismatch, match="product code 1018h:02"):
            wire.bring_up(identify)
        assert wire.written(1) == wire.written(2) == []


def test_a_device_that_is_not_ours_gets_nothing_of_ours_whatever_the_plan_says():
    """The last line of defence: the gate is at the download, too."""
    (plan, _) = plans_of(Controllers(rig_of(), "hybrid"))
    device = device_of(plan, None)
    device.identity = (0x4C0, 0x403)
    with pytest.raises(DeviceMismatch, match=r"2002h.*not ours.*0x00000403"):
        device.write(next(s for s in plan.writes if s.index == 0x2002))


@pytest.mark.parametrize("after_ns", [1_000, 60_000, 300_000, 5_000_000])
@pytest.mark.parametrize("answer", [b"\x43%b\x92\x01\x00\x00", b"\x80%b\x00\x00\x02\x06"], ids=["value", "abort"])
def test_two_devices_of_one_node_id_are_told_whoever_answers_first(answer, after_ns):
    wire = Wire(rig_of())

    def twin(frame):
        if frame.data[0] >> 5 == 2:
            station.send(0x581, answer % frame.data[1:4], at_ns=frame.t_ns + after_ns)

    station = wire.world.station({0x601}, twin)
    with pytest.raises(DeviceMismatch, match=r"^two devices answer as node 1 \(motor\): take one off .*coulombus lss"):
        wire.bring_up()


def test_a_device_that_answers_late_is_no_second_device():
    """It is asked once; its answer comes behind the client's abort."""
    wire = Wire(rig_of())
    wire.world.sdo_timeout_s = 15e-6
    with pytest.raises(NodeMissing, match="does not answer SDO"):
        wire.bring_up()


def test_what_an_own_device_lacks_is_told_too():
    losses = Wire(rig_of(gone(MOTOR, "2001"), gone(BRAKE, "2005"))).bring_up()
    assert [
        re.search(r"(\w+) \(node.*: (\w+h) is not written, it is not described; ", text).groups() for text in losses
    ] == [
        ("motor", "2001h"),
        ("brake", "2005h"),
    ]
    assert Wire(rig_of()).bring_up() == ()


# values that do not fit


def test_all_values_that_do_not_fit_are_refused_at_once_and_before_anything_is_sent():
    """3000 us into 8 bits would be 184 us."""
    text = edit(edit(MOTOR, "2001", DataType=U8), "1017", HighLimit=20)
    wire = Wire(rig_of(text, edit(BRAKE, "7341sub1", LowLimit=5)))
    with pytest.raises(DeviceMismatch) as refused:
        wire.bring_up()
    outside = "is outside the EDS file's LowLimit"
    for place, what in (
        (
            "motor (node 1), object 2001h:00",
            "3000 (0xbb8) does not fit into its type, which holds 0 to 255 (motor.eds:",
        ),
        ("motor (node 1), object 1017h:00", f"50 (0x32) {outside} any and HighLimit 20 (motor.eds:"),
        ("brake (node 2), object 7341h:01", f"0 {outside} 5 and HighLimit 5000 (mr_brake.eds:"),
    ):
        assert re.search(f"{re.escape(place)}[^:;]*: {re.escape(what)}", str(refused.value)), place
    assert all(f"; change {key}" in str(refused.value) for key in ("motor.setpoint_zero_cycles", "motor.heartbeat_s"))
    assert [f for batch in wire.log for f in batch if f["can_id"] in (0x000, 0x601, 0x602)] == []


@pytest.mark.parametrize(
    ("code", "value", "data"),
    [
        (0x5, 255, b"\xff"),
        (0x5, 256, None),
        (0x5, -1, None),
        (0x2, -128, b"\x80"),
        (0x2, -129, None),
        (0x2, 128, None),
        (0x3, -2, b"\xfe\xff"),
        (0x10, -2, b"\xfe\xff\xff"),
        (0x10, 1 << 23, None),
        (0x7, 0xFFFFFFFF, b"\xff\xff\xff\xff"),
        (0x7, 1 << 32, None),
        (0x1, 1, b"\x01"),
        (0x1, 2, None),
        (0x8, 0, None),
        (0x9, 0, None),
    ],
)
def test_no_value_is_ever_cut(code, value, data):
    text = edit(MOTOR, "2001", DataType=f"0x{code:X}")
    variable = parse_eds(text.encode(), "x.eds").variable(0x2001, 0)
    if data is None:
        with pytest.raises(OverflowError):
            encoded(variable, value)
    else:
        assert encoded(variable, value) == data


# what is read back


class Other:
    """An SDO server of another width: it keeps `keep` bytes of what is written and sends `send`
    bytes, the size told or not.
    """

    def __init__(self, keep, send, told, fill=b"\0"):
        self.keep, self.send, self.told, self.fill, self.values = keep, send, told, fill, {}

    def download(self, index, subindex, data):
        self.values[index, subindex] = data

    def upload(self, index, subindex, unsized):
        data = self.values[index, subindex]
        if index == 0x6071:
            data = (data[: self.keep] + 8 * self.fill)[: self.send or len(data)]
        return data if self.told else unsized(data)


@pytest.mark.parametrize(
    ("server", "value", "difference"),
    [
        (Other(2, 2, True), -5, None),
        (Other(1, 1, True), 3, "has 1 bytes in the device, 2 in"),
        (Other(1, 2, True), 3000, "wrote 0xbb8, reads back 0xb8"),
        (Other(1, 2, True), -5, "wrote -0x5, reads back 0xfb"),
        (Other(2, 4, True), 3, "has 4 bytes in the device, 2 in"),
        (Other(2, 4, False), 3, None),  # an expedited upload whose size is not told has four bytes
        (Other(2, 4, False, b"\xff"), -5, None),
        (Other(2, 4, False, b"\xff"), 5, "has 4 bytes in the device"),
        (Other(2, 4, False), -5, "has 4 bytes in the device"),
    ],
)
def test_read_backs_are_compared_whole(server, value, difference):
    (plan, _) = plans_of(Controllers(rig_of(), "hybrid"))
    device = device_of(plan, server)
    device.identity = (0x4C0, OURS)
    object.__setattr__(plan, "writes", tuple(bringup.Setting(0x6071, 0, value) for _ in range(2)))
    object.__setattr__(plan, "read_backs", (((0x6071, 0), value),))
    told = device.configure()
    assert len(told) == (difference is not None)
    assert difference is None or difference in told[0]


def test_bring_up_writes_and_reads_back_just_what_the_plan_says():
    wire = Wire(rig_of())
    wire.bring_up()
    motor, brake = plans_of(wire.world.controllers)
    for plan in (motor, brake):
        assert plan.writes
        at = plan.description.variable
        sent = [s for s in plan.writes if not s.unless_equal]  # as the device has it already
        writes = [(s.index, s.subindex, encoded(at(s.index, s.subindex), s.value)) for s in sent]
        assert wire.requests(plan.node_id, 1) == writes
        assert [key[:2] for key in wire.requests(plan.node_id, 2)][-len(plan.read_backs) :] == [
            key for key, _ in plan.read_backs
        ]
        assert {key for key, _ in plan.read_backs} == {(s.index, s.subindex) for s in plan.writes}


# what a device offers

ACCEPT = 'host.accept=["motor: no torque limit of its own", "motor: no reaction to the host\'s loss"]'
LIMITS = ("6072", "60E0", "60E1", "6073")


def plan_of(motor=MOTOR, brake=BRAKE, *overrides, mode="hybrid", node="motor"):
    plans = plans_of(Controllers(rig_of(motor, brake, *overrides), mode))
    return next(plan for plan in plans if plan.name == node)


def written_to(plan, index, sub=0):
    return [s.value for s in plan.writes if (s.index, s.subindex) == (index, sub)]


def test_the_torque_is_limited_by_what_the_drive_has():
    both = gone(MOTOR, "6072")
    assert [written_to(plan_of(both), index) for index in (0x6072, 0x60E0, 0x60E1, 0x6073)] == [[], [97], [97], []]
    current = gone(both, "60E0")
    assert [written_to(plan_of(current), index) for index in (0x60E1, 0x6073)] == [[], [97]]
    none = gone(MOTOR, *LIMITS)
    (problem,) = plan_of(none).problems
    assert (
        problem.remedy == 'take another device, or acknowledge it: host.accept = ["motor: no torque limit of its own"]'
    )
    assert problem.accept == "motor: no torque limit of its own"
    assert plan_of(none, BRAKE, ACCEPT).problems == ()
    assert plan_of(none, mode="passive").problems == ()  # there the motor has no torque


def test_the_least_that_a_limit_takes_is_taken_and_told():
    plan = plan_of(edit(MOTOR, "6072", LowLimit=100, DefaultValue=100))
    assert written_to(plan, 0x6072) == [100]
    assert any(
        "its own limit is 100 per mille, the least that 6072h takes; the host limits to 97" in t for t in plan.losses
    )


def test_a_device_that_does_not_notice_the_host_s_loss_is_refused_unless_it_is_acknowledged():
    deaf = gone(MOTOR, "1400sub5", "1016sub1", "100C", "2002")
    (problem,) = plan_of(deaf).problems
    assert "no reaction to the host's loss: its last set-point acts on after the loss of the host" in problem.text
    assert {(r.who, r.within_s, r.what) for r in plan_of(deaf).reactions} == {("", None, "its last set-point stays")}
    assert plan_of(deaf, BRAKE, ACCEPT).problems == ()
    assert plan_of(deaf, mode="passive").problems == ()


@pytest.mark.parametrize(
    ("lacking", "who", "within_s"),
    [
        ((), "RPDO deadline 1400h:05", 0.01),
        (("1400sub5",), "SYNC time-out 2002h", 0.02),
        (("1400sub5", "2002"), "heartbeat consumer 1016h:01", 0.15),
        (("1400sub5", "1016sub1", "2002"), "life guarding 100Ch, 100Dh", 0.15),
    ],
)
def test_the_fastest_watch_of_a_device_ends_its_set_point(lacking, who, within_s):
    found = plan_of(gone(MOTOR, *lacking)).reactions
    assert [(r.fault, r.who, r.within_s) for r in found] == [
        (fault, who, within_s) for fault in ("host dies", "bus cut", "host hangs")
    ]


def test_a_node_without_heartbeats_is_guarded():
    motor = gone(MOTOR, "1017")
    plan = plan_of(motor)
    assert (written_to(plan, 0x100C), written_to(plan, 0x100D), written_to(plan, 0x1016, 1)) == ([50], [3], [])
    control = Controller(rig_of(motor).one_axis(), "hybrid").control[0]
    assert (control["guard_ns"], control["guarded"], control["heartbeat_timeout_ns"][0]) == (
        50_000_000,
        0b01,
        150_000_000,
    )
    guarded = {
        m.name: (m.can_id, m.length, m.period_ns)
        for m in plan_cycle(rig_of(motor)).messages
        if m.can_id & 0x7FF == 0x701
    }
    assert guarded == {
        "motor guard request": (CAN_RTR_FLAG | 0x701, 1, 50_000_000),
        "motor heartbeat": (0x701, 1, 50_000_000),
    }
    assert plan_cycle(rig_of(motor)).fits
    mute = gone(motor, "100C")
    control = Controller(rig_of(mute).one_axis(), "hybrid").control[0]
    assert (control["guard_ns"], control["guarded"], control["heartbeat_timeout_ns"][0]) == (0, 0, 0)
    assert any("the host does not hear whether it lives" in text for text in plan_of(mute).losses)


def test_a_heartbeat_consumer_whose_limits_leave_no_room_for_a_node_id_is_written_all_the_same():
    plan = plan_of(edit(MOTOR, "1016sub1", HighLimit=65535))
    assert written_to(plan, 0x1016, 1) == [127 << 16 | 150]
    assert any("limits 1016h:01 to 65535" in text for text in plan.questions)


def test_profile_torque_is_taken_where_there_is_no_cst_and_its_slope_follows():
    plan = plan_of(edit(MOTOR, "6502", DefaultValue="0x0000000F"))
    assert (plan.mode, written_to(plan, 0x6060)) == (4, [4])
    assert written_to(plan, 0x6087) == [-(-2500 * 1000 // (0.18 * 9.587)) // 1]
    (problem,) = plan_of(edit(MOTOR, "6502", DefaultValue="0x00000043")).problems
    assert "do not include cyclic synchronous torque" in problem.text
    assert "motor.mode" in problem.remedy
    own = plan_of(edit(MOTOR, "6502", DefaultValue="0x00000043"), BRAKE, "motor.mode=-3")
    assert (own.mode, written_to(own, 0x6060), own.problems) == (-3, [-3], ())


def test_what_the_rig_file_lists_is_written_where_it_says(tmp_path):
    text = BENCH + "".join(
        f'\n[[motor.sdo]]\nindex = {index}\ntype = "UNSIGNED32"\nvalue = {value}\nwhen = "{when}"\n'
        for index, value, when in ((0x2001, 7, "end"), (0x2002, 8, "before"))
    )
    motor = identified(MOTOR)
    rig = load_rig_text(text, "r.toml", {"motor.eds": motor, "mr_brake.eds": BRAKE}, IS_FOREIGN)
    (plan, _) = plans_of(Controllers(rig, "hybrid"))
    assert plan.writes[0].index == 0x2002
    assert plan.writes[-1].index == 0x2001
    wire = Wire(rig)
    wire.bring_up()
    assert makers(wire.written(1)) == [0x2002, 0x2001]
    wide = load_rig_text(
        text.replace("UNSIGNED32", "UNSIGNED8"), "r.toml", {"motor.eds": motor, "mr_brake.eds": BRAKE}, IS_FOREIGN
    )
    assert all(
        "the rig file says UNSIGNED8, and the EDS file says 32 bits" in p.text
        for p in plans_of(Controllers(wide, "hybrid"))[0].problems
    )


def test_in_a_foreign_drive_constants_are_read_first_and_reactions_are_set():
    wire = Wire(rig_of(edit(identified(MOTOR), "1005", AccessType="const"), BRAKE, *IS_FOREIGN))
    wire.bring_up()
    assert 0x1005 not in wire.written(1)
    plan = wire.world.controllers and plans_of(wire.world.controllers)[0]
    assert [written_to(plan, index) for index in (0x6007, 0x605A, 0x605E)] == [[2], [0], [0]]
    read = [key[:2] for key in wire.requests(1, 2)]
    assert (0x6007, 0) in read
    ours = Wire(rig_of())
    ours.bring_up()
    assert not {0x6007, 0x605A, 0x1029, 0x60C2} & set(ours.written(1))


def test_what_the_host_can_do_without_and_the_device_refuses_is_lost():
    class Refusing(Other):
        def download(self, index, subindex, data):
            if index == 0x6007:
                raise SdoRefused("download to", index, subindex, 0x06090031)
            super().download(index, subindex, data)

    (plan, _) = plans_of(Controllers(rig_of(), "hybrid"))
    device = device_of(plan, Refusing(2, 2, True))
    settings = (bringup.Setting(0x6071, 0, 1), bringup.Setting(0x6007, 0, 2, soft=True, lost="its own reaction stays"))
    object.__setattr__(plan, "writes", settings)
    object.__setattr__(plan, "read_backs", (((0x6071, 0), 1), ((0x6007, 0), 2)))
    assert device.configure() == []
    (loss,) = device.losses
    assert "6007h:00" in loss
    assert loss.endswith("; its own reaction stays")
    object.__setattr__(plan, "writes", (settings[0], bringup.Setting(0x6007, 0, 2)))
    with pytest.raises(SdoAborted, match="06090031"):
        device.configure()


def test_an_identity_that_the_file_does_not_have_is_not_compared():
    motor = gone(MOTOR, "1018sub2")
    text = BENCH.replace("product_code = 0x00000402\n", "")
    rig = load_rig_text(text, "r.toml", {"motor.eds": motor, "mr_brake.eds": BRAKE})
    (plan, _) = plans_of(Controllers(rig, "hybrid"))
    assert plan.problems == ()
    assert any("has no 1018h:02, so the product code is not compared" in text for text in plan.losses)
    rig = load_rig_text(text, "r.toml", {"motor.eds": MOTOR, "mr_brake.eds": BRAKE})
    (problem,) = plans_of(Controllers(rig, "hybrid"))[0].problems
    assert str(problem).endswith("give motor.product_code = 0x402, if the file is of this very device")


# `check` and bring-up say the same

QUIRKS = {
    "own": (MOTOR, BRAKE, ()),
    "foreign": (identified(MOTOR), BRAKE, IS_FOREIGN),
    "no 6072h": (gone(MOTOR, "6072"), BRAKE, ()),
    "no deadline": (gone(MOTOR, "1400sub5"), BRAKE, ()),
    "no heartbeat consumer": (gone(MOTOR, "1016sub1"), BRAKE, ()),
    "no heartbeat": (gone(MOTOR, "1017"), BRAKE, ()),
    "no 1005h": (gone(MOTOR, "1005"), BRAKE, ()),
    "no product code": (gone(MOTOR, "1018sub2"), BRAKE, ()),
    "no device type": (gone(MOTOR, "1000"), BRAKE, ()),
    "constant 1005h": (edit(MOTOR, "1005", AccessType="const"), BRAKE, ()),
    "another constant 1005h": (edit(MOTOR, "1005", AccessType="const", DefaultValue="0x81"), BRAKE, ()),
    "constant 1005h of no value": (edit(MOTOR, "1005", AccessType="ro", DefaultValue=""), BRAKE, ()),
    "no torque mode": (edit(MOTOR, "6502", DefaultValue="0x6D"), BRAKE, ()),
    "no 6502h": (gone(MOTOR, "6502"), BRAKE, ()),
    "narrow 1016h": (edit(MOTOR, "1016sub1", DataType=U16), BRAKE, ()),
    "map of another object that stands": (
        edit(edit(MOTOR, "1801sub1", AccessType="ro"), "1A01sub1", DefaultValue="0x60640020"),
        BRAKE,
        (),
    ),
    "6072h from 100 on": (edit(MOTOR, "6072", LowLimit=100, DefaultValue=100), BRAKE, ()),
    "real 6072h": (edit(MOTOR, "6072", DataType=REAL32, LowLimit="", HighLimit=""), BRAKE, ()),
    "text 1017h": (edit(MOTOR, "1017", DataType=TEXT), BRAKE, ()),
    "read-only identifiers": (edit(MOTOR, "1800sub1", AccessType="ro"), BRAKE, ()),
    "read-only inhibit time of 0": (edit(MOTOR, "1800sub3", AccessType="ro", DefaultValue=0), BRAKE, ()),
    "read-only map of our own": (edit(MOTOR, "1600sub1", AccessType="ro"), BRAKE, ()),
    "write-only mode": (edit(MOTOR, "6060", AccessType="wo"), BRAKE, ()),
    "no fault mode": (MOTOR, gone(BRAKE, "6340sub1"), ()),
    "wrong file": (identified(MOTOR), BRAKE, ()),
}


@pytest.mark.parametrize("name", QUIRKS)
def test_check_says_ok_where_bring_up_goes_on_and_nowhere_else(name, tmp_path):
    motor, brake, overrides = QUIRKS[name]
    (tmp_path / "motor.eds").write_text(motor)
    (tmp_path / "mr_brake.eds").write_text(brake)
    (tmp_path / "rig.toml").write_text(BENCH)
    sets = [word for text in overrides for word in ("--set", text)]
    result = CliRunner().invoke(main, ["check", "--rig", str(tmp_path / "rig.toml"), *sets])
    failures = [line.removeprefix("FAIL: ") for line in result.output.splitlines() if line.startswith("FAIL: ")]
    told = []
    for mode in ("active", "passive", "hybrid"):
        wire = Wire(rig_of(motor, brake, *overrides), mode)
        try:
            wire.bring_up()
        except DeviceMismatch as error:
            told.append(str(error))
            assert wire.written(1) == wire.written(2) == []
    assert result.exit_code == (1 if told else 0), result.output
    assert result.output.splitlines()[-1].startswith("ok") is not bool(told)
    strip = re.compile(r"in \S+|but \S+ does|\(\S+:\d+\)")
    for line in failures:
        assert any(strip.sub("", line) in strip.sub("", text) for text in told), line


def test_check_tells_all_that_is_wrong_with_what_to_do(tmp_path):
    motor = gone(MOTOR, "6072", "60E0", "60E1", "6073", "1000")
    motor = gone(edit(motor, "1017", DataType=TEXT), "1400sub5", "1016sub1", "100C", "2002")
    (tmp_path / "motor.eds").write_text(motor)
    (tmp_path / "rig.toml").write_text(BENCH)
    result = CliRunner().invoke(main, ["check", "--rig", str(tmp_path / "rig.toml")])
    assert result.exit_code == 1
    failures = [line for line in result.output.splitlines() if line.startswith("FAIL: ")]
    for place in ("object 1000h:00", "object 1017h:00", "no torque limit of its own", "no reaction to the host's loss"):
        (line,) = (line for line in failures if place in line)
        assert re.search(r"; (take|correct|change|expected) ", line)


def test_json_has_the_same_for_programs(tmp_path):
    def told(motor, *more):
        (tmp_path / "motor.eds").write_text(motor)
        (tmp_path / "rig.toml").write_text(BENCH)
        result = CliRunner().invoke(main, ["check", "--rig", str(tmp_path / "rig.toml"), "--json", *more])
        return result.exit_code, json.loads(result.stdout)

    status, good = told(MOTOR, "--steps")
    assert (status, good["ok"], good["problems"], good["losses"]) == (0, True, [], [])
    assert {(r["device"], r["fault"]) for r in good["reactions"]} == {
        (device, fault) for device in ("motor", "brake") for fault in ("host dies", "bus cut", "host hangs")
    }
    assert [s["object"] for s in good["steps"]][:3] == ["1801h:01", "1016h:01", "1017h:00"]
    assert {r["role"] for r in good["roles"]} >= {"position", "torque_setpoint", "handle_torque"}
    status, bad = told(gone(MOTOR, "1000"))
    (problem,) = bad["problems"]
    assert (status, bad["ok"], problem["node"], problem["object"]) == (1, False, "motor", "1000h:00")
    assert problem["remedy"] == "take the EDS file of this very device"
    status, none = told(gone(MOTOR, "6071"))
    (problem,) = none["problems"]
    assert (status, none["ok"], problem["role"], problem["object"]) == (3, False, "torque_setpoint", "6071h:0")
    assert problem["remedy"].startswith("take a device that has it")
    status, wrong = told(MOTOR, "--set", "bus.period_s=x")
    assert (status, wrong["problems"][0]["role"], wrong["event"]) == (3, "", "error")


def test_the_steps_that_check_prints_are_those_of_bring_up(tmp_path):
    (tmp_path / "rig.toml").write_text(BENCH)
    result = CliRunner().invoke(main, ["check", "--rig", str(tmp_path / "rig.toml"), "--json", "--steps"])
    told = [s for s in json.loads(result.stdout)["steps"] if not s["only_if_different"]]
    steps = [(s["device"], s["object"], s["value"]) for s in told]
    wire = Wire(rig_of())
    wire.bring_up()
    sent = [
        (name, f"{index:04X}h:{sub:02X}", int.from_bytes(data, "little"))
        for name, node in (("motor", 1), ("brake", 2))
        for index, sub, data in wire.requests(node, 1)
    ]
    assert steps == sent


def test_what_the_file_does_not_tell_is_open_and_no_plain_ok(tmp_path):
    (tmp_path / "motor.eds").write_text(edit(MOTOR, "6502", DefaultValue=""))
    (tmp_path / "rig.toml").write_text(BENCH)
    result = CliRunner().invoke(main, ["check", "--rig", str(tmp_path / "rig.toml")])
    assert result.exit_code == 0
    assert "6502h; bring-up asks the device" in result.output
    assert result.output.splitlines()[-1] == "ok, if the devices answer what is open above"


def test_no_pdo_has_more_than_eight_bytes():
    wide = edit(MOTOR, "6077", DataType=I32)
    pdos = rig_of(wide).pdos()
    assert [[s.index for s in p.signals] for p in pdos if p.node == "motor"] == [
        [0x6040, 0x6071],
        [0x6041, 0x6064],
        [0x6077],
    ]
    assert max(p.layout.length for p in pdos) <= 8
    single = gone(wide, "1801sub1", "1802sub1", "1803sub1")
    (loss,) = rig_of(single).one_axis().allocation.losses
    assert "the watch of its net work (limits.net_work_J) takes the command for it" in loss
    with pytest.raises(RigError, match=r"6077h:0 finds no place in a TPDO: no PDO can be mapped with it"):
        rig_of(single, BRAKE, "role.torque.object=6077:0")


@pytest.mark.parametrize(("code", "most"), [(I8, 127), (U8, 255), (I16, 4500), (I32, 4500)])
def test_the_brakes_set_point_is_never_wider_than_its_object(code, most):
    text = edit(edit(BRAKE, "7300sub1", DataType=code), "7300sub1", HighLimit="" if code in (I8, U8) else 4500)
    assert Controller(rig_of(MOTOR, text).one_axis(), "hybrid").control[0]["brake_limit_raw"] == most


def test_the_motors_limit_is_never_wider_than_its_set_point():
    with pytest.raises(RigError, match=r"mode.active.motor_limit_Nm.*the drive's 6071h ends at 127 per mille"):
        Controller(rig_of(edit(MOTOR, "6071", DataType=I8, LowLimit="", HighLimit="")).one_axis(), "active")


@beside(CORPUS)
@pytest.mark.parametrize("own", ["motor.eds", "mr_brake.eds"])
def test_no_vendors_file_ends_in_a_traceback(own, tmp_path):
    files = sorted(path for path in CORPUS.iterdir() if path.suffix in (".eds", ".dcf"))
    assert files
    for path in files:
        rig = tmp_path / "rig.toml"
        rig.write_text(BENCH.replace(f'"{own}"', f'"{path}"'))
        result = CliRunner().invoke(main, ["check", "--rig", str(rig)])
        assert isinstance(result.exception, SystemExit), (path.name, result.exception)
        assert result.exit_code in (1, 3), (path.name, result.output)
        assert (
            "FAIL: " in result.output
            or "expected" in result.output
            or "which the host maps" in result.output
            or "finds no place" in result.output
            or "; give [role." in result.output
        )


@pytest.mark.parametrize("deadline", [True, False])
def test_what_ends_an_old_set_point_is_told_of_the_device_that_is_there(deadline):
    motor = identified(MOTOR) if deadline else gone(identified(MOTOR), "1400sub5")
    (plan, _) = plans_of(Controllers(rig_of(motor, BRAKE, *IS_FOREIGN), "hybrid"))
    (told,) = (text for text in plan.losses if "2001h is not written" in text)
    assert told.endswith(
        "only the RPDO deadline 1400h:05 ends an old set-point"
        if deadline
        else "an old set-point acts until the drive detects the loss of the host"
    )
    assert any("1400h:05 is not written" in text for text in plan.losses) is not deadline
