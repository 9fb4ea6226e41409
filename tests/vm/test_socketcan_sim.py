"""``coulombus emulate`` on SocketCAN: the nodes as stations of a bus that Linux carries."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import subprocess
import threading
import time
from functools import partial

import canopen
import pytest

import canopen_clients
from coulombus.wire.socketcan import is_virtual
from places import ROOT
from vm_interfaces import INTERFACES
from warm_start import Warm

pytestmark = pytest.mark.real_time

FRAME = struct.Struct("=IB3x8s")
TIMEOUT_S = 60.0


@pytest.fixture(scope="module")
def sim(start_sim):
    """One sim for all tests here: under emulation its start takes half a minute."""
    return start_sim()


@pytest.fixture
def raw(interface):
    with can_socket(interface) as opened:
        yield opened


def can_socket(interface):
    opened = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    opened.bind((interface,))
    return opened


def ip(*arguments):
    subprocess.run(["ip", "link", *arguments], check=True, timeout=TIMEOUT_S)


def answer(raw, can_id, wait_s):
    """Return the data of the next frame with an identifier; TimeoutError without one, whatever else
    is on the bus (heartbeats never end).
    """
    deadline = time.monotonic() + wait_s
    while (left := deadline - time.monotonic()) > 0:
        raw.settimeout(left)
        came, length, data = FRAME.unpack(raw.recv(16))
        if came == can_id:
            return data[:length]
    raise TimeoutError(f"no frame {can_id:03X}h in {wait_s} s")


def upload(raw, node, index, subindex, wait_s=5.0):
    """Read an object by SDO, again and again while the interface is not quite up, or its controller
    loses frames.
    """
    deadline = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline:
        with contextlib.suppress(TimeoutError, OSError):
            raw.send(FRAME.pack(0x600 + node, 8, struct.pack("<BHB4x", 0x40, index, subindex)))
            return answer(raw, 0x580 + node, wait_s)[4:]
    raise TimeoutError(f"no answer of node {node}")


def test_nodes_answer(sim, raw):
    assert sim.ready["bus"] == f"socketcan:{INTERFACES[-1]}"
    assert upload(raw, 1, 0x1000, 0) == struct.pack("<I", 0x00020192)
    assert upload(raw, 2, 0x1000, 0) == struct.pack("<I", 0x000A0194)


def test_its_thread_keeps_to_one_cpu_so_that_its_frames_keep_their_order(sim):
    granted = [right["name"] for right in sim.ready["real_time"] if right["granted"]]
    cpus = [name for name in granted if name.removeprefix("CPU ").isdigit()]
    assert len(cpus) == (is_virtual(INTERFACES[-1]) and len(os.sched_getaffinity(0)) > 1)


def test_canopen_brings_a_node_to_operational_and_sync_makes_pdos(sim, raw, interface):
    network = canopen.Network()
    network.connect(interface="socketcan", channel=interface)
    try:
        node = network.add_node(1, str(ROOT / "eds" / "motor.eds"))
        node.sdo.RESPONSE_TIMEOUT = 5.0
        assert node.sdo[0x1000].raw == 0x00020192
        node.sdo[0x1017].raw = 50
        node.nmt.state = "OPERATIONAL"
        node.nmt.wait_for_heartbeat(TIMEOUT_S)
        network.sync.transmit()
        answer(raw, 0x181, TIMEOUT_S)
    finally:
        network.disconnect()


@pytest.mark.parametrize("use", ["transfers", "pdos", "drive", "layer_setting"])
def test_canopen_s_own_classes(sim, interface, use):
    network = canopen.Network()
    network.connect(interface="socketcan", channel=interface)
    try:
        getattr(canopen_clients, use)(network)
    finally:
        network.disconnect()


def test_a_flood_of_unknown_identifiers(sim, interface):
    over = threading.Event()

    def flood():
        with can_socket(interface) as sender:
            k = 0
            while not over.is_set():
                with contextlib.suppress(OSError):  # ENOBUFS: the interface is full
                    sender.send(FRAME.pack(0x7F0 - k % 16, 8, bytes(8)))
                k += 1

    thread = threading.Thread(target=flood)
    thread.start()
    time.sleep(1.0)
    try:
        with can_socket(interface) as raw:
            accept = struct.pack("=II", 0x581, 0x7FF)
            raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, accept)
            # the request stands behind a thousand frames of the flood, of which one in sixteen is on 7E5h
            assert upload(raw, 1, 0x1000, 0, wait_s=2.0) == struct.pack("<I", 0x00020192)
    finally:
        over.set()
        thread.join()


def test_an_interface_that_goes_down_is_used_again_and_what_is_told_at_the_end(sim, raw):
    upload(raw, 1, 0x1000, 0)
    for name in set(INTERFACES):
        ip("set", name, "down")
    time.sleep(0.5)
    assert sim.process.poll() is None
    for name in set(INTERFACES):
        ip("set", name, "up")
    assert upload(raw, 1, 0x1000, 0) == struct.pack("<I", 0x00020192)
    end, status = sim.end()
    assert status == 0
    assert end["socketcan"]["net_down"] >= 1
    assert min(end["socketcan"][name] for name in ("sent", "delivered")) >= 4


def test_an_interface_that_is_removed_ends_the_sim():
    ip("add", "vcan9", "type", "vcan")
    try:
        sim = partial(
            *(Warm, ["emulate", "--bus", "socketcan:vcan9", "--json"]),
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        refused = sim()
        _, told = refused.communicate(timeout=TIMEOUT_S)
        assert refused.returncode == 4
        assert "ip link set vcan9 up" in told
        ip("set", "vcan9", "up")
        process = sim()
        assert process.stdout is not None
        assert "ready" in process.stdout.readline()
    finally:
        ip("delete", "vcan9")
    _, told = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 4, told
    assert "does not exist any more" in told
