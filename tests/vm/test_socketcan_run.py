"""``coulombus run`` on SocketCAN: the host's data plane and control plane on Linux's own CAN.

Slowed down fifty times, as an emulated machine is.
"""

from __future__ import annotations

import re
import signal
import struct
import subprocess
import threading
import time

import pytest

from coulombus.host.run.control_socket import NotChanged, ask_change
from coulombus.recording.reading import read
from coulombus.wire.address import parse_address
from coulombus.wire.client import BusFull, BusUnavailable, pack_frame
from vm_host import enabled, host, observer, result, until
from vm_interfaces import INTERFACES

pytestmark = pytest.mark.real_time

SLOW = (
    *(
        "bus.period_s=0.05",
        "bus.tpdo_window_s=0.04",
        "host.heartbeat_s=0.2",
        "host.sdo_timeout_s=10",
        "host.loss_limit=1",
    ),
    *(f"{node}.heartbeat_s=0.2" for node in ("motor", "brake")),
    *(f"{node}.heartbeat_timeout_s=5" for node in ("motor", "brake")),
    *(f"{node}.setpoint_fault_s=1" for node in ("motor", "brake")),
    *(f"{node}.sync_timeout_s=1" for node in ("motor", "brake")),
    *("limits.missed_tpdo_cycles=40", "limits.still_timeout_s=60", "limits.handle_mismatch_Nm=100"),
)
SETS = [part for text in SLOW for part in ("--set", text)]


@pytest.fixture(scope="module")
def sim(start_sim):
    return start_sim("--mode", "passive", *SETS)


def test_a_run(sim, interface, tmp_path):
    record = tmp_path / "r.pcapng"
    with host(interface, *SETS, "--record", record) as run:
        status, data, err = result(run)
    assert status == 0, (err, data and data["trip"])
    assert data["bus"] == f"socketcan:{interface}"
    assert data["cycles"] > 10
    found = list(read(record).frames["can_id"])
    assert {0x000, 0x080, 0x181, 0x182, 0x201, 0x202, 0x581, 0x601, 0x701} <= set(found)


def test_no_torque_without_a_switch_or_a_word(sim, interface):
    with host(interface, *SETS, mode="active") as run:
        status, _, err = result(run)
    assert status == 7
    assert "host.deadman" in err


def test_a_change_needs_the_arm_key_that_the_host_has_printed(sim, interface):
    address = parse_address(f"socketcan:{interface}")

    def change(key):
        return ask_change(address, {"values": {"F_s_Nm": 3.4}, "over_s": 0.1, "key": key}, timeout_s=60)

    with observer(interface) as client, host(interface, *SETS, seconds=60) as run:
        key = next(found[1] for line in run.stderr if (found := re.search(r"arm key.*: (\d{6})", line)))
        until(client, enabled, run)
        for wrong in ("", "x", f"{(int(key) + 1) % 10**6:06d}"):
            with pytest.raises(NotChanged, match="arm key"):
                change(wrong)
        assert "F_s_Nm" in change(key)["marker"]
        run.send_signal(signal.SIGINT)


def test_the_interface_goes_down_in_mid_run(sim, interface):
    with observer(interface) as client, host(interface, *SETS, seconds=60) as run:
        until(client, enabled, run)
        try:
            subprocess.run(["ip", "link", "set", interface, "down"], check=True)
            status, data, err = result(run)
        finally:
            subprocess.run(["ip", "link", "set", interface, "up"], check=True)
    assert status == 7, err
    assert data["trip"].startswith("BUS_LOST")
    assert "down" in data["trip"]


def test_the_host_is_killed_under_a_flood(sim, interface):
    """While it lives it bears a flood of unknown identifiers.

    When it dies the nodes say so, and nobody sends SYNC.
    """
    over = threading.Event()
    with observer(interface) as client, observer(interface) as flooder, host(interface, *SETS, seconds=60) as run:

        def flood():
            while not over.is_set():
                for _ in range(20):
                    try:
                        flooder.send(pack_frame(0x7F0, b"\xaa" * 8))
                    except (BusFull, BusUnavailable):
                        break
                time.sleep(0.01)

        until(client, enabled, run)
        thread = threading.Thread(target=flood)
        thread.start()
        end = time.monotonic() + 3
        until(client, lambda can_id, data: can_id == 0x201 and time.monotonic() > end, run)
        over.set()
        thread.join()
        assert run.poll() is None, result(run)
        run.send_signal(signal.SIGKILL)
        run.wait()
        told = {}

        def emergency(can_id, data):
            if can_id in (0x81, 0x82) and struct.unpack_from("<H", data)[0]:
                told[can_id] = struct.unpack_from("<H", data)[0]
            return len(told) == 2

        until(client, emergency)
        syncs = []
        end = time.monotonic() + 1
        while time.monotonic() < end:
            client.wait(0.1)
            syncs += [can_id for _, can_id, _, _ in client.receive() if can_id == 0x080]
    assert set(told.values()) <= {0x8130, 0x8250, 0x8700}
    assert not syncs


def test_it_runs_again_after_all_that(sim, interface):
    with host(interface, *SETS, seconds=0.5) as run:
        status, data, err = result(run)
    assert status == 0, (err, data and data["trip"])
    assert INTERFACES
