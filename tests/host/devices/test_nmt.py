"""NMT commands, and what the nodes' heartbeats and boot-ups say of them."""

from __future__ import annotations

import pytest

from coulombus.eds.cia301 import NmtState
from coulombus.host.devices.nmt import COMMANDS, command
from coulombus.host.errors import NodeMissing
from coulombus.host.sdo.sdo_client import SdoClient
from devices_bench import DevicesLink, Server, eds

S = 1_000_000_000


def bench(heartbeat_ms=50):
    link = DevicesLink()
    link.add(eds("motor"), 1)
    link.add(eds("mr_brake"), 2)
    for node_id in (1, 2) if heartbeat_ms else ():
        SdoClient(link, node_id).download(0x1017, 0, heartbeat_ms.to_bytes(2, "little"))
    return link


@pytest.mark.parametrize("word", COMMANDS)
def test_a_node_follows_and_the_other_does_not(word):
    link = bench()
    (told,) = command(link, word, 2, 2.0)
    assert (told.node_id, told.state, told.well) == (2, COMMANDS[word][1], True)
    assert int(link.devices[0].record["nmt"]) == NmtState.PRE_OPERATIONAL
    assert link.t < 0.5 * S


def test_all_nodes_follow():
    link = bench()
    assert [(one.node_id, one.well) for one in command(link, "start", None, 0.3)] == [(1, True), (2, True)]
    assert [int(device.record["nmt"]) for device in link.devices] == [NmtState.OPERATIONAL] * 2
    assert [str(one) for one in command(link, "reset", None, 0.3)] == ["node 1: booted", "node 2: booted"]


def test_a_node_without_a_heartbeat_cannot_tell():
    (told,) = command(bench(0), "start", 1, 5.0)
    assert (told.state, told.well) == (None, None)
    assert "1017h is 0" in str(told)


def test_a_node_that_does_not_follow_is_told():
    link = DevicesLink()
    Server(link, 7, lambda request: [b"\x4b" + request[1:4] + b"\x64\0\0\0"])
    for k in range(20):
        link.put(0x707, b"\x7f", after_ns=(k + 1) * S // 10)
    (told,) = command(link, "start", 7, 1.0)
    assert (told.state, told.well) == (NmtState.PRE_OPERATIONAL, False)
    assert "not what was asked for" in str(told)


def test_a_node_that_is_not_there_is_told():
    (told,) = command(DevicesLink(), "start", 7, 1.0)
    assert (told.state, told.well) == (None, False)
    (told,) = command(DevicesLink(), "reset", 7, 1.0)
    assert told.well is False
    assert command(DevicesLink(), "start", None, 1.0) == ()
    with pytest.raises(NodeMissing, match="no node booted within 1 s"):
        command(DevicesLink(), "reset", None, 1.0)


def test_a_heartbeat_of_another_length_is_told_as_that():
    link = DevicesLink()
    for k in range(20):
        link.put(0x707, b"\5" + bytes(7), after_ns=(k + 1) * S // 10)
    (told,) = command(link, "start", 7, 1.0)
    assert (told.state, told.well) == (None, False)
    assert str(told) == "node 7: its heartbeat has 8 bytes; 1 is right (CiA 301)"


@pytest.mark.parametrize(("word", "seconds"), [("start", 2.0), ("reset", 5.0), ("reset-communication", 5.0)])
def test_a_boot_up_has_more_time_than_a_heartbeat(word, seconds):
    for share, follows in ((0.9, True), (1.3, False)):
        link = DevicesLink()
        Server(link, 7, lambda request: [b"\x4b" + request[1:4] + b"\x64\0\0\0"])
        link.put(0x707, bytes((COMMANDS[word][1],)), after_ns=round(share * seconds * S))
        (told,) = command(link, word, 7)
        assert told.well is follows
