"""A program that sends anything to a display in real time: what the bus carries stays within the rig's limits."""

from __future__ import annotations

import os
import random
import select
import signal
import socket
import struct
import time
from contextlib import suppress
from itertools import pairwise

import pytest

from coulombus import load_rig
from coulombus.host.world.hand import NoWorld, connect, world_path
from coulombus.host.world.model_check import ModelRefused
from coulombus.host.world.model_parts import Wall
from coulombus.host.world.protocol import Greeting
from coulombus.host.world.state import RUN
from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.wire.address import parse_address
from real_bench import PATIENCE_S, Observer, host, result, simulation
from world_fuzz import Fuzz

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.slow,
    pytest.mark.usefixtures("private_sockets"),
    pytest.mark.skipif(JIT_DISABLED, reason="plain Python is no real-time loop"),
]
BUS = "coulombus:f"
SEED = 20261127
MOTOR_NM, RATE_NM_S, BRAKE_NM, FALL_NM_S = 1.0, 200.0, 3.0, 400.0
PERIOD_S = 0.001
LIMITS = (
    f"mode.hybrid.motor_limit_Nm={MOTOR_NM}",
    f"limits.torque_rate_Nm_s={RATE_NM_S}",
    f"limits.brake_torque_Nm={BRAKE_NM}",
    f"limits.brake_fall_Nm_s={FALL_NM_S}",
    "mode.hybrid.F_s_Nm=2.5",
    "mode.hybrid.F_d_Nm=2.0",
)
NO_TRIPS = ("limits.speed_rad_s=1000", "limits.net_work_J=1e6", "limits.handle_mismatch_Nm=100")
"""Random pushes do what no hand does: these monitors would end the run."""
BRAKE_NM_RAW = 0.001


class Sender:
    """A program that has control and sends models at random, and others that send rubbish beside it."""

    def __init__(self, hand):
        self._rng = random.Random(SEED)
        self._fuzz = Fuzz(self._rng, hand.welcome.longest_life_ns, hand.parameters)
        self._program = self._connected(Greeting(flags=0).record())

    def _connected(self, data):
        program = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        program.settimeout(PATIENCE_S)
        program.connect(str(world_path(parse_address(BUS))))
        program.sendall(data)
        return program

    def send(self, sequence):
        """Send a message; every tenth over a connection of its own, which the server ends."""
        if sequence % 10 == 0:
            with suppress(ConnectionError), self._connected(self._fuzz.rubbish(sequence)) as program:
                program.shutdown(socket.SHUT_WR)
                while program.recv(1 << 16):
                    pass
            return
        message = self._fuzz.model if self._rng.random() < 0.5 else self._fuzz.garbled
        self._program.sendall(message(sequence))
        if select.select([self._program], [], [], 0)[0]:
            assert self._program.recv(1 << 16)  # refusals

    def close(self):
        self._program.close()


def running(run):
    """Return a hand at the display, as soon as that runs."""
    deadline = time.monotonic() + PATIENCE_S
    while run.poll() is None and time.monotonic() < deadline:
        try:
            hand = connect(BUS, timeout_s=PATIENCE_S)
        except NoWorld:
            os.sched_yield()
            continue
        if any(state.phase == RUN for state in hand):
            return hand
    raise AssertionError(run.communicate()[1])


def displayed(hand):
    """Render a wall as soon as control is free; return the state of its first cycle."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        try:
            number = hand.render(Wall(x_rad=-10.0, K_Nm_rad=2.0), law=0.0)
            return next(state for state in hand if state.model == number)
        except ModelRefused as refused:
            if "has control" not in str(refused):
                raise
    raise AssertionError("control does not become free")


def setpoints(log, can_id):
    """Return stamp and last two bytes of each RPDO: the motor's torque, or the brake's."""
    return [(stamp, struct.unpack_from("<h", data, len(data) - 2)[0]) for stamp, sent, data in log if sent == can_id]


def changes(points):
    """Return the values of two cycles in a row; the observer may have lost frames between others."""
    within_s = 1.5 * PERIOD_S
    return [(before, after) for (t1, before), (t2, after) in pairwise(points) if t2 - t1 < within_s]


@pytest.mark.parametrize(
    "messages",
    [3000, pytest.param(10_000, marks=pytest.mark.thorough), pytest.param(100_000, marks=pytest.mark.long)],
)
def test_random_messages_leave_the_bus_within_the_limits_and_the_server_alive(messages):
    overrides = (*LIMITS, *NO_TRIPS)
    axis = load_rig("bench", LIMITS).axes[0]
    motor_Nm_raw = axis.motor.rated_torque_Nm / 1000 * axis.mechanics.ratio
    run_of = host(BUS, "--world", overrides=overrides, seconds=2 * PATIENCE_S)
    with simulation(BUS, overrides=overrides), run_of as run, Observer(BUS) as bus:
        hand = running(run)
        sender = Sender(hand)
        bus.look()
        bus.log.clear()
        try:
            for sequence in range(1, messages + 1):
                sender.send(sequence)
                if sequence % 20 == 0:
                    bus.look()
                    assert hand.state.phase == RUN, result(run)
        except (OSError, NoWorld) as error:
            raise AssertionError(f"message {sequence}: {result(run)}") from error
        sender.close()
        bus.look()
        with hand:
            assert displayed(hand).phase == RUN
        run.send_signal(signal.SIGINT)
        _, data, err = result(run)
    assert data["trip"] is None, err

    motor, brake = setpoints(bus.log, 0x201), setpoints(bus.log, 0x202)
    most, rate = int(MOTOR_NM / motor_Nm_raw), RATE_NM_S * PERIOD_S / motor_Nm_raw + 1
    assert max(abs(value) for _, value in motor) == most  # reached, and never exceeded
    assert len(changes(motor)) > messages // 10
    # without a new position the motor has no torque
    assert all(after == 0 or abs(after - before) <= rate for before, after in changes(motor))
    most, fall = round(BRAKE_NM / BRAKE_NM_RAW), FALL_NM_S * PERIOD_S / BRAKE_NM_RAW + 1
    assert {min(value for _, value in brake), max(value for _, value in brake)} == {0, most}
    assert all(before - after <= fall for before, after in changes(brake))
