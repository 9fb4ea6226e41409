"""RUN of a joint of an arm, the wait for the other joint, and the place of a world's model in RUN."""

from __future__ import annotations

from functools import cache

import pytest

from coulombus.eds.cia402 import INTERNAL_LIMIT, PowerState
from coulombus.host.cycle.phases import advance, enter, run, run_joint, settle, split_law, still
from coulombus.host.cycle.records import Image, Phase, Trip
from coulombus.host.laws.laws import compile_law
from coulombus.host.world.model_parts import Model, Spring
from host_bench import MS, HostBench
from model_cycle import offer

T = 123 * MS


@cache
def free_law():
    return compile_law(lambda motion, law, state: 0.0)


@cache
def dynamic_law():
    return compile_law(lambda motion, law, state: law.F_d)


def joint(mode="hybrid", brake_Nm=0.75, motor_Nm=0.5):
    bench = HostBench(mode).enter(Phase.RUN)
    c, h, state = bench.c, bench.h, bench.axis.state
    c.brake_limit_Nm, c.brake_fall_Nm, c.brake_rise_Nm, c.brake_Nm_raw = 1.0, 0.25, 0.5, 0.0625
    state.brake_Nm, state.motor_Nm = brake_Nm, motor_Nm
    h.brake_Nm, h.gain, h.full_gain_ns, h.limited_by_drive = 0.5, 0.5, -1, 7
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
    model = Model(law=1.0, spring=Spring(0.0, 4.0), parameters={"F_d_Nm": 0.25}).record({"F_d_Nm": 2}, profile=0)
    offer(w, model, 1)
    w.motor_rate_Nm, w.motor_limit_Nm = 100.0, 100.0
    h.counts, c.rad_count, c.gain_step, h.gain, h.fresh = 64, 2.0**-7, 0.0, gain, 1
    assert run(axis, dynamic_law(), T) == (-gain * (4.0 * 0.5 + 0.25), Phase.RUN)
    assert (h.world_Nm, h.world_elastic_Nm, h.world_most_J) == (gain * 2.0, gain * 2.0, 1.0)
    w.on, h.world_Nm = 0, 9.0
    assert run(axis, dynamic_law(), T) == (-gain * axis.law.F_d, Phase.RUN)
    assert h.world_Nm == 9.0


def test_a_brake_that_is_nearly_off_gets_no_negative_set_point():
    bench = joint(brake_Nm=-0.5)
    bench.h.brake_Nm = 0.0625
    run_joint(bench.axis, T)
    assert bench.h.brake_Nm == 0.0


def test_a_display_begins_without_what_an_earlier_one_left():
    bench = HostBench().enter(Phase.SETTLE)
    h = bench.h
    names = "displayed_Nm", "felt_v_counts", "mean_v_counts", "felt_error_Nm", "mean_error_Nm", "mean_size_Nm"
    counts = "ready", "end_cycles", "felt_wrong"
    for name in (*names, *counts):
        setattr(h, name, 3)
    h.side[:], h.reversals[:] = [1, 1], [2.0, 2.0]
    enter(bench.axis, int(Phase.RUN), T)
    assert [getattr(h, name) for name in (*names, *counts)] == [0] * 9
    assert (list(h.side), list(h.reversals)) == ([0, 0], [0.0, 0.0])


@pytest.mark.parametrize(("end_cycles", "shown"), [(0, 0.75), (1, 0.375), (2, 0.375)])
def test_at_an_end_the_brake_bears_the_load_and_not_the_law(end_cycles, shown):
    bench = HostBench().enter(Phase.RUN)
    c, h = bench.c, bench.h
    c.gain_step, h.gain, h.brake_Nm, bench.axis.state.brake_Nm = 1.0, 1.0, 0.75, 0.75
    h.end_cycles, h.level_Nm = end_cycles, 0.375
    split_law(bench.axis)
    assert h.brake_Nm == shown


@pytest.mark.parametrize(("end_cycles", "count"), [(0, 6), (1, 5), (2, 5)])
def test_the_cycles_of_an_end_are_none_of_the_display(end_cycles, count):
    bench = HostBench().enter(Phase.RUN)
    h = bench.h
    h.enabled_ns, h.display_cycles, h.end_cycles = 0, 5, end_cycles
    advance(bench.axis, free_law(), 0, T)
    assert h.display_cycles == count


def test_the_brake_takes_over_in_the_first_cycle_of_an_end_and_once():
    bench = HostBench("active").enter(Phase.RUN)
    c, h = bench.c, bench.h
    c.hands_over, c.rise_cycles, c.fade_cycles = 1, 5, 5
    h.stop, h.displayed_Nm = 1, 0.5
    advance(bench.axis, free_law(), 0, T)
    assert (h.end_cycles, h.takes_over) == (1, 1)
    level_Nm = h.level_Nm
    assert level_Nm > 0.0
    h.displayed_Nm = 2.0
    advance(bench.axis, free_law(), 0, T)
    assert (h.end_cycles, h.level_Nm) == (2, level_Nm)
