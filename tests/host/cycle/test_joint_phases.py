"""RUN of a joint of an arm, the wait for the other joint, and the place of a world's model in RUN."""

from __future__ import annotations

import pytest

from coulombus.eds.cia402 import INTERNAL_LIMIT, PowerState
from coulombus.host.cycle.phases import run, run_joint, settle, still
from coulombus.host.cycle.records import Image, Phase, Trip
from coulombus.host.world.model_parts import Model, Spring
from coulombus.host.world.records import MODEL, OFFERS
from host_bench import MS, HostBench

T = 123 * MS


def joint(mode="hybrid", brake_Nm=0.75, motor_Nm=0.5):
    bench = HostBench(mode).enter(Phase.RUN)
    c, h, state = bench.c, bench.h, bench.axis.state
    c.brake_limit_Nm, c.brake_fall_Nm, c.brake_rise_Nm, c.brake_Nm_raw = 1.0, 0.25, 0.5, 0.0625
    h.brake_Nm, state.brake_Nm, state.motor_Nm, h.full_gain_ns, h.gain, h.limited_by_drive = (
        *(0.5, brake_Nm, motor_Nm, -1, 0.5),
        7,
    )
    return bench


@pytest.mark.parametrize(
    ("brake_Nm", "shown"), [(0.75, 0.75), (-0.5, 0.25), (0.0, 0.25), (0.875, 0.875), (3.0, 1.0), (0.125, 0.25)]
)
@pytest.mark.parametrize("motor_Nm", [0.5, -0.25])
def test_a_joint_displays_its_share_of_the_laws_force_within_the_limits(brake_Nm, shown, motor_Nm):
    bench = joint(brake_Nm=brake_Nm, motor_Nm=motor_Nm)
    assert run_joint(bench.axis, T) == (-motor_Nm, Phase.RUN)
    assert bench.h.brake_Nm == shown


def test_a_joint_without_a_brake_that_displays_leaves_it_alone_unless_the_display_ends():
    bench = joint("active")
    run_joint(bench.axis, T)
    assert bench.h.brake_Nm == 0.5
    for end_cycles in (1, 2):
        bench.h.end_cycles, bench.h.level_Nm = end_cycles, 0.375
        run_joint(bench.axis, T)
        assert bench.h.brake_Nm == 0.375
        bench.h.brake_Nm = 0.5


@pytest.mark.parametrize(
    ("gain", "before_ns", "after_ns"), [(0.99, -1, -1), (1.0, -1, T), (1.0, 0, 0), (1.0, 5, 5), (0.5, 5, 5)]
)
def test_a_joint_tells_when_it_displays_the_whole_law(gain, before_ns, after_ns):
    bench = joint()
    bench.h.gain, bench.h.full_gain_ns = gain, before_ns
    run_joint(bench.axis, T)
    assert bench.h.full_gain_ns == after_ns


@pytest.mark.parametrize(("bits", "count"), [(0, 7), (INTERNAL_LIMIT, 8), (~INTERNAL_LIMIT & 0xFFFF, 7)])
def test_a_joint_counts_the_cycles_in_which_its_drive_limits_the_torque(bits, count):
    bench = joint()
    bench.h.image[Image.STATUSWORD] = bits
    run_joint(bench.axis, T)
    assert bench.h.limited_by_drive == count


def test_a_held_joint_waits_for_the_other_however_long_and_however_still_it_is():
    bench = HostBench().enter(Phase.STILL)
    c, h = bench.c, bench.h
    c.still_cycles, c.still_timeout_cycles = 3, 10
    h.fresh, h.held, h.drive, h.brake_drive = 1, 1, int(PowerState.SWITCHED_ON), int(PowerState.SWITCHED_ON)
    h.still, h.phase_cycle = 9, 99
    assert still(c, h) == (0.0, Phase.STILL)
    assert (h.still, h.phase_cycle) == (0, 0)
    h.held = 0
    for k in range(3):
        assert still(c, h) == (0.0, Phase.ENABLE if k == 2 else Phase.STILL)


@pytest.mark.parametrize("ready", [False, True])
def test_a_joint_that_is_held_in_settle_goes_neither_on_nor_out(ready):
    bench = HostBench().enter(Phase.SETTLE)
    c, h = bench.c, bench.h
    c.settle_cycles, c.still_timeout_cycles = 3, 10
    h.fresh, h.held, h.torque_Nm, h.still, h.phase_cycle = 1, 1, 0.0, 9 if ready else -100, 99
    assert settle(c, h)[1] == Phase.SETTLE
    assert h.ready == ready
    h.held = 0
    assert settle(c, h)[1] == (Phase.RUN if ready else Phase.SAFE)
    assert h.trip == (Trip.NONE if ready else Trip.NOT_STILL)


@pytest.mark.parametrize("gain", [0.5, 1.0])
def test_a_model_acts_beside_the_law_with_the_gain_and_gives_it_its_parameters(gain):
    bench = HostBench("active", 'world.rest = "law"').enter(Phase.RUN, 0)
    c, h, axis = bench.c, bench.h, bench.axis
    w = axis.world
    row = w.offered[1 % OFFERS]
    model = Model(law=1.0, spring=Spring(0.0, 4.0), parameters={"F_d_Nm": 0.25}).record({"F_d_Nm": 2}, profile=0)
    for name, value in zip(MODEL.names, model.tolist(), strict=True):
        row[name] = value
    w.wanted, w.motor_rate_Nm, w.motor_limit_Nm = 1, 100.0, 100.0
    h.counts, c.rad_count, c.gain_step, h.gain, h.fresh = 64, 2.0**-7, 0.0, gain, 1
    seen = []

    def law(motion, parameters, state):
        seen.append(parameters.F_d)
        return 0.125

    torque_Nm, phase = run(axis, law, T)
    assert (torque_Nm, phase) == (-gain * (4.0 * 0.5 + 0.125), Phase.RUN)
    assert seen == [0.25]
    assert (h.world_Nm, h.world_elastic_Nm, h.world_most_J) == (gain * 2.0, gain * 2.0, 1.0)
    w.on, h.world_Nm = 0, 9.0
    assert run(axis, law, T) == (-gain * 0.125, Phase.RUN)
    assert h.world_Nm == 9.0
    assert seen[1] != 0.25
