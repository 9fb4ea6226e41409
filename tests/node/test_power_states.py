"""CiA 402's power states: every transition, and every controlword in every state, written from the
standard's figure and tables.

The tables below are typed from IEC 61800-7-201 (figure 2, tables 23, 24 and 27 to 32), not made by
the code under test.
"""

from __future__ import annotations

import pytest

from node_bench import MS, US, Bench, SdoAborted, motor

NOT_READY, DISABLED, READY, ON, ENABLED, QUICK, REACTION, FAULT = range(8)
NAMES = ["not_ready", "disabled", "ready", "switched_on", "enabled", "quick_stop", "reaction", "fault"]
STATUS = {  # state: mask, value of the statusword
    DISABLED: (0x4F, 0x40),
    READY: (0x6F, 0x21),
    ON: (0x6F, 0x23),
    ENABLED: (0x6F, 0x27),
    QUICK: (0x6F, 0x07),
    REACTION: (0x4F, 0x0F),
    FAULT: (0x4F, 0x08),
}
# command: bits 3 2 1 0 of the controlword, x does not matter
PATTERNS = {
    "shutdown": "x110",
    "switch on": "0111",
    "enable operation": "1111",
    "disable voltage": "xx0x",
    "quick stop": "x01x",
}
# transition: from, command, to
TRANSITIONS = {
    2: (DISABLED, "shutdown", READY),
    3: (READY, "switch on", ON),
    4: (ON, "enable operation", ENABLED),
    5: (ENABLED, "switch on", ON),
    6: (ON, "shutdown", READY),
    7: (READY, "disable voltage", DISABLED),
    8: (ENABLED, "shutdown", READY),
    9: (ENABLED, "disable voltage", DISABLED),
    10: (ON, "disable voltage", DISABLED),
    11: (ENABLED, "quick stop", QUICK),
    12: (QUICK, "disable voltage", DISABLED),
    16: (QUICK, "enable operation", ENABLED),
}
ALSO = {  # figure 2: 7 and 10 by quick stop too; table 24, note: "enable operation" in Ready is 3, and 4 by itself
    (READY, "quick stop"): DISABLED,
    (ON, "quick stop"): DISABLED,
    (READY, "enable operation"): ENABLED,
}


def command_of(word):
    bits = f"{word & 0xF:04b}"
    (name,) = [n for n, pattern in PATTERNS.items() if all(p in ("x", b) for p, b in zip(pattern, bits, strict=True))]
    return name


def following(state, word):
    command = command_of(word)
    for begin, by, end in TRANSITIONS.values():
        if (begin, by) == (state, command):
            return end
    return ALSO.get((state, command), state)


def command(bench: Bench, word: int) -> None:
    bench.write(0x6040, 0, word, 2)


def state(bench: Bench) -> int:
    """The state that the statusword tells; it is that of the record."""
    word = bench.number(0x6041)
    (told,) = [s for s, (mask, value) in STATUS.items() if word & mask == value]
    assert told == bench.node.power_state
    return told


def out(bench: Bench) -> float:
    return float(bench.node.out_torque_pm)


def drive(at: int = ENABLED, *, mode: int = 10, torque: int = 0, **objects: int) -> Bench:
    """A drive in the state `at`; objects: o6087=1000 and so on."""
    bench = motor()
    sizes = {0x6087: 4, 0x2006: 4, 0x6080: 4, 0x6072: 2, 0x2001: 4}
    for name, value in {"o605A": 6, **objects}.items():
        index = int(name[1:], 16)
        bench.write(index, 0, value, sizes.get(index, 2))
    bench.write(0x6060, 0, mode, 1)
    if at in (READY, ON, ENABLED, QUICK):
        command(bench, 0x06)
    if at in (ON, ENABLED, QUICK):
        command(bench, 0x07)
    if at in (ENABLED, QUICK):
        command(bench, 0x0F)
        if torque:
            bench.write(0x6071, 0, torque, 2)
    if at == QUICK:
        command(bench, 0x02)
    if at == FAULT:
        bench.node.in_faults = 1
        bench.sync()
        bench.node.in_faults = 0
        bench.sync()
    assert state(bench) == at
    bench.take()
    return bench


@pytest.mark.parametrize("at", [DISABLED, READY, ON, ENABLED, QUICK], ids=lambda at: NAMES[at])
@pytest.mark.parametrize("high", [0x0000, 0x0080, 0xFE70])
def test_every_controlword_in_every_state(at, high):
    """The low four bits are the command.

    Outside FAULT no other bit makes a transition (bit 8, halt, stays 0 here).
    """
    for low in range(16):
        bench = drive(at)
        command(bench, high | low)
        assert state(bench) == following(at, low), f"{low:04b}"


def test_fault_is_left_by_the_rising_edge_of_bit_7_only():
    for low in range(16):
        bench = drive(FAULT)
        command(bench, low)
        assert state(bench) == FAULT
        command(bench, 0x80 | low)  # 15
        assert state(bench) == DISABLED
        bench.node.in_faults = 1
        bench.sync()
        bench.run(MS)
        assert state(bench) == FAULT
        bench.node.in_faults = 0
        bench.sync()
        command(bench, 0x80 | low)  # bit 7 has not been 0 since
        assert state(bench) == FAULT


@pytest.mark.parametrize("at", [DISABLED, READY, ON, ENABLED, QUICK], ids=lambda at: NAMES[at])
def test_a_fault_leads_to_fault_from_every_state(at):
    """13 and 14."""
    bench = drive(at)
    bench.node.in_faults = 1
    bench.sync()
    assert state(bench) == FAULT


def test_0_and_1_by_itself_and_after_a_reset():
    bench = Bench("motor", 1)
    bench.power_on()
    assert state(bench) == DISABLED
    bench = drive(ENABLED, torque=300)
    bench.nmt(129)
    assert (state(bench), out(bench)) == (DISABLED, 0)


@pytest.mark.parametrize(
    ("index", "good", "bad"),
    [
        (0x6007, (0, 1, 2, 3), (-1, 4, 100)),
        (0x605A, (0, 1, 2, 5, 6), (-1, 3, 4, 7, 8, 9)),
        (0x605B, (0, 1), (-1, 2)),
        (0x605C, (0, 1), (-1, 2)),
        (0x605D, (1, 2), (-1, 0, 3, 4)),
        (0x605E, (0, 1, 2), (-1, 3, 4)),
    ],
)
def test_option_codes_hold_what_is_supported(index, good, bad):
    bench = motor()
    for value in good:
        bench.write(index, 0, value, 2)
        assert bench.number(index) == value
    for value in bad:
        with pytest.raises(SdoAborted, match="06090030"):
            bench.write(index, 0, value, 2)
    assert bench.number(index) == good[-1]


# The ramps, in profile torque with 6087h = 1000 per mille a second: 100 per mille are gone in 100
# ms.
# option code, its value, what starts the ramp, the state on the ramp (None: there is no ramp), the
# state behind it
RAMPS = [
    (0x605A, 0, 0x02, None, DISABLED),
    (0x605A, 1, 0x02, QUICK, DISABLED),
    (0x605A, 2, 0x02, None, DISABLED),
    (0x605A, 5, 0x02, QUICK, QUICK),
    (0x605A, 6, 0x02, None, QUICK),
    (0x605B, 0, 0x06, None, READY),
    (0x605B, 1, 0x06, ENABLED, READY),
    (0x605C, 0, 0x07, None, ON),
    (0x605C, 1, 0x07, ENABLED, ON),
    (0x605E, 0, "fault", None, FAULT),
    (0x605E, 1, "fault", REACTION, FAULT),
    (0x605E, 2, "fault", None, FAULT),
]


def start_ramp(bench, by):
    if by == "fault":
        bench.node.in_faults = 1 << 1  # over-temperature: it leaves time for a ramp
        bench.node.next_ns = bench.t
        bench.run(0)
    else:
        command(bench, by)


@pytest.mark.parametrize("mode", [4, 10])
@pytest.mark.parametrize(("index", "option", "by", "on_ramp", "after"), RAMPS)
def test_ramps_of_the_option_codes(mode, index, option, by, on_ramp, after):
    bench = drive(mode=mode, torque=100, **{f"o{index:04X}": option})
    bench.run(MS)
    assert out(bench) == 100
    bench.write(0x6087, 0, 1000, 4)
    start_ramp(bench, by)
    if on_ramp is not None:
        begin = bench.t
        for elapsed_ms in (10, 50, 99):
            bench.until(begin + elapsed_ms * MS)
            assert state(bench) == on_ramp
            assert out(bench) == pytest.approx(100 - elapsed_ms)
        bench.until(begin + 100 * MS + 2 * US)
    assert (state(bench), out(bench)) == (after, 0)
    bench.run(500 * MS)
    assert (state(bench), out(bench)) == (after, 0)


def test_no_ramp_is_longer_than_2006h_nor_without_supply():
    bench = drive(mode=4, torque=100, o605C=1, o2006=50)
    bench.run(MS)
    bench.write(0x6087, 0, 0, 4)  # a slope that would never end
    command(bench, 0x07)
    bench.run(49 * MS)
    assert (state(bench), out(bench)) == (ENABLED, 100)
    bench.run(2 * MS)
    assert (state(bench), out(bench)) == (ON, 0)
    bench = drive(mode=4, torque=100, o605A=5)
    bench.run(MS)
    bench.write(0x6087, 0, 100, 4)
    command(bench, 0x02)
    bench.run(5 * MS)
    assert out(bench) > 0
    bench.node.in_supply_ok = 0
    bench.node.next_ns = bench.t
    bench.run(0)
    assert (state(bench), out(bench)) == (FAULT, 0)


def test_a_fault_that_takes_the_control_away_does_not_wait_for_605e():
    for bit in (0, 2, 5):  # over-current, encoder, supply low
        bench = drive(mode=4, torque=100, o605E=1)
        bench.run(MS)
        bench.write(0x6087, 0, 10, 4)
        bench.node.in_faults = 1 << bit
        bench.sync()
        assert (state(bench), out(bench)) == (FAULT, 0)


def test_disable_voltage_is_at_once_also_on_a_ramp_and_enabling_again_ends_it():
    bench = drive(mode=4, torque=100, o605C=1)
    bench.run(MS)
    bench.write(0x6087, 0, 1000, 4)
    command(bench, 0x07)
    bench.run(30 * MS)
    command(bench, 0x0F)
    assert state(bench) == ENABLED
    bench.run(30 * MS)
    assert (state(bench), out(bench)) == (ENABLED, pytest.approx(100))
    command(bench, 0x07)
    bench.run(30 * MS)
    command(bench, 0x00)
    assert (state(bench), out(bench)) == (DISABLED, 0)


def test_16_only_when_605a_lets_the_drive_stay():
    bench = drive(mode=4, torque=100, o605A=1)
    bench.run(MS)
    bench.write(0x6087, 0, 1000, 4)
    command(bench, 0x02)
    bench.run(10 * MS)
    command(bench, 0x0F)
    assert state(bench) == QUICK
    bench.run(100 * MS)
    assert state(bench) == DISABLED


@pytest.mark.parametrize(
    ("option", "expected", "codes"),
    [(0, ENABLED, []), (1, FAULT, [0x8100]), (2, DISABLED, []), (3, QUICK, [])],
)
def test_6007h_when_nmt_leaves_operational(option, expected, codes):
    bench = drive(torque=200, o6007=option)
    bench.sync()
    assert out(bench) == 200
    bench.nmt(128)
    assert (state(bench), out(bench)) == (expected, 200 if option == 0 else 0)
    assert [code for code, _, _ in bench.emcy()] == codes
    if option == 1:
        assert bench.number(0x603F) == 0x8100
        assert bench.number(0x1003, 1) == 0x8100
        command(bench, 0x80)
        assert state(bench) == DISABLED
        assert bench.number(0x1001) == 0


def test_halt_by_605dh():
    for option, after_20_ms in ((1, 80), (2, 0)):
        bench = drive(mode=4, torque=100, o605D=option)
        bench.run(MS)
        bench.write(0x6087, 0, 1000, 4)
        command(bench, 0x10F)
        bench.run(20 * MS)
        assert (state(bench), out(bench)) == (ENABLED, pytest.approx(after_20_ms))
        bench.run(100 * MS)
        assert (state(bench), out(bench)) == (ENABLED, 0)
        assert bench.number(0x6041) & 0x400  # standing still is reached
