"""Every object that bring-up sets in each kind of device, with its value and how it is set.

A row is ``INDEX:SUB=VALUE/HOW``, all in hexadecimal; the letters of HOW are those of `HOW`.
"""

from __future__ import annotations

import pytest

from coulombus.host.setup.settings import Setting, encoded, number_of, settings_of, torque_limits
from eds_edit import SENSOR, edit, fixed, mapped
from foreign_eds import BRAKE, I16, MOTOR, with_variable, without
from foreign_rigs import Part, brake, drive, rig_of

HOW = {
    "o": "optional",
    "s": "soft",
    "u": "unless_equal",
    "w": "while_valid",
    "l": "listed",
}
LIMIT_PM = 97


def shown(setting):
    how = "".join(letter for letter, name in HOW.items() if getattr(setting, name)) + "n" * (not setting.verify)
    return f"{setting.index:04X}:{setting.subindex:X}={setting.value:X}" + (f"/{how}" if how else "")


def settings(rig, node, mode="hybrid"):
    return list(settings_of(rig.one_axis(), node, mode, LIMIT_PM))


def rows(rig, node):
    return [shown(one) for one in settings(rig, node)]


def only(rig, node, *indices):
    return [shown(one) for one in settings(rig, node) if one.index in indices]


OWN_HEAD = "1016:1=7F0096/o 1017:0=32/o 1005:0=80/o 1014:0=8{}/ou 2002:0=4E20/o"
HEAD = "1016:1=7F0096/o 1017:0=32/o 1005:0=80/ou 1014:0=8{}/ou 2002:0=4E20/o 1006:0=3E8/osu 1029:1=0/osu"
SPARE = "1801:1=8000028{}/s"
SPARE_1 = "1800:1=80000182/s"
STOPS = "60C2:1=1/osu 60C2:2=-3/osu 6007:0=2/osu 605A:0=0/osu 605B:0=0/osu 605C:0=0/osu 605E:0=0/osu"
RPDO = "1400:1=80000201 1600:0=0/w 1400:2=1/o 1400:5=A/o 1600:1=60400010/w 1600:2={}/w 1600:0=2/w 1400:1=201"
TPDO = (
    "1800:1=80000181 1A00:0=0/w 1800:2=1/o 1800:3=0/o 1800:5=0/o 1800:6=0/o "
    "1A00:1=60410010/w 1A00:2=60640020/w 1A00:3=60770010/w 1A00:0=3/w 1800:1=181"
)
BRAKE_RPDO = "1400:1=80000202 1600:0=0/w 1400:2=1/o 1400:5=A/o 1600:1={}/w 1600:0=1/w 1400:1=202"
BRAKE_TPDO = (
    "1800:1=80000182 1A00:0=0/w 1800:2=1/o 1800:3=0/o 1800:5=0/o 1800:6=0/o "
    "1A00:1=71300110/w 1A00:2=71300210/w 1A00:3=71300310/w 1A00:0=3/w 1800:1=182"
)
AGE, BRAKE_AGE = "2001:0=BB8/o", "2001:0=186A0/o 2005:0=7A120/o"
FIXED = (
    "1400:1=80000201 1600:0=0 1400:2=1/o 1400:5=A/o 1600:1=60600008 1600:2=60400010 1600:3=60710010 1600:0=3 1400:1=201 "
    "1800:1=80000181 1A00:0=0 1800:2=1/o 1800:3=0/o 1800:5=0/o 1800:6=0/o 1A00:1=60610008 1A00:2=60410010 1A00:0=2 "
    "1800:1=181 1802:1=80000381 1A02:0=0 1802:2=1/o 1802:3=0/o 1802:5=0/o 1802:6=0/o 1A02:1=60640020 1A02:2=60770010 "
    "1A02:0=2 1802:1=381"
)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        (
            "own",
            (SPARE.format(1), OWN_HEAD.format(1), "6060:0=A 6071:0=0/l 6072:0=61", AGE, RPDO.format("60710010"), TPDO),
        ),
        (
            "A",
            (
                SPARE.format(1),
                HEAD.format(1),
                "6060:0=A 6071:0=0/l",
                STOPS,
                "6072:0=61",
                AGE,
                RPDO.format("60710010"),
                TPDO,
            ),
        ),
        ("B", (SPARE.format(1), HEAD.format(1), "6060:0=A 6071:0=0/l", STOPS, "6072:0=61", AGE, FIXED)),
        (
            "C",
            (
                *(SPARE.format(1), HEAD.format(1), "6060:0=4 6071:0=0/l 6087:0=161B12", STOPS, "6072:0=61", AGE),
                *(RPDO.format("60710010"), TPDO),
            ),
        ),
        (
            "D",
            (
                SPARE.format(1),
                HEAD.format(1),
                "6060:0=-3 2030:0=0/l",
                STOPS,
                "6072:0=61",
                AGE,
                RPDO.format("20300010"),
                TPDO,
            ),
        ),
    ],
)
def test_every_object_of_each_class_of_drive(kind, expected):
    assert rows(rig_of(drive(kind), brake("own")), "motor") == " ".join(expected).split()


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("own", (OWN_HEAD.format(2), "6340:1=1 7341:1=0", BRAKE_AGE, BRAKE_RPDO.format("73000110"), BRAKE_TPDO)),
        ("404", (HEAD.format(2), "6340:1=1/os 7341:1=0/os", BRAKE_AGE, BRAKE_RPDO.format("73000110"), BRAKE_TPDO)),
        ("401", (SPARE_1, HEAD.format(2), "6443:1=1/os 6444:1=0/os", BRAKE_AGE, BRAKE_RPDO.format("64110110"))),
        ("8ao", (SPARE_1, HEAD.format(2), "6340:3=1/os 7341:3=0/os", BRAKE_AGE, BRAKE_RPDO.format("73000310"))),
        (
            "402",
            (
                *(SPARE.format(2), HEAD.format(2), "6060:0=-3 2030:0=0/l", STOPS),
                "1400:1=80000202 1600:0=0/w 1400:2=1/o 1400:5=A/o 1600:1=60400010/w 1600:2=20300010/w 1600:0=2/w",
                "1400:1=202 1800:1=80000182 1A00:0=0/w 1800:2=1/o 1800:3=0/o 1800:5=0/o 1800:6=0/o 1A00:1=60410010/w",
                "1A00:0=1/w 1800:1=182",
            ),
        ),
    ],
)
def test_every_object_of_each_kind_of_brake(kind, expected):
    assert rows(rig_of(drive("own"), brake(kind)), "brake") == " ".join(expected).split()


def test_a_sensor_gets_what_every_device_gets_and_its_tpdo():
    found = rows(rig_of(drive("own"), brake("401")), "cell")
    assert found[0] == "1400:1=80000203/s"  # its EDS file is the brake's
    assert not [row for row in found if row.startswith(("2002", "2001", "6", "73", "14001:5"))]
    assert "1800:1=183" in found


def test_a_guarded_node_has_its_guard_time_and_no_heartbeat():
    rig = rig_of(drive("own", "guarding"), brake("own"), "host.heartbeat_s=0.04", "motor.heartbeat_timeout_s=0.15")
    found = only(rig, "motor", 0x1016, 0x1017, 0x100C, 0x100D)
    assert found == ["1017:0=0/o", "100C:0=28", "100D:0=4"]


def test_the_rig_files_list_is_set_at_its_places():
    text = "".join(
        f'\n[[motor.sdo]]\nindex = {0x2040 + k:#x}\nsub = {k}\nvalue = {k + 7}\ntype = "UNSIGNED16"\nwhen = "{when}"\n'
        + ("verify = false\n" if when == "end" else "")
        for k, when in enumerate(("end", "after", "before"))
    )
    found = settings(rig_of(drive("own"), brake("own"), text=text), "motor")
    assert shown(found[0]) == "2042:2=9/l"
    assert [shown(one) for one in found[-2:]] == ["2041:1=8/l", "2040:0=7/ln"]
    assert [one.key for one in (found[0], *found[-2:])] == ["motor.sdo.2", "motor.sdo.1", "motor.sdo.0"]
    assert [one.variable_bits for one in (found[0], found[1])] == [16, 0]


@pytest.mark.parametrize(
    ("index", "subindex", "first"), [(0x607E, 0, True), (0x607E, 1, False), (0x687E, 0, False), (0x607D, 0, False)]
)
def test_a_polarity_is_read_first_and_written_only_if_it_differs(index, subindex, first):
    text = f'\n[[motor.sdo]]\nindex = {index:#x}\nsub = {subindex}\nvalue = 64\ntype = "UNSIGNED8"\nwhen = "before"\n'
    setting = settings(rig_of(drive("own"), brake("own"), text=text), "motor")[0]
    assert shown(setting) == f"{index:X}:{subindex}=40/" + ("ul" if first else "l")


# the torque's slope and the cycle's period


@pytest.mark.parametrize(("rate_Nm_s", "expected"), [(5000, 0x2C3623), (1, 580), (1e6, 579488428)])
def test_the_slope_follows_the_hosts_own_rounded_up(rate_Nm_s, expected):
    rig = rig_of(drive("C"), brake("own"), f"limits.torque_rate_Nm_s={rate_Nm_s}")
    (slope,) = (one for one in settings(rig, "motor") if one.index == 0x6087)
    scale_Nm = rig.one_axis().allocation.bound["torque_setpoint"].scale
    assert 0 <= slope.value - rate_Nm_s / scale_Nm < 1
    assert slope.key == "limits.torque_rate_Nm_s"
    assert slope.value == expected


def test_the_slope_keeps_to_what_the_object_takes():
    part = drive("C")
    part = Part(edit(part.eds, "6087", HighLimit=1234), part.text, part.overrides)
    assert only(rig_of(part, brake("own")), "motor", 0x6087) == ["6087:0=4D2"]


@pytest.mark.parametrize(
    ("period_s", "cycle", "exponent"), [(0.001, 1, -3), (0.002, 2, -3), (0.0015, 15, -4), (0.00125, 125, -5)]
)
def test_the_cycles_period_has_the_coarsest_unit_that_is_whole(period_s, cycle, exponent):
    rig = rig_of(drive("A"), brake("own"), f"bus.period_s={period_s}")
    assert only(rig, "motor", 0x60C2) == [f"60C2:1={cycle:X}/osu", f"60C2:2={exponent}/osu"]
    assert only(rig, "motor", 0x1006) == [f"1006:0={round(period_s * 1e6):X}/osu"]


# the drive's own limit


@pytest.mark.parametrize(
    ("ro", "expected"),
    [
        ((), (0x6072,)),
        ((0x6072,), (0x60E0, 0x60E1)),
        ((0x6072, 0x60E0), (0x6073,)),
        ((0x6072, 0x60E1), (0x6073,)),
        ((0x6072, 0x60E0, 0x6073), ()),
    ],
)
@pytest.mark.parametrize("access", ["ro", "const"])
def test_the_first_limit_that_can_be_written_is_taken(ro, expected, access):
    eds = MOTOR
    for index in (0x60E0, 0x60E1, 0x6073):
        if f"[{index:04X}]" not in eds:
            eds = with_variable(eds, f"{index:04X}", I16, 100, "rw")
    for index in ro:
        eds = edit(eds, f"{index:04X}", AccessType=access)
    assert torque_limits(rig_of(Part(eds), brake("own")).one_axis().description("motor")) == expected


@pytest.mark.parametrize(("low", "value"), [(0, 97), (97, 97), (98, 98), (200, 200)])
def test_a_limit_below_what_the_object_takes_is_told(low, value):
    (limit,) = (
        one
        for one in settings(rig_of(Part(edit(MOTOR, "6072", LowLimit=low)), brake("own")), "motor")
        if one.index == 0x6072
    )
    assert limit.value == value
    assert limit.key == "mode.hybrid.motor_limit_Nm"
    assert limit.told == (
        f"its own limit is {value} per mille, the least that 6072h takes; the host limits to 97" if value > 97 else ""
    )


@pytest.mark.parametrize(
    ("watch", "by"), [("all", "only the RPDO deadline 1400h:05"), ("heartbeat", "an old set-point acts")]
)
def test_what_ends_an_old_set_point_is_told(watch, by):
    (age,) = (one for one in settings(rig_of(drive("A", watch), brake("own")), "motor") if one.index == 0x2001)
    assert by in age.lost


# PDOs that are not used


@pytest.mark.parametrize(
    ("value", "off"), [("0x281", True), ("0x40000281", True), ("0x80000281", False), ("0xC0000281", False), ("", True)]
)
def test_a_pdo_that_is_not_used_and_valid_is_switched_off(value, off):
    found = only(rig_of(Part(edit(MOTOR, "1801sub1", DefaultValue=value)), brake("own")), "motor", 0x1801)
    bits = int(value or "0x281", 16) | 1 << 31
    assert found == [f"1801:1={bits:X}/s"] * off


@pytest.mark.parametrize(("map_access", "row"), [("rw", "1A01:0=0/sw"), ("ro", "1801:1=80000281/s")])
def test_a_pdo_whose_identifier_is_read_only_is_emptied_instead(map_access, row):
    eds = edit(edit(MOTOR, "1801sub1", AccessType="ro"), "1A01sub0", AccessType=map_access)
    assert only(rig_of(Part(eds), brake("own")), "motor", 0x1801, 0x1A01) == [row]


# numbers


@pytest.mark.parametrize(
    ("code", "low", "high"), [(0x2, -128, 127), (0x3, -32768, 32767), (0x5, 0, 255), (0x6, 0, 65535), (0x1, 0, 1)]
)
def test_a_number_is_transferred_whole_or_not_at_all(code, low, high):
    description = rig_of(
        Part(edit(MOTOR, "6072", DataType=f"{code:#x}", LowLimit="", HighLimit="", DefaultValue="")), brake("own")
    )
    variable = description.one_axis().description("motor").variable(0x6072, 0)
    for value in (low, high, 1):
        assert number_of(variable, encoded(variable, value)) == value
        assert len(encoded(variable, value)) == (variable.bits + 7) // 8
    for value in (low - 1, high + 1):
        with pytest.raises(OverflowError, match=f"{value} does not fit into 6072h:00"):
            encoded(variable, value)


def test_numbers_are_little_endian():
    variable = rig_of(Part(MOTOR), Part(BRAKE)).one_axis().description("motor").variable(0x6072, 0)
    assert encoded(variable, 0x1234) == b"\x34\x12"
    assert number_of(variable, b"\x34\x12") == 0x1234


def test_an_object_that_the_eds_file_lacks_is_of_the_type_that_the_rig_file_says():
    description = rig_of(drive("own"), brake("own")).one_axis().description("motor")
    variable = Setting(0x2FFF, 3, 1, type="INTEGER32").variable(description)
    assert (variable.index, variable.subindex, variable.bits, variable.access) == (0x2FFF, 3, 32, "rw")
    assert variable.whole == (-(1 << 31), (1 << 31) - 1)
    assert (variable.low, variable.high, variable.node_relative, variable.pdo_mappable) == (None, None, False, False)
    assert variable.line == 1
    with pytest.raises(KeyError, match=r"motor\.eds describes no object 2FFFh"):
        Setting(0x2FFF, 3, 1).variable(description)
    assert Setting(0x6072, 0, 1, type="INTEGER32").variable(description).bits == 16


def test_a_real_is_no_number_of_a_setting():
    eds = edit(MOTOR, "2001", DataType="0x8", LowLimit="", HighLimit="", DefaultValue="")
    variable = rig_of(Part(eds), brake("own")).one_axis().description("motor").variable(0x2001, 0)
    with pytest.raises(OverflowError):
        encoded(variable, 1)
    assert number_of(variable, b"\xff\xff") == 0xFFFF


# times, and what is lost


@pytest.mark.parametrize("node", ["motor", "brake"])
def test_times_are_whole_milliseconds_of_the_rig_file(node):
    times = {"setpoint_fault_s": 0.9, "heartbeat_timeout_s": 0.8, "heartbeat_s": 0.7, "sync_timeout_s": 0.6}
    rig = rig_of(drive("own"), brake("own"), *(f"{node}.{key}={value}" for key, value in times.items()))
    found = {(one.index, one.subindex): one for one in settings(rig, node)}
    expected = {
        (0x1400, 5): (900, "setpoint_fault_s"),
        (0x1016, 1): (127 << 16 | 800, "heartbeat_timeout_s"),
        (0x1017, 0): (700, "heartbeat_s"),
        (0x2002, 0): (600_000, "sync_timeout_s"),
    }
    assert {place: (found[place].value, found[place].key) for place in expected} == {
        place: (value, f"{node}.{key}") for place, (value, key) in expected.items()
    }


@pytest.mark.parametrize(("kind", "lost"), [("own", ""), ("A", "it does not detect a missing RPDO")])
def test_a_deadline_that_another_maker_lacks_is_a_loss(kind, lost):
    found = settings(rig_of(drive(kind), brake("own")), "motor")
    (deadline,) = (one for one in found if (one.index, one.subindex) == (0x1400, 5))
    assert deadline.lost == lost
    assert [one.key for one in found if one.subindex == 2 and one.index in (0x1400, 0x1800)] == ["bus.actuation", ""]


@pytest.mark.parametrize(("node", "name"), [("motor", "drive"), ("brake", "brake")])
def test_the_loss_of_sync_is_named_for_the_device(node, name):
    (sync,) = (one for one in settings(rig_of(drive("own"), brake("own")), node) if one.index == 0x2002)
    assert sync.lost == f"the {name} does not detect the loss of SYNC ({node}.sync_timeout_s)"


def test_the_reaction_to_the_hosts_loss_is_the_one_that_is_lost():
    found = [one for one in settings(rig_of(drive("A"), brake("own")), "motor") if one.index in range(0x6007, 0x605F)]
    assert [one.index for one in found if one.lost] == [0x6007]


@pytest.mark.parametrize(("access", "how"), [("rw", ""), ("ro", ""), ("wo", "/n")])
def test_a_mode_that_cannot_be_read_is_not_read_back(access, how):
    rig = rig_of(Part(edit(MOTOR, "6060", AccessType=access)), brake("own"))
    assert only(rig, "motor", 0x6060) == [f"6060:0=A{how}"]


def test_a_drive_in_profile_torque_without_a_slope_tells_the_loss():
    part = drive("C")
    rig = rig_of(Part(without(part.eds, "6087"), part.text, part.overrides), brake("own"))
    (slope,) = (one for one in settings(rig, "motor") if one.index == 0x6087)
    assert shown(slope) == "6087:0=0/o"
    assert slope.lost == "nothing tells how fast the torque follows in mode 4"


def test_a_drive_may_lack_every_limit_and_a_limit_may_have_no_least():
    description = rig_of(Part(without(MOTOR, "6072", "60E0", "60E1", "6073")), brake("own")).one_axis()
    assert torque_limits(description.description("motor")) == ()
    assert only(rig_of(Part(edit(MOTOR, "6072", LowLimit="")), brake("own")), "motor", 0x6072) == ["6072:0=61"]


@pytest.mark.parametrize(
    ("gone", "by"),
    [
        (("1401sub5", "1402sub5", "1403sub5"), "only the RPDO deadline"),
        (("1400sub5",), "an old set-point acts until the drive detects the loss of the host"),
    ],
)
def test_the_deadline_that_counts_is_that_of_the_rpdo_that_is_used(gone, by):
    (age,) = (
        one for one in settings(rig_of(Part(without(MOTOR, *gone)), brake("own")), "motor") if one.index == 0x2001
    )
    assert by in age.lost


@pytest.mark.parametrize(
    ("gone", "by"),
    [(("1400sub5", "1402sub5"), "only the RPDO deadline"), (("1401sub5",), "an old set-point acts")],
)
def test_the_deadline_that_counts_is_of_the_drives_own_rpdo(gone, by):
    """The drive has its set-point in RPDO 2, the brake in RPDO 1; TPDO 3 of the drive is used."""
    eds = fixed(MOTOR, *(base + k for base in (0x1600, 0x1A00) for k in range(4)))
    eds = mapped(mapped(eds, 0x1600, 0x60600008), 0x1601, 0x60400010, 0x60710010)
    eds = mapped(mapped(eds, 0x1A00, 0x60410010), 0x1A02, 0x60640020, 0x60770010)
    rig = rig_of(Part(without(eds, *gone)), Part(BRAKE))
    (age,) = (one for one in settings(rig, "motor") if one.index == 0x2001)
    assert by in age.lost


def test_the_slope_is_at_most_31_bits():
    rig = rig_of(drive("C"), brake("own"), "limits.torque_rate_Nm_s=1e7", "motor.rated_torque_Nm=0.01")
    assert only(rig, "motor", 0x6087) == ["6087:0=7FFFFFFF"]


def test_an_unused_pdo_without_its_map_is_switched_off_where_its_identifier_is_read_only():
    eds = without(edit(MOTOR, "1801sub1", AccessType="ro"), "1A01")
    assert only(rig_of(Part(eds), brake("own")), "motor", 0x1801, 0x1A01) == ["1801:1=80000281/s"]


def test_a_pdo_without_a_default_beyond_the_four_is_off_already():
    eds = with_variable(without(MOTOR, "1801"), "15FFsub1", "0x7", "", "rw")
    eds += "\n\n[15FF]\nParameterName=X\nObjectType=0x9\nSubNumber=1\n\n"
    assert only(rig_of(Part(eds), brake("own")), "motor", 0x15FF) == []


def test_the_last_of_512_pdos_is_looked_at_too():
    eds = with_variable(without(MOTOR, "1801"), "15FFsub1", "0x7", "0x222", "rw")
    eds += "\n\n[15FF]\nParameterName=X\nObjectType=0x9\nSubNumber=1\n\n"
    assert only(rig_of(Part(eds), brake("own")), "motor", 0x15FF) == ["15FF:1=80000222/s"]


@pytest.mark.parametrize("number", [0x1403, 0x1801])
def test_a_pdo_without_an_identifier_is_left_alone(number):
    assert only(rig_of(Part(without(MOTOR, f"{number:04X}sub1")), brake("own")), "motor", number) == []


def test_a_map_needs_its_number_only_to_be_emptied():
    eds = without(edit(MOTOR, "1801sub1", AccessType="ro"), *(f"1A01sub{k}" for k in range(1, 9)))
    assert only(rig_of(Part(eds), brake("own")), "motor", 0x1801, 0x1A01) == ["1A01:0=0/sw"]


@pytest.mark.parametrize("ms", [1, 7])
def test_a_tpdo_that_does_not_follow_sync_has_an_event_timer(ms):
    eds = edit(edit(MOTOR, "1800sub2", AccessType="ro", DefaultValue=255), "1800sub5", AccessType="ro", DefaultValue=ms)
    rig = rig_of(Part(eds), brake("own"), "limits.missed_tpdo_cycles=20")
    assert f"1800:5={ms:X}" in rows(rig, "motor")


def test_the_mode_is_read_back_where_the_eds_file_says_nothing_of_it():
    assert only(rig_of(Part(without(MOTOR, "6060")), brake("own")), "motor", 0x6060) == ["6060:0=A"]
    eds = without(edit(MOTOR, "6060", AccessType="wo"), "6061")
    assert only(rig_of(Part(eds), brake("own")), "motor", 0x6060) == ["6060:0=A/n"]


def test_the_slope_has_no_sign_where_a_brakes_table_falls():
    part = brake("402")
    table = part.text.replace("scale_Nm = 0.002", "table = [[0, 0.0], [-2000, 4.0]]")
    part = Part(part.eds, table, (*part.overrides[:2], "brake.mode=4"))
    assert only(rig_of(drive("own"), part), "brake", 0x6087) == ["6087:0=1312D0"]


def test_a_brake_that_does_not_take_the_set_point_gets_no_fault_value():
    text = SENSOR + '\n[role.brake_setpoint]\nnode = "cell"\nobject = "7300:1"\nscale_Nm = 0.001\n'
    rig = rig_of(drive("own"), brake("own"), text=text)
    assert only(rig, "brake", 0x6340, 0x7341, 0x2001, 0x2005) == []
    assert [row for row in rows(rig, "cell") if row.startswith("14") and ":5=" in row] == ["1400:5=0/o"]


MUTE = "it reports no fault to the host by EMCY"
SWITCHED_ON = "its EMCY is switched off in 1014h (bit 31); bring-up switches it on"


@pytest.mark.parametrize(
    ("default", "access", "value", "soft", "lost", "told"),
    [
        ("$NODEID+0x80", "rw", 0x81, False, "", ""),
        ("$NODEID+0x80", "ro", 0x81, False, "", ""),
        ("", "rw", 0x81, False, "", ""),
        ("", "ro", 0x81, False, "", ""),
        ("$NODEID+0x80000080", "rw", 0x81, False, "", SWITCHED_ON),
        ("$NODEID+0x80000080", "ro", 0x81, True, MUTE, ""),
        ("0", "rw", 0x81, False, "", ""),
        ("0", "ro", 0x81, True, MUTE, ""),
        ("0x80", "rw", 0x81, True, "", ""),
        ("0x80", "ro", 0x81, True, "", ""),
        ("0x91", "rw", 0x91, False, "", ""),
        (None, "", 0x81, True, MUTE, ""),
    ],
)
def test_emcy_is_switched_on_where_it_can_be_and_else_a_loss(default, access, value, soft, lost, told):
    """A device that has SYNC's identifier for ever is refused elsewhere: here that is no second one."""
    eds = without(MOTOR, "1014") if default is None else edit(MOTOR, "1014", DefaultValue=default, AccessType=access)
    (one,) = (one for one in settings(rig_of(Part(eds), brake("own")), "motor") if one.index == 0x1014)
    assert (one.subindex, one.value, one.optional, one.unless_equal) == (0, value, True, True)
    assert (one.soft, one.lost, one.told) == (soft, lost, told)
