"""Another maker's device, simulated: its kind, what is opened for it, a mode of its maker's own,
guarding, its first TPDOs.
"""

from __future__ import annotations

import struct

import pytest

from coulombus.eds.reader import parse_eds, read_eds
from coulombus.node.brake404 import BRAKE404
from coulombus.node.drive402 import DRIVE402, with_own_mode
from coulombus.node.io401 import IO401, IO404
from coulombus.node.kinds import GENERIC, of_description
from coulombus.node.relaxed_eds import completed, opened
from coulombus.wire.frame import CAN_RTR_FLAG
from foreign_eds import (
    BRAKE,
    I8,
    I16,
    I32,
    MOTOR,
    REAL32,
    U8,
    U16,
    U32,
    U64,
    another,
    dual,
    edited,
    with_array,
    with_variable,
    without,
)
from node_bench import MS, Bench, SdoAborted
from places import CORPUS, beside

FILES = sorted(path for kind in ("*.eds", "*.dcf") for path in CORPUS.glob(kind))


def described(text):
    return parse_eds(text.encode(), "x.eds")


def served(text, kind=None, node_id=5):
    description = described(text)
    kind = kind or of_description(description)
    bench = Bench("x", node_id, kind, opened(description, kind).description)
    bench.power_on()
    bench.take()
    return bench


def enabled(bench, mode):
    bench.nmt(1)
    bench.write(0x6060, 0, mode, 1)
    for controlword in (0x80, 6, 7, 15):
        bench.write(0x6040, 0, controlword, 2)
    assert bench.node.power_state == 4


# kinds


BARE = without(MOTOR, "1018", "60", "6502", "2")


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        (MOTOR, DRIVE402),
        (BRAKE, BRAKE404),
        (another(MOTOR), DRIVE402),
        (another(BRAKE), IO404),
        (edited(another(MOTOR), "1000", DefaultValue=0), DRIVE402),
        (edited(another(BRAKE), "1000", DefaultValue="0xFFFF0192"), IO404),
        (BARE, GENERIC),
        (with_array(BARE, "6411", I16, 2), IO401),
        (with_array(BARE, "6401", I32, 2), GENERIC),  # CiA 406's work area
        (with_array(BARE, "6000", U8, 1, "ro"), IO401),
        (with_variable(BARE, "6000", U16, 0, "ro"), GENERIC),  # CiA 406's operating parameters
        (with_array(BARE, "9130", I32, 2, "ro"), IO404),
    ],
)
def test_the_kind_is_that_of_1000h_or_of_the_objects(text, kind):
    assert of_description(described(text)) is kind


def test_a_cia_404_module_gives_counts_and_takes_counts():
    text = with_array(with_array(another(BRAKE), "9300", I32, 1), "9130", I32, 1, "ro")
    bench = served(text)
    assert bench.node.out_analogue[0] == 0
    bench.write(0x7300, 1, 1234, 2)
    assert bench.node.out_analogue[0] == 1234
    bench.write(0x9300, 1, 100_000, 4)
    assert bench.node.out_analogue[0] == 100_000
    bench.node.in_analogue[0] = -70_000
    assert bench.number(0x9130, 1, signed=True) == -70_000


@pytest.mark.parametrize(("mode", "expected"), [(1, 77), (0, 1234)])
def test_a_cia_404_output_takes_its_fault_value(mode, expected):
    bench = served(another(BRAKE))
    bench.write(0x6340, 1, mode, 1)
    bench.write(0x7341, 1, 77, 2)
    bench.nmt(1)
    bench.write(0x7300, 1, 1234, 2)
    bench.nmt(2)
    assert bench.node.out_analogue[0] == expected


def test_a_fault_mode_is_0_or_1():
    bench = served(edited(another(BRAKE), "6340sub1", HighLimit=255))
    with pytest.raises(SdoAborted, match="06090030"):
        bench.write(0x6340, 1, 2, 1)


# what is opened


def test_nothing_of_our_own_files_is_opened():
    for text, kind in ((MOTOR, DRIVE402), (BRAKE, BRAKE404)):
        description = described(text)
        assert opened(description, kind) == opened(description, GENERIC)
        assert opened(description, kind).description is description
        assert opened(description, kind).remarks == ()


@pytest.mark.parametrize(
    ("section", "keys", "label", "value"),
    [
        ("6072", {"DefaultValue": 0}, "6072h is 0", 3000),
        ("6072", {"DefaultValue": 0, "HighLimit": 1200}, "6072h is 0", 1200),
        ("6073", {"DefaultValue": 0}, "6073h is 0", 3000),
        ("60E0", {"DefaultValue": ""}, "60E0h is without a default", 3000),
        ("60E1", {"DefaultValue": 0}, "60E1h is 0", 3000),
        ("6080", {"DefaultValue": 0}, "6080h is 0", 0xFFFFFFFF),
        ("6087", {"DefaultValue": 0, "HighLimit": 32767}, "6087h is 0", 32767),
        ("6502", {"DefaultValue": 0}, "6502h is 0", 0x30C),
        ("6502", {"DefaultValue": ""}, "6502h is without a default", 0x30C),
    ],
)
def test_defaults_that_block_a_drive_are_opened_and_told(section, keys, label, value):
    text = edited(edited(another(MOTOR), "6072", DefaultValue=1000), section, **keys)
    found = opened(described(text), DRIVE402)
    assert found.description.variable(int(section, 16), 0).default == value
    (remark,) = found.remarks
    assert remark.startswith(f"x.eds: {label}")
    assert found.description.variable(0x6040, 0) == described(text).variable(0x6040, 0)


@pytest.mark.parametrize(
    ("section", "keys", "remark", "typed"),
    [
        ("60FF", {"DataType": U32, "DefaultValue": "0xFFFFFC18"}, "60FFh is UNSIGNED32 in the file, signed at CiA; served as INTEGER32",
         (0x0004, None, None, -1000)),
        ("60FF", {"DataType": U32, "DefaultValue": 7, "LowLimit": 0, "HighLimit": 3000}, "60FFh is UNSIGNED32", (0x0004, None, 3000, 7)),
        ("60FF", {"DataType": U32, "LowLimit": 5, "HighLimit": "0xFFFFFFFF"}, "60FFh is UNSIGNED32", (0x0004, 5, None, 0)),
        ("607Dsub1", {"DataType": U32, "DefaultValue": "0x80000000"}, "607Dh:01 is UNSIGNED32", (0x0004, None, None, -(1 << 31))),
        ("6060", {"DataType": U8, "DefaultValue": 255}, "6060h is UNSIGNED8", (0x0002, None, None, -1)),
        ("1017", {"DataType": I16, "DefaultValue": -25536, "LowLimit": -32768, "HighLimit": 32767},
         "1017h is INTEGER16 in the file, unsigned at CiA; served as UNSIGNED16", (0x0006, None, 32767, 40000)),
        ("1400sub5", {"DataType": I16, "DefaultValue": 10}, "1400h:05 is INTEGER16", (0x0006, None, None, 10)),
    ],
)  # fmt: skip
def test_an_integer_has_the_sign_of_cia_s_type(section, keys, remark, typed):
    text = edited(edited(another(MOTOR), "6072", DefaultValue=1000), section, **keys)
    index, _, subindex = section.partition("sub")
    for reading in (opened(described(text), DRIVE402), completed(described(text), DRIVE402)):
        variable = reading.description.variable(int(index, 16), int(subindex or 0))
        assert (variable.data_type, variable.low, variable.high, variable.default) == typed
        assert reading.remarks[0].startswith(f"x.eds: {remark}")
        assert opened(reading.description, DRIVE402).remarks == ()
    ours = edited(MOTOR, section, **keys)
    assert (
        completed(described(ours), DRIVE402).description.variable(int(index, 16), int(subindex or 0)).data_type
        != typed[0]
    )


def test_a_window_that_is_off_is_off_whatever_sign_its_type_has():
    text = edited(another(MOTOR), "6072", DefaultValue=1000)
    for section in ("6065", "6067"):
        text = with_variable(text, section, I32, -1)
    reading = opened(described(text), DRIVE402)
    assert [reading.description.variable(index, 0).default for index in (0x6065, 0x6067)] == [0xFFFFFFFF] * 2
    assert reading.remarks == (
        "x.eds: 6065h and 1 more are INTEGER32 in the file, unsigned at CiA; served as UNSIGNED32",
    )


def test_a_sign_belongs_to_an_object_of_a_drive_and_to_no_count():
    text = edited(edited(another(MOTOR), "6072", DefaultValue=1000), "607Dsub0", DataType=I8)
    assert opened(described(text), DRIVE402).remarks == completed(described(text), DRIVE402).remarks == ()
    unsigned = edited(dual(text), "68FF", DataType=U32)
    assert [remark.partition(" is ")[0] for remark in opened(described(unsigned), DRIVE402, axis=2).remarks][:1] == [
        "x.eds: 68FFh"
    ]
    for kind in (IO401, GENERIC):
        assert completed(described(unsigned), kind).remarks == ()


@pytest.mark.parametrize(
    "section", ["1006", "1007", "100C", "100D", "1015", "1017", "1029sub1", "1400sub5", "1800sub5"]
)
@pytest.mark.parametrize("data_type", [U32, U64])
@pytest.mark.parametrize("written", [1, 0x7F, 0xFF])
def test_the_largest_time_of_a_wide_type_is_taken(section, data_type, written):
    index, _, subindex = section.partition("sub")
    text = edited(
        edited(another(MOTOR), "100D", DataType=data_type, HighLimit=""), "100C", DataType=data_type, HighLimit=""
    )
    bench = served(
        edited(text, section, DataType=data_type, DefaultValue=0, LowLimit="", HighLimit="", AccessType="rw")
    )
    data = bytes((*(255,) * (3 if data_type == U32 else 7), written))
    for key in ((0x100C, 0), (0x100D, 0), (int(index, 16), int(subindex or 0))):
        bench.download(*key, data)
        assert bench.upload(*key) == data
    bench.nmt(1)
    bench.sync()
    bench.run(20 * MS)
    assert (bench.node.guard_life_ns > 0) == (section != "1017")  # who sends heartbeats is not guarded


@pytest.mark.parametrize("data_type", [I32, U32])
def test_a_negative_speed_turns_backwards_whatever_sign_its_type_has(data_type):
    bench = served(edited(another(MOTOR), "60FF", DataType=data_type))
    enabled(bench, 9)
    bench.write(0x60FF, 0, 0xFFFFFC18, 4)
    assert bench.node.out_torque_pm < 0
    bench.run(MS)
    assert bench.node.speed_demand == -1000


@pytest.mark.parametrize(
    ("section", "limit", "free"), [("6080", 0, 0xFFFFFFFF), ("607Dsub1", 0, -(1 << 31)), ("607Dsub2", 0, (1 << 31) - 1)]
)
def test_a_limit_that_an_rpdo_writes_limits(section, limit, free):
    text = edited(edited(another(MOTOR), section, PDOMapping=1, AccessType="rww"), "6072", DefaultValue=1000)
    bench = served(text)
    mapped = int(section[:4], 16) << 16 | int(section[7:] or 0) << 8 | 32
    for index, subindex, value, size in (
        (0x1400, 1, 0x80000205, 4), (0x1400, 2, 255, 1), (0x1600, 0, 0, 1), (0x1600, 1, mapped, 4), (0x1600, 0, 1, 1),
        (0x1400, 1, 0x205, 4),
    ):  # fmt: skip
        bench.write(index, subindex, value, size)
    enabled(bench, 10)
    bench.write(0x6071, 0, (-100 if section == "607Dsub1" else 100) & 0xFFFF, 2)
    torques = []
    for value in (free, limit, free):
        bench.frame(0x205, (value & 0xFFFFFFFF).to_bytes(4, "little"))
        bench.run(2 * MS)
        torques.append(abs(int(bench.node.out_torque_pm)))
    assert torques == [100, 0, 100]


def test_a_position_range_of_nothing_is_the_whole_range():
    text = edited(another(MOTOR), "6072", DefaultValue=1000)
    blocked = edited(edited(text, "607Dsub1", DefaultValue=0), "607Dsub2", DefaultValue=0)
    found = opened(described(blocked), DRIVE402)
    assert [found.description.variable(0x607D, k).default for k in (1, 2)] == [-(1 << 31), (1 << 31) - 1]
    assert [remark.partition(",")[0] for remark in found.remarks] == ["x.eds: 607Dh is 0 on both sides in the file"]
    one_sided = edited(blocked, "607Dsub2", DefaultValue=5)
    assert opened(described(one_sided), DRIVE402).remarks == ()
    whole = edited(
        edited(text, "607Dsub1", DefaultValue=0, DataType=U32), "607Dsub2", DefaultValue="0xFFFFFFFF", DataType=U32
    )
    relaxed = opened(described(whole), DRIVE402)
    assert [relaxed.description.variable(0x607D, k).default for k in (1, 2)] == [-(1 << 31), (1 << 31) - 1]
    assert relaxed.remarks[1].startswith("x.eds: 607Dh is 0 to -1 in the file, which would")


def test_a_setpoint_that_is_no_integer_moves_nothing():
    bench = served(edited(another(MOTOR), "6071", DataType=REAL32, DefaultValue=""))
    enabled(bench, 10)
    bench.download(0x6071, 0, struct.pack("<f", 100.0))
    bench.run(5 * MS)
    assert (bench.node.out_torque_pm, bench.upload(0x6071)) == (0.0, struct.pack("<f", 100.0))


def test_a_limit_below_cia_s_range_is_opened():
    text = edited(edited(another(BRAKE), "1016sub1", HighLimit=65535), "1400sub1", HighLimit="0x7FF", LowLimit=1)
    found = opened(described(text), IO404)
    assert [remark.partition(",")[0] for remark in found.remarks] == [
        "x.eds: 1016h:01 has the HighLimit 65535",
        "x.eds: 1400h:01 has the HighLimit 2047",
    ]
    bench = served(text)
    bench.write(0x1016, 1, 0x007F0064, 4)
    bench.write(0x1400, 1, 0x80000205, 4)
    strict = Bench("x", 5, GENERIC, described(text))
    strict.power_on()
    with pytest.raises(SdoAborted, match="06090031"):
        strict.write(0x1016, 1, 0x007F0064, 4)


def test_a_high_limit_of_0_is_one_that_nobody_has_set():
    bench = served(edited(another(MOTOR), "6085", LowLimit=0, HighLimit=0))
    bench.write(0x6085, 0, 5000, 4)
    assert bench.number(0x6085) == 5000


def test_a_negative_60E1h_limits_to_the_negative_side():
    text = edited(another(MOTOR), "60E1", DataType=I16, DefaultValue=-400, LowLimit=-1000, HighLimit=0)
    bench = served(text)
    enabled(bench, 10)
    bench.write(0x6071, 0, -900, 2)
    bench.run(MS)
    assert bench.node.out_torque_pm == -400


# a mode of the maker's own


def current_mode(mode=-3, per_mille=0.2, **keys):
    text = with_variable(edited(another(MOTOR), "6072", DefaultValue=1000, **keys), "2030", I16, 0)
    return served(text, with_own_mode(mode, (0x2030, 0), per_mille))


@pytest.mark.parametrize("mode", [-3, -128, 10, 4])
def test_a_set_point_of_the_makers_own_acts_in_its_mode(mode):
    bench = current_mode(mode)
    enabled(bench, mode)
    bench.write(0x2030, 0, -1503, 2)
    bench.run(MS)
    assert bench.node.out_torque_pm == pytest.approx(-300.6)
    assert bench.number(0x6061, signed=False) == mode & 0xFF
    bench.write(0x2030, 0, 30_000, 2)
    bench.run(MS)
    assert bench.node.out_torque_pm == 1000  # 6072h
    assert bench.number(0x6041) & 0x0800
    bench.write(0x6040, 0, 0x10F, 2)  # halt
    bench.run(MS)
    assert bench.node.out_torque_pm == 0


def test_the_makers_set_point_does_nothing_in_cia_s_modes():
    bench = current_mode()
    enabled(bench, 10)
    bench.write(0x2030, 0, 1500, 2)
    bench.run(MS)
    assert bench.node.out_torque_pm == 0
    bench.write(0x6071, 0, 250, 2)
    bench.run(MS)
    assert bench.node.out_torque_pm == 250
    bench.write(0x6060, 0, -3, 1)  # goes to torque 0 first, and wants a new set-point
    bench.run(200 * MS)
    assert bench.node.mode == -3
    assert bench.node.out_torque_pm == 0


def test_a_mode_that_neither_the_drive_nor_its_maker_has_is_refused():
    bench = current_mode()
    with pytest.raises(SdoAborted, match="06090030"):
        bench.write(0x6060, 0, -4, 1)
    with pytest.raises(SdoAborted, match="06090030"):
        served(another(MOTOR)).write(0x6060, 0, -3, 1)


def test_a_set_point_in_a_pdo_acts_as_one_by_sdo():
    bench = current_mode()
    bench.write(0x1400, 1, 0x80000205, 4)
    bench.write(0x1600, 0, 0, 1)
    bench.write(0x1600, 1, 0x60400010, 4)
    bench.write(0x1600, 2, 0x20300010, 4)
    bench.write(0x1600, 0, 2, 1)
    bench.write(0x1400, 2, 255, 1)
    bench.write(0x1400, 1, 0x205, 4)
    enabled(bench, -3)
    bench.frame(0x205, bytes((15, 0)) + (500).to_bytes(2, "little"))
    assert bench.node.out_torque_pm == pytest.approx(100)
    bench.nmt(128)
    assert bench.node.out_torque_pm == 0


def test_torque_in_32_bits():
    text = edited(edited(another(MOTOR), "6071", DataType=I32), "6077", DataType=I32)
    bench = served(edited(text, "6072", DefaultValue=1000))
    enabled(bench, 10)
    bench.write(0x6071, 0, -321, 4)
    bench.run(MS)
    assert bench.node.out_torque_pm == -321
    bench.node.in_torque_pm = -320.6
    assert bench.number(0x6077) == 0x100000000 - 321


# PDOs whose COB-ID no client can change


@pytest.mark.parametrize("access", ["ro", "const"])
def test_a_map_that_can_be_written_is_written_where_the_cob_id_cannot(access):
    text = edited(edited(another(MOTOR), "1400sub1", AccessType=access), "1800sub1", AccessType=access)
    bench = served(text)
    with pytest.raises(SdoAborted, match="06010002"):
        bench.write(0x1400, 1, 0x80000205, 4)
    with pytest.raises(SdoAborted, match="08000022"):
        bench.write(0x1600, 1, 0x60710010, 4)  # by way of 0 entries
    bench.write(0x1600, 0, 0, 1)
    bench.write(0x1600, 1, 0x60710010, 4)
    bench.write(0x1600, 0, 1, 1)
    bench.write(0x1800, 3, 100, 2)
    bench.write(0x1400, 2, 255, 1)
    bench.nmt(1)
    bench.frame(0x205, (250).to_bytes(2, "little"))
    assert bench.number(0x6071) == 250
    with pytest.raises(SdoAborted, match="08000022"):
        served(another(MOTOR)).write(0x1600, 0, 0, 1)


# guarding, on a drive that has neither heartbeats nor 1029h


def guarded(option, guard_ms=50, factor=3):
    text = without(edited(another(MOTOR), "6072", DefaultValue=1000), "1016", "1017", "1029")
    bench = served(text, node_id=1)
    bench.write(0x6007, 0, option, 2)
    bench.write(0x100C, 0, guard_ms, 2)
    bench.write(0x100D, 0, factor, 1)
    enabled(bench, 10)
    bench.write(0x6071, 0, 100, 2)
    bench.take()
    return bench


@pytest.mark.parametrize(("option", "state", "torque"), [(0, 4, 100), (1, 7, 0), (2, 1, 0), (3, 1, 0)])
def test_another_makers_drive_does_what_6007h_says_when_its_guarding_host_is_lost(option, state, torque):
    bench = guarded(option)
    answers = []
    for _ in range(4):
        bench.frame(0x701 | CAN_RTR_FLAG, length=1)
        answers += [frame.data[0] for frame in bench.take(0x701)]
        bench.run(50 * MS)
    assert answers == [5, 0x85, 5, 0x85]
    assert bench.node.out_torque_pm == 100
    bench.run(99 * MS)
    assert bench.emcy() == []
    bench.run(2 * MS)
    assert bench.emcy()[0][0] == 0x8130
    assert (bench.node.power_state, bench.node.out_torque_pm, bench.node.nmt) == (state, torque, 127)
    bench.frame(0x701 | CAN_RTR_FLAG, length=1)  # the host is back
    told = [code for code, _, _ in bench.emcy()]
    assert told == ([] if option == 1 else [0])  # a fault is told until its reset


@pytest.mark.parametrize("option", [0, 1, 2])
def test_the_loss_of_the_host_is_a_fault_of_a_drive_without_6007h_and_of_our_own(option):
    foreign = without(edited(another(MOTOR), "6072", DefaultValue=1000), "1016", "1017", "1029", "6007")
    for text in (foreign, edited(MOTOR, "6072", DefaultValue=1000)):
        bench = served(text, node_id=1)
        if "[6007]" in text:
            bench.write(0x6007, 0, option, 2)
        bench.write(0x100C, 0, 50, 2)
        bench.write(0x100D, 0, 2, 1)
        enabled(bench, 10)
        bench.frame(0x701 | CAN_RTR_FLAG, length=1)
        bench.run(100 * MS)
        assert bench.node.power_state == 7


@pytest.mark.parametrize(("bit", "code"), [(0, 0x2310), (2, 0x7305)])
@pytest.mark.parametrize("option", [0, 1, 2, 3])
def test_6007h_is_for_a_lost_host_and_for_nothing_else(bit, code, option):
    bench = guarded(option)
    bench.node.in_faults = 1 << bit
    bench.sync()
    assert bench.emcy()[0][0] == code
    assert (bench.node.power_state, bench.node.out_torque_pm) == (7, 0)


# vendors' files


def corpus(test):
    return beside(CORPUS)(pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)(test))


@corpus
def test_a_vendors_file_is_served_and_gives_torque_where_it_has_the_objects(path):
    description = read_eds(path)
    kind = of_description(description)
    bench = Bench("x", 5, kind, opened(description, kind).description)
    bench.power_on()
    bench.take()
    if kind is not DRIVE402 or not description.has(0x6071):
        bench.nmt(1)
        bench.run(100 * MS)
        return
    modes = bench.device.dictionary.number(0x6502)
    torque_modes = [mode for mode in (10, 4) if modes >> mode - 1 & 1]
    if not torque_modes:
        assert path.stem == "technosoft_iPOS"  # its torque modes are its maker's own
    for mode in torque_modes:
        enabled(bench, mode)
        bench.write(0x6071, 0, 60, description.variable(0x6071, 0).bits // 8)
        bench.run(400 * MS)
        assert bench.node.out_torque_pm == 60
        bench.write(0x6040, 0, 0, 2)
        assert bench.node.out_torque_pm == 0


def starts(description, kind):
    bench = Bench("x", 5, kind, description)
    bench.power_on()
    for command in ((), (2,), (128,), (130,), (129,)):
        for one in command:
            bench.nmt(one)
        bench.take()
        due = [int(p["cob_id"]) for p in bench.node["tpdo"] if p["cob_id"] >= 0 and p["transmission"] >= 254]
        bench.nmt(1)
        sent = [frame.can_id for frame in bench.sent]
        assert [sent.count(can_id) for can_id in due] == [due.count(can_id) for can_id in due]
    return due


@corpus
def test_event_driven_tpdos_of_a_vendors_file_are_sent_once_at_every_start(path):
    description = read_eds(path)
    for kind in (of_description(description), GENERIC):
        starts(opened(description, kind).description, kind)


def test_event_driven_tpdos_are_sent_once_at_every_start():
    text = another(MOTOR)
    for k in range(4):
        for section, keys in (
            (f"18{k:02X}sub1", {"DefaultValue": 0x181 + k}),
            (f"18{k:02X}sub2", {"DefaultValue": 255}),
        ):
            text = edited(text, section, **keys)
    assert len(starts(described(text), DRIVE402)) == 4
