"""`coulombus run`, `stop` and the demo in real time, on the built-in bus: what they do, never how
fast.
"""

from __future__ import annotations

import json
import os
import pty
import signal
import socket
import subprocess
import threading
import time

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.lab.replay.host_replay import host_replay
from coulombus.recording.reading import read
from coulombus.rigs.overrides import SHARED_MACHINE
from coulombus.wire.client import pack_frame
from real_bench import HOLD, PATIENCE_S, Observer, command, host, result, simulation, start

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.usefixtures("private_sockets"),
    pytest.mark.skipif(JIT_DISABLED, reason="plain Python is no real-time loop"),
]
BUS = "coulombus:r"


def test_a_run_is_recorded_and_measured(tmp_path):
    """Hybrid, with sign check, through the hold.

    The recording gives the same figures as in virtual time.
    """
    record, picture = tmp_path / "r.pcapng", tmp_path / "h.png"
    overrides = (f"phase={HOLD}",)
    with (
        simulation(BUS, overrides=overrides),
        host(BUS, "--record", record, "--histogram", picture, seconds=3.5, overrides=overrides) as run,
    ):
        status, data, err = result(run)
    assert status == 0, err
    assert data["trip"] is None
    assert data["sign_check"] == "agreed"
    assert data["hold_counts_p2p"] <= 2
    assert data["hold_push_Nm"] > 1.0
    assert 1000 < data["cycles"] <= 3600
    assert data["wakeup_us"]["p50"] <= data["wakeup_us"]["p99"] <= data["wakeup_us"]["max"]
    assert data["sync_to_rpdo_us"]["p50"] > 100  # three TPDOs take more than that on the wire
    assert data["cpu_us_per_cycle"] > 0
    assert {right["name"] for right in data["real_time"]} >= {"timer slack", "SCHED_FIFO"}
    assert data["deadman"] == "none"
    assert data["bus"] == BUS
    assert picture.stat().st_size > 5000

    recording = read(record)
    found = list(recording.frames["can_id"])
    assert found.count(0x201) == pytest.approx(found.count(0x080), abs=5)
    assert {0x000, 0x601, 0x581, 0x602, 0x701, 0x77F} <= set(found)  # the control plane's frames too
    texts = [text for _, text in recording.markers]
    assert texts[:4] == ["run hybrid", "deadman none", "phase rest", "phase hold"]
    assert texts[4:] == ["phase end", "safe"]
    assert recording["motor.target_torque_Nm"].values[-1] == 0
    assert recording["brake.setpoint_Nm"].values[-1] == 0
    assert list(recording.frames["t_ns"]) == sorted(recording.frames["t_ns"])

    again = host_replay(
        record
    )  # the controller on the recorded inputs: bit for bit, the safe set-points at the end included
    assert (again.difference, again.unchecked, again.computed_trip) == (None, 0, None)
    assert again.frames["motor.RPDO1"] + again.refused >= found.count(0x201)
    assert again.frames["SYNC"] == found.count(0x080)


def stop_by_signal(number):
    def stop(run, observer):
        run.send_signal(number)

    return stop


def stop_by_command(run, observer):
    with subprocess.Popen(
        command("stop", "--bus", BUS), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as done:
        while done.poll() is None:  # who does not read for more than a second loses frames
            observer.watch(0.05)
        out, err = done.communicate()
    assert done.returncode == 0, err
    assert "stopped safely after" in out


@pytest.mark.parametrize(
    ("how", "status", "by"),
    [
        (stop_by_signal(signal.SIGINT), 130, "SIGINT"),
        (stop_by_signal(signal.SIGTERM), 143, "SIGTERM"),
        (stop_by_signal(signal.SIGHUP), 129, "SIGHUP"),
        (stop_by_signal(signal.SIGQUIT), 131, "SIGQUIT"),
        (stop_by_command, 0, "coulombus stop"),
    ],
    ids=["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "coulombus stop"],
)
def test_it_is_stopped_safely(how, status, by):
    """Also as a shell's background job, which is started with SIGINT ignored."""
    with (
        simulation(BUS, mode="passive"),
        Observer(BUS) as observer,
        host(BUS, mode="passive", background=True) as run,
    ):
        observer.until_enabled(run)
        observer.watch(0.2)
        how(run, observer)
        got, data, err = result(run)
        observer.watch(0.1)
    assert got == status, err
    assert data["stopped_by"] == by
    assert data["trip"] is None
    rpdos = [d for _, can_id, d in observer.log if can_id == 0x201]
    assert rpdos[-1] == b"\0\0\0\0"  # disabled, without torque
    assert [d for _, can_id, d in observer.log if can_id == 0x202][-1] == b"\0\0"
    codes = {code for node in (1, 2) for _, code in observer.emcys(node)}
    assert codes <= {0x8130}  # neither SYNC nor set-points are missed, the heartbeat may be


def test_one_host_at_a_time():
    """The second hears of the first at its door."""
    with (
        simulation(BUS, mode="passive"),
        Observer(BUS) as observer,
        host(BUS, mode="passive") as first,
    ):
        observer.until_cycling(first)
        with host(BUS, mode="passive") as second:
            status, data, err = result(second)
        assert status == 7, err
        assert data["event"] == "error"
        assert "another host runs" in err
        assert first.poll() is None


def test_a_host_elsewhere_is_heard():
    """By its heartbeat (or its SYNC), which need not come from this machine.

    Its nodes are left alone.
    """
    over = threading.Event()
    with simulation(BUS, mode="passive"), Observer(BUS) as observer, host(BUS, mode="passive") as second:

        def beat():
            while not over.is_set():
                observer.client.send(pack_frame(0x77F, b"\x05"))
                time.sleep(0.05)

        thread = threading.Thread(target=beat)
        thread.start()
        status, _, err = result(second)
        over.set()
        thread.join()
        observer.look()
    assert status == 7, err
    assert "the heartbeat of node 127 was heard" in err
    assert 0x000 not in {can_id for _, can_id, _ in observer.log}


def test_without_a_bus_and_without_nodes(tmp_path):
    with host(BUS) as run:
        status, _, err = result(run)
    assert status == 4
    assert "coulombus emulate" in err
    done = subprocess.run(command("stop", "--bus", BUS), capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 4
    off = tmp_path / "off.toml"
    off.write_text('[[at]]\nt_s = 0.0\nnode = "brake"\naction = "power_off"\n')
    with simulation(BUS, "--script", off), host(BUS) as run:
        status, data, err = result(run)
    assert status == 5
    assert "brake (node 2)" in err
    assert (data["event"], data["exit_status"]) == ("error", 5)
    assert "brake (node 2)" in data["error"]


def test_a_signal_before_anything_is_armed():
    with simulation(BUS), Observer(BUS) as observer, host(BUS) as run:
        observer.until(run, lambda can_id, data: can_id == 0x000)  # bring-up has begun
        run.send_signal(signal.SIGTERM)
        status, data, _ = result(run)
        observer.watch(0.1)
    assert status == 143
    assert data.get("cycles", 0) == 0
    assert all(data[0] == 0x80 for _, can_id, data in observer.log if can_id == 0x000)  # PRE-OPERATIONAL, never started


def test_the_space_bar_as_dead_mans_switch():
    """Armed while it repeats; let go, the rig stops."""
    ours, theirs = pty.openpty()
    over = threading.Event()

    def hold():
        while not over.wait(0.03):
            os.write(ours, b" ")

    thread = threading.Thread(target=hold)
    with (
        simulation(BUS, mode="passive"),
        Observer(BUS) as observer,
        host(BUS, mode="passive", overrides=("host.deadman=key",), stdin=theirs) as run,
    ):
        observer.until(run, lambda can_id, data: can_id == 0x000 and data[0] == 1)
        observer.watch(0.5)
        assert 0x080 not in {can_id for _, can_id, _ in observer.log}  # not held: no cycle
        thread.start()
        observer.until_enabled(run)
        observer.watch(0.5)
        over.set()
        status, data, err = result(run)
    thread.join()
    os.close(ours)
    os.close(theirs)
    assert status == 7, err
    assert data["trip"].startswith("DEADMAN")
    assert "hold the space bar" in err


def test_a_socket_as_dead_mans_switch(tmp_path):
    """Armed while its client speaks; the client is gone, and the rig stops."""
    over = threading.Event()
    with (
        simulation(BUS, mode="passive"),
        Observer(BUS) as observer,
        host(BUS, mode="passive", overrides=(f"host.deadman=socket:{tmp_path}/hand",)) as run,
    ):
        observer.until(run, lambda can_id, data: can_id == 0x000 and data[0] == 1)
        observer.watch(0.5)
        assert 0x080 not in {can_id for _, can_id, _ in observer.log}  # not held: no cycle

        def hold():
            with socket.socket(socket.AF_UNIX) as hand:
                hand.connect(f"{tmp_path}/hand")
                while not over.wait(0.01):
                    hand.send(b"x")

        thread = threading.Thread(target=hold)
        thread.start()
        observer.until_enabled(run)
        observer.watch(0.5)
        over.set()
        thread.join()
        status, data, err = result(run)
    assert status == 7, err
    assert data["trip"].startswith("DEADMAN")
    assert "keep the socket of host.deadman alive" in err
    assert not (tmp_path / "hand").exists()


def test_no_switch_no_torque_on_a_real_interface():
    with host("socketcan:can0", mode="active") as run:
        status, _, err = result(run)
    assert status == 7
    assert "host.deadman" in err


@pytest.mark.thorough
def test_the_demo(tmp_path):
    """The whole of it with a short schedule: two simulations, two hosts, verdict, figure."""
    phase = HOLD.replace("20.0", "2.6")
    process = start("demo", "--out", tmp_path / "demo", "--json", "--set", f"phase={phase}")
    out, err = process.communicate(timeout=PATIENCE_S)
    found = json.loads(out)
    assert found["active"]["trip"] is None, found
    assert found["hybrid"]["trip"] is None, found
    assert process.returncode == 0, found["criteria"]
    assert found["active"]["wakeup_us"]["p50"] > 0
    for override in SHARED_MACHINE:
        assert f"--set {override}" in err
    assert {path.name for path in (tmp_path / "demo").iterdir()} >= {
        *("active.pcapng", "hybrid.pcapng", "demo.json", "demo.png", "active-timing.png")
    }


def test_parameters_are_changed_while_the_law_displays_and_replayed(tmp_path):
    """Bit for bit, from the recording alone; what is refused changes nothing."""
    record, overrides = tmp_path / "r.pcapng", (f"phase={HOLD}",)
    calls = ("F_s=2.5 F_d=2.0 --over 0.2s", "K_p=500", "F_s=999", "--undo")
    with (
        simulation(BUS, overrides=overrides),
        host(BUS, "--record", record, seconds=60, overrides=overrides) as run,
        Observer(BUS) as observer,
    ):
        observer.until(run, lambda can_id, data: can_id == 0x202 and int.from_bytes(data, "little") > 100)
        done = [CliRunner().invoke(main, ["set", *words.split(), "--bus", BUS]) for words in (*calls, "--json")]
        assert CliRunner().invoke(main, ["stop", "--bus", BUS]).exit_code == 0
        ended, data, err = result(run)
    assert (ended, data["trip"]) == (0, None), err
    assert [one.exit_code for one in done] == [0, 0, 2, 0, 0]
    wanted = {row["name"]: row["value"] for row in json.loads(done[-1].stdout)["parameters"][0]}
    assert wanted == {"K_p_Nm_rad": 10000.0, "F_s_Nm": 2.5, "F_d_Nm": 2.0, "compensation": 0.97}
    told = [text.partition(" [")[0] for _, text in read(record).markers if text.startswith("set ")]
    assert told == [
        "set F_s_Nm 3.5 -> 2.5 Nm, F_d_Nm 3 -> 2 Nm in 0.4 s",
        "set K_p_Nm_rad 10000 -> 500 Nm/rad in 0.5 s",
        "set K_p_Nm_rad 500 -> 10000 Nm/rad in 0.5 s (undo)",
    ]
    again = host_replay(record)
    assert (again.difference, again.unchecked, again.computed_trip) == (None, 0, None)
