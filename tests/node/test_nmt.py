"""NMT: boot-up, every transition, and what each state lets through."""

from __future__ import annotations

import pytest

from node_bench import MS, US, Bench, motor, setpoint

START, STOP, PRE, RESET_NODE, RESET_COMMUNICATION = 1, 2, 128, 129, 130
STOPPED, OPERATIONAL, PRE_OPERATIONAL = 4, 5, 127
LEAD = {STOPPED: (STOP,), OPERATIONAL: (START,), PRE_OPERATIONAL: ()}


def at_state(state: int) -> Bench:
    bench = Bench("motor", 3)
    bench.power_on()
    for command in LEAD[state]:
        bench.nmt(command)
    bench.take()
    assert bench.node.nmt == state
    return bench


def test_boot_up_then_pre_operational():
    bench = Bench("mr_brake", 9)
    bench.t = 7 * MS
    bench.power_on()
    (boot,) = bench.take()
    assert (boot.can_id, boot.data, boot.t_ns) == (0x709, b"\x00", 7 * MS + 20 * US)
    assert bench.node.nmt == PRE_OPERATIONAL


@pytest.mark.parametrize("state", [STOPPED, OPERATIONAL, PRE_OPERATIONAL])
@pytest.mark.parametrize("broadcast", [False, True])
@pytest.mark.parametrize(
    ("command", "expected", "boots"),
    [
        (START, OPERATIONAL, False),
        (STOP, STOPPED, False),
        (PRE, PRE_OPERATIONAL, False),
        (RESET_NODE, PRE_OPERATIONAL, True),
        (RESET_COMMUNICATION, PRE_OPERATIONAL, True),
    ],
)
def test_every_transition(state, command, broadcast, expected, boots):
    bench = at_state(state)
    bench.nmt(command, 0 if broadcast else None)
    assert bench.node.nmt == expected
    assert [s.data for s in bench.take(0x703)] == ([b"\x00"] if boots else [])


@pytest.mark.parametrize("data", [b"", b"\x01", b"\x01\x04", b"\x00\x03", b"\x03\x03", b"\xff\x00", b"\x01\x83"])
def test_commands_for_others_unknown_or_too_short_do_nothing(data):
    bench = at_state(PRE_OPERATIONAL)
    bench.frame(0x000, data)
    assert bench.node.nmt == PRE_OPERATIONAL
    assert bench.take() == []
    unknown = len(data) == 2 and data[1] in (0, 3)
    assert bench.node.dropped_unknown == unknown
    assert bench.node.dropped_length == (len(data) < 2)


def test_services_by_state():
    """What CiA 301's table 36 lets through: PDO in OPERATIONAL, SDO and EMCY not in STOPPED."""
    for state, pdo, sdo in ((PRE_OPERATIONAL, False, True), (OPERATIONAL, True, True), (STOPPED, False, False)):
        bench = at_state(state)
        bench.sync()
        assert bool(bench.take(0x183)) == pdo
        dropped = int(bench.node.dropped_unknown)
        bench.frame(0x203, setpoint(6, 5))
        assert bench.node.dropped_unknown - dropped == (not pdo)
        bench.sync()
        assert (bench.device[0x6071, 0] == 5) == pdo
        assert (bench.request(bytes.fromhex("4000100000000000")) is not None) == sdo
        bench.take()


def test_heartbeat_goes_on_in_every_state():
    bench = at_state(PRE_OPERATIONAL)
    bench.write(0x1017, 0, 10, 2)
    states = []
    for command in (START, STOP, PRE):
        bench.nmt(command)
        bench.run(10 * MS)
        states += [s.data[0] for s in bench.take(0x703)]
    assert states == [OPERATIONAL, STOPPED, PRE_OPERATIONAL]


def test_an_rpdo_that_waits_for_sync_does_not_outlive_operational():
    bench = at_state(OPERATIONAL)
    bench.frame(0x203, setpoint(6, 77))
    bench.nmt(PRE)
    bench.nmt(START)
    bench.sync()
    assert bench.device[0x6071, 0] == 0


def test_reset_communication_restores_communication_objects_only():
    bench = at_state(OPERATIONAL)
    bench.write(0x1017, 0, 10, 2)
    bench.write(0x2004, 0, 0x6162, 2)
    bench.write(0x6072, 0, 321, 2)
    bench.write(0x1801, 1, 0x80000283, 4)
    bench.nmt(RESET_COMMUNICATION)
    assert bench.number(0x1017) == 0
    assert bench.number(0x6072) == 321
    assert bench.upload(0x2004) == b"ba"
    bench.take()
    bench.run(50 * MS)
    assert bench.take() == []  # no heartbeat
    bench.nmt(START)
    bench.sync()
    assert len(bench.take(0x283)) == 1  # TPDO2 is valid again


def test_reset_node_restores_everything():
    bench = at_state(OPERATIONAL)
    bench.write(0x6072, 0, 321, 2)
    bench.download(0x2004, 0, b"mine")
    bench.frame(0x203, b"\x00")
    bench.nmt(RESET_NODE)
    assert bench.number(0x6072) == 0
    assert bench.upload(0x2004) == b"Coulombus motor drive, handle axis"
    assert bench.number(0x1001) == 0
    assert bench.number(0x1003) == 0


def test_reset_ends_an_open_sdo_transfer():
    bench = at_state(PRE_OPERATIONAL)
    bench.request(bytes.fromhex("4008100000000000"))
    bench.nmt(RESET_COMMUNICATION)
    answer = bench.request(bytes.fromhex("6000000000000000"))
    assert answer is not None
    assert answer[0] == 0x80
    bench.take()
    bench.run(2000 * MS)
    assert bench.take() == []


def test_emcy_in_stopped_is_kept_back():
    bench = motor()
    bench.write(0x1016, 1, 0x007F0032, 4)
    bench.write(0x1029, 1, 1, 1)
    bench.frame(0x77F, b"\x05")
    bench.nmt(2)
    bench.take()
    bench.run(200 * MS)
    assert bench.take() == []
    bench.nmt(128)
    assert bench.number(0x1003, 1) & 0xFFFF == 0x8130
    assert bench.number(0x1001) == 0x11
