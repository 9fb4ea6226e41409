"""A CiA 401 module: digital and analogue channels, error modes and error values, what a failure is
and how it ends.
"""

from __future__ import annotations

import pytest

from coulombus.eds.cia301 import NmtState
from coulombus.eds.reader import parse_eds
from coulombus.node import emcy, io401, reactions
from coulombus.node.io401 import IO401
from coulombus.node.kinds import GENERIC, PROFILES, named, number
from coulombus.node.profile import BY_COMMAND, BY_ITSELF, BY_RESET
from coulombus.node.record import new_nodes
from coulombus.node.slots402 import ACTS_POSITION
from node_bench import MS, Bench, SdoAborted

U8, I16, I32, U16, U32 = 5, 3, 4, 6, 7
RPDO, TPDO = 0x205, 0x185
OVER_TEMPERATURE = 1 << emcy.OVER_TEMPERATURE - emcy.FIRST_DEVICE_CAUSE


def variable(name, data_type, default=0, access="rw"):
    head = f"[{name}]\nParameterName=X\nObjectType=7\nDataType={data_type}\nAccessType={access}\n"
    return head + f"DefaultValue={default}\nPDOMapping={int(name[0] == '6')}\n\n"


def structure(name, *rows, kind=8):
    text = f"[{name}]\nParameterName=X\nObjectType={kind}\nSubNumber={len(rows) + 1}\n\n"
    text += variable(f"{name}sub0", U8, len(rows), "const")
    return text + "".join(variable(f"{name}sub{k}", *row) for k, row in enumerate(rows, 1))


def module(*, without=(), transmission=255, deadline_ms=0, **defaults):
    """An EDS with two ports and two channels of each kind; RPDO1 6200h:1 and 6411h:1, TPDO1 6000h:1
    and 6401h:1.
    """
    text = "[DeviceInfo]\nVendorName=test\n\n" + variable("1000", U32, 0xF0191, "ro") + variable("1001", U8, 0, "ro")
    text += variable("1014", U32, "$NODEID+0x80") + variable("1017", U16)
    text += structure("1016", (U32,)) + structure("1029", (U8, defaults.get("behaviour", 0)), (U8, 1))
    for index, row in {
        "6000": (U8, 0, "ro"),
        "6002": (U8,),
        "6200": (U8,),
        "6202": (U8,),
        "6206": (U8, 0xFF),
        "6207": (U8,),
        "6401": (I16, 0, "ro"),
        "6411": (I16,),
        "6443": (U8, 1),
        "6444": (I32,),
    }.items():
        if index not in without:
            text += structure(index, row, row)
    text += structure("1400", (U32, RPDO), (U8, transmission), (U16,), (U8,), (U16, deadline_ms), kind=9)
    text += structure("1600", (U32, 0x62000108), (U32, 0x64110110), kind=9)
    text += structure("1800", (U32, TPDO), (U8, 255), kind=9)
    text += structure("1A00", (U32, 0x60000108), (U32, 0x64010110), kind=9)
    bench = Bench("io", 5, IO401, parse_eds(text.encode(), "io.eds"))
    bench.power_on()
    bench.nmt(1)
    bench.take()
    return bench


def put(bench, port, channel):
    bench.frame(RPDO, bytes((port,)) + channel.to_bytes(2, "little", signed=True))


def outputs(bench):
    return int(bench.node.out_digital[0]), int(bench.node.out_analogue[0])


def error_values(bench, port=0x0F, port_mode=0x3C, channel=-700, channel_mode=1):
    bench.write(0x6206, 1, port_mode, 1)
    bench.write(0x6207, 1, port, 1)
    bench.write(0x6443, 1, channel_mode, 1)
    bench.write(0x6444, 1, channel & 0xFFFFFFFF, 4)


def test_what_is_written_is_put_out():
    bench = module()
    assert outputs(bench) == (0, 0)
    put(bench, 0xA5, -1234)
    assert outputs(bench) == (0xA5, -1234)
    bench.write(0x6411, 2, 321, 2)
    assert int(bench.node.out_analogue[1]) == 321
    assert outputs(bench) == (0xA5, -1234)


def test_a_synchronous_output_waits_for_the_sync():
    bench = module(transmission=1)
    put(bench, 0x81, 77)
    assert outputs(bench) == (0, 0)
    bench.sync()
    assert outputs(bench) == (0x81, 77)


def test_the_polarity_inverts_inputs_and_outputs():
    bench = module()
    bench.write(0x6002, 1, 0xF0, 1)
    bench.write(0x6202, 1, 0x0F, 1)
    bench.node.in_digital[0] = 0x3C
    put(bench, 0x55, 0)
    assert bench.number(0x6000, 1) == 0xCC
    assert outputs(bench) == (0x5A, 0)


def test_a_changed_input_is_sent_and_an_analogue_one_is_within_16_bits():
    bench = module()
    bench.node.in_digital[0], bench.node.in_analogue[0], bench.node.in_analogue[1] = 3, -40_000, 40_000
    bench.node.next_ns = bench.t + 1
    bench.run(MS)
    assert [frame.data for frame in bench.take(TPDO)] == [b"\x03\x00\x80"]
    assert bench.number(0x6401, 2, signed=True) == 32767


def test_stop_gives_the_error_values_where_the_modes_say_so():
    bench = module()
    error_values(bench)
    put(bench, 0xA5, 1000)
    bench.nmt(2)
    assert outputs(bench) == (0xA5 & 0xC3 | 0x0F & 0x3C, -700)
    bench.nmt(1)
    assert outputs(bench) == (0xA5 & 0xC3 | 0x0F & 0x3C, -700)  # until it is written anew
    put(bench, 0x81, 5)
    assert outputs(bench) == (0x81, 5)


def test_an_error_mode_of_0_keeps_the_output_and_another_output_is_not_touched():
    bench = module()
    error_values(bench, channel_mode=0, port_mode=0)
    bench.write(0x6411, 2, 99, 2)
    put(bench, 0xA5, 1000)
    bench.nmt(2)
    assert outputs(bench) == (0xA5, 1000)
    assert int(bench.node.out_analogue[1]) == 0  # its own mode is 1, its value 0


def test_pre_operational_by_command_keeps_the_outputs():
    bench = module()
    error_values(bench)
    put(bench, 0xA5, 1000)
    bench.nmt(128)
    assert outputs(bench) == (0xA5, 1000)


@pytest.mark.parametrize("behaviour", [0, 1, 2])
def test_a_lost_heartbeat_is_a_failure_whatever_1029h_says(behaviour):
    bench = module(behaviour=behaviour)
    error_values(bench)
    bench.write(0x1016, 1, 9 << 16 | 10, 4)
    put(bench, 0xA5, 1000)
    bench.frame(0x709, b"\x05")
    bench.run(9 * MS)
    assert outputs(bench) == (0xA5, 1000)
    bench.run(2 * MS)
    assert outputs(bench)[1] == -700
    assert [code for code, _, _ in bench.emcy()] == [0x8130]


def test_an_rpdo_that_stays_out_is_a_failure_and_the_next_one_ends_it():
    bench = module(deadline_ms=5)
    error_values(bench)
    put(bench, 0xA5, 1000)
    bench.run(6 * MS)
    assert outputs(bench) == (0xA5 & 0xC3 | 0x0F & 0x3C, -700)
    put(bench, 0x01, -2)
    assert outputs(bench) == (0x01, -2)


def test_the_second_port_has_its_own_objects():
    bench = module()
    for index, value in ((0x6002, 0x0F), (0x6202, 0xF0), (0x6206, 0x3C), (0x6207, 0x18), (0x6200, 0xA5)):
        bench.write(index, 2, value, 1)
    bench.node.in_digital[:2] = 0x11, 0x22
    assert (bench.number(0x6000, 1), bench.number(0x6000, 2)) == (0x11, 0x2D)
    assert list(bench.node.out_digital[:3]) == [0, 0x55, 0]
    bench.nmt(2)
    assert list(bench.node.out_digital[:3]) == [0, (0xA5 & 0xC3 | 0x18) ^ 0xF0, 0]


def test_a_second_failure_changes_nothing():
    bench = module()
    error_values(bench)
    put(bench, 0xA5, 1000)
    bench.write(0x6411, 2, 50, 2)
    bench.write(0x6200, 2, 0x77, 1)
    bench.nmt(2)
    failed = outputs(bench)
    bench.nmt(128)
    error_values(bench, port=0xFF, port_mode=0xFF, channel=5)
    bench.write(0x6444, 2, 6, 4)
    bench.write(0x6207, 2, 0xFF, 1)
    bench.nmt(2)
    assert outputs(bench) == failed
    assert (int(bench.node.out_digital[1]), int(bench.node.out_analogue[1])) == (0, 0)


@pytest.mark.parametrize("cause", range(len(emcy.CAUSES)))
def test_a_cause_that_is_no_fault_is_no_failure(cause):
    bench = module()
    error_values(bench)
    put(bench, 0xA5, 1000)
    reactions.react(bench.node, bench.t, cause)
    assert outputs(bench)[1] == (-700 if emcy.CAUSES[cause].fault else 1000)


def test_what_1029h_makes_of_a_fault_is_a_failure():
    bench = module()
    error_values(bench)
    bench.write(0x1029, 2, 0, 1)
    put(bench, 0xA5, 1000)
    bench.node.in_faults = 1 << 6  # a fault without a name, which no kind reacts to by itself
    bench.node.next_ns = bench.t + 1
    bench.run(MS)
    assert bench.node.nmt == 127
    assert outputs(bench)[1] == -700


def test_a_fault_of_the_module_holds_the_error_values():
    bench = module()
    error_values(bench)
    put(bench, 0xA5, 1000)
    bench.node.in_faults = OVER_TEMPERATURE
    bench.node.next_ns = bench.t + 1
    bench.run(MS)
    put(bench, 0x01, 3)
    assert outputs(bench)[1] == -700
    bench.node.in_faults = 0
    bench.node.next_ns = bench.t + 1
    bench.run(MS)
    assert outputs(bench)[1] == -700
    put(bench, 0x01, 4)
    assert outputs(bench) == (0x01, 4)
    assert [code for code, _, _ in bench.emcy()] == [0x4210, 0x0000]


@pytest.mark.parametrize("command", [129, 130])
def test_a_reset_and_power_off_leave_nothing_on(command):
    bench = module()
    error_values(bench)
    put(bench, 0xA5, 1000)
    bench.nmt(command)
    assert outputs(bench) == (0, 0)
    bench.nmt(1)
    bench.run(MS)
    assert outputs(bench) == (0, 0)
    put(bench, 0x11, 12)
    assert outputs(bench) == (0x11, 12)
    bench.device.power_off()
    assert outputs(bench) == (0, 0)


def test_a_file_without_error_objects_fails_to_0():
    bench = module(without=("6206", "6207", "6443", "6444", "6202", "6002"))
    put(bench, 0xFF, 1000)
    bench.nmt(2)
    assert outputs(bench) == (0, 0)


def test_an_error_value_beyond_16_bits_is_the_nearest_one():
    bench = module()
    error_values(bench, channel=-100_000)
    put(bench, 0, 1)
    bench.nmt(2)
    assert outputs(bench)[1] == -32768


def test_an_error_mode_is_0_or_1():
    bench = module()
    with pytest.raises(SdoAborted, match="06090030"):
        bench.write(0x6443, 1, 2, 1)
    assert bench.number(0x6443, 1) == 1


def test_set_points_are_not_stored():
    bench = module()
    assert not bench.device.parameters.is_parameter(0x6411, 1)
    assert bench.device.parameters.is_parameter(0x6444, 1)


def test_the_kinds_have_names_and_numbers():
    assert [profile.name for profile in PROFILES] == ["generic", "drive", "brake", "io", "io404"]
    assert [number(profile) for profile in PROFILES] == [0, 1, 2, 3, 4]
    assert named("io") is IO401
    with pytest.raises(ValueError, match="got kind 'pump', expected generic, drive, brake, io, io404"):
        named("pump")


def test_the_slots_of_a_kind_are_its_own():
    for profile in PROFILES:
        rows = [row for row in profile.objects if row.index < 0x9000]  # there stands the same in 32 bits
        slots = [row.slot for row in rows]
        assert len(set(slots)) == len(slots), profile.name
        bits = [row.acts for row in rows if row.acts]
        shared = {bit for bit in bits if bits.count(bit) > 1}
        assert shared == ({ACTS_POSITION} if profile.name == "drive" else set())  # 607Ah, 60C1h: a position each
    assert [row.key for row in GENERIC.objects] == [(0x1001, 0)]


@pytest.mark.parametrize(
    ("why", "nmt", "put_out"),
    [
        (BY_COMMAND, NmtState.PRE_OPERATIONAL, (1, 5)),
        (BY_COMMAND, NmtState.STOPPED, (3, -700)),
        (BY_ITSELF, NmtState.PRE_OPERATIONAL, (3, -700)),
        (BY_ITSELF, NmtState.OPERATIONAL, (3, -700)),
        (BY_RESET, NmtState.PRE_OPERATIONAL, (0, 0)),
    ],
)
def test_what_becomes_of_the_outputs_without_the_connection(why, nmt, put_out):
    """A failure, but for a command that does not stop; a reset leaves nothing on."""
    nodes = new_nodes(1)
    n = nodes[0]
    n.nmt, n.out_digital[0], n.out_analogue[0], n.analogue_most = nmt, 1, 5, 0x7FFF
    n.values[io401.DIGITAL_ERROR_MODE], n.values[io401.DIGITAL_ERROR_VALUE] = 0xFF, 3
    n.values[io401.ANALOGUE_ERROR_MODE], n.values[io401.ANALOGUE_ERROR_VALUE] = 1, -700
    assert io401._connection_lost(n, 0, why) == 0
    assert (n.out_digital[0], n.out_analogue[0]) == put_out
    assert bool(n.failed) is (put_out != (1, 5))


@pytest.mark.parametrize(
    ("low", "high", "value", "put_out"),
    [
        (-5, 9, 4, 4),
        (-5, 9, 10, 9),
        (-5, 9, -6, -5),
        (0, 0, 700, 700),  # the hardware sets no limit
        (3, 4, 0, 3),
        (5, 5, 700, 700),
    ],
)
@pytest.mark.parametrize("k", [0, 1])
def test_an_analogue_output_keeps_to_what_its_hardware_may_put_out(low, high, value, put_out, k):
    nodes = new_nodes(1)
    n = nodes[0]
    n.board_low[k], n.board_high[k], n.values[io401.ANALOGUE_OUT + k] = low, high, value
    io401._actuate(n, 0)
    assert n.out_analogue[k] == put_out
    assert n.out_analogue[1 - k] == 0
