"""What a node tells of its CAN controller: 8120h in error passive, 8140h when it is back from
bus-off, and 1029h:01.
"""

from __future__ import annotations

import pytest

from coulombus.eds.cia301 import NmtCommand
from coulombus.eds.cia402 import PowerState
from coulombus.node.brake404 import BRAKE404
from coulombus.node.drive402 import DRIVE402
from coulombus.sim_bus.can_bus.stations import refresh
from coulombus.sim_bus.network.network import VirtualNetwork
from node_bench import EDS

MS = 1_000_000
NODE_ID = 5
STOPPED, OPERATIONAL, PRE_OPERATIONAL = 4, 5, 127


def network(name="motor.eds", kind=DRIVE402, behaviour=0):
    """A device that is OPERATIONAL with 1029h:01 as told, and who hears its EMCYs."""
    world = VirtualNetwork()
    device = world.add(EDS / name, NODE_ID, kind)
    tester = world.station({0x80 + NODE_ID})
    world.power_on()
    world.wait_ns(5 * MS)
    node = world.canopen().add_node(NODE_ID, str(EDS / name))
    node.sdo[0x1029][1].raw = behaviour
    node.sdo[0x1017].raw = 10
    world.nmt_command(0, NmtCommand.START)
    tester.take()
    return world, device, tester


def emcys(tester):
    return [(int.from_bytes(f.data[:2], "little"), f.data[2]) for f in tester.take()]


def count(world, **values):
    """Let the device's controller have counted errors: it takes note with the next frame."""
    for name, value in values.items():
        world.bus[0].stations[0][name] = value
    refresh(world.bus[0])


def test_error_passive_and_back():
    world, device, tester = network()
    count(world, tec=130)
    world.wait_ns(11 * MS)  # one heartbeat: 129, error passive
    assert emcys(tester) == [(0x8120, 0x11)]
    assert device[0x1001, 0] == 0x11
    assert device[0x1003, 1] == 0x8120
    world.wait_ns(30 * MS)  # three more, and the EMCY itself
    assert emcys(tester) == [(0x0000, 0x00)]
    assert device.record["nmt"] == OPERATIONAL


@pytest.mark.parametrize(("behaviour", "state"), [(0, PRE_OPERATIONAL), (1, OPERATIONAL), (2, STOPPED)])
def test_bus_off_does_what_1029_01_says(behaviour, state):
    """The drive is in FAULT, and stays there, whatever NMT does; a STOPPED node tells nothing."""
    world, device, tester = network(behaviour=behaviour)
    world.bus[0].stations["restart_ns"] = 20 * MS
    count(world, tec=248)
    _break(world)
    world.wait_ns(12 * MS)
    assert device.record["nmt"] == state
    assert device.record["power_state"] == PowerState.FAULT
    assert emcys(tester) == []
    world.wait_ns(40 * MS)
    assert emcys(tester) == ([] if state == STOPPED else [(0x8140, 0x11)])
    assert device.record["power_state"] == PowerState.FAULT
    assert device.record["nmt"] == state


def test_a_brake_tells_and_releases():
    world, device, tester = network("mr_brake.eds", BRAKE404)
    world.bus[0].stations["restart_ns"] = 20 * MS
    count(world, tec=248)
    _break(world)
    world.wait_ns(60 * MS)
    assert emcys(tester) == [(0x8140, 0x11), (0x0000, 0x00)]
    assert device.record["nmt"] == PRE_OPERATIONAL


def _break(world):
    """Destroy the device's next frame."""
    row = world.bus[0].faults[0]
    row.kind, row.framed, row.nth, row.match_id, row.match_mask = 0, 1, 1, 0x700 + NODE_ID, 0x7FF
    row.match_source = row.station = -1000
    row.until_ns, row.bit = 1 << 62, 25
    world.bus[0].fault_count = 1
    refresh(world.bus[0])
