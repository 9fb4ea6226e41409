"""Fault files: their mistakes with places, and the whole rig under faults of the bus: torque 0 and
the brake off on any doubt.
"""

from __future__ import annotations

import contextlib
import json
import struct
import threading
from contextlib import contextmanager

import can
import numpy as np
import pytest

from coulombus.eds.cia402 import PowerState
from coulombus.host.errors import NodeMissing
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.faults.fault_file import FaultError, injected_lines, read_faults
from coulombus.sim_bus.faults.fault_kinds import KINDS, SlowSdo
from coulombus.sim_bus.faults.rows import _effect
from coulombus.sim_bus.network.event_loop import BRAKE, MOTOR
from coulombus.sim_bus.server.rig_server import SimServer
from coulombus.wire.address import BusAddress
from coulombus.wire.frame import CAN_ERR_FLAG
from coulombus.wire.handshake import Answer, Flags, Hello, connect
from places import ROOT

GOOD = """
[[fault]]
kind = "flip"
on = "3rd TPDO1 of node 2"
bit = 30
"""


def write(path, text):
    file = path / "faults.toml"
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("text", "line", "word"),
    [
        ('[[fault]]\nkind = "nois"\n', 2, "noise"),
        ('[[fault]]\nkind = "noise"\nrate = 2\n', 3, "rate"),
        ('[[fault]]\nkind = "noise"\n', 1, "rate"),
        ('[[fault]]\nkind = "flip"\non = "3rd TPD1 of node 2"\n', 3, "TPDO1"),
        ('[[fault]]\nkind = "flip"\nbits = 3\n', 3, "no such key"),
        ('[[fault]]\nkind = "flip"\nbit = "eof8"\n', 3, "eof7"),
        ('[[fault]]\nkind = "flip"\nbits = 3\n', 3, "did you mean 'bit'?"),
        ('[[fault]]\nkind = "drop"\nlost_fro = "host"\n', 3, "did you mean 'lost_for'?"),
        ('[[fault]]\nkind = "drop"\non = { fram = "SYNC" }\n', 3, "did you mean 'frame'?"),
        ('[[faults]]\nkind = "flip"\n', 1, "did you mean 'fault'?"),
        ("[[controller]]\nnode = 1\nrestart = 5\n", 3, "did you mean 'restart_ms'?"),
        ('[[fault]]\nkind = "drop"\non = "third SYNC"\n', 3, "SDO REQUEST"),
        ("[[fault]\n", 1, ""),
        ('[fault]\nkind = "flip"\n', 1, "tables [[fault]], in double brackets"),
        ('[[fault]]\nkind = "flip"\non = 3\n', 3, 'a text such as "3rd TPDO1 of node 2"'),
        ('[[fault]]\nkind = "flip"\nat_s = nan\n', 3, "expected a finite number, not nan"),
        ('[[fault]]\nkind = "flip"\nat_s = -1\n', 3, "expected a number of at least 0, not -1"),
        ('[[fault]]\nkind = "noise"\nrate = 0.1\nduration_s = 1e-12\n', 4, "at least 1e-09"),
        ('[[fault]]\nkind = "babble"\nnode = "motor"\ncan_id = 1\ndata = "123"\n', 5, "eight bytes in hexadecimal"),
        ('[[fault]]\nkind = "cut"\nhalves = "motor"\n', 3, 'two lists of nodes, as in [["host", "brake"], ["motor"]]'),
        ('[[controller]]\nnode = 1\nrestart_ms = "never"\n', 3, "expected a number or 'manual', not \"never\""),
        ('[[fault]]\nkind = "flip"\non = "SYNC of node 3"\n', 3, "SYNC is of no node"),
        ('[[fault]]\nkind = "flip"\non = "1st 0x181 of node 2"\n', 3, "is of no node"),
        ('[[fault]]\nkind = "flip"\non = "1st TPDO1 of node 1000"\n', 3, "from 1 to 127"),
        ('[[fault]]\nkind = "flip"\non = "99999999999999999999th SYNC"\n', 3, "nth"),
        ('[[fault]]\nkind = "flip"\nmost = 99999999999999999999\n', 3, "most"),
        ('[[fault]]\nkind = "flip"\nbit = true\n', 3, "expected 0 (the start of frame) to 160"),
        ('[[fault]]\nkind = "noise"\nrate = true\n', 3, "rate"),
        ('[[fault]]\nkind = "stuck_dominant"\nduration_s = "1"\n', 3, "duration_s"),
        ("seed = true\n", 1, "seed"),
        ("[[fault]]\nkind = 'flip'\n" * 63, 125, "63 faults"),
    ],
)
def test_a_mistake_is_told_with_its_place(tmp_path, text, line, word):
    with pytest.raises(FaultError) as error:
        read_faults(write(tmp_path, text))
    assert f"faults.toml:{line}:" in str(error.value)
    assert word in str(error.value)
    assert error.value.exit_status == 3


def test_a_file_in_another_encoding_is_refused_with_the_line(tmp_path):
    file = tmp_path / "faults.toml"
    file.write_bytes('[[fault]]\nkind = "drop"  # verz\u00f6gert\n'.encode("latin-1"))
    with pytest.raises(FaultError, match=r"faults.toml:2: byte F6h is not UTF-8"):
        read_faults(file)


def test_one_mistake_is_told_once_and_a_byte_order_mark_is_none(tmp_path):
    with pytest.raises(FaultError) as error:
        read_faults(write(tmp_path, '[[fault]]\nkind = "reset"\nnode = ["motor"]\n'))
    assert len(str(error.value).splitlines()) == 1
    assert len(read_faults(write(tmp_path, "\ufeff" + GOOD)).file.fault) == 1


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('[[fault]]\nkind = "reset"\nnode = "arm"\n', r"faults.toml:3: .*'arm'.*motor, brake"),
        ('[[fault]]\nkind = "reset"\nnode = "host"\n', r"faults.toml:3: .*the host cannot be reset"),
        ("[[controller]]\nnode = 'motor'\n[[controller]]\nnode = 1\n", r"faults.toml:4: .*in line 1 already"),
        ("[[fault]]\nkind = 'drop'\nbus = 'can0'\n", r"faults.toml:3: .*no bus 'can0'"),
    ],
)
def test_what_is_not_on_this_bus(tmp_path, text, reason):
    with pytest.raises(FaultError, match=reason):
        simulate("bench", "hybrid", 1.0, faults=write(tmp_path, text))


TWO_BUSES = ('axis.left.bus.channel="a"', 'axis.right.bus.channel="b"')


def test_each_of_several_buses_has_its_faults(tmp_path):
    drop = '[[fault]]\nkind = "drop"\nbus = "b"\non = "20th TPDO1 of right.motor"\n'
    noise = '[[fault]]\nkind = "noise"\nbus = "a"\nrate = 1e-3\nafter = "enabled"\n'
    one_shot = '[[controller]]\nbus = "b"\nnode = "right.motor"\nqueue_limit = 9\n'
    result = simulate("two_axes", "hybrid", 0.3, overrides=TWO_BUSES, faults=write(tmp_path, drop + noise + one_shot))
    assert [(one["bus"], one["kind"], one["line"]) for one in result.faults] == [("a", "noise", 5), ("b", "drop", 1)]
    assert result.faults[0]["times"] > 0
    assert result.faults[1]["times"] == 1
    assert {name: c["retransmissions"] > 0 for name, c in result.controllers.items() if name.endswith("host")} == {
        "a.host": True,
        "b.host": False,
    }
    with pytest.raises(FaultError, match=r'faults.toml:1: .*expected bus = one of "a", "b"'):
        simulate(
            "two_axes", "hybrid", 0.3, overrides=TWO_BUSES, faults=write(tmp_path, drop.replace('bus = "b"\n', ""))
        )
    with pytest.raises(FaultError, match=r"faults.toml:4: .*no node 'left.motor' on this bus; it has right.motor"):
        simulate(
            "two_axes", "hybrid", 0.3, overrides=TWO_BUSES, faults=write(tmp_path, drop.replace("right.m", "left.m"))
        )


def test_a_recorded_run_that_ends_before_anything_is_displayed_has_no_figures(tmp_path):
    """The drive is reset while the rig arms: a trip, and a recording without a phase."""
    file = write(tmp_path, '[[fault]]\nkind = "reset"\non = "3rd RPDO1 of node 1"\nnode = "motor"\n')
    result = simulate("bench", "hybrid", 1.0, faults=file, record=tmp_path / "r.pcapng")
    assert result.exit_status == 7
    assert (result.cycles, result.hold_counts_p2p, result.hold_velocity_rms_rad_s) == (0, None, None)


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_has_an_effect_and_no_other_has_one(kind):
    _effect(KINDS[kind].model_construct(kind=kind))
    with pytest.raises(KeyError):
        _effect(SlowSdo.model_construct(kind=f"{kind}s"))


def test_what_never_struck_is_told():
    faults = [
        {"kind": "flip", "line": 3, "times": 0, "first_s": None, "last_s": None},
        {"kind": "drop", "line": 9, "times": 1, "first_s": 0.5, "last_s": 0.5},
    ]
    counters = ("tec", "rec", "retransmissions", "dropped", "passives", "bus_offs")
    motor = {"state": "bus-off", "errors": {"bit": 32}, **dict.fromkeys(counters, 0), "bus_offs": 1}
    assert list(injected_lines(faults, {"motor": motor})) == [
        "fault flip (line 3): never struck: what it waits for did not come",
        "fault drop (line 9): once, at 0.500000 s",
        "controller motor: BUS-OFF (berr-counter tx 0 rx 0), 32 errors, 1 times bus-off",
    ]


CLOCK = '[[fault]]\nkind = "drift"\nppm = 100\n'
NOISE = '[[fault]]\nkind = "noise"\nrate = 1e-4\n'


@pytest.mark.parametrize(
    ("text", "line", "word"),
    [
        ('[[controller]]\nnode = "motor"\n[[controller]]\nnode = "motor"\none_shot = true\n', 4, "line 1 already"),
        ('[[controller]]\nnode = "motor"\n[[controller]]\nnode = 1\n', 4, "line 1 already"),
        (CLOCK + 'node = "motor"\n' + CLOCK + "node = 1\n", 8, "by line 1 already"),
        (CLOCK + "node = 1\nduration_s = 2.0\n" + CLOCK + "node = 1\nat_s = 1.0\n", 9, "by line 1 already"),
        (CLOCK + "node = 1\nduration_s = 2.0\n" + CLOCK + 'node = 1\nafter = "enabled"\n', 9, "by line 1 already"),
    ],
)
def test_what_is_said_twice_is_refused_with_its_place(tmp_path, text, line, word):
    """It was accepted, and the last one held."""
    with pytest.raises(FaultError, match=rf"faults.toml:{line}: .*{word}"):
        simulate("bench", "hybrid", 0.1, faults=write(tmp_path, text))


def test_one_after_the_other_is_no_contradiction(tmp_path):
    """Also where the second one stands first, and begins when the other one ends."""
    later, sooner = "at_s = 0.3\n", "at_s = 0.1\nduration_s = 0.2\n"
    text = "".join(one + when for when in (later, sooner) for one in (CLOCK + "node = 1\n", NOISE))
    seen = []
    result = simulate("bench", "hybrid", 0.5, faults=write(tmp_path, text), script=seen.append)
    assert seen[0].nodes[MOTOR].clock_ppb == 100_000
    assert seen[0].bus[0].noise.rate == 1e-4
    assert all(fault["times"] > 0 for fault in result.faults)


def test_same_seed_same_bytes_and_what_was_injected(tmp_path):
    file = write(tmp_path, GOOD + '[[fault]]\nkind = "noise"\nrate = 1e-4\nafter = "enabled"\n')
    runs = [
        simulate("bench", "hybrid", 2.0, faults=file, seed=s, record=tmp_path / f"{n}.pcapng")
        for n, s in enumerate((5, 5, 6))
    ]
    assert runs[0].recording_sha256 == runs[1].recording_sha256 != runs[2].recording_sha256
    flip, noise = runs[0].faults
    assert (flip["kind"], flip["line"], flip["times"]) == ("flip", 2, 1)
    assert noise["times"] > 50
    json.dumps(runs[0].as_dict(), allow_nan=False)
    assert "fault flip 182h (line 2)" in [text for _, text in read(tmp_path / "0.pcapng").markers]


def test_frame_errors_lose_nothing_that_is_not_told(tmp_path):
    """1 % of the frames destroyed: each is sent again, and the recording has each frame that the
    host has received.
    """
    file = write(tmp_path, '[[fault]]\nkind = "noise"\nrate = 1e-4\n')
    result = simulate("bench", "hybrid", 6.0, faults=file, record=tmp_path / "r.pcapng")
    frames = read(tmp_path / "r.pcapng").frames
    good = frames[frames["can_id"] & CAN_ERR_FLAG == 0]
    errors = frames[frames["can_id"] & 0x20000080 == 0x20000080]
    assert len(errors) / len(good) > 0.005
    told = sum(c["retransmissions"] for c in result.controllers.values())
    markers = read(tmp_path / "r.pcapng").markers
    idle = len({t for t, text in markers if text == "fault noise (line 1)"})  # nobody sent: an error frame all the same
    assert idle > 0.3 * len(errors)
    assert 0.95 * (len(errors) - idle) <= told <= len(errors) - idle
    syncs = int(np.sum(good["can_id"] == 0x80))
    for can_id in (0x181, 0x182, 0x201, 0x202):
        assert abs(int(np.sum(good["can_id"] == can_id)) - syncs) <= 0.02 * syncs
    assert all(c["bus_offs"] == 0 for c in result.controllers.values())
    assert result.trip is None


@pytest.mark.parametrize("node", ["host", "motor", "brake"])
def test_one_controller_alone_may_see_a_wrong_bit(tmp_path, node):
    """Bit 10 of SYNC (0 00010000000b) is the stuff bit after five dominant ones: who sees it
    dominant, sender or receiver, has a stuff error.
    """
    on = f'[[fault]]\nkind = "flip"\non = "20th SYNC"\nbit = 10\nseen_by = "{node}"\n'
    result = simulate("bench", "hybrid", 0.2, faults=write(tmp_path, on))
    assert result.controllers[node]["errors"]["stuff"] == 1
    assert result.controllers["host"]["retransmissions"] == 1
    assert result.trip is None


def test_a_wire_that_stays_dominant_from_within_a_frame_is_in_result_and_recording(tmp_path):
    """At 0.5 s a SYNC is on the wire, so the bus is never free again: the fault is told all the
    same, from its begin on.
    """
    file = write(tmp_path, '[[fault]]\nkind = "stuck_dominant"\nat_s = 0.50003\n')
    result = simulate("bench", "hybrid", 1.0, faults=file, record=tmp_path / "r.pcapng")
    assert result.exit_status == 7
    assert [(one["times"], one["first_s"]) for one in result.faults] == [(1, pytest.approx(0.50003))]
    assert "fault stuck_dominant (line 1)" in [text for _, text in read(tmp_path / "r.pcapng").markers]


def test_the_example():
    result = simulate("bench", "hybrid", 2.0, faults=ROOT / "examples" / "faults.toml")
    assert [fault["kind"] for fault in result.faults] == ["flip", "drop", "noise"]
    assert result.faults[0]["times"] == 1
    assert all(fault["times"] > 0 for fault in result.faults)
    assert result.lost_pdos >= 1  # what was dropped for the host


SAFE = {
    "stuck": 'kind = "stuck_dominant"\nduration_s = 0.05',
    "babble": 'kind = "babble"\nnode = "brake"\ncan_id = 0\ndata = "00 00"\nperiod_us = 20\nduration_s = 0.2',
    "bus-off of the drive": 'kind = "flip"\non = { frame = "TPDO1", node = 1, every = 1 }\nbit = 60\nduration_s = 0.2',
    "bus-off of the host": 'kind = "corrupt_crc"\non = { frame = "RPDO1", node = 1, every = 1 }\nduration_s = 0.2',
    "reset": 'kind = "reset"\nnode = "motor"',
}


@pytest.mark.parametrize("name", SAFE)
def test_whatever_fails_it_ends_safely(tmp_path, name):
    file = write(tmp_path, f'[[fault]]\nafter = "enabled"\nat_s = 1.5\n{SAFE[name]}\n')
    seen = {}
    result = simulate("bench", "active", 4.0, faults=file, script=lambda world: seen.update(world=world))
    world = seen["world"]
    assert result.exit_status == 7
    assert world.nodes[MOTOR].out_torque_pm == 0.0
    assert world.nodes[BRAKE].out_brake_Nm == 0.0
    assert world.nodes[MOTOR].power_state != PowerState.OPERATION_ENABLED
    controllers = result.controllers
    assert all(
        c["state"] != "bus-off" for c in controllers.values()
    )  # recovered, and yet nothing has armed itself again
    if name.startswith("bus-off"):
        station = controllers["motor" if name.endswith("drive") else "host"]
        assert station["bus_offs"] == station["restarts"] >= 1


@contextmanager
def served(tmp_path, monkeypatch, text):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    server = SimServer(load_rig("bench"), BusAddress("coulombus", "t"), faults=read_faults(write(tmp_path, text)))
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield server
    finally:
        server.stop()
        thread.join()
        server.close()


def test_the_host_is_every_client_where_it_is_another_process(tmp_path, monkeypatch):
    """As a sender, as the one that alone sees a wrong bit, and with the set-up of its
    controller.
    """
    text = """
[[fault]]
kind = "corrupt_crc"
on = { can_id = 0x100, sender = "host" }
[[fault]]
kind = "drop"
on = "1st 0x101"
lost_for = "host"
[[controller]]
node = "host"
one_shot = true
"""
    with (
        served(tmp_path, monkeypatch, text) as server,
        can.Bus(interface="coulombus", channel="t") as one,
        can.Bus(interface="coulombus", channel="t", ignore_rx_error_frames=True) as other,
    ):
        for can_id in (0x100, 0x101, 0x102):
            one.send(can.Message(arbitration_id=can_id, is_extended_id=False))
        seen = []
        while not seen or seen[-1] != 0x102:
            message = other.recv(20.0)
            assert message is not None
            seen.append(message.arbitration_id)
        details = one.details(20.0)
    assert [can_id for can_id in seen if can_id in (0x100, 0x101)] == []
    assert "<ONE-SHOT> state ERROR-ACTIVE (berr-counter tx 6 rx 0) restart-ms 100" in details
    assert [one["times"] for one in server.result.faults] == [1, 1]
    assert server.result.controllers["host"]["dropped"] == 1


def test_what_a_client_sent_before_it_left_is_sent_again_after_an_error_and_its_place_is_clean(tmp_path, monkeypatch):
    flips = '[[fault]]\nkind = "flip"\non = { can_id = 0x100, every = 1 }\nbit = 20\n'
    with served(tmp_path, monkeypatch, flips) as server:
        frame = struct.Struct("=IB3x8s")
        reader = connect(server.address)
        reader.settimeout(20.0)
        with connect(server.address) as brief:
            brief.send(b"".join(frame.pack(0x100, 1, bytes((n, *bytes(7)))) for n in range(5)))
        seen = []
        while len(seen) < 5:
            seen += [f[2][0] for f in frame.iter_unpack(reader.recv(4096)) if f[0] == 0x100]
        left = greet_again(reader)
        with connect(server.address) as next_one:
            assert greet_again(next_one).station == left.station + 1
            assert greet_again(next_one).controller.tec == 0
        reader.close()
    assert seen == [0, 1, 2, 3, 4]
    assert server.result.faults[0]["times"] == 5
    assert not server.world.bus[0].stations["attached"][128:192].any()


def greet_again(connection):
    connection.settimeout(20.0)
    connection.send(Hello().pack())
    while (answer := Answer.unpack(connection.recv(1 << 16))) is None:
        pass
    return answer


def test_error_frames_for_the_clients_that_ask_for_them(tmp_path, monkeypatch):
    """Each with the counters of its own controller.

    Who does not ask sees the frame alone, once it has passed.
    """
    with served(tmp_path, monkeypatch, '[[fault]]\nkind = "flip"\non = "1st SYNC"\nbit = 8\n') as server:
        sender, other, plain = (
            connect(server.address, flags) for flags in (Flags.ERRORS | Flags.OWN, Flags.ERRORS, Flags(0))
        )
        frame = struct.Struct("=IB3x8s")
        sender.send(frame.pack(0x80, 0, bytes(8)))
        seen = []
        for one in (sender, other, plain):
            one.settimeout(20.0)
            frames = []
            while not frames or frames[-1][0] != 0x80:
                frames += [f for f in frame.iter_unpack(one.recv(4096)) if f[0] & 0x780 != 0x700]
            seen.append(frames)
            one.close()
    error = CAN_ERR_FLAG | 0x288  # CNT, BUSERROR, PROT
    assert [[f[0] for f in frames] for frames in seen] == [[error, 0x80], [error, 0x80], [0x80]]
    mine, others = seen[0][0][2], seen[1][0][2]
    assert (mine[2] & 0x80, mine[6], mine[7]) == (0x80, 8, 0)
    assert (others[2] & 0x80, others[6], others[7]) == (0, 0, 1)


@pytest.mark.parametrize(("seconds", "armed"), [(0.35, True), (2.0, False)])
def test_a_late_heartbeat_is_waited_for_and_a_missing_one_is_refused(tmp_path, seconds, armed):
    drop = f"""
[[fault]]
kind = "drop"
on = {{ can_id = 0x702, every = 1 }}
duration_s = {seconds}
lost_for = "host"
"""
    with contextlib.ExitStack() as stack:
        if not armed:
            stack.enter_context(pytest.raises(NodeMissing, match=r"brake \(node 2\) says INITIALISING after NMT start"))
        result = simulate("bench", "hybrid", 0.1, faults=write(tmp_path, drop))
        assert armed
        assert result.trip is None


@pytest.mark.parametrize("text", ["", "seed = 3\n", "fault = []\ncontroller = []\n"])
def test_a_file_without_a_fault_is_refused(tmp_path, text):
    file = tmp_path / "f.toml"
    file.write_text(text)
    with pytest.raises(FaultError, match=r"f.toml: it has no fault; expected \[\[fault\]\] or"):
        read_faults(file)
