"""The cable cut into two halves: each goes on alone, nothing is heard across, and after the mend
nothing has armed itself again.
"""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.eds.cia402 import PowerState
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.faults.fault_file import FaultError, read_faults
from coulombus.sim_bus.faults.injection import Injection
from coulombus.sim_bus.network.event_loop import BRAKE, MOTOR
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.wire.bits import frame_bits
from coulombus.wire.frame import CAN_ERR_FLAG, data_bytes

MS = 1_000_000
CUT = '[[fault]]\nkind = "cut"\nhalves = [["host"], ["motor"]]\n'


def write(path, text):
    file = path / "cut.toml"
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("halves", "word"),
    [
        ('[["host"], ["host"]]', "each in one"),
        ('[["host"], []]', "each in one"),
        ('[["host"]]', "halves"),
    ],
)
def test_mistakes(tmp_path, halves, word):
    with pytest.raises(FaultError, match=f"cut.toml:3: .*{word}"):
        read_faults(write(tmp_path, f'[[fault]]\nkind = "cut"\nhalves = {halves}\n'))


def test_a_node_that_is_not_there(tmp_path):
    file = write(tmp_path, '[[fault]]\nkind = "cut"\nhalves = [[], ["motor", "arm"]]\n')
    with pytest.raises(FaultError, match=r"cut.toml:3: .*'arm'"):
        simulate("bench", "hybrid", 1.0, faults=file)


def test_a_node_in_both_halves_by_name_and_by_node_id(tmp_path):
    file = write(tmp_path, '[[fault]]\nkind = "cut"\nhalves = [["motor"], [1]]\n')
    with pytest.raises(FaultError, match=r"cut.toml:3: .*1 is named twice"):
        simulate("bench", "hybrid", 1.0, faults=file)


@pytest.mark.parametrize("far", ['["motor"]', '["motor", "brake"]', '["brake"]'])
def test_who_is_cut_off_becomes_safe_and_stays_so(tmp_path, far):
    file = write(
        tmp_path,
        f'[[fault]]\nkind = "cut"\nafter = "enabled"\nat_s = 1.4\nduration_s = 0.3\nhalves = [["host"], {far}]\n',
    )
    seen = {}

    def watch(world):
        seen["world"] = world
        seen["outputs"] = outputs = []

        def look(world):
            node = world.nodes
            outputs.append((world.t_ns, float(node[MOTOR].out_torque_pm), float(node[BRAKE].out_brake_Nm)))
            world.at(world.t_ns + 10 * MS, look)

        world.at(0, look)

    result = simulate("bench", "hybrid", 4.0, faults=file, script=watch, record=tmp_path / "r.pcapng")
    world, fault = seen["world"], result.faults[0]
    assert (fault["kind"], fault["times"]) == ("cut", 1)
    assert result.exit_status == 7
    begin = fault["first_s"] * 1e9
    assert begin < result.trip_ns < begin + 50 * MS
    after = [row for row in seen["outputs"] if begin + 150 * MS < row[0]]
    assert len(after) > 20
    assert {motor for _, motor, _ in after} == {0.0}
    brakes = [brake for _, _, brake in after]
    assert brakes == sorted(brakes, reverse=True)
    assert brakes[-1] == 0.0
    assert world.nodes[MOTOR].power_state != PowerState.OPERATION_ENABLED
    assert not world.bus[0].cut
    if far == '["motor"]':  # alone: its frames find no ACK; then the mended wire carries them
        assert result.controllers["motor"]["errors"]["ack"] > 0
        frames = read(tmp_path / "r.pcapng").frames
        good = frames[frames["can_id"] & CAN_ERR_FLAG == 0]
        mine = good["t_ns"][np.isin(good["can_id"], (0x81, 0x181, 0x701))]
        assert not np.any((mine > begin + MS) & (mine < begin + 300 * MS))
        assert np.any(mine > begin + 300 * MS)
    texts = [text for _, text in read(tmp_path / "r.pcapng").markers]
    assert "the cable is cut (line 1)" in texts
    assert "the cable is repaired (line 1)" in texts


def cut_rig(tmp_path, text):
    """The bench's two nodes without a host's cycle.

    Return the rig, its faults, and the list of what the bus carries.
    """
    rows = []
    world = VirtualRig(load_rig("bench"), "passive", on_frames=lambda frames: rows.append(frames.copy()))
    injection = Injection(world, read_faults(write(tmp_path, text)), 1)
    world.power_on()
    return world, injection, rows


def test_both_halves_speak_at_the_same_time_and_hear_nothing_of_each_other(tmp_path):
    """Two babblers, one in each half: together more than a wire can carry, and each half has its
    own alone.
    """
    babble = (
        '[[fault]]\nkind = "babble"\nnode = "{node}"\ncan_id = {can_id}\ndata = "0102030405060708"\n'
        "period_us = 140\nat_s = 0.1\nduration_s = 0.05\n"
    )
    text = (
        '[[fault]]\nkind = "cut"\nhalves = [["host"], ["motor", "brake"]]\non = "1st 0x7FF"\nduration_s = 0.1\n'
        + babble.format(node="host", can_id="0x100")
        + babble.format(node="motor", can_id="0x102")
    )

    def course():
        world, injection, rows = cut_rig(tmp_path, text)
        station = world.station({0x100, 0x102})  # in the first half, where it acknowledges
        world.run_until(60 * MS)
        world.send(0x7FF, b"")
        world.run_until(300 * MS)
        world.flush()
        return np.concatenate(rows), [(f.t_ns, f.can_id) for f in station.heard], injection.results()

    rows, heard, faults = course()
    (cut,) = rows["t_ns"][rows["can_id"] == 0x7FF]
    assert [fault["times"] for fault in faults] == [1, 358, 358]  # 50 ms / 140 us
    near, far = (rows["t_ns"][rows["can_id"] == can_id] for can_id in (0x100, 0x102))
    assert len(near) == len(far) == 358
    assert near[-1] < 151 * MS < cut + 100 * MS  # 358 frames of 111 bits and more each: 40 ms of a wire, twice in 51 ms
    assert far[-1] < 151 * MS
    assert {can_id for _, can_id in heard} == {0x100}
    assert not np.any(rows["can_id"] & CAN_ERR_FLAG)
    again = course()
    assert np.array_equal(rows, again[0])
    assert (heard, faults) == again[1:]


def test_without_a_mend_it_ends_with_its_counters(tmp_path):
    world, injection, _ = cut_rig(tmp_path, CUT + "at_s = 0.02\n")
    world.nodes["heartbeat_ns"], world.nodes["heartbeat_next_ns"] = 10 * MS, 30 * MS
    world.nodes["next_ns"] = 30 * MS
    world.run_until(200 * MS)
    assert world.bus[0].cut
    assert injection.results()[0]["times"] == 1
    assert world.bus[1].stations[MOTOR].tec >= 128  # nobody acknowledges its heartbeats


def test_alone_in_its_half_worked_out_bit_by_bit(tmp_path):
    """A heartbeat that nobody acknowledges, from 30 ms on.

    The cable is mended in the midst of an attempt, at 60 ms, and the next one passes.

    An attempt lasts up to the ACK slot, then 6 bits of error flag, 8 of delimiter, 3 of
    intermission; 16 of them make it error passive, and then it waits for 8 bits more. It does not
    go bus-off. What it tries from the 17th time on is the EMCY that tells of it, which comes first.
    """
    us = 1_000
    text = CUT.replace('["host"]', '["host", "brake"]') + "at_s = 0.02\nduration_s = 0.04\n"
    world, injection, rows = cut_rig(tmp_path, text)
    for node, begin in ((MOTOR, 30), (BRAKE, 25)):
        world.nodes[node].heartbeat_ns, world.nodes[node].heartbeat_next_ns = 1000 * MS, begin * MS
        world.nodes[node].next_ns = begin * MS
    world.run_until(59 * MS)
    alone = world.bus[1].stations[MOTOR]
    assert (int(alone.tec), int(alone.rec)) == (128, 0)
    world.run_until(100 * MS)
    world.flush()
    found = np.concatenate(rows)
    mine = found[np.isin(found["can_id"], (0x081, 0x701)) & (found["t_ns"] > 20 * MS)]
    assert list(mine["can_id"]) == [0x081, 0x701, 0x081]  # 8120h; the heartbeat; 0000h: error active again
    told, alive = (frame_bits(0x081, data_bytes(int(mine["word"][0]), 8)), frame_bits(0x701, b"\x7f"))
    starts = [30 * MS + n * (alive - 11 + 17) * us for n in range(17)]
    starts[16] += 8 * us
    while starts[-1] < 60 * MS:
        starts.append(starts[-1] + (told - 11 + 17 + 8) * us)
    assert mine["t_ns"][0] == starts[-1] + (told - 3) * us
    motor, brake = (world.bus[0].stations[station] for station in (MOTOR, BRAKE))
    assert [int(n) for n in motor.errors] == [0, 0, 0, 0, len(starts) - 1]
    assert (int(motor.tec), int(motor.rec), int(motor.retransmissions)) == (125, 0, len(starts) - 1)
    assert (int(brake.tec), int(brake.rec), int(brake.errors.sum())) == (0, 0, 0)
    (his,) = found["t_ns"][(found["can_id"] == 0x702) & (found["t_ns"] > 20 * MS)]
    assert his == 25 * MS + (frame_bits(0x702, b"\x7f") - 3) * us
    assert injection.results()[0]["times"] == 1


def test_what_is_on_the_wire_at_a_cut_and_at_a_mend_is_not_torn(tmp_path):
    """Frame after frame of the host, 60 us apart, each in the midst of its time at some cut or
    mend: the brake has all of them.
    """
    text = "".join(CUT + f"at_s = {0.02 + 0.001 * n + 0.000013 * n}\nduration_s = 0.00051{n}\n" for n in range(10))
    world, injection, rows = cut_rig(tmp_path, text)
    world.run_until(19 * MS)
    for n in range(250):
        world.at(19 * MS + n * 60_000, lambda world, n=n: world.send(0x7FF, bytes((n,))))
    world.run_until(60 * MS)
    world.flush()
    found = np.concatenate(rows)
    assert np.count_nonzero(found["can_id"] == 0x7FF) == 250
    assert not np.any(found["can_id"] & CAN_ERR_FLAG)
    assert [fault["times"] for fault in injection.results()] == [1] * 10


def test_a_cut_that_is_left_out_is_not_counted(tmp_path):
    """One cut at a time: who asks for another meanwhile, in either half, has not struck."""
    again = CUT + 'on = { frame = "HEARTBEAT", every = 1 }\nduration_s = 0.001\n'
    world, injection, _ = cut_rig(tmp_path, CUT + "at_s = 0.02\nduration_s = 0.05\n" + again + "at_s = 0.021\n")
    world.nodes["heartbeat_ns"], world.nodes["heartbeat_next_ns"] = 10 * MS, 30 * MS
    world.nodes["next_ns"] = 30 * MS
    world.run_until(69 * MS)
    assert [fault["times"] for fault in injection.results()] == [1, 0]
    world.run_until(100 * MS)
    assert injection.results()[1]["times"] > 0
