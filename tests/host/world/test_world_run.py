"""A world at a host in real time, on the built-in bus: what they do, never how fast."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from coulombus.host.run.control_socket import NotChanged, ask_change
from coulombus.host.world.hand import NoWorld, connect
from coulombus.host.world.model_parts import Wall
from coulombus.host.world.state import RUN
from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.lab.replay.host_replay import host_replay
from coulombus.recording.reading import read
from coulombus.wire.address import parse_address
from places import ROOT
from real_bench import PATIENCE_S, host, result, simulation

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.usefixtures("private_sockets"),
    pytest.mark.skipif(JIT_DISABLED, reason="plain Python is no real-time loop"),
]
BUS = "coulombus:r"
WORLD = """
from coulombus import Wall, connect
with connect("coulombus:r") as hand:
    hand.render(Wall(x_rad=-10.0, K_Nm_rad=2.0, B_Nms_rad=0.05), law=0.0, life_s=0.1)
    for state in hand:
        if state.share == 1.0:
            print("renders", flush=True)
"""


def connected(run):
    """Return a hand at the host, as soon as that lets a world in."""
    deadline = time.monotonic() + PATIENCE_S
    while run.poll() is None and time.monotonic() < deadline:
        try:
            return connect(BUS, timeout_s=PATIENCE_S)
        except NoWorld:
            os.sched_yield()
    raise AssertionError(run.communicate()[1])


def test_a_world_displays_a_wall_and_sees_each_cycle(tmp_path):
    record = tmp_path / "w.pcapng"
    with simulation(BUS), host(BUS, "--world", "--record", record, seconds=4) as run, connected(run) as hand:
        hand.render(Wall(x_rad=-10.0, K_Nm_rad=2.0, B_Nms_rad=0.05), law=0.0)
        states = []
        for state in hand:
            if state.share == 1.0 and not states:
                with pytest.raises(NotChanged, match="has control"):
                    ask_change(parse_address(BUS), {"values": {"F_s_Nm": 2.0}})
            states.append(state)
        status, data, err = result(run)
    assert status == 0, err
    assert data["trip"] is None
    first, last = states[0], states[-1]
    assert len(states) + last.lost == last.sequence - first.sequence + 1
    rendered = [state for state in states if state.phase == RUN and state.share == 1.0]
    assert len(rendered) > 1000
    assert min(state.world_Nm for state in rendered) < -0.01
    replayed = host_replay(record)
    assert (replayed.difference, replayed.judged) == (None, True)
    assert read(record)["host.world_share"].values.max() == 1.0


def test_the_model_of_a_killed_world_fades_and_the_run_goes_on():
    with simulation(BUS), host(BUS, "--world", seconds=6) as run, connected(run) as hand:
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        world = subprocess.Popen(
            [sys.executable, "-c", WORLD], stdout=subprocess.PIPE, text=True, env=environment, cwd=ROOT
        )
        assert world.stdout is not None
        assert world.stdout.readline() == "renders\n"
        world.send_signal(signal.SIGKILL)
        world.wait()
        world.stdout.close()
        fading = False
        for state in hand:
            if state.share == 1.0:
                last = state
            fading = fading or 0.0 < state.share < 1.0
            if fading and state.share == 0.0:
                break
        assert 150 < state.sequence - last.sequence < 250  # 200 cycles of ramp
        assert state.phase == RUN
        hand.render(Wall(x_rad=-10.0, K_Nm_rad=1.0))  # control is free again
        assert next(state for state in hand if state.share == 1.0).phase == RUN
        status, data, err = result(run)
    assert status == 0, err
    assert data["trip"] is None


def test_without_the_option_no_world_is_let_in():
    with simulation(BUS), host(BUS, seconds=1) as run:
        status, _, err = result(run)
        with pytest.raises(NoWorld):
            connect(BUS)
    assert status == 0, err
