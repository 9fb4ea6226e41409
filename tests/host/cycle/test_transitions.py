"""The table of phases and the compiled step: every row happens, with each of its reasons, and
nothing else does.
"""

from __future__ import annotations

import math
import random
from functools import cache

import pytest

from coulombus.eds.cia402 import PowerState
from coulombus.host.cycle.records import Phase, SignResult, Trip
from coulombus.host.cycle.transitions import TRANSITIONS, allowed
from coulombus.host.laws.laws import compile_law
from host_bench import MS, HostBench


def no_number(motion, law, state):
    return math.nan


@cache
def no_number_law():
    return compile_law(no_number)


def still(bench, **fields):
    """Wait in STILL for the last cycle of the time that arming has."""
    bench.c.still_cycles, bench.h.still = 10, 0
    bench.h.phase_cycle = bench.c.still_timeout_cycles
    for name, value in fields.items():
        setattr(bench.h if name in ("still", "deadman_ok") else bench, name, value)


def checking(bench, moved, handle_Nm=0.0):
    """Be at the end of the sign check's ramp, the handle `moved` counts away."""
    c, h = bench.c, bench.h
    h.torque_Nm = min(c.sign_torque_Nm, c.motor_limit_raw * abs(c.motor_Nm_raw))
    h.handle_samples, h.handle_during_Nm = c.sign_hand_cycles - 1, (c.sign_hand_cycles - 1) * handle_Nm
    bench.counts += moved
    bench.handle_Nm = handle_Nm


def stuck(bench):
    checking(bench, 0)
    bench.h.sign_direction, bench.h.torque_Nm = -1, -bench.h.torque_Nm
    bench.h.still = bench.c.sign_hand_cycles


def late(bench):
    bench.h.phase_cycle = max(bench.c.still_timeout_cycles, bench.c.enable_timeout_cycles)


def settled(bench):
    bench.h.still, bench.h.torque_Nm = bench.c.settle_cycles, 0.0


def set_host(name, value):
    return lambda bench: setattr(bench.h, name, value)


def unheard(k):
    """Let node k be silent for long; the third is a sensor that the bench does not have."""

    def act(bench):
        bench.c.nodes, bench.c.heartbeat_timeout_ns[k], bench.h.nmt[k] = max(2, k + 1), 1, 5
        bench.h.heard_ns[k] = -(10**12)

    return act


def set_limit(name, value):
    return lambda bench: setattr(bench.c, name, value)


def hot(bench):
    bench.c.coil_limit_A2, bench.coil_A = 1e-6, 1.0


def mismatched(bench):
    bench.h.mismatch, bench.handle_Nm = bench.c.mismatch_cycles, 9.0


def worked(bench):
    bench.h.work_sum = 1.0


def unpowered(bench):
    bench.supply, bench.h.voltage_low = False, 1


ANYWHERE = {
    Trip.SPEED: set_limit("speed_limit", -1.0),
    Trip.ENCODER_JUMP: lambda bench: setattr(bench, "counts", bench.counts + 600),
    Trip.NET_WORK: worked,
    Trip.HANDLE_TORQUE: mismatched,
    Trip.TRAVEL: set_limit("travel_rad", -1.0),
    Trip.VOLTAGE: unpowered,
    Trip.COIL_I2T: hot,
    Trip.TPDO_LOST: set_limit("missed_cycles", 0),
    Trip.EMCY_MOTOR: set_host("emcy", int(Trip.EMCY_MOTOR)),
    Trip.EMCY_BRAKE: set_host("emcy", int(Trip.EMCY_BRAKE)),
    Trip.HEARTBEAT_MOTOR: unheard(0),
    Trip.HEARTBEAT_BRAKE: unheard(1),
    Trip.HEARTBEAT_SENSOR: unheard(2),
    Trip.EMCY_SENSOR: set_host("emcy", int(Trip.EMCY_SENSOR)),
    Trip.MOTOR_TORQUE: lambda bench: (
        setattr(bench.c, "motor_mismatch_Nm", -1.0),
        setattr(bench.c, "motor_mismatch_cycles", 0),
    ),
    Trip.NMT_STATE: lambda bench: bench.h.nmt.__setitem__(1, 127),
    Trip.DRIVE_STATE: lambda bench: setattr(bench, "state", int(PowerState.SWITCHED_ON)),
    Trip.NONE: lambda bench: (
        setattr(bench.h, "stop", 1),
        setattr(bench.h, "end_cycles", bench.c.rise_cycles + bench.c.fade_cycles),  # the brake has taken over
    ),
}
"""What makes the watches doubt, or others ask for the safe state.

Any other reason comes as the wish to stop.
"""

OWN = {
    (Phase.STILL, Phase.ENABLE, Trip.NONE): lambda bench: still(bench, still=20),
    (Phase.STILL, Phase.SAFE, Trip.NOT_STILL): still,
    (Phase.STILL, Phase.SAFE, Trip.HANDLE_LOADED): lambda bench: still(bench, handle_Nm=0.9),
    (Phase.STILL, Phase.SAFE, Trip.ENABLE_TIMEOUT): lambda bench: still(bench, state=int(PowerState.FAULT)),
    (Phase.STILL, Phase.SAFE, Trip.DEADMAN): lambda bench: still(bench, still=20, deadman_ok=0),
    (Phase.ENABLE, Phase.SIGN, Trip.NONE): lambda bench: setattr(bench, "state", int(PowerState.OPERATION_ENABLED)),
    (Phase.ENABLE, Phase.RUN, Trip.NONE): lambda bench: (
        setattr(bench, "state", int(PowerState.OPERATION_ENABLED)),
        setattr(bench.c, "sign_check", 0),
    ),
    (Phase.ENABLE, Phase.SAFE, Trip.ENABLE_TIMEOUT): late,
    (Phase.SIGN, Phase.SETTLE, Trip.NONE): lambda bench: checking(bench, bench.c.sign_counts, -0.1),
    (Phase.SIGN, Phase.SAFE, Trip.SIGN_TRANSDUCER): lambda bench: checking(bench, bench.c.sign_counts, 3.0),
    (Phase.SIGN, Phase.SAFE, Trip.SIGN_ENCODER): lambda bench: checking(bench, -bench.c.sign_counts),
    (Phase.SIGN, Phase.SAFE, Trip.SIGN_TRAVEL): lambda bench: (
        setattr(bench.c, "jump_counts", 10**6),
        setattr(bench.c, "speed_limit", 1e9),
        checking(bench, bench.c.sign_travel_counts + 1),
    ),
    (Phase.SIGN, Phase.SAFE, Trip.SIGN_NO_MOTION): stuck,
    (Phase.SETTLE, Phase.RUN, Trip.NONE): settled,
    (Phase.SETTLE, Phase.SAFE, Trip.NOT_STILL): late,
    (Phase.RUN, Phase.SAFE, Trip.LAW): lambda bench: setattr(bench.k, "law_function", no_number_law()),
    (Phase.SAFE, Phase.DISABLE, Trip.NONE): lambda bench: (
        setattr(bench.h, "phase_cycle", 1),
        setattr(bench.h, "level_Nm", 0.0),
    ),
    (Phase.DISABLE, Phase.DONE, Trip.NONE): lambda bench: setattr(bench, "state", int(PowerState.SWITCH_ON_DISABLED)),
}
"""What makes a phase itself go on, or refuse."""


def cases():
    for row in TRANSITIONS:
        for phase in row.phases:
            for trip in row.trips or (Trip.NONE,):
                yield pytest.param(phase, row.following, trip, id=f"{phase.name}-{row.following.name}-{trip.name}")


def make_happen(bench, phase, following, trip):
    if (phase, following, trip) in OWN:
        OWN[phase, following, trip](bench)
    elif trip is Trip.DEADMAN:
        bench.h.deadman_ok = 0
    elif trip in ANYWHERE:
        ANYWHERE[trip](bench)
    else:
        bench.h.stop = int(trip)


@pytest.mark.parametrize(("phase", "following", "trip"), list(cases()))
def test_every_row_happens(phase, following, trip):
    bench = HostBench("active").enter(phase, counts=40)
    bench.h.level_Nm = 0.5
    make_happen(bench, phase, following, trip)
    bench.cycle()
    assert bench.phase is following
    assert Trip(int(bench.h.trip)) is trip
    assert bench.h.trip_ns == (bench.t_ns if following is Phase.SAFE else 0)
    assert bench.h.sign_result == (
        SignResult.REFUSED
        if (phase, following) == (Phase.SIGN, Phase.SAFE)
        else SignResult.AGREED
        if phase is Phase.SIGN
        else SignResult.NOT_RUN
    )


@pytest.mark.parametrize("phase", Phase)
def test_without_a_reason_a_phase_goes_on(phase):
    bench = HostBench("active").enter(phase, counts=40)
    bench.h.level_Nm = 2.0
    bench.cycle()
    assert bench.phase is phase


@pytest.mark.parametrize("seed", range(40))
def test_whatever_happens_the_phases_change_as_the_table_says(seed):
    """`HostBench.cycle` holds each cycle against the table.

    Here are many that no other test thinks of.
    """
    draw = random.Random(seed)
    bench = HostBench(draw.choice(("active", "hybrid", "passive"))).enter(draw.choice(list(Phase)), counts=40)
    bench.c.still_cycles, bench.c.settle_cycles, bench.c.still_timeout_cycles = 3, 3, 20
    bench.c.enable_timeout_cycles, bench.c.sign_hand_cycles, bench.c.safe_longest_cycles = 5, 4, 9
    bench.c.release_Nm = 0.5
    happenings = [
        *ANYWHERE.values(),
        *(act for (phase, *_), act in OWN.items() if phase is not Phase.SAFE),
        lambda bench: bench.h.stop or setattr(bench.h, "stop", 1),
    ]
    for _ in range(120):
        if draw.random() < 0.03:
            draw.choice(happenings)(bench)
        if draw.random() < 0.2:
            bench.state = draw.randrange(8)
        if draw.random() < 0.1:
            bench.counts += draw.choice((-30, -1, 1, 30))
        bench.cycle()
    assert bench.t_ns > 100 * MS


def test_the_table_allows_what_it_has_and_no_more():
    assert allowed(Phase.STILL, Phase.STILL)
    assert allowed(Phase.STILL, Phase.ENABLE)
    assert not allowed(Phase.STILL, Phase.SIGN)
    assert allowed(Phase.RUN, Phase.SAFE, Trip.LAW)
    assert not allowed(Phase.SIGN, Phase.SAFE, Trip.LAW)
    assert not allowed(Phase.SAFE, Phase.RUN)
    assert not any(allowed(Phase.DONE, phase) for phase in Phase if phase is not Phase.DONE)
