"""Arming: still, little loaded, signs agreed - or refused with the reason."""

from __future__ import annotations

from itertools import pairwise

import pytest

from coulombus.eds.cia402 import PowerState
from coulombus.host.cycle.records import Phase, SignResult
from host_bench import HostBench


def test_the_drive_is_walked_up_but_not_enabled_before_the_handle_was_still():
    bench = HostBench()
    bench.cycles(150)
    assert bench.state == PowerState.SWITCHED_ON
    assert bench.phase is Phase.STILL
    bench.cycles(60)
    assert bench.state == PowerState.OPERATION_ENABLED


@pytest.mark.parametrize("mode", ["active", "hybrid"])
def test_a_good_rig_arms(mode):
    bench = HostBench(mode)
    bench.arm()
    assert bench.phase is Phase.RUN
    assert bench.k.trip is None
    assert bench.k.sign_result is SignResult.AGREED


def test_passive_needs_no_sign_check_and_never_sends_torque():
    bench = HostBench("passive")
    bench.arm()
    assert bench.k.sign_result is SignResult.NOT_RUN
    for n in range(500):
        bench.counts = 20 * n
        bench.handle_Nm = 3.0
        bench.cycle()
        assert bench.motor_pm == 0


def test_a_free_handle_arms_without_a_verdict_on_the_transducer():
    bench = HostBench()
    bench.arm(hand=0)
    assert bench.phase is Phase.RUN
    assert bench.k.sign_result is SignResult.NO_HAND


@pytest.mark.parametrize(
    ("direction", "hand", "text"),
    [(-1, 1, "SIGN_ENCODER"), (1, 1, "SIGN_TRANSDUCER"), (0, 0, "SIGN_NO_MOTION")],
)
def test_a_wrong_sign_refuses(direction, hand, text):
    bench = HostBench()
    bench.arm(direction, hand)
    assert bench.phase is Phase.SAFE
    assert bench.k.trip.startswith(text)
    assert bench.motor_pm == 0
    assert abs(bench.counts * bench.c.rad_count) < 0.2


@pytest.mark.parametrize("preload_Nm", [-0.1, 0.1])
@pytest.mark.parametrize(
    ("encoder", "transducer", "text"), [(1, 1, None), (-1, 1, "SIGN_ENCODER"), (1, -1, "SIGN_TRANSDUCER")]
)
def test_a_hand_that_rests_on_the_handle(preload_Nm, encoder, transducer, text):
    """Its pull and the friction hold the handle against a torque in one sense.

    In the other one it moves, and every sign is told.
    """
    bench = HostBench()
    angle = 0.0
    for _ in range(3000):
        if bench.phase >= Phase.RUN:
            break
        torque = bench.motor_pm * bench.c.motor_Nm_raw
        net = torque + preload_Nm
        if abs(net) > 0.14:
            angle = (abs(net) - 0.14) / 5.0 * (1 if net > 0 else -1)
        bench.counts = encoder * angle / abs(bench.c.rad_count)
        bench.handle_Nm = transducer * (preload_Nm - 5.0 * angle)
        bench.cycle()
    if text is None:
        assert bench.phase is Phase.RUN
        assert bench.k.sign_result is SignResult.AGREED
        assert bench.h.sign_direction == (1 if preload_Nm > 0 else -1)
    else:
        assert bench.k.trip.startswith(text)
    assert abs(bench.motor_pm * bench.c.motor_Nm_raw) <= 0.168


def test_no_torque_before_operation_enabled_and_little_in_the_sign_check():
    bench = HostBench("active")
    largest = 0.0
    while bench.phase < Phase.RUN:
        if bench.phase in (Phase.SIGN, Phase.SETTLE):
            bench.follow_sign_check()
        bench.cycle()
        torque = bench.motor_pm * bench.c.motor_Nm_raw
        if bench.phase < Phase.SIGN:
            assert torque == 0
        largest = max(largest, torque)
    assert 0.1 < largest <= bench.rig.one_axis().limits.sign_check_torque_Nm + bench.c.motor_Nm_raw


def test_a_moving_handle_is_waited_for_and_then_refused():
    bench = HostBench()
    for n in range(6000):
        bench.counts = 3 * n
        bench.cycle()
        if bench.phase is Phase.SAFE:
            break
    assert bench.k.trip.startswith("NOT_STILL")
    assert "bus.tpdo_window_s" not in bench.k.trip
    assert bench.state != PowerState.OPERATION_ENABLED


def test_a_handle_whose_position_comes_too_late_is_refused_with_the_reason():
    bench = HostBench()
    for n in range(6000):
        bench.silent = set() if n % 10 else {"motor"}
        bench.cycle()
        if bench.phase is Phase.SAFE:
            break
    assert bench.k.trip.startswith("NOT_STILL")
    assert "cycles lacked a TPDO within bus.tpdo_window_s" in bench.k.trip


def test_a_loaded_handle_is_refused():
    bench = HostBench()
    bench.handle_Nm = 1.0
    bench.cycles(6000, lambda: bench.phase >= Phase.SAFE)
    assert bench.k.trip.startswith("HANDLE_LOADED")


def test_a_drive_that_does_not_enable_is_refused():
    bench = HostBench()
    bench.cycles(3000, lambda: bench.phase is Phase.ENABLE)
    while bench.phase is Phase.ENABLE:
        bench.cycle()
        bench.state = int(PowerState.SWITCHED_ON)
    assert bench.k.trip.startswith("ENABLE_TIMEOUT")


def test_the_gain_ramps_in():
    bench = HostBench("hybrid")
    bench.arm()
    F_s = bench.rig.one_axis().mode["hybrid"].F_s_Nm
    shown = []
    for _ in range(600):
        bench.cycle()
        shown.append(bench.brake_Nm)
    assert all(later >= earlier for earlier, later in pairwise(shown))
    assert shown[249] == pytest.approx(F_s / 2, rel=0.02)
    assert shown[-1] == pytest.approx(F_s)
