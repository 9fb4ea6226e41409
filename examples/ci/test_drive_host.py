"""Tests of drive_host.py on a virtual bus: `python -m pytest`, where coulombus[test] is installed."""

from __future__ import annotations

import canopen
import pytest
from drive_host import EDS, HEARTBEAT_MS, DriveError, DriveHost


@pytest.fixture
def network(can_bus):
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.02  # disconnect() waits so long for its thread
    network.connect(interface="coulombus", channel=can_bus.channel)
    yield network
    network.disconnect()


@pytest.fixture
def drive(canopen_node):
    return canopen_node(EDS, node_id=5, kind="drive")


@pytest.fixture
def host(network, drive):
    return DriveHost(network, 5)


# configuration


def test_heartbeat_is_configured_before_the_node_starts(host, can_bus):
    host.configure()
    can_bus.log.assert_before("SDO write of 1017h", "NMT start node 5")


def test_heartbeat_has_the_hosts_period(host, drive):
    host.configure()
    assert drive["1017"] == HEARTBEAT_MS


def test_node_becomes_operational(host, can_bus):
    host.configure()
    can_bus.log.assert_said("NMT start", "heartbeat operational node 5")


def test_device_of_another_profile_is_refused(host, drive, can_bus):
    drive["1000"] = 401
    with pytest.raises(DriveError, match="no drive"):
        host.configure()
    assert not can_bus.log.said("SDO write")


def test_missing_node_is_reported(network, can_bus):
    host = DriveHost(network, 6)
    host.node.sdo.RESPONSE_TIMEOUT = 0.05
    with pytest.raises(canopen.SdoCommunicationError):
        host.configure()
    assert not can_bus.log.said("NMT start")


# state machine


def test_drive_is_enabled(host):
    host.configure()
    host.enable()
    assert host.state == "enabled"


def test_drive_is_enabled_at_velocity_0(host, can_bus):
    host.configure()
    host.enable()
    can_bus.log.assert_before("SDO write 60FFh = 0", "SDO write 6040h = 6")


def test_controlwords_come_in_the_order_of_cia_402(host, can_bus):
    host.configure()
    host.enable()
    can_bus.log.assert_said("SDO write 6040h = 6", "SDO write 6040h = 7", "SDO write 6040h = 15")


def test_mode_is_profile_velocity(host, drive):
    host.configure()
    host.enable()
    assert drive["6061"] == 3


def test_drive_is_disabled_at_start(host):
    host.configure()
    assert host.state == "switch on disabled"


def test_stop_switches_off_before_the_node_stops(host, can_bus):
    host.configure()
    host.enable()
    host.stop()
    can_bus.log.assert_said("SDO write 6040h = 0", "NMT stop", "heartbeat stopped")


# PDOs


@pytest.mark.parametrize("velocity", [1, -1, 20_000, -100_000])
def test_velocity_reaches_the_drive(host, drive, can_bus, velocity):
    host.configure()
    host.enable()
    host.run(velocity)
    can_bus.log.assert_said(f"RPDO1 node 5 60FFh = {velocity}")
    assert drive["60FF"] == velocity


def test_velocity_above_the_limit_is_refused(host, can_bus):
    host.configure()
    host.enable()
    with pytest.raises(DriveError, match="607Fh"):
        host.run(100_001)
    assert not can_bus.log.said("RPDO1")


def test_status_comes_by_tpdo(host, can_bus):
    host.configure()
    host.enable()
    assert host.read()[0] & 0x6F == 0x27
    can_bus.log.assert_said("SYNC", "TPDO1 node 5")


# faults


def test_host_survives_a_lost_response(host, faults, can_bus):
    faults('[[fault]]\nkind = "drop"\non = "1st SDO RESPONSE of node 5"')
    host.node.sdo.RESPONSE_TIMEOUT = 0.1
    host.configure()
    assert len(can_bus.log.said("SDO read 1000h")) >= 2


def test_missing_tpdo_is_an_error(host, faults):
    host.configure()
    faults('[[fault]]\nkind = "drop"\non = "every 1st TPDO1 of node 5"')
    with pytest.raises(DriveError, match="does not answer SYNC"):
        host.read(timeout_s=0.1)


def test_drive_without_power_is_noticed(host, drive):
    host.configure()
    assert host.alive()
    drive.power_off()
    assert not host.alive(timeout_s=0.1)


def test_bit_errors_are_repaired_by_the_bus(host, faults, can_bus):
    faults('[[fault]]\nkind = "flip"\non = "every 2nd SDO REQUEST of node 5"\nbit = 30\nmost = 5')
    host.configure()
    host.enable()
    assert len(can_bus.log.said("error")) >= 3
