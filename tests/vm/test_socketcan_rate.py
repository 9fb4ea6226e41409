"""1 kHz on Linux's own CAN, at the bench rig's own limits.

In a guest whose time advances by executed instructions (COULOMBUS_TEST_STEADY): on another machine
with an emulated processor a cycle does not keep its time. One sim serves all tests, in their order:
its script strikes the first run, and the last one ends it.
"""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from functools import partial

import pytest

from coulombus.wire.client import BusFull, BusUnavailable, pack_frame
from vm_host import emergencies, enabled, observer, result, running, until

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.skipif("COULOMBUS_TEST_STEADY" not in os.environ, reason="no COULOMBUS_TEST_STEADY: no steady guest"),
]

host = partial(running, mode="hybrid", seconds=60)
NO_SWITCH = ("--set", 'host.deadman="none"')
OFF_AND_ON = """
[[at]]
t_s = 0.5
node = "brake"
action = "power_off"
after = "enabled"
[[at]]
t_s = 1.5
node = "brake"
action = "power_on"
after = "enabled"
"""
FLOOD_FRAMES = 4
"""A millisecond: with the 5 of a cycle some 1,000 us of a real bus at 1 Mbit/s."""


@pytest.fixture(scope="module")
def sim(start_sim, tmp_path_factory):
    script = tmp_path_factory.mktemp("sim") / "off_and_on.toml"
    script.write_text(OFF_AND_ON, encoding="utf-8")
    return start_sim("--script", script)


def test_a_node_goes_off_in_mid_run(sim, interface):
    with host(interface, *NO_SWITCH) as run:
        status, data, err = result(run)
    assert status == 7, err
    assert data["trip"].split(":")[0] in ("TPDO_LOST", "EMCY", "HEARTBEAT_LOST"), data["trip"]


@pytest.mark.parametrize(("mode", "seconds"), [("hybrid", 3.0), ("active", 1.0), ("passive", 1.0)])
def test_no_pdo_is_lost_from_bring_up_to_the_end(sim, interface, mode, seconds):
    with host(interface, *NO_SWITCH, mode=mode, seconds=seconds) as run:
        status, data, err = result(run)
    assert data is not None, err
    figures = ("cycles", "missed_deadlines", "lost_pdos", "wakeup_us", "sync_to_rpdo_us", "hold_counts_p2p")
    print(f"\n{interface}, {mode}, 1 kHz:", {name: data[name] for name in figures})
    assert status == 0, (err, data["trip"])
    assert data["cycles"] >= 1000 * seconds
    assert data["lost_pdos"] == data["missed_deadlines"] == 0
    assert data["hold_counts_p2p"] in ((0, None) if mode == "hybrid" else (data["hold_counts_p2p"],))


def test_the_host_is_killed_under_a_flood(sim, interface):
    over = threading.Event()
    with observer(interface) as client, observer(interface) as flooder, host(interface, *NO_SWITCH) as run:

        def flood():
            while not over.wait(0.001):
                for _ in range(FLOOD_FRAMES):
                    try:
                        flooder.send(pack_frame(0x7F0, b"\xaa" * 8))
                    except (BusFull, BusUnavailable):
                        break

        until(client, enabled, run)
        thread = threading.Thread(target=flood)
        thread.start()
        end = time.monotonic() + 0.5
        try:
            until(client, lambda can_id, data: can_id == 0x201 and time.monotonic() > end, run)
        finally:
            over.set()
            thread.join()
        assert run.poll() is None, result(run)
        run.send_signal(signal.SIGKILL)
        run.wait()
        told = emergencies(client)
    assert set(told.values()) <= {0x8130, 0x8250, 0x8700}


def test_the_interface_goes_down_in_mid_run(sim, interface):
    with observer(interface) as client, host(interface, *NO_SWITCH) as run:
        until(client, enabled, run)
        try:
            subprocess.run(["ip", "link", "set", interface, "down"], check=True)
            status, data, err = result(run)
        finally:
            subprocess.run(["ip", "link", "set", interface, "up"], check=True)
    assert status == 7, err
    assert data["trip"].startswith("BUS_LOST")


def test_it_runs_again_and_the_sim_is_killed(sim, interface):
    with observer(interface) as client, host(interface, *NO_SWITCH) as run:
        until(client, enabled, run)
        sim.process.send_signal(signal.SIGKILL)
        status, data, err = result(run)
    assert status == 7, err
    assert data["trip"].startswith("TPDO_LOST")
