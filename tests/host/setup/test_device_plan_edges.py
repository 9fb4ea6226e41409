"""What bring-up plans for each device: what is written and read back, what is refused, what is asked,
and what the host loses, at the edges of each rule.
"""

from __future__ import annotations

import pytest

from coulombus.eds.reader import Variable, parse_eds
from coulombus.host.cycle.controller import Controller
from coulombus.host.setup.device_plan import (
    NOT_SHOWN,
    _locked,
    _misfit,
    _other,
    _Planner,
    device_plans,
    missing_mode,
    steps_of,
)
from coulombus.host.setup.settings import Setting, settings_of
from coulombus.rigs.rig import load_rig, load_rig_text
from eds_edit import SENSOR, edit, gone
from foreign_eds import BRAKE, I16, MOTOR, U8, U32, another, with_variable
from foreign_rigs import BENCH, SCHEDULE, Part, brake, drive, rig_of

NOT_OURS = "it is the maker's own object: 1018h of the EDS file is not ours"
NOT_DESCRIBED = "it is not described"
NO_SYNC = "does not detect the loss of SYNC"
OLD = "no set-point becomes 0 after motor.setpoint_zero_cycles; only the RPDO deadline 1400h:05 ends an old set-point"
HOLD = "without set-points the brake does not hold for brake.hold_s and then ramp down by itself"
RAMP = "the brake's own ramp does not take brake.ramp_s"
COIL = (
    "the coil's current is not measured: its I2t watch takes the command times brake.coil_A_Nm for it",
    "the coil's temperature is not measured, and not recorded",
)
SENT_TOO = "motor: RPDO1 carries 6060h:0 too, which is sent as 10 (the mode of operation)"
OF_DRIVE = (
    f"motor (node 1): 2002h is not written, {NOT_OURS}; the drive {NO_SYNC} (motor.sync_timeout_s)",
    f"motor (node 1): 2001h is not written, {NOT_OURS}; {OLD}",
)
OF_402 = (f"brake (node 2): 2002h is not written, {NOT_OURS}; the brake {NO_SYNC} (brake.sync_timeout_s)",)
OF_BRAKE = (
    *OF_402,
    f"brake (node 2): 2001h is not written, {NOT_OURS}; {HOLD}",
    f"brake (node 2): 2005h is not written, {NOT_OURS}; {RAMP}",
)
SILENT = "brake (node 2) sends no TPDO; the host notices its loss by its heartbeat alone, within 0.15 s"
MANUFACTURER = range(0x2000, 0x6000)
KNOWN = "take the EDS file of this very device"


def stands(text, section, name="motor.eds"):
    """Return file and line of a section's header, where the reader says an object stands."""
    return f"{name}:{text.splitlines().index(f'[{section}]') + 1}"


def plans_of(motor="own", brake_="own", *overrides, mode="hybrid"):
    """Return the plans by the devices' names; a device is a kind, or the text of an EDS file."""
    parts = (drive(motor) if len(motor) < 4 else Part(motor)), (brake(brake_) if len(brake_) < 4 else Part(brake_))
    plans = device_plans(Controller(rig_of(*parts, *overrides).one_axis(), mode))
    return {plan.name: plan for plan in plans}


def motor_of(eds, *overrides, mode="hybrid"):
    return plans_of(eds, "own", *overrides, mode=mode)["motor"]


def brake_of(eds, *overrides):
    return plans_of("own", eds, *overrides)["brake"]


def listed(node, *rows):
    """Return [[NODE.sdo]] of a rig file, of rows (index, sub-index, type, value, verify)."""
    return "".join(
        f"\n[[{node}.sdo]]\nindex = {index}\nsub = {sub}\n"
        f'type = "{kind}"\n'
        f"value = {value}\nverify = {str(verify).lower()}\n"
        for index, sub, kind, value, verify in rows
    )


def places(plan):
    return [(s.index, s.subindex) for s in plan.writes]


def values(plan, index, subindex=0):
    return [s.value for s in plan.writes if (s.index, s.subindex) == (index, subindex)]


@pytest.mark.parametrize(
    ("motor", "kind", "modes", "losses"),
    [
        ("own", "own", (10, None), ((), ())),
        ("A", "404", (10, None), (OF_DRIVE, OF_BRAKE)),
        ("B", "401", (10, None, None), ((*COIL, SENT_TOO, *OF_DRIVE), (*OF_BRAKE, SILENT), ())),
        ("C", "8ao", (4, None, None), ((*COIL, *OF_DRIVE), (*OF_BRAKE, SILENT), ())),
        ("D", "402", (-3, -3, None), ((*COIL, *OF_DRIVE), OF_402, ())),
    ],
)
def test_the_plans_of_each_kind_of_device(motor, kind, modes, losses):
    rig = rig_of(drive(motor), brake(kind))
    controller = Controller(rig.one_axis(), "hybrid")
    plans = device_plans(controller)
    assert [plan.role for plan in plans] == ["motor", "brake", "cell"][: len(modes)]
    assert [plan.name for plan in plans] == [plan.role for plan in plans]
    assert [plan.node_id for plan in plans] == [1, 2, 3][: len(modes)]
    assert tuple(plan.mode for plan in plans) == modes
    assert tuple(plan.losses for plan in plans) == losses
    for plan in plans:
        assert plan.problems == plan.questions == ()
        assert plan.part is controller.axis.part(plan.role)
        assert plan.description is controller.axis.description(plan.role)
        assert plan.identity == ((1, "vendor id", plan.part.vendor_id), (2, "product code", plan.part.product_code))
        wanted = settings_of(controller.axis, plan.role, "hybrid", controller.drive_limit_pm())
        makers = motor != "own" and plan.role != "cell"  # its own objects mean what it says
        there = [
            s
            for s in wanted
            if plan.description.has(s.index, s.subindex) and not (makers and not s.listed and s.index in MANUFACTURER)
        ]
        stands = [s for s in there if plan.description.variable(s.index, s.subindex).access in ("ro", "const")]
        assert list(plan.writes) == [s for s in there if s not in stands]
        assert dict(plan.read_backs) == {(s.index, s.subindex): s.value for s in there}
        assert len(plan.read_backs) == len(dict(plan.read_backs))
        assert bool(stands) == (motor == "B" and plan.role == "motor")
        assert len({one.fault for one in plan.reactions}) == (3 if plan.role != "cell" else 0)
        assert all(one.who for one in plan.reactions)
    assert list(steps_of(plans)) == [(plan, setting) for plan in plans for setting in plan.writes]


# what is needed, and what is told instead


def test_each_axis_names_its_own_devices_and_losses():
    lost = "axis.left.role.coil_temperature.object=none"
    controllers = [Controller(axis, "hybrid") for axis in load_rig("two_axes", (lost,)).axes]
    left, right = (device_plans(controller) for controller in controllers)
    assert [plan.name for plan in (*left, *right)] == ["left.motor", "left.brake", "right.motor", "right.brake"]
    assert left[0].losses == ("left.the coil's temperature is not measured, and not recorded",)
    assert left[1].losses == right[0].losses == right[1].losses == ()


def test_the_mode_of_a_sensor_s_power_stage_is_not_set():
    text = SENSOR.replace("0x404", "0x402") + 'object = "6077"\nscale_Nm = 0.001\n'
    rig = load_rig_text(
        BENCH + SCHEDULE + text, "rig.toml", {"motor.eds": MOTOR, "mr_brake.eds": BRAKE, "cell.eds": MOTOR}
    )
    sensor = device_plans(Controller(rig.one_axis(), "hybrid"))[2]
    assert sensor.mode is None
    assert 0x6060 not in [s.index for s in sensor.writes]


DEAF = ("1400sub5", "1016sub1", "100C", "2002")
NO_REACTION = "no reaction to the host's loss: its last set-point acts on after the loss of the host"
NO_LIMIT = "no torque limit of its own: 6072h, 60E0h and 60E1h, 6073h cannot be written; only the host limits"
LIMITS = ("6072", "60E0", "60E1", "6073")


@pytest.mark.parametrize(("limit_Nm", "refused"), [(0.0018, True), (0.0016, False)])
def test_a_motor_needs_a_reaction_and_a_limit_from_the_least_torque_on(limit_Nm, refused):
    """0.0017 Nm at the handle are 1 per mille."""
    little = (f"mode.hybrid.motor_limit_Nm={limit_Nm}", "mode.hybrid.compensation=0")
    told = [one.text for one in motor_of(gone(MOTOR, *DEAF, *LIMITS), *little).problems]
    assert told == [f"motor (node 1): {what}" for what in (NO_LIMIT, NO_REACTION) if refused]


@pytest.mark.parametrize(("mode", "refused"), [("active", False), ("passive", True), ("hybrid", True)])
def test_a_brake_needs_a_reaction_where_it_has_torque(mode, refused):
    told = [one.text for one in plans_of("own", gone(BRAKE, *DEAF, "2001"), mode=mode)["brake"].problems]
    assert told == [f"brake (node 2): {NO_REACTION}"] * refused


@pytest.mark.parametrize("mode", ["passive", "hybrid"])
def test_what_is_acknowledged_is_told_as_a_loss_whether_it_is_needed_or_not(mode):
    accept = 'host.accept=["motor: no torque limit of its own", "motor: no reaction to the host\'s loss"]'
    plan = motor_of(gone(MOTOR, *DEAF, *LIMITS), accept, mode=mode)
    assert plan.problems == ()
    assert plan.losses[-2:] == (f"motor: {NO_LIMIT} (host.accept)", f"motor: {NO_REACTION} (host.accept)")


@pytest.mark.parametrize(
    ("lacking", "by"),
    [((), ""), (("6072",), "60E0h and 60E1h"), (("6072", "60E1"), "6073h")],
)
def test_another_limit_than_6072h_is_told(lacking, by):
    text = f"motor (node 1): 6072h is not written, it is not described; {by} limit the torque"
    assert motor_of(gone(MOTOR, *lacking)).losses == ((text,) if by else ())


def test_an_object_that_our_own_brake_must_have_is_needed():
    problem, _ = brake_of(gone(BRAKE, "6340sub1")).problems
    assert problem == (
        *("", "brake", "6340h:01"),
        "brake (node 2), object 6340h:01 is needed, but mr_brake.eds does not have it",
        "take the EDS file of this very device, or a device that has the object",
        "",
    )


def test_an_object_that_only_the_rig_file_describes_is_written_and_read_back():
    text = listed("motor", ("0x5FFF", 1, "INTEGER16", -5, True))
    (plan, _) = device_plans(Controller(rig_of(Part(MOTOR), Part(BRAKE), text=text).one_axis(), "hybrid"))
    assert values(plan, 0x5FFF, 1) == [-5]
    assert dict(plan.read_backs)[0x5FFF, 1] == -5
    assert plan.problems == ()


@pytest.mark.parametrize(
    ("section", "limits", "told"),
    [
        ("6007", {"HighLimit": 1}, "6007h:00 is not set (2 is outside the EDS file's LowLimit any and HighLimit 1); "
         "its reaction to the loss of the host is the drive's default"),
        ("605A", {"LowLimit": 1}, "605Ah:00 is not set (0 is outside the EDS file's LowLimit 1 and HighLimit any); "
         "no torque when it stops"),
        ("1006", {"HighLimit": 0xFFF0 // 100}, "1006h:00 is not set (1000 (0x3e8) is outside the EDS file's LowLimit "
         "any and HighLimit 655); SYNC's period"),
    ],
)  # fmt: skip
def test_what_a_device_cannot_take_and_the_host_can_do_without_is_told_and_left_out(section, limits, told):
    part = drive("A")
    plans = device_plans(
        Controller(
            rig_of(Part(edit(part.eds, section, **limits), "", part.overrides), Part(BRAKE)).one_axis(), "hybrid"
        )
    )
    index = int(section, 16)
    assert plans[0].losses == (OF_DRIVE[0], OF_DRIVE[1], f"motor (node 1): {told}")
    assert plans[0].problems == plans[0].questions == ()
    assert index not in [s.index for s in plans[0].writes]
    assert (index, 0) not in dict(plans[0].read_backs)


def test_another_maker_s_object_of_the_same_number_is_not_written():
    motor = Part(another(MOTOR), "", ("motor.vendor_id=0x99",))
    plan = device_plans(Controller(rig_of(motor, Part(BRAKE)).one_axis(), "hybrid"))[0]
    assert plan.description.has(0x2001, 0)
    assert plan.losses == OF_DRIVE
    assert not [index for index, _ in places(plan) if index in MANUFACTURER]


def test_a_limit_that_the_drive_takes_larger_than_the_host_wants_it_is_told():
    plan = motor_of(edit(MOTOR, "6072", LowLimit=98))
    told = "its own limit is 98 per mille, the least that 6072h takes; the host limits to 97"
    assert plan.losses == (f"motor (node 1): {told}",)
    assert values(plan, 0x6072) == [98]


# what cannot be written


CORRECT = "correct the file where the device lets it be written, or take another device"


@pytest.mark.parametrize("access", ["ro", "const"])
@pytest.mark.parametrize(
    ("default", "has"),
    [(50, None), (51, "says 51"), ("", "tells no value"), ("$NODEID+49", None)],
)
def test_an_object_that_cannot_be_written_needs_its_value_already(access, default, has):
    motor = edit(MOTOR, "1017", AccessType=access, DefaultValue=default)
    plan = motor_of(motor)
    text = "motor (node 1), object 1017h:00 Producer heartbeat time: 50 (0x32) is to be set, but AccessType is "
    expected = [
        ("", "motor", "1017h:00", f"{text}{access} and the EDS file {has} ({stands(motor, '1017')})", CORRECT, "")
    ]
    assert list(plan.problems) == (expected if has else [])
    assert (0x1017, 0) not in places(plan)
    assert dict(plan.read_backs)[0x1017, 0] == 50


def test_a_default_that_nobody_can_read_is_no_value_whatever_it_is_added_to():
    variable = Variable(0x1017, 0, "", 6, "ro", None, True, None, None, False, 1)
    what, remedy = _other(variable, {(0x1017, 0): 50}, 1, "AccessType is ro")
    assert what == "50 (0x32) is to be set, but AccessType is ro and the EDS file tells no value"
    assert remedy == CORRECT


def test_the_value_that_counts_of_an_object_that_cannot_be_written_is_the_last_one():
    """1A00h:00 is to be 0 and then 3."""
    plan = motor_of(edit(MOTOR, "1A00sub0", AccessType="ro", DefaultValue=3))
    assert not [one for one in plan.problems if one.object == "1A00h:00"]


@pytest.mark.parametrize("verify", [True, False])
def test_what_cannot_be_read_back_is_written_and_told_but_for_what_the_rig_file_lists(verify):
    plan = motor_of(edit(MOTOR, "6060", AccessType="wo"))
    assert plan.losses == ("motor (node 1): 6060h:00 is write-only and cannot be read back",)
    assert values(plan, 0x6060) == [10]
    assert plan.problems == ()
    assert (0x6060, 0) not in dict(plan.read_backs)
    text = listed("motor", ("0x2001", 0, "UNSIGNED32", 7, verify))
    (mine, _) = device_plans(Controller(rig_of(Part(MOTOR), Part(BRAKE), text=text).one_axis(), "hybrid"))
    assert mine.losses == ()
    assert values(mine, 0x2001) == [3000, 7]
    assert ((0x2001, 0) in dict(mine.read_backs)) is verify


def test_a_write_only_object_that_must_be_read_back_is_refused():
    motor = edit(MOTOR, "2001", AccessType="wo")
    (problem,) = motor_of(motor).problems
    text = "3000 (0xbb8) is to be set, but a write-only object cannot be read back"
    assert (
        problem.text == f"motor (node 1), object 2001h:00 Set-point zero time-out us: {text} ({stands(motor, '2001')})"
    )
    assert problem.remedy == "take another device"


@pytest.mark.parametrize(
    ("index", "subindex", "while_valid", "word"),
    [
        *((mapping, sub, valid, mapping - 0x200) for mapping in (0x1600, 0x17FF, 0x1A00, 0x1BFF) for sub in (0, 1) for valid in (False, True)),
        *((0x1800, sub, False, 0x1800) for sub in range(1, 7)),
        *((0x19FF, sub, False, 0x19FF) for sub in (3, 6)),
        *((0x1400, sub, False, 0x1400) for sub in (1, 2, 3, 5, 6)),
        *((index, 3, False, 0x1800) for index in (0x2003, 0x1C00)),
        (0x1800, 3, True, 0x1800),
    ],
)  # fmt: skip
@pytest.mark.parametrize("access", ["ro", "const", "rw", ""])
def test_a_map_and_an_inhibit_time_need_a_pdo_that_can_be_made_invalid(index, subindex, while_valid, word, access):
    """A SYNC start value (6) and an inhibit time (3) of a TPDO, and the map of any PDO (CiA 301)."""
    text = "[DeviceInfo]\n\n"
    objects = {(index, subindex): "rw"} | ({(word, 1): access} if access else {})
    if (index, subindex) == (word, 1):
        return
    for one in sorted({index for index, _ in objects}):
        subs = sorted(sub for at, sub in objects if at == one)
        text += f"[{one:04X}]\nParameterName=X\nObjectType=0x9\nSubNumber={len(subs)}\n\n"
        for sub in subs:
            text += f"[{one:04X}sub{sub:X}]\nParameterName=X\nObjectType=0x7\nDataType={U32}\n"
            text += f"AccessType={objects[one, sub]}\nDefaultValue=0\nPDOMapping=0\n\n"
    setting = Setting(index, subindex, 0, while_valid=while_valid)
    needs = index & ~0x1FF in (0x1600, 0x1A00) or (0x1800 <= index < 0x1A00 and subindex in (3, 6))
    stands = needs and not while_valid and access in ("ro", "const")
    expected = f"the PDO cannot be made invalid for it, {word:04X}h:01 is read-only," if stands else ""
    assert _locked(parse_eds(text.encode(), "x.eds"), setting) == expected


@pytest.mark.parametrize("access", ["rw", "ro"])
@pytest.mark.parametrize("identifier", ["0x80", "0x81"])
def test_a_device_whose_emcy_is_sync_for_ever_is_refused(access, identifier):
    plan = motor_of(edit(MOTOR, "1014", AccessType=access, DefaultValue=identifier))
    line = plan.description.variable(0x1014, 0).line
    text = f"motor (node 1), object 1014h:00 is 80h, the identifier of SYNC, and read-only (motor.eds:{line})"
    remedy = "correct the EDS file where the device has another one, or take another device"
    refused = access == "ro" and identifier == "0x80"
    assert plan.problems == ((("", "motor", "1014h:00", text, remedy, ""),) if refused else ())


# who the device is


def identity(of_motor, product="", vendor=None):
    text = BENCH.replace("product_code = 0x00000402\n", product)
    if vendor is not None:
        text = text.replace("vendor_id = 0x000004C0\n", vendor, 1)
    rig = load_rig_text(text, "rig.toml", {"motor.eds": of_motor, "mr_brake.eds": BRAKE})
    return device_plans(Controller(rig.one_axis(), "hybrid"))[0]


def test_a_file_without_a_device_type_is_refused():
    (problem,) = motor_of(gone(MOTOR, "1000")).problems
    text = "motor (node 1), object 1000h:00 is needed to know the device, but motor.eds does not have it"
    assert problem == ("", "motor", "1000h:00", text, KNOWN, "")


def test_a_part_of_the_identity_that_the_file_does_not_tell_is_asked_of_the_device():
    motor = edit(edit(MOTOR, "1018sub1", DefaultValue=""), "1018sub2", DefaultValue=0)
    plan = motor_of(motor)
    ask = "motor (node 1): motor.eds does not tell 1018h:{:02X}; bring-up asks the device"
    assert plan.questions == (ask.format(1), ask.format(2))
    assert plan.problems == ()
    assert plan.identity == ((1, "vendor id", 0x4C0), (2, "product code", 0x402))


def test_a_part_of_the_identity_that_the_file_lacks_is_not_compared():
    plan = motor_of(gone(MOTOR, "1018sub1"))
    lost = "motor (node 1): motor.eds has no 1018h:01, so the vendor id is not compared"
    assert plan.losses[0] == lost
    assert plan.identity == ((2, "product code", 0x402),)
    assert plan.problems == plan.questions == ()
    lean = identity(gone(MOTOR, "1018sub2"))
    assert lean.losses[0] == "motor (node 1): motor.eds has no 1018h:02, so the product code is not compared"
    assert lean.identity == ((1, "vendor id", 0x4C0),)
    assert lean.problems == ()


@pytest.mark.parametrize(("told", "hint"), [("0x402", " = 0x402, if the file is of this very device"), ("", "")])
def test_a_part_of_the_identity_that_the_rig_file_does_not_tell_is_demanded(told, hint):
    plan = identity(edit(MOTOR, "1018sub2", DefaultValue=told))
    text = "motor (node 1): the rig file does not tell the product code 1018h:02"
    assert plan.problems == (("", "motor", "1018h:02", text, f"give motor.product_code{hint}", ""),)
    assert plan.identity == ((1, "vendor id", 0x4C0),)


def test_another_identity_than_the_file_s_is_refused():
    plan = motor_of(MOTOR, "motor.vendor_id=0x99", "motor.product_code=0x12345")
    texts = (
        f"motor (node 1): vendor id 1018h:01 is 0x000004c0 in {stands(MOTOR, '1018sub1')}, the rig file says 0x00000099 (motor.vendor_id)",
        f"motor (node 1): product code 1018h:02 is 0x00000402 in {stands(MOTOR, '1018sub2')}, the rig file says 0x00012345 (motor.product_code)",
    )
    remedy = "take the EDS file of this very device, or correct the key"
    assert plan.problems == tuple(
        ("", "motor", f"1018h:{sub:02X}", text, remedy, "") for sub, text in enumerate(texts, 1)
    )


# its modes


@pytest.mark.parametrize(
    ("modes", "mode", "lacking"),
    [
        (1 << 9, 10, ""),
        (0xFFFFFFFF & ~(1 << 9), 10, "cyclic synchronous torque"),
        (1 << 3, 4, ""),
        (0xFFFFFFFF & ~(1 << 3), 4, "profile torque"),
        (0, -3, ""),
        (0, 3, ""),
    ],
)
def test_the_mode_that_6502h_lacks_is_named(modes, mode, lacking):
    assert missing_mode(modes, mode) == lacking


@pytest.mark.parametrize("default", ["", "0"])
def test_supported_modes_that_the_file_does_not_tell_are_asked_of_the_device(default):
    plan = motor_of(edit(MOTOR, "6502", DefaultValue=default))
    text = "motor (node 1): motor.eds does not tell the supported drive modes 6502h; bring-up asks the device"
    assert plan.questions == (text,)
    assert plan.problems == ()
    assert plan.mode == 10


def test_a_drive_without_6502h_is_asked_nothing():
    plan = motor_of(gone(MOTOR, "6502"))
    assert (plan.questions, plan.problems, plan.losses, plan.mode) == ((), (), (), 10)


def test_a_drive_without_a_torque_mode_is_refused():
    motor = edit(MOTOR, "6502", DefaultValue="0x43")
    (problem,) = motor_of(motor).problems
    text = (
        f"motor (node 1): supported drive modes 6502h = 0x00000043 in {stands(motor, '6502')} do not include "
        "cyclic synchronous torque"
    )
    remedy = (
        "take a drive that has it, correct the file where this one does, or name the maker's own torque or current mode "
        "(motor.mode) and its set-point ([role.torque_setpoint])"
    )
    assert problem == ("", "motor", "6502h:00", text, remedy, "")


# how the host notices its loss


@pytest.mark.parametrize("beat", [True, False])
def test_a_device_without_a_tpdo_is_noticed_by_its_heartbeat_alone(beat):
    part = brake("401")
    part = Part(part.eds if beat else gone(part.eds, "1017", "100C"), part.text, part.overrides)
    plan = device_plans(Controller(rig_of(drive("own"), part).one_axis(), "hybrid"))[1]
    assert [text for text in plan.losses if "TPDO; the host notices" in text] == ([SILENT] if beat else [])


# values that do not fit


@pytest.mark.parametrize(
    ("high", "data_type", "refused", "asked"),
    [
        ("", U32, False, False),
        (0, U32, False, False),
        (1, U32, False, True),
        (0xFFFF, U32, False, True),
        (0x10000, U32, True, False),
        (0x7F0095, U32, True, False),
        (0x7F0096, U32, False, False),
        (0xFFFF, "0x16", True, False),
    ],
)
def test_limits_of_1016h_without_room_for_a_node_id_are_no_limits(high, data_type, refused, asked):
    plan = motor_of(edit(MOTOR, "1016sub1", HighLimit=high, DataType=data_type))
    question = (
        f"motor (node 1): motor.eds limits 1016h:01 to {high}, where no node id has room; it is written all the same"
    )
    assert plan.questions == ((question,) if asked else ())
    assert [one.object for one in plan.problems] == ["1016h:01"] * refused
    assert values(plan, 0x1016, 1) == [0x7F0096]


def misfit(value, data_type=I16, key="motor.sdo.0", **limits):
    """Return what is said of a value that is to be set in an object of this type."""
    text = edit(with_variable(MOTOR, "2100", data_type, 0, "rw"), "2100", **limits)
    setting = Setting(0x2100, 0, value, key)
    return _misfit(parse_eds(text.encode(), "x.eds").variable(0x2100, 0), setting)


@pytest.mark.parametrize(
    ("value", "shown"),
    [(9, "9"), (10, "10 (0xa)"), (-9, "-9"), (-10, "-10 (-0xa)"), (0, "0"), (11, "11 (0xb)"), (8, "8")],
)
def test_a_value_of_more_than_one_figure_is_shown_in_both_ways(value, shown):
    text, remedy = misfit(value, LowLimit=100)
    assert text == f"{shown} is outside the EDS file's LowLimit 100 and HighLimit any"
    assert remedy == "change motor.sdo.0, or correct the limits in a copy of the file where the device takes the value"


@pytest.mark.parametrize(
    ("value", "limits", "refused"),
    [
        (7, {"LowLimit": 7, "HighLimit": 7}, ""),
        (6, {"LowLimit": 7, "HighLimit": 7}, "LowLimit 7 and HighLimit 7"),
        (8, {"LowLimit": 7, "HighLimit": 7}, "LowLimit 7 and HighLimit 7"),
        (8, {"HighLimit": 7}, "LowLimit any and HighLimit 7"),
        (6, {"LowLimit": 7}, "LowLimit 7 and HighLimit any"),
    ],
)
def test_the_file_s_limits_are_kept(value, limits, refused):
    found = misfit(value, **limits)
    assert (found is None) is not bool(refused)
    assert found is None or found[0] == f"{value} is outside the EDS file's {refused}"


@pytest.mark.parametrize(
    ("value", "data_type", "holds"),
    [
        (0, U8, ""),
        (255, U8, ""),
        (256, U8, "0 to 255"),
        (-1, U8, "0 to 255"),
        (-32768, I16, ""),
        (32767, I16, ""),
        (32768, I16, "-32768 to 32767"),
        (-32769, I16, "-32768 to 32767"),
    ],
)
def test_a_value_fits_into_its_type(value, data_type, holds):
    found = misfit(value, data_type)
    assert (found is None) is not bool(holds)
    if found:
        assert found[0].endswith(f" does not fit into its type, which holds {holds}")
        assert found[1] == "change motor.sdo.0"
        assert misfit(value, data_type, "")[1] == "take another device"


@pytest.mark.parametrize(("data_type", "told"), [("0x8", "0x0008"), ("0x9", "0x0009")])
def test_a_value_goes_into_an_integer_only(data_type, told):
    text = f"5 is to be set, but its DataType is {told}"
    assert misfit(5, data_type) == (text, "expected an integer, correct the EDS file if it is one")


@pytest.mark.parametrize(
    ("kind", "wrong"), [("INTEGER16", False), ("UNSIGNED16", False), ("UNSIGNED8", True), ("UNSIGNED32", True)]
)
def test_the_type_that_the_rig_file_says_is_as_wide_as_the_file_s(kind, wrong):
    motor = with_variable(MOTOR, "2100", I16, 0, "rw")
    text = listed("motor", ("0x2100", 0, kind, 5, True))
    (plan, _) = device_plans(Controller(rig_of(Part(motor), Part(BRAKE), text=text).one_axis(), "hybrid"))
    told = f"motor (node 1), object 2100h:00 X: the rig file says {kind}, and the EDS file says 16 bits"
    told += f" ({stands(motor, '2100')})"
    assert plan.problems == ((("", "motor", "2100h:00", told, "change motor.sdo.0", ""),) if wrong else ())


def test_where_no_key_of_the_rig_file_says_the_value_another_device_is_to_be_taken():
    (problem,) = brake_of(edit(BRAKE, "7341sub1", LowLimit=5)).problems
    assert problem.remedy == (
        "take another device, or correct the limits in a copy of the file where the device takes the value"
    )


# a drive of two axes


def test_a_set_point_of_a_further_axis_is_refused_unless_it_is_acknowledged():
    motor = with_variable(MOTOR, "6871", I16, 0)
    text = '\n[role.torque_setpoint]\nobject = "6871"\nscale_Nm = 0.0002\n'
    sentence = "motor: its set-point is axis 2's"
    for accept, refused in (("", True), (sentence, False)):
        overrides = (f'host.accept=["{accept}"]',) if accept else ()
        rig = rig_of(Part(motor, text, overrides), Part(BRAKE))
        (plan, _) = device_plans(Controller(rig.one_axis(), "hybrid"))
        assert [problem.accept for problem in plan.problems] == ([sentence] if refused else [])
        assert all("6860h, 6872h, 685Ah" in problem.text for problem in plan.problems)


# maps


@pytest.mark.parametrize(("granularity", "is_asked"), [("0", True), ("0x0", True), ("8", False), ("", False)])
def test_a_file_without_granularity_is_mapped_all_the_same_and_that_is_a_question(granularity, is_asked):
    motor = edit(MOTOR, "DeviceInfo", Granularity=granularity)
    assert any("has Granularity=0" in text for text in motor_of(motor).questions) is is_asked


@pytest.mark.parametrize(
    ("indices", "is_asked"),
    [
        ((), False),
        ((0x1600,), True),
        ((0x1601, 0x6040), True),
        ((0x17FF,), True),
        ((0x1A00,), True),
        ((0x1BFF,), True),
        ((0x15FF, 0x1800, 0x19FF, 0x1C00, 0x1400, 0x6040), False),
    ],
)
def test_only_a_map_that_is_written_makes_granularity_a_question(indices, is_asked):
    axis = rig_of(Part(edit(MOTOR, "DeviceInfo", Granularity=0)), Part(BRAKE)).one_axis()
    planner = _Planner(axis, "motor", "hybrid", 900)
    planner._granularity([Setting(index, 1, 0) for index in indices])
    assert len(planner.questions) == is_asked


# the display of the mode


@pytest.mark.parametrize(
    ("motor", "shows"),
    [
        (another(MOTOR), True),
        (MOTOR, False),  # ours always displays it
        (gone(another(MOTOR), "6061"), False),
        (edit(another(MOTOR), "6061", AccessType="wo"), False),
    ],
)
def test_the_mode_of_another_makers_drive_is_compared_where_it_can_be_read(motor, shows):
    plans = plans_of(motor)
    assert {name: plan.shows_mode for name, plan in plans.items()} == {"motor": shows, "brake": False}


def test_a_display_of_the_mode_that_is_waived_is_a_loss_and_is_not_compared():
    plan = motor_of(another(MOTOR), f'host.accept=["motor: {NOT_SHOWN}"]')
    assert not plan.shows_mode
    assert f"motor: {NOT_SHOWN} (host.accept)" in plan.losses
    assert not any(NOT_SHOWN in text for text in motor_of(another(MOTOR)).losses)


def test_only_a_drive_displays_a_mode():
    assert not brake_of(with_variable(another(BRAKE), "6061", "0x0002", 0, "ro")).shows_mode
    plans = device_plans(Controller(rig_of(drive("A"), brake("402")).one_axis(), "hybrid"))
    assert [plan.shows_mode for plan in plans] == [True, True, False][: len(plans)]
