"""PDOs of a node: transmission types, lengths, inhibit and event times, RTR, remapping by the
prescribed procedure.
"""

from __future__ import annotations

import random
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.eds.reader import parse_eds
from coulombus.node import slots402
from coulombus.node.brake404 import BRAKE404
from coulombus.node.drive402 import DRIVE402
from coulombus.node.kinds import GENERIC
from coulombus.wire.frame import CAN_RTR_FLAG
from eds_text import HEAD, variable
from node_bench import MS, US, Bench, SdoAborted, motor, setpoint

INVALID = 0x80000000


def booted(name: str = "motor", node_id: int = 1) -> Bench:
    bench = Bench(name, node_id)
    bench.power_on()
    bench.take()
    return bench


def remap(bench: Bench, direction: str, number: int, entries, cob_id: int, transmission: int) -> None:
    """The procedure of CiA 301: destroy, count 0, entries, count, create."""
    communication, mapping = {"rpdo": (0x1400, 0x1600), "tpdo": (0x1800, 0x1A00)}[direction]
    communication, mapping = communication + number - 1, mapping + number - 1
    bench.write(communication, 1, INVALID | cob_id, 4)
    bench.write(mapping, 0, 0, 1)
    for position, (index, subindex, bits) in enumerate(entries, 1):
        bench.write(mapping, position, index << 16 | subindex << 8 | bits, 4)
    bench.write(mapping, 0, len(entries), 1)
    bench.write(communication, 2, transmission, 1)
    bench.write(communication, 1, cob_id, 4)


def times(bench: Bench, can_id: int) -> list[int]:
    return [s.t_ns - 20 * US for s in bench.take(can_id)]


# transmission


@pytest.mark.parametrize("every", [1, 2, 3, 240])
def test_cyclic_synchronous_tpdo(every):
    bench = booted()
    bench.write(0x1800, 2, every, 1)
    bench.nmt(1)
    for _ in range(3 * every):
        bench.run(MS)
        bench.sync()
    assert times(bench, 0x181) == [k * every * MS for k in (1, 2, 3)]


def test_sync_start_value_delays_the_first_transmission():
    bench = booted()
    bench.write(0x1019, 0, 6, 1)
    bench.write(0x1800, 1, INVALID | 0x181, 4)
    bench.write(0x1800, 6, 4, 1)
    bench.write(0x1800, 2, 2, 1)
    bench.write(0x1800, 1, 0x181, 4)
    bench.nmt(1)
    bench.take()
    sent_at = []
    for k in range(12):
        counter = k % 6 + 1
        bench.sync(bytes((counter,)))
        if bench.take(0x181):
            sent_at.append((k, counter))
    assert sent_at == [(3, 4), (5, 6), (7, 2), (9, 4), (11, 6)]


def test_acyclic_synchronous_tpdo_is_sent_on_the_sync_after_a_change():
    bench = booted()
    bench.write(0x1801, 2, 0, 1)  # 606Ch
    bench.nmt(1)
    sent = []
    for velocity in (0, 0, 5, 5, 5, -3, 0, 0):
        bench.node.in_velocity_counts_s = velocity
        bench.run(MS)
        bench.sync()
        sent.append(len(bench.take(0x281)))
    assert sent == [1, 0, 1, 0, 0, 1, 1, 0]


def test_event_driven_tpdo_by_its_timer():
    bench = booted()
    bench.write(0x1801, 2, 254, 1)
    bench.write(0x1801, 5, 10, 2)
    bench.nmt(1)
    assert times(bench, 0x281) == [0]
    for k in range(1, 35):
        bench.at(k * MS, 0x080)  # SYNC and the change of the velocity move nothing
        bench.node.in_velocity_counts_s = k
    assert times(bench, 0x281) == [10 * MS, 20 * MS, 30 * MS]
    bench.write(0x1801, 5, 0, 2)
    bench.nmt(128)
    bench.take()
    bench.run(100 * MS)
    assert bench.take() == []


def test_event_driven_tpdo_on_change_waits_for_the_inhibit_time():
    bench = booted()
    remap(bench, "tpdo", 3, [(0x6041, 0, 16)], 0x381, 255)
    bench.write(0x1802, 1, INVALID | 0x381, 4)
    bench.write(0x1802, 3, 50, 2)  # 5 ms
    bench.write(0x1802, 1, 0x381, 4)
    bench.nmt(1)
    assert times(bench, 0x381) == [0]
    for t_ms, controlword in ((1, 6), (2, 7), (3, 0), (4, 6)):
        bench.until(t_ms * MS)
        bench.write(0x6040, 0, controlword, 2)
    bench.until(30 * MS)
    (frame,) = bench.take(0x381)
    assert frame.t_ns == 5 * MS + 20 * US
    assert int.from_bytes(frame.data, "little") & 0x6F == 0x21  # the latest value, once
    bench.write(0x6040, 0, 7, 2)
    assert times(bench, 0x381) == [30 * MS]


def test_a_changed_event_timer_or_transmission_type_keeps_the_inhibit_time():
    bench = booted()
    bench.write(0x1801, 1, INVALID | 0x281, 4)
    bench.write(0x1801, 2, 254, 1)
    bench.write(0x1801, 3, 500, 2)  # 50 ms
    bench.write(0x1801, 5, 60, 2)
    bench.write(0x1801, 1, 0x281, 4)
    bench.nmt(1)
    bench.until(65 * MS)
    assert times(bench, 0x281) == [0, 60 * MS]
    bench.write(0x1801, 5, 10, 2)
    bench.until(115 * MS)
    assert times(bench, 0x281) == [110 * MS]
    bench.write(0x1801, 5, 100, 2)
    bench.write(0x1801, 2, 255, 1)
    bench.until(215 * MS)
    assert times(bench, 0x281) == [210 * MS]


def test_a_changed_transmission_type_counts_anew_and_a_changed_event_timer_does_not():
    bench = booted()
    bench.write(0x1800, 2, 3, 1)
    bench.nmt(1)
    seen = []
    for count in range(1, 9):
        bench.sync()
        seen += [count] * len(bench.take(0x181))
        if count == 2:
            bench.write(0x1800, 5, 10, 2)
        if count == 4:
            bench.write(0x1800, 2, 4, 1)
    assert seen == [3, 8]


def test_rtr_is_answered_where_the_cob_id_allows():
    bench = booted()
    bench.write(0x1801, 1, INVALID | 0x281, 4)
    bench.write(0x1801, 2, 253, 1)
    bench.write(0x1801, 1, 0x281, 4)
    bench.node.in_velocity_counts_s = 99
    bench.frame(CAN_RTR_FLAG | 0x281, length=4)
    assert bench.take() == []  # PRE-OPERATIONAL
    bench.nmt(1)
    bench.sync()
    assert bench.take(0x281) == []
    bench.frame(CAN_RTR_FLAG | 0x281, length=4)
    assert [s.data for s in bench.take(0x281)] == [struct.pack("<i", 99)]
    bench.write(0x1801, 1, INVALID | 0x281, 4)
    bench.write(0x1801, 1, 0x40000281, 4)
    bench.frame(CAN_RTR_FLAG | 0x281, length=4)
    assert bench.take(0x281) == []


def test_rtr_of_type_252_gives_the_sample_of_the_last_sync():
    bench = booted()
    bench.write(0x1801, 2, 252, 1)
    bench.nmt(1)
    bench.node.in_velocity_counts_s = 7
    bench.sync()
    bench.node.in_velocity_counts_s = 8
    bench.frame(CAN_RTR_FLAG | 0x281, length=4)
    assert [s.data for s in bench.take(0x281)] == [struct.pack("<i", 7)]


def test_tpdos_are_ready_after_the_processing_time():
    bench = motor()
    bench.node.processing_ns = 35_000
    bench.run(MS)
    bench.sync()
    assert [(s.can_id, s.t_ns) for s in bench.take()] == [(0x181, MS + 35_000), (0x281, MS + 35_000)]


EVENT_PDO = """[{parameter}]
ParameterName=P
ObjectType=0x9
SubNumber=6
[{parameter}sub0]
ParameterName=N
DataType=5
AccessType=const
DefaultValue=5
[{parameter}sub1]
ParameterName=C
DataType=7
AccessType=rw
DefaultValue=$NODEID+0x{cob_id:X}
[{parameter}sub2]
ParameterName=T
DataType=5
AccessType=rw
DefaultValue={kind}
[{parameter}sub3]
ParameterName=I
DataType=6
AccessType=rw
DefaultValue={inhibit}
[{parameter}sub5]
ParameterName=E
DataType=6
AccessType=rw
DefaultValue=0
[{mapping}]
ParameterName=M
ObjectType=0x9
SubNumber=2
[{mapping}sub0]
ParameterName=N
DataType=5
AccessType=rw
DefaultValue=1
[{mapping}sub1]
ParameterName=E
DataType=7
AccessType=rw
DefaultValue=0x20000010
"""


def events(*, start_up=None):
    """A device with four event-driven TPDOs: both transmission types, with and without an inhibit
    time, none with a timer.
    """
    rows = ((254, 0), (255, 0), (254, 5000), (255, 65535))
    text = HEAD + variable(PDOMapping="1", DefaultValue="0")
    for k, (kind, inhibit) in enumerate(rows):
        parameter, mapping = f"{0x1800 + k:X}", f"{0x1A00 + k:X}"
        text += EVENT_PDO.format(
            parameter=parameter, mapping=mapping, cob_id=0x180 + 0x100 * k, kind=kind, inhibit=inhibit
        )
    if start_up is not None:
        text += f"[1F80]\nParameterName=S\nDataType=7\nAccessType=rw\nDefaultValue={start_up}\n"
    return parse_eds(text.encode(), "events.eds")


EVENT_IDS = [0x185, 0x285, 0x385, 0x485]


@pytest.mark.parametrize("kind", [GENERIC, DRIVE402, BRAKE404])
@pytest.mark.parametrize("start_up", [None, "4", ""])
@pytest.mark.parametrize("waited_ns", [0, 1, 3 * MS, 700 * MS])
def test_event_driven_tpdos_are_sent_once_at_every_start_the_first_one_too(kind, start_up, waited_ns):
    """Without a timer nothing else would ever send them: no value changes here.

    The inhibit time of the last start is over with it.
    """
    bench = Bench("", 5, kind, events(start_up=start_up))
    bench.power_on()
    assert [s.can_id for s in bench.take()] == [0x705]
    for leave in (128, 2, 129, 130, 128):
        bench.run(waited_ns)
        assert bench.take() == []
        bench.nmt(1)
        assert [(s.can_id, s.data) for s in bench.take()] == [(can_id, b"\0\0") for can_id in EVENT_IDS]
        bench.nmt(1)  # it is started already: no event
        bench.run(3 * MS)
        assert bench.take() == []
        bench.nmt(leave)
        bench.take(0x705)


def test_a_device_that_starts_by_itself_sends_its_event_driven_tpdos_behind_the_boot_up():
    """1F80h with bit 2 clear: the first NMT start finds it OPERATIONAL and is no start any more.

    The next one is.
    """
    bench = Bench("", 5, GENERIC, events(start_up="0"))
    bench.power_on()
    assert [s.can_id for s in sorted(bench.take(), key=lambda s: s.t_ns)] == [0x705, *EVENT_IDS]
    bench.nmt(1)
    assert bench.take() == []
    bench.nmt(128)
    bench.nmt(1)
    assert [s.can_id for s in bench.take()] == EVENT_IDS


# reception


def test_rpdo_acts_on_the_next_sync_or_at_once():
    for transmission, at_once in ((0, False), (1, False), (240, False), (254, True), (255, True)):
        bench = booted()
        bench.write(0x1400, 2, transmission, 1)
        bench.nmt(1)
        bench.frame(0x201, setpoint(6, 42))
        assert (bench.device[0x6071, 0] == 42) == at_once
        bench.sync()
        assert bench.device[0x6071, 0] == 42


def test_the_last_rpdo_before_sync_wins():
    bench = motor()
    bench.frame(0x201, setpoint(6, 1))
    bench.frame(0x201, setpoint(6, 2))
    bench.sync()
    assert bench.device[0x6071, 0] == 2


def test_too_short_is_ignored_too_long_uses_the_first_bytes():
    bench = motor()
    for length in range(4):
        bench.frame(0x201, setpoint(6, 9)[:length])
    bench.sync()
    assert bench.device[0x6071, 0] == 0
    assert bench.node.dropped_length == 4
    assert bench.emcy() == [(0x8210, 0x11, 1)]
    bench.frame(0x201, setpoint(6, 10) + b"\xff\xff\xff\xff")
    bench.sync()
    assert bench.device[0x6071, 0] == 10
    assert bench.node.excess_length == 1
    assert bench.emcy() == [(0x8220, 0x11, 1)]
    bench.frame(0x201, setpoint(6, 11))
    assert [code for code, _, _ in bench.emcy()] == [0, 0]
    assert bench.number(0x1001) == 0


def test_two_rpdos_with_one_identifier_both_act():
    bench = booted()
    remap(bench, "rpdo", 2, [(0x0006, 0, 16), (0x6072, 0, 16)], 0x201, 1)
    bench.nmt(1)
    bench.frame(0x201, setpoint(6, 123))
    bench.sync()
    assert bench.device[0x6071, 0] == 123
    assert bench.device[0x6072, 0] == 123


@pytest.mark.parametrize(
    ("index", "subindex", "value"), [(0x1005, 0, 0x201), (0x1012, 0, INVALID | 0x201), (0x1201, 1, 0x201)]
)
def test_rpdos_share_their_identifier_with_nothing_else_that_listens(index, subindex, value):
    bench = booted()
    bench.write(0x1201, 2, 0x6C0, 4)
    bench.write(0x1012, 0, 0x100, 4)  # not consumed: its identifier may change
    before = bench.number(index, subindex)
    with pytest.raises(SdoAborted, match="06040043"):
        bench.write(index, subindex, value, 4)
    assert bench.number(index, subindex) == before
    bench.write(0x1400, 1, INVALID | 0x201, 4)
    bench.write(index, subindex, value, 4)
    with pytest.raises(SdoAborted, match="06040043"):
        bench.write(0x1400, 1, 0x201, 4)
    bench.write(index, subindex, before, 4)
    bench.write(0x1400, 1, 0x201, 4)


def test_who_does_not_listen_takes_no_identifier_from_an_rpdo():
    bench = booted()
    bench.write(0x1012, 0, 0x40000201, 4)  # TIME is produced, not consumed
    bench.write(0x1201, 1, INVALID | 0x201, 4)
    bench.write(0x1012, 0, 0x100, 4)
    bench.write(0x1400, 1, INVALID | 0x100, 4)
    bench.write(0x1400, 1, 0x100, 4)


# mapping


def test_remapped_tpdo_carries_any_widths():
    bench = booted("mr_brake", 2)
    remap(bench, "tpdo", 2, [(0x7130, 3, 16), (0x1001, 0, 8), (0x7130, 1, 16)], 0x282, 1)
    bench.nmt(1)
    bench.node.in_handle_Nm, bench.node.in_coil_degC = -0.321, 30.0
    bench.sync()
    assert bench.take(0x282)[0].data == struct.pack("<hBh", 300, 0, -321)


def test_remapped_rpdo_keeps_its_watch_of_the_setpoint():
    bench = booted()
    bench.write(0x6072, 0, 500, 2)
    bench.write(0x2001, 0, 3000, 4)
    remap(bench, "rpdo", 2, [(0x6071, 0, 16), (0x0002, 0, 8), (0x6040, 0, 16)], 0x301, 255)
    bench.nmt(1)
    for controlword in (6, 7, 15, 15):
        bench.frame(0x301, struct.pack("<hbH", 200, 0, controlword))
    assert bench.node.out_torque_pm == 200
    bench.run(3 * MS)
    assert bench.node.out_torque_pm == 0


def test_objects_that_a_pdo_maps_move_into_slots_with_their_value():
    bench = booted()
    bench.write(0x6060, 0, 4, 1)
    slot = bench.device.slot(0x6060)
    assert slot == slots402.MODE
    assert bench.node["values"][slot] == 4


def test_a_change_outside_the_procedure_is_refused():
    bench = booted()
    word = 0x6071 << 16 | 16
    for index, subindex, value, size, abort in (
        (0x1A00, 0, 2, 1, "08000022"),  # the PDO is valid
        (0x1A00, 1, word, 4, "08000022"),
        (0x1800, 3, 5, 2, "08000022"),
        (0x1800, 1, 0x182, 4, "06090030"),  # the identifier of a valid PDO
        (0x1400, 2, 241, 1, "06090030"),
        (0x1400, 2, 253, 1, "06090030"),
        (0x1800, 2, 251, 1, "06090030"),
    ):
        with pytest.raises(SdoAborted, match=abort):
            bench.write(index, subindex, value, size)
    bench.write(0x1A00, 0, bench.number(0x1A00), 1)  # no change: accepted
    bench.write(0x1800, 1, INVALID | 0x181, 4)
    with pytest.raises(SdoAborted, match="08000022"):
        bench.write(0x1A00, 1, 0x606C0020, 4)  # the count is not 0
    bench.write(0x1A00, 0, 0, 1)
    bench.write(0x1A00, 1, 0x606C0020, 4)


@pytest.mark.parametrize(
    ("direction", "word", "abort"),
    [
        ("tpdo", 0x20020020, "06040041"),  # not mappable
        ("tpdo", 0x60710010, "06040041"),  # rww into a TPDO
        ("rpdo", 0x60410010, "06040041"),  # ro into an RPDO
        ("rpdo", 0x60400008, "06040041"),  # a wrong width
        ("tpdo", 0x00050008, "06040041"),  # dummies are for RPDOs
        ("tpdo", 0x60FD0010, "06020000"),
        ("tpdo", 0x60410110, "06090011"),
        ("rpdo", 0x00050010, "06040041"),  # a dummy of a wrong width
    ],
)
def test_entries_that_cannot_be_mapped(direction, word, abort):
    bench = booted()
    communication, mapping = (0x1800, 0x1A00) if direction == "tpdo" else (0x1400, 0x1600)
    bench.write(communication, 1, INVALID | 0x181, 4)
    bench.write(mapping, 0, 0, 1)
    with pytest.raises(SdoAborted, match=abort):
        bench.write(mapping, 1, word, 4)


def test_too_many_or_too_long():
    bench = booted()
    bench.write(0x1800, 1, INVALID | 0x181, 4)
    bench.write(0x1A00, 0, 0, 1)
    for subindex in (1, 2, 3):
        bench.write(0x1A00, subindex, 0x606C0020, 4)
    for count, abort in ((3, "06040042"), (9, "06040042"), (64, "06040042"), (254, "06040042"), (4, "06020000")):
        with pytest.raises(SdoAborted, match=abort):
            bench.write(0x1A00, 0, count, 1)
    bench.write(0x1A00, 0, 2, 1)


@pytest.mark.parametrize("can_id", [0x000, 0x001, 0x07F, 0x101, 0x180, 0x581, 0x601, 0x6E0, 0x701, 0x7FF])
def test_restricted_identifiers(can_id):
    bench = booted()
    bench.write(0x1400, 1, INVALID | 0x201, 4)
    with pytest.raises(SdoAborted, match="06090030"):
        bench.write(0x1400, 1, can_id, 4)
    with pytest.raises(SdoAborted, match="06090030"):
        bench.write(0x1400, 1, 0x20000000 | 0x201, 4)


def test_an_invalid_pdo_is_neither_sent_nor_received():
    bench = motor()
    bench.write(0x1800, 1, INVALID | 0x181, 4)
    bench.write(0x1400, 1, INVALID | 0x201, 4)
    bench.take()
    bench.frame(0x201, setpoint(6, 5))
    bench.sync()
    assert [s.can_id for s in bench.take()] == [0x281]
    assert bench.device[0x6071, 0] == 0
    bench.write(0x1800, 1, 0x1A5, 4)  # a new identifier
    bench.sync()
    assert [s.can_id for s in bench.take() if s.can_id != 0x581] == [0x1A5, 0x281]


@pytest.mark.parametrize("transmission", [0, 1, 253, 255])
def test_a_pdo_that_maps_nothing_is_neither_sent_nor_received(transmission):
    """Count 0 disables the mapping: there is no frame without data."""
    bench = booted()
    remap(bench, "tpdo", 1, [], 0x181, transmission)
    remap(bench, "rpdo", 1, [], 0x201, 255)
    bench.write(0x1800, 5, 10, 2)
    bench.nmt(1)
    for _ in range(3):
        bench.sync()
        bench.frame(CAN_RTR_FLAG | 0x181, length=0)
        bench.frame(0x201, b"\x06")
        bench.run(20 * MS)
    assert bench.take(0x181) == bench.emcy() == []


INPUTS = [(0x6064, 32), (0x606C, 32), (0x6077, 16), (0x6041, 16), (0x6061, 8), (0x603F, 16), (0x1001, 8)]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1 << 30))
def test_any_map_is_packed_as_struct_packs_it(seed):
    chance = random.Random(seed)
    entries, bits = [], 0
    for index, width in chance.sample(INPUTS, k=len(INPUTS)):
        if bits + width <= 64:
            entries.append((index, 0, width))
            bits += width
    bench = booted()
    remap(bench, "tpdo", 4, entries, 0x481, 1)
    bench.nmt(1)
    bench.node.in_position_counts = chance.randint(-(1 << 31), (1 << 31) - 1)
    bench.node.in_velocity_counts_s = chance.randint(-(1 << 31), (1 << 31) - 1)
    bench.node.in_torque_pm = chance.randint(-32768, 32767)
    bench.sync()
    (frame,) = bench.take(0x481)
    content = b"".join(bench.upload(index) for index, _, _ in entries)
    assert frame.data == content
