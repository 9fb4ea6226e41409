"""The network in virtual time: many devices, stations written in Python, the same frames every
time.
"""

from __future__ import annotations

import signal

import canopen
import numpy as np
import pytest

from coulombus.node.drive402 import DRIVE402
from coulombus.node.record import new_nodes
from coulombus.sim_bus.network.deadline_tree import keep_deadline, look_again, new_deadlines, new_wants, next_device
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.wire.bits import frame_bits
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import CAN_RTR_FLAG, arbitration_key
from places import EDS

MS = 1_000_000
START = b"\x01\x00"


def network_of(count, bitrate=1_000_000, **options):
    network = VirtualNetwork(bitrate, capacity=count, **options)
    for row in range(count):
        network.add(EDS / "motor.eds", row + 1)
    return network


def upload(index, subindex=0):
    return bytes((0x40, index & 0xFF, index >> 8, subindex, 0, 0, 0, 0))


def test_the_docstrings_example():
    network = VirtualNetwork(bitrate_bit_s=500_000)
    device = network.add(EDS / "motor.eds", 5, DRIVE402)
    tester = network.station()
    network.power_on()
    network.wait_ns(10 * MS)
    boot = tester.take(0x705)[0]
    assert (boot.data, boot.source) == (b"\0", 0)
    assert boot.t_ns == 20_000 + (frame_bits(0x705, b"\0") - 3) * 2_000  # the node's processing time, then its bits
    tester.send(0x605, upload(0x1018, 1))
    answer = tester.wait_for(0x585, 10 * MS)
    assert int.from_bytes(answer.data[4:], "little") == device[0x1018, 1]
    assert tester.wait_for(0x585, 10 * MS) is None


def test_every_node_answers_a_sync_in_the_order_of_identifiers():
    network = network_of(40)
    tester = network.station()
    network.power_on()
    tester.send(0x000, START)
    network.wait_ns(20 * MS)
    tester.take()
    tester.send(0x080)
    network.wait_ns(20 * MS)
    heard = [frame.can_id for frame in tester.take() if frame.can_id < 0x600]
    tpdos = [can_id for can_id in heard if can_id in range(0x181, 0x181 + 40)]
    assert tpdos == list(range(0x181, 0x181 + 40))
    assert heard == sorted(heard, key=arbitration_key)


def test_a_broadcast_reaches_every_node_and_an_addressed_command_one():
    network = network_of(20)
    network.power_on()
    master = network.station(())
    network.wait_ns(20 * MS)
    master.send(0x000, b"\x01\x07")
    network.wait_ns(MS)
    assert [device.node_id for device in network.devices if device.record["nmt"] == 5] == [7]
    master.send(0x000, START)
    network.wait_ns(MS)
    assert all(device.record["nmt"] == 5 for device in network.devices)


def test_a_device_hears_what_it_was_told_to_hear():
    """The table of who wants a frame follows the COB-ID of an RPDO."""
    network = network_of(3)
    tester = network.station({0x583})
    network.power_on()
    network.wait_ns(5 * MS)
    tester.send(0x603, bytes.fromhex("2300140145020080"))  # 1400h:01 = 80000245h: invalid
    assert tester.wait_for(0x583, 5 * MS).data[0] == 0x60
    tester.send(0x603, bytes.fromhex("2300140145020000"))
    assert tester.wait_for(0x583, 5 * MS).data[0] == 0x60
    tester.send(0x000, START)
    network.wait_ns(MS)
    before = [int(device.record["rpdo_ns"][0]) for device in network.devices]
    tester.send(0x245, bytes(8))
    network.wait_ns(MS)
    changed = [int(device.record["rpdo_ns"][0]) != b for device, b in zip(network.devices, before, strict=True)]
    assert changed == [False, False, True]


def test_stations_hear_what_they_name_and_may_answer_at_once():
    network = VirtualNetwork()
    heard = []

    def answer(frame):
        heard.append(frame)
        echo.send(frame.can_id + 1, frame.data)

    echo = network.station({0x100}, answer)
    everything, other = network.station(), network.station({0x101})
    other.send(0x100, b"ab")
    other.send(0x102, at_ns=MS)
    other.send(0x100 | CAN_RTR_FLAG, length=3, at_ns=2 * MS)
    network.wait_ns(5 * MS)
    assert [(frame.can_id, frame.data) for frame in heard] == [(0x100, b"ab")]
    expected = [(0x100, b"ab"), (0x101, b"ab"), (0x102, b""), (0x100 | CAN_RTR_FLAG, b"\0\0\0")]
    assert [(frame.can_id, frame.data) for frame in everything.take()] == expected
    assert [(frame.can_id, frame.source) for frame in other.take()] == [(0x101, echo.number)]
    with pytest.raises(ValueError, match="at most 8"):
        other.send(0x100, bytes(9))


def test_the_same_calls_give_the_same_bytes():
    def course():
        batches = []
        network = network_of(9, on_frames=lambda batch: batches.append(batch.copy()))
        station = network.station(())
        network.power_on()
        network.at(3 * MS, lambda network: network.power_off(4))
        network.at(9 * MS, lambda network: network.power_on(4))
        station.send(0x000, START, at_ns=MS)
        for k in range(10):
            station.send(0x080, at_ns=(2 + k) * MS)
        network.wait_ns(300 * MS)
        network.flush()
        return np.concatenate(batches)

    one, two = course(), course()
    assert len(one) > 60
    assert one.tobytes() == two.tobytes()
    off = one[(one["source"] == 4) & (one["t_ns"] > 3.3 * MS) & (one["t_ns"] < 9 * MS)]
    assert len(off) == 0


def test_canopen_configures_a_device():
    network = network_of(2)
    network.power_on()
    network.wait_ns(5 * MS)
    client = network.canopen()
    node = client.add_node(canopen.RemoteNode(2, str(EDS / "motor.eds")))
    node.sdo[0x1017].raw = 250
    assert network.devices[1].record["heartbeat_ns"] == 250 * MS
    assert node.sdo[0x1017].raw == 250
    client.nmt.state = "OPERATIONAL"
    network.wait_ns(300 * MS)
    assert node.nmt.state == "OPERATIONAL"


def test_mistakes_are_named():
    network = VirtualNetwork(capacity=1)
    network.add(EDS / "motor.eds", 3)
    with pytest.raises(ValueError, match="capacity=4"):
        network.add(EDS / "motor.eds", 4)
    roomy = VirtualNetwork(capacity=3)
    roomy.add(EDS / "motor.eds", 3)
    with pytest.raises(ValueError, match="3 is taken"):
        roomy.add(EDS / "mr_brake.eds", 3)
    with pytest.raises(ValueError, match="0 to 127"):
        VirtualNetwork(capacity=128)


@pytest.mark.parametrize("count", [1, 2, 5, 126])
def test_the_next_deadline_is_the_earliest(count):
    nodes = new_nodes(count)
    nodes["powered"] = 1
    random = np.random.default_rng(count)
    nodes["next_ns"] = random.integers(0, 50, count)
    deadlines, wants = new_deadlines(count), new_wants(count)
    assert deadlines[1] == NEVER_NS
    look_again(nodes, deadlines, wants)
    for _ in range(200):
        alive = np.where(nodes["powered"] == 1, nodes["next_ns"], NEVER_NS)
        assert deadlines[1] == alive.min()
        if alive.min() < NEVER_NS:
            assert next_device(deadlines) == int(np.argmin(alive))
        i = int(random.integers(count))
        nodes[i].next_ns, nodes[i].powered = int(random.integers(0, 50)), int(random.random() < 0.9)
        keep_deadline(deadlines, i, nodes[i])


def test_who_wants_a_frame_follows_the_routes():
    nodes = new_nodes(7)
    deadlines, wants = new_deadlines(7), new_wants(7)
    random = np.random.default_rng(1)
    for _ in range(30):
        i = int(random.integers(7))
        nodes["route"][i] = random.random(2048) < 0.3
        nodes[i].rerouted = 1
        look_again(nodes, deadlines, wants)
        for can_id in random.integers(0, 2048, 50):
            count = wants[can_id, 0]
            assert list(wants[can_id, 1 : count + 1]) == list(np.flatnonzero(nodes["route"][:, can_id]))


def test_an_interrupt_waits_until_the_kernel_has_returned():
    """It was raised where numba, at the kernel's entry, runs Python for the law and does not look
    for exceptions.
    """
    network = network_of(1)
    kernel, passed = network._run, []

    def entered(*arguments):
        signal.raise_signal(signal.SIGINT)
        passed.append("entry")
        reason = kernel(*arguments)
        passed.append("return")
        return reason

    entered.load = kernel.load
    network._run = entered
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job of a shell ignores it
    try:
        with pytest.raises(KeyboardInterrupt):
            network.run_until(MS)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert passed == ["entry", "return"]
    network._run = kernel
    network.run_until(2 * MS)
    assert network.t_ns == 2 * MS


def test_two_stations_that_begin_the_same_frame_with_other_data_collide():
    carried = []
    network = network_of(2, on_frames=lambda frames: carried.extend(frames.tolist()))
    one, two = network.station(), network.station()
    network.power_on()
    one.send(0x000, START)
    network.wait_ns(20 * MS)
    for sender, data in ((one, b"\x01"), (two, b"\x02")):
        sender.send(0x123, data, at_ns=25 * MS)
    network.wait_ns(20 * MS)
    network.flush()
    assert any(can_id >> 29 & 1 for _, can_id, *_ in carried)  # the collision was told by an error frame
