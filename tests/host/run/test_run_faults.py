"""Faults in real time on the built-in bus: whatever dies, the rig becomes safe by those who live.

Function is asserted, never speed.
"""

from __future__ import annotations

import ctypes
import json
import os
import resource
import shutil
import signal
import threading
import time
from types import SimpleNamespace

import pytest

from coulombus.explain.explained import explain
from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.recording.reading import read
from coulombus.wire.client import BusFull, pack_frame
from real_bench import HOLD, PATIENCE_S, STROKE, Observer, children, gone, host, result, simulation

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.usefixtures("private_sockets"),
    pytest.mark.skipif(JIT_DISABLED, reason="plain Python is no real-time loop"),
]
BUS = "coulombus:r"
SLOW = ("setpoint_fault_s", "sync_timeout_s")
ZERO_PM = 10  # 6077, per mille of rated torque
EMCY_S = 0.1


@pytest.mark.parametrize(
    ("mode", "phase", "victim"),
    [("hybrid", STROKE, "host"), ("active", HOLD, "host"), ("active", HOLD, "data plane")],
    ids=["stroke", "active hold", "active hold, data plane alone"],
)
def test_the_host_is_killed(mode, phase, victim):
    """With its data plane: both nodes save themselves.

    When the data plane dies alone, the host saves them.
    """
    overrides = (f"phase={phase}",)
    with (
        simulation(BUS, mode=mode, overrides=overrides),
        Observer(BUS) as observer,
        host(BUS, mode=mode, overrides=overrides) as run,
    ):
        observer.until_enabled(run)
        observer.watch(1.7)
        assert run.poll() is None, result(run)
        (plane,) = children(run.pid)
        os.kill(plane, signal.SIGKILL)
        if victim == "host":
            os.kill(run.pid, signal.SIGKILL)
        samples = []
        begin = time.monotonic()
        while time.monotonic() - begin < 1.2:
            samples.append((*observer.upload(1, 0x6077), *observer.upload(2, 0x7130, 2)))
            observer.watch(0.02)
        if victim == "data plane":
            status, data, err = result(run)
            assert status == 7, err
            assert data["trip"].endswith("(it was ended by signal 9: Killed)")
            assert data["trip"].startswith("DATA_PLANE")
        assert gone(plane)
        observer.watch(0.3)
        last_sync = observer.last(0x080)
        observer.watch(0.2)
        assert observer.last(0x080) == last_sync  # no orphan sends SYNC
    for node in (1, 2):
        first = min(stamp for stamp, _ in observer.emcys(node) if stamp > last_sync)
        assert {code for _, code in observer.emcys(node)} <= {0x8130, 0x8250, 0x8700}
        if victim == "host":
            assert first - last_sync <= EMCY_S
    if victim == "data plane":  # the host has sent both nodes to PRE-OPERATIONAL
        stopped = [stamp for stamp, can_id, data in observer.log if can_id == 0x000 and data == b"\x80\x00"]
        assert stopped[-1] > last_sync
    torque = [pm for stamp, pm, _, _ in samples if stamp > last_sync + EMCY_S]
    assert torque
    assert max(map(abs, torque)) <= ZERO_PM
    coil = [
        raw for _, _, stamp, raw in samples if stamp > last_sync + 0.1
    ]  # from where the set-point is held no longer
    assert coil[-1] == 0
    if mode == "hybrid":
        assert coil[0] > 0
        assert coil == sorted(coil, reverse=True)
        assert len(set(coil)) > 5  # ramped, not dropped


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_parent_alone_dies_or_stands_still(number):
    """The data plane goes to the safe state: torque 0 and the drive disabled while SYNC goes on.

    After a dead parent it ends, too.
    """
    overrides = (f"phase={HOLD}",)
    with (
        simulation(BUS, mode="active", overrides=overrides),
        Observer(BUS) as observer,
        host(BUS, mode="active", overrides=overrides) as run,
    ):
        observer.until_enabled(run)
        observer.watch(1.7)
        (plane,) = children(run.pid)
        os.kill(run.pid, number)
        try:
            disabled = observer.until(
                SimpleNamespace(poll=lambda: None), lambda can_id, data: can_id == 0x201 and data == bytes(4)
            )
            observer.watch(0.5)
            assert observer.last(0x080) > disabled  # it was still cycling
            assert {data for stamp, can_id, data in observer.log if can_id == 0x201 and stamp > disabled} == {bytes(4)}
            if number == signal.SIGKILL:
                observer.watch(1.0)
                assert gone(plane)
            else:
                os.kill(run.pid, signal.SIGCONT)
                status, data, err = result(run)
                assert status == 7, err
                assert data["trip"].startswith("HOST")
                assert data["trip"].endswith("(it hung for 2 s)")
        finally:
            run.kill()


@pytest.mark.parametrize(
    ("victim", "number", "trips"),
    [
        ("data plane", signal.SIGKILL, ("trip DATA_PLANE",)),
        ("data plane", signal.SIGSTOP, ("trip DATA_PLANE",)),
        ("parent", signal.SIGKILL, ("trip HOST",)),
        ("bus", signal.SIGKILL, ("trip BUS_LOST", "trip TPDO_LOST")),
        ("wire", None, ("trip BUS_LOST", "trip TPDO_LOST")),
    ],
)
def test_the_last_marker_of_the_recording_is_the_trip(tmp_path, victim, number, trips):
    """Each process in turn: who lives writes it. It was lost where no frame followed."""
    stuck = tmp_path / "stuck.toml"
    stuck.write_text('[[fault]]\nkind = "stuck_dominant"\nafter = "enabled"\nat_s = 0.3\n')
    path = tmp_path / "r.pcapng"
    faults = ("--faults", stuck) if victim == "wire" else ()
    with simulation(BUS, *faults) as sim, Observer(BUS) as observer, host(BUS, "--record", path) as run:
        observer.until_enabled(run)
        (plane,) = children(run.pid)
        if number is not None:
            os.kill({"data plane": plane, "parent": run.pid, "bus": sim.pid}[victim], number)
        assert result(run)[0] == (-signal.SIGKILL if victim == "parent" else 7)
        deadline = time.monotonic() + PATIENCE_S
        while not gone(plane) and time.monotonic() < deadline:
            observer.watch(0.02)
    _, marker = read(path).markers[-1]
    assert marker.startswith(trips)
    clues = [clue for incident in explain(path).incidents for clue in incident.clues]
    assert [clue for clue in clues if clue.kind == "host_trip"]


def test_a_recording_folder_that_is_removed_is_a_trip_at_once(tmp_path):
    folder = tmp_path / "runs"
    folder.mkdir()
    with simulation(BUS), Observer(BUS) as observer, host(BUS, "--record", folder / "r.pcapng") as run:
        observer.until_enabled(run)
        shutil.rmtree(folder)
        status, data, err = result(run)
    assert status == 7, err
    assert data["trip"].startswith(f"RECORDING: {folder / 'r.pcapng'}")
    assert data["cycles"] < 15_000  # half of the display at most


def test_the_bus_is_killed_and_comes_back():
    """The host trips; a new bus takes the dead one's place; a new run arms, with its sign check."""
    with simulation(BUS) as sim, Observer(BUS) as observer, host(BUS) as run:
        observer.until_enabled(run)
        observer.watch(0.3)
        sim.kill()
        status, data, err = result(run)
    assert status == 7, err
    assert data["trip"].startswith(("BUS_LOST", "TPDO_LOST"))  # a large process takes a while to die
    with simulation(BUS), host(BUS, seconds=1.2) as run:
        status, data, err = result(run)
    assert status == 0, err
    assert data["sign_check"] == "agreed"


@pytest.mark.parametrize("node", ["motor", "brake"])
def test_a_node_loses_its_power(tmp_path, node):
    script = tmp_path / "off.toml"
    script.write_text(f'[[at]]\nt_s = 0.5\nnode = "{node}"\naction = "power_off"\nafter = "enabled"\n')
    with (
        simulation(BUS, "--script", script, mode="passive"),
        Observer(BUS) as observer,
        host(BUS, mode="passive", seconds=8) as run,
    ):
        status, data, err = result(run)
        observer.look()
    assert status == 7, err
    assert data["trip"].startswith(("TPDO_LOST", f"HEARTBEAT_{node.upper()}"))
    assert data["cycles"] < 5000
    assert [d for _, can_id, d in observer.log if can_id == 0x201][-1] == b"\0\0\0\0"


def test_a_flood_of_unknown_identifiers():
    """At full bus load, of the lowest priority: the cycle goes on.

    The flood ends at the bus, by the filters. It keeps a processor busy, here where the cycle is.
    """
    over, slow = threading.Event(), [f"{one}.{key}=0.5" for one in ("motor", "brake") for key in SLOW]
    with simulation(BUS, mode="passive", overrides=slow), Observer(BUS) as observer, Observer(BUS) as flooder:

        def flood():
            message = b"".join(pack_frame(0x7F0 + i % 8, b"\xaa" * 8) for i in range(32))
            while not over.is_set():
                try:
                    flooder.client.send(message)
                except BusFull:
                    time.sleep(1e-3)
                flooder.look()
                flooder.log.clear()

        thread = threading.Thread(target=flood)
        with host(BUS, mode="passive", seconds=2.0, overrides=[*slow, "limits.missed_tpdo_cycles=500"]) as run:
            observer.until_enabled(run)
            thread.start()
            status, data, err = result(run)
        observer.look()
        over.set()
        thread.join()
    strange = sum(0x7F0 <= can_id <= 0x7F7 for _, can_id, _ in observer.log)
    assert strange > 2000
    assert status == 0, (err, data and data["trip"])
    assert data["counters"]["stray_frames"] < 100
    assert data["counters"]["rx_overflow"] == 0


def test_a_reader_that_does_not_read_harms_nobody():
    """The observer looks at nothing."""
    with simulation(BUS, mode="passive"), Observer(BUS), host(BUS, mode="passive", seconds=1.5) as run:
        status, data, err = result(run)
    assert status == 0, (err, data and data["trip"])


def test_the_disk_is_full(tmp_path):
    """The file may not grow any more in mid-run: safe stop; what was written stays readable."""
    record = tmp_path / "r.pcapng"
    with (
        simulation(BUS, mode="passive"),
        Observer(BUS) as observer,
        host(BUS, "--record", record, mode="passive") as run,
    ):
        observer.until_enabled(run)
        observer.watch(0.7)
        size = record.stat().st_size
        resource.prlimit(run.pid, resource.RLIMIT_FSIZE, (size + 100_000, resource.RLIM_INFINITY))
        status, data, err = result(run)
    assert status == 7, err
    assert data["trip"].startswith("RECORDING")
    assert "File too large" in data["trip"]
    assert len(read(record).frames) > 500
    assert record.stat().st_size <= size + 100_000


def test_no_file_can_be_opened_any_more():
    """The trip is told with its place, be there no descriptor for what prints the result."""
    with (
        simulation(BUS, mode="passive"),
        Observer(BUS) as observer,
        host(BUS, mode="passive") as run,
    ):
        observer.until_enabled(run)
        observer.watch(0.3)
        resource.prlimit(run.pid, resource.RLIMIT_NOFILE, (3, 3))
        status, data, err = result(run)
    assert status == 7, err
    assert data is None or "HOST: OSError: [Errno 24] Too many open files (" in data["trip"]
    assert data is not None or "trip: HOST: OSError: [Errno 24] Too many open files (" in " ".join(err.split())


def drop_capabilities():
    """Take the right to real time from what is executed next, whoever runs it."""
    library = ctypes.CDLL(None, use_errno=True)
    for capability in (23, 14):  # CAP_SYS_NICE, CAP_IPC_LOCK
        library.prctl(24, capability, 0, 0, 0)  # PR_CAPBSET_DROP
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (1 << 16, 1 << 16))


def test_without_real_time_rights():
    """It runs all the same, and says what was refused and how to get it."""
    with (
        simulation(BUS, mode="passive"),
        host(BUS, mode="passive", seconds=1.0, preexec_fn=drop_capabilities) as run,
    ):
        status, data, err = result(run)
    assert status == 0, (err, data and data["trip"])
    refused = {right["name"]: right["remedy"] for right in data["real_time"] if not right["granted"]}
    assert {"SCHED_FIFO", "locked memory"} <= set(refused)
    for name, remedy in refused.items():
        assert f"{name}: refused" in err
        assert remedy in err
    json.dumps(data)
