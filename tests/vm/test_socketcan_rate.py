"""The bench rig at its own 1 kHz and with its own limits on Linux's own CAN, in a machine whose
clock is steady: COULOMBUS_TEST_STEADY=1.

Without a hand on the handle nothing has a dead man's switch. The figures are printed: what an
emulated processor takes for a cycle says nothing about a real one, but that no PDO is lost from
bring-up to the end does.
"""

from __future__ import annotations

import signal
import struct
import subprocess
import threading
import time

import pytest

from coulombus.recording.reading import read
from coulombus.wire.client import BusFull, BusUnavailable, pack_frame
from vm_host import NO_SWITCH, STEADY, enabled, host, observer, result, until
from vm_interfaces import INTERFACES

pytestmark = [pytest.mark.real_time, STEADY]

STOPPED = {0x8130, 0x8250, 0x8700}
"""EMCY codes of a node whose host is gone: heartbeat, set-point's age, SYNC."""


@pytest.fixture(scope="module")
def sim(start_sim):
    return start_sim()


def told(run):
    """Return what a run came to, and print its figures."""
    status, data, err = result(run)
    if data and "cycles" in data:
        times = ("wakeup_us", "sync_to_rpdo_us")
        latencies = ", ".join(f"{name} {'/'.join(f'{us:.0f}' for us in data[name].values())}" for name in times)
        counts = ", ".join(f"{data[name]} {name}" for name in ("cycles", "lost_pdos", "missed_deadlines"))
        print(f"\n{','.join(INTERFACES)} {data['mode']}: {counts}, {latencies}, trip {data['trip']}")
    return status, data, err


@pytest.mark.parametrize("mode", ["passive", "active", "hybrid"])
def test_no_pdo_is_lost_from_bring_up_to_the_end(sim, interface, mode, tmp_path):
    seconds = 4.0 if mode == "hybrid" else 1.0
    record = tmp_path / "r.pcapng"
    with host(interface, *NO_SWITCH, "--record", record, mode=mode, seconds=seconds) as run:
        status, data, err = told(run)
    assert status == 0, (err, data and data["trip"])
    assert data["period_ns"] == 1_000_000
    assert data["cycles"] >= 1000 * seconds
    assert data["lost_pdos"] == 0
    frames = read(record).frames
    assert (frames["can_id"] == 0x181).sum() >= data["cycles"]
    if mode == "hybrid":
        assert data["hold_counts_p2p"] == 0


def test_a_flood_of_unknown_identifiers_loses_nothing(sim, interface):
    over = threading.Event()

    def flood():
        with observer(interface) as client:
            while not over.wait(0.005):
                for _ in range(5):
                    try:
                        client.send(pack_frame(0x7F0, b"\xaa" * 8))
                    except (BusFull, BusUnavailable):
                        break

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        with host(interface, *NO_SWITCH, mode="passive", seconds=2) as run:
            status, data, err = told(run)
    finally:
        over.set()
        thread.join()
    assert status == 0, (err, data and data["trip"])
    assert data["lost_pdos"] == 0


def test_the_interface_goes_down_and_it_runs_again(sim, interface):
    with observer(interface) as client, host(interface, *NO_SWITCH, mode="active", seconds=30) as run:
        until(client, enabled, run)
        try:
            subprocess.run(["ip", "link", "set", interface, "down"], check=True)
            status, data, err = told(run)
        finally:
            subprocess.run(["ip", "link", "set", interface, "up"], check=True)
    assert status == 7, err
    assert data["trip"].split(":")[0] in ("BUS_LOST", "TPDO_LOST")  # whichever the host sees first
    with host(interface, *NO_SWITCH, seconds=1) as run:
        status, data, err = told(run)
    assert status == 0, (err, data and data["trip"])


def test_a_killed_host_leaves_nodes_that_are_safe(sim, interface):
    with observer(interface) as client, host(interface, *NO_SWITCH, mode="hybrid", seconds=30) as run:
        until(client, enabled, run)
        run.send_signal(signal.SIGKILL)
        run.wait()
        codes, torque = {}, []

        def emergency(can_id, data):
            if can_id in (0x81, 0x82) and struct.unpack_from("<H", data)[0]:
                codes[can_id] = struct.unpack_from("<H", data)[0]
            if can_id == 0x181:
                torque.append(data)
            return len(codes) == 2

        until(client, emergency)
        end, syncs = time.monotonic() + 0.5, 0
        while time.monotonic() < end:
            client.wait(0.1)
            syncs += sum(can_id == 0x080 for _, can_id, _, _ in client.receive())
    assert set(codes.values()) <= STOPPED
    assert not syncs


def test_a_node_that_is_powered_off_and_a_sim_that_is_killed_trip_the_host(start_sim, sim, interface, tmp_path):
    """Both in a sim of their own: the one before ends here."""
    sim.process.terminate()
    sim.wait()
    script = tmp_path / "off.toml"
    script.write_text(
        "".join(
            f'[[at]]\nt_s = {t_s}\nnode = "brake"\naction = "{action}"\nafter = "enabled"\n'
            for t_s, action in ((0.5, "power_off"), (1.5, "power_on"))
        )
    )
    other = start_sim("--script", script)
    with observer(interface) as client:
        with host(interface, *NO_SWITCH, mode="hybrid", seconds=30) as run:
            until(client, enabled, run)
            until(client, lambda can_id, data: can_id == 0x702 and data == b"\0")  # read meanwhile: the queue is short
            status, data, err = told(run)
        assert status == 7, err
        assert data["trip"].startswith("TPDO_LOST")
    with observer(interface) as client, host(interface, *NO_SWITCH, mode="active", seconds=30) as run:
        until(client, enabled, run)
        other.process.kill()
        status, data, err = told(run)
    assert status == 7, err
    assert data["trip"].split()[0].strip(":") in ("TPDO_LOST", "HEARTBEAT_LOST")
