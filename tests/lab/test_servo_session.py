"""A servo drive of our own as `canopen`'s BaseNode402 uses it: homing, positions, a followed sine, a blocked axis."""

from __future__ import annotations

import math

import canopen
import pytest

from canopen_clients import WAIT_S, node_of, until
from coulombus.lab.served_bus import empty_bus
from coulombus.sim_bus.faults.fault_file import faults_of
from places import EDS

pytestmark = [pytest.mark.real_time, pytest.mark.patient]

NODE_ID = 5
ENABLE, START, IMMEDIATELY = 0x0F, 0x10, 0x20
TARGET_REACHED, ACKNOWLEDGED, FOLLOWING_ERROR = 0x0400, 0x1000, 0x2000
TURN = 8192


@pytest.fixture
def served(private_sockets):
    bus = empty_bus()
    yield bus
    bus.close()


@pytest.fixture
def drive(served):
    served.add(EDS / "servo.eds", NODE_ID, "drive")
    network = canopen.Network()
    network.connect(interface="coulombus", channel=served.channel, bitrate=1_000_000)
    try:
        with node_of(network, canopen.BaseNode402, "servo", NODE_ID) as node:
            for name in ("SWITCH_OP_MODE", "SWITCH_STATE_FINAL", "SWITCH_STATE_SINGLE", "CHECK_TPDO"):
                setattr(node, f"TIMEOUT_{name}", WAIT_S)
            node.nmt.state = "PRE-OPERATIONAL"
            node.setup_402_state_machine()
            node.nmt.state = "OPERATIONAL"
            yield node
    finally:
        network.disconnect()


def homed(node, method):
    """Home by a method, from bit 4 = 0; return the position."""
    node.sdo[0x6098].raw = method
    node.controlword = ENABLE
    assert node.homing(timeout=WAIT_S)
    return node.sdo[0x6064].raw


def test_a_session_as_its_users_write_it(served, drive):
    assert abs(homed(drive, 35)) <= 1
    before = drive.sdo[0x6063].raw
    homed(drive, 17)
    assert drive.sdo[0x6063].raw < before  # it has been at the negative limit switch
    drive.op_mode = "PROFILED POSITION"
    drive.state = "OPERATION ENABLED"
    for target in (TURN, -200, 3 * TURN):
        drive.sdo[0x607A].raw = target
        drive.controlword = ENABLE
        drive.controlword = ENABLE | START | IMMEDIATELY
        until(lambda: drive.statusword & ACKNOWLEDGED, drive.check_statusword)
        drive.controlword = ENABLE
        until(lambda: drive.statusword & TARGET_REACHED, drive.check_statusword)
        assert abs(drive.sdo[0x6064].raw - target) <= drive.sdo[0x6067].raw
    drive.op_mode = "CYCLIC SYNCHRONOUS POSITION"
    middle = drive.sdo[0x6064].raw
    for step in range(200):
        drive.sdo[0x607A].raw = middle + round(300 * math.sin(2 * math.pi * step / 100))
        assert abs(drive.sdo[0x60F4].raw) <= drive.sdo[0x6065].raw
    assert not drive.sdo[0x6041].raw & FOLLOWING_ERROR


def test_a_blocked_axis_is_a_following_error(served, drive):
    drive.op_mode = "PROFILED POSITION"
    drive.state = "OPERATION ENABLED"
    emergencies = []
    drive.emcy.add_callback(lambda error: emergencies.append(error.code))
    served.inject(faults_of('[[fault]]\nkind = "blocked"\nnode = 5\n', "blocked.toml"))
    drive.sdo[0x607A].raw = 20 * TURN
    drive.controlword = ENABLE | START
    until(lambda: drive.state == "FAULT", drive.check_statusword)
    until(lambda: emergencies)
    assert emergencies[0] == 0x8611
