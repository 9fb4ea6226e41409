"""What the host watches, rule by rule: each limit at its edge, in both senses, away from position 0
and torque 0.
"""

from __future__ import annotations

import pytest

from coulombus.eds.cia402 import STATUSWORD, VOLTAGE_ENABLED, PowerState
from coulombus.host.cycle.monitors import measure, watch, watch_devices, watch_motion
from coulombus.host.cycle.records import Image, Phase, Trip
from host_bench import MS, HostBench

BOTH = pytest.mark.parametrize("sign", [1, -1])
T0 = 70 * MS
FAR = 1e9


def binary(**control):
    """A bench whose scales are powers of two, so that a limit can be met exactly.

    No limit is near.
    """
    bench = HostBench("hybrid")
    c, h = bench.c, bench.h
    c.period_ns, c.rad_count, c.motor_Nm_raw, c.handle_Nm_raw, c.coil_A_raw = (
        500_000_000,
        2.0**-6,
        2.0**-8,
        2.0**-7,
        2.0**-4,
    )
    c.speed_limit = c.travel_rad = c.net_work_J = c.coil_limit_A2 = c.mismatch_Nm = c.motor_mismatch_Nm = FAR
    c.brake_lag_decay = c.coil_decay = 0.5
    c.friction_Nm, c.viscous, c.velocity_band_counts = 0.25, 0.125, 2.0
    c.net_work_cycles = 4
    for name, value in control.items():
        setattr(c, name, value)
    c.torque_Nm_raw = c.motor_Nm_raw
    h.counts, h.fresh = 4096, 1
    return bench


def healthy():
    """A bench that heard of everything just before T0."""
    bench = HostBench("hybrid")
    h = bench.h
    h.heard_ns[0] = h.heard_ns[1] = T0 - 5
    h.fresh = 1
    h.image[Image.STATUSWORD] = VOLTAGE_ENABLED | 0x27
    return bench


# position


def positioned(raw=1000, counts=37):
    bench = HostBench("hybrid")
    h = bench.h
    h.has_position, h.raw_position, h.counts, h.v_counts = 1, raw, counts, 3.0
    h.arrived = bench.c.position_mask
    h.image[Image.POSITION] = raw
    return bench


@BOTH
def test_a_fresh_position_gives_way_and_speed(sign):
    bench = positioned(1000 * sign, -37)
    h = bench.h
    h.fresh = 0
    h.image[Image.HANDLE_TORQUE] = sign * 700
    h.image[Image.POSITION] += sign * 13
    assert measure(bench.c, h) == Trip.NONE
    assert (h.counts, h.v_counts, h.raw_position) == (-37 + sign * 13, sign * 13, sign * 1013)
    assert (h.fresh, h.position_age) == (1, 0)
    assert h.handle_Nm == pytest.approx(sign * 700 * bench.c.handle_Nm_raw)


@BOTH
def test_a_position_that_was_late_gives_the_mean_speed_since(sign):
    bench = positioned()
    h = bench.h
    h.position_age = 2
    h.image[Image.POSITION] += sign * 12
    assert measure(bench.c, h) == Trip.NONE
    assert h.v_counts == sign * 4
    assert (h.fresh, h.position_age) == (1, 0)


@pytest.mark.parametrize("arrived", [0, 0b110])
def test_a_position_that_does_not_come_ages_and_keeps_what_was_known(arrived):
    bench = positioned()
    h = bench.h
    assert bench.c.position_mask == 1
    h.arrived, h.fresh, h.position_age = arrived, 1, 2
    h.image[Image.POSITION] += 12
    assert measure(bench.c, h) == Trip.NONE
    assert (h.counts, h.v_counts, h.raw_position) == (37, 3.0, 1000)
    assert (h.fresh, h.position_age) == (0, 3)


@pytest.mark.parametrize("raw", [0, 70_000, -70_000])
def test_the_first_position_is_where_counting_begins(raw):
    bench = HostBench("hybrid")
    h = bench.h
    h.arrived, h.image[Image.POSITION], h.position_age = bench.c.position_mask, raw, 4
    assert measure(bench.c, h) == Trip.NONE
    assert (h.counts, h.v_counts, h.raw_position, h.has_position) == (0, 0.0, raw, 1)
    assert (h.fresh, h.position_age) == (0, 0)


@BOTH
@pytest.mark.parametrize("age", [0, 1, 2])
def test_a_jump_is_more_than_the_limit_for_each_cycle_that_passed(sign, age):
    bench = positioned(-200, 37)
    h, most = bench.h, bench.c.jump_counts * (age + 1)
    h.position_age = age
    h.image[Image.POSITION] = -200 + sign * (most + 1)
    assert measure(bench.c, h) == Trip.ENCODER_JUMP
    assert (h.counts, h.v_counts, h.raw_position, h.fresh) == (37, 3.0, -200, 0)
    h.position_age = age
    h.image[Image.POSITION] = -200 + sign * most
    assert measure(bench.c, h) == Trip.NONE
    assert h.counts == 37 + sign * most


@BOTH
def test_the_position_is_followed_across_the_wrap_of_32_bits(sign):
    bench = positioned(2**31 - 3 if sign > 0 else -(2**31) + 3)
    h = bench.h
    h.image[Image.POSITION] = -sign * (2**31 - 4)
    assert measure(bench.c, h) == Trip.NONE
    assert h.counts == 37 + sign * 7
    assert h.v_counts == sign * 7


@BOTH
def test_a_position_of_16_bits_is_followed_across_its_wrap(sign):
    bench = positioned(2**15 - 3 if sign > 0 else -(2**15) + 3)
    bench.c.position_half = 2**15
    bench.h.image[Image.POSITION] = -sign * (2**15 - 4)
    assert measure(bench.c, bench.h) == Trip.NONE
    assert (bench.h.counts, bench.h.v_counts) == (37 + sign * 7, sign * 7)


@BOTH
def test_the_handle_torque_has_its_offset(sign):
    bench = binary(handle_offset_Nm=sign * 0.25)
    bench.h.image[Image.HANDLE_TORQUE] = 64
    measure(bench.c, bench.h)
    assert bench.h.handle_Nm == 0.5 + sign * 0.25


@pytest.mark.parametrize("state", PowerState)
@pytest.mark.parametrize("other_bits", [0, 0xFF80])
def test_a_brake_that_is_a_drive_has_a_state_of_its_own(state, other_bits):
    bench = positioned()
    c, h = bench.c, bench.h
    h.image[Image.STATUSWORD] = STATUSWORD[PowerState.SWITCHED_ON]
    h.image[Image.BRAKE_STATUSWORD] = int(STATUSWORD[state]) & 0x7F | other_bits
    c.brake_is_drive = 1
    measure(c, h)
    assert (h.drive, h.brake_drive) == (PowerState.SWITCHED_ON, state)
    c.brake_is_drive = 0
    measure(c, h)
    assert (h.drive, h.brake_drive) == (PowerState.SWITCHED_ON, PowerState.SWITCHED_ON)


# motion


@BOTH
@pytest.mark.parametrize("polarity", [1, -1])
def test_speed_beyond_its_limit_trips(sign, polarity):
    bench = binary(speed_limit=2.0, rad_count=polarity * 2.0**-6)
    bench.h.v_counts = sign * 64.0  # 1 rad a cycle of 0.5 s
    assert watch_motion(bench.c, bench.h) == Trip.NONE
    bench.h.v_counts = sign * 64.25
    assert watch_motion(bench.c, bench.h) == Trip.SPEED


@BOTH
@pytest.mark.parametrize("polarity", [1, -1])
def test_travel_beyond_its_limit_trips(sign, polarity):
    bench = binary(travel_rad=2.0, rad_count=polarity * 2.0**-6)
    bench.h.counts = sign * 128
    assert watch_motion(bench.c, bench.h) == Trip.NONE
    bench.h.counts = sign * 129
    assert watch_motion(bench.c, bench.h) == Trip.TRAVEL


@BOTH
@pytest.mark.parametrize("polarity", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_the_motors_net_work_is_summed_over_a_sliding_window(sign, polarity):
    """Work that goes in counts, in either sense of the handle, what comes back is taken off, and
    what is old is forgotten.
    """
    motor, encoder = polarity
    bench = binary(motor_Nm_raw=motor * 2.0**-8, rad_count=encoder * 2.0**-6)
    c, h = bench.c, bench.h
    h.work_row = 2
    done = []
    for n, (torque_pm, counts) in enumerate(
        [(64, 32), (128, 16), (-64, 8), (256, 64), (32, 16), (-16, -64), (8, 8), (8, 8)]
    ):
        h.image[Image.TORQUE] = sign * motor * torque_pm
        h.v_counts = h.moved_counts = sign * encoder * counts
        done.append(torque_pm * 2.0**-8 * counts * 2.0**-6)
        c.net_work_J = sum(done[-4:])
        assert watch_motion(c, h) == Trip.NONE
        assert h.work_sum == sum(done[-4:])
        assert h.work_row == (3 + n) % 4
    h.fresh = 0  # a speed that is not known does no work
    c.net_work_J = sum(done[-3:])
    assert watch_motion(c, h) == Trip.NONE
    assert h.work_sum == sum(done[-3:])
    h.fresh = 1
    c.net_work_J = sum(done[-2:]) + done[-1] - 2.0**-20
    assert watch_motion(c, h) == Trip.NET_WORK


@BOTH
def test_a_wall_gives_back_what_the_hand_has_put_into_it(sign):
    bench = binary(stores=1, net_work_J=1.0)
    bench.h.handle_Nm = 0.0

    def cycle(pushed_Nm: float, counts: int, measured_Nm: float | None = None) -> int:
        bench.h.pushed_Nm = sign * pushed_Nm
        bench.h.v_counts = bench.h.moved_counts = sign * counts
        bench.h.image[Image.TORQUE] = round(-sign * (pushed_Nm if measured_Nm is None else measured_Nm) * 2**8)
        return int(watch_motion(bench.c, bench.h))

    for _ in range(20):  # 10 J in, 8 J out
        assert cycle(2.0, 16) == Trip.NONE
    for _ in range(16):
        assert cycle(2.0, -16) == Trip.NONE
    assert bench.h.contact_J == -2.0
    assert cycle(0.0, -16) == Trip.NONE  # what is left is in the window
    assert (bench.h.contact_J, bench.h.work_sum) == (0.0, -2.0)
    for _ in range(4):
        assert cycle(0.0, 0) == Trip.NONE
    assert bench.h.work_sum == 0.0
    assert cycle(2.0, -16) == Trip.NONE
    assert cycle(2.0, -16) == Trip.NONE  # 1 J that nobody has put in
    assert cycle(2.0, -1) == Trip.NET_WORK


def test_a_wall_whose_motor_has_the_wrong_sign_trips_in_the_window():
    bench = binary(stores=1, net_work_J=1.0)
    bench.h.pushed_Nm, bench.h.handle_Nm = 2.0, 0.0
    bench.h.v_counts = bench.h.moved_counts = 16
    bench.h.image[Image.TORQUE] = 2 * 2**8
    assert watch_motion(bench.c, bench.h) == Trip.NONE  # 0.5 J measured where -0.5 J is the law's
    assert bench.h.work_sum == 1.0
    assert watch_motion(bench.c, bench.h) == Trip.NET_WORK


def test_a_law_that_stores_nothing_has_no_sum_of_its_own():
    bench = binary(stores=0, net_work_J=0.4)
    bench.h.pushed_Nm, bench.h.v_counts, bench.h.moved_counts = 2.0, -16, -16
    bench.h.image[Image.TORQUE] = -2 * 2**8
    assert watch_motion(bench.c, bench.h) == Trip.NET_WORK
    assert bench.h.contact_J == 0.0


def test_work_that_the_handle_does_on_the_motor_trips_never():
    bench = binary(net_work_J=0.0)
    bench.h.image[Image.TORQUE], bench.h.v_counts, bench.h.moved_counts = 512, -640.0, -640
    for _ in range(6):
        assert watch_motion(bench.c, bench.h) == Trip.NONE
    assert bench.h.work_sum == 4 * -2.0 * 10.0


@BOTH
def test_the_coils_heat_follows_the_square_of_its_current_with_a_lag(sign):
    bench = binary()
    c, h = bench.c, bench.h
    h.coil_A2 = 1.0
    h.image[Image.COIL_CURRENT] = sign * 24  # 1.5 A
    c.coil_limit_A2 = 2.25 - 1.25 / 2
    assert watch_motion(c, h) == Trip.NONE
    assert h.coil_A2 == c.coil_limit_A2
    c.coil_limit_A2 = 2.25 - 1.25 / 4 - 2.0**-20
    assert watch_motion(c, h) == Trip.COIL_I2T
    h.image[Image.COIL_CURRENT] = 0
    assert watch_motion(c, h) == Trip.NONE
    assert h.coil_A2 == (2.25 - 1.25 / 4) / 2


SLIP = [
    # counts a cycle, brake, lagged before, motor torque, hand's torque beyond what is expected
    (64, 2.0, 1.0, 0.0, 1.0),
    (64, 2.0, 1.0, 0.0, -1.0),
    (64, 0.0, 3.0, 0.5, 1.0),
    (64, 0.0, 3.0, -0.5, -1.0),
    (16, 1.0, 1.0, 1.0, 1.0),
    (3, 1.0, 0.0, 0.25, -1.0),
]


@BOTH
@pytest.mark.parametrize("polarity", [1, -1])
@pytest.mark.parametrize(("counts", "brake", "lagged", "motor", "beyond"), SLIP)
def test_in_slip_the_hand_bears_brake_friction_viscous_drag_less_the_motor(
    sign, polarity, counts, brake, lagged, motor, beyond
):
    """What is more or less than that by the limit counts; within it, the counting begins anew."""
    bench = binary(mismatch_Nm=1.0, mismatch_cycles=100, rad_count=polarity * 2.0**-6)
    c, h = bench.c, bench.h
    h.mismatch = 7
    h.brake_Nm, h.brake_lagged_Nm = brake, lagged
    h.v_counts = sign * polarity * counts
    h.image[Image.TORQUE] = sign * round(motor * 2**8)
    speed = counts * 2.0**-6 / 0.5
    after = (brake + lagged) / 2
    expected = after + 0.25 + 0.125 * speed - motor
    h.handle_Nm = sign * (expected + beyond)
    assert watch_motion(c, h) == Trip.NONE
    assert (h.mismatch, h.brake_lagged_Nm) == (0, after)
    h.mismatch, h.brake_lagged_Nm = 7, lagged
    h.handle_Nm = sign * (expected + beyond * (1 + 2.0**-10))
    assert watch_motion(c, h) == Trip.NONE
    assert h.mismatch == 8


@BOTH
@pytest.mark.parametrize("counts", [0, 2, -2])
@pytest.mark.parametrize("motor", [0.0, 0.5, -0.5])
def test_when_stuck_the_hand_may_bear_less_but_not_more(sign, counts, motor):
    bench = binary(mismatch_Nm=1.0, mismatch_cycles=100)
    c, h = bench.c, bench.h
    h.brake_Nm, h.brake_lagged_Nm, h.v_counts = 2.0, 1.0, counts
    h.image[Image.TORQUE] = sign * round(motor * 2**8)
    for handle, count in ((1.5 + 0.25 + 1.0 - motor, 0), (1.5 + 0.25 + 1.0 - motor + 2.0**-10, 8), (-motor, 0)):
        h.mismatch, h.brake_lagged_Nm = 7, 1.0
        h.handle_Nm = sign * handle
        assert watch_motion(c, h) == Trip.NONE
        assert h.mismatch == count


@BOTH
@pytest.mark.parametrize("counts", [0, 40, -40])
def test_a_hand_torque_that_does_not_fit_trips_when_it_lasts(sign, counts):
    bench = binary(mismatch_Nm=1.0, mismatch_cycles=3)
    c, h = bench.c, bench.h
    h.v_counts, h.handle_Nm = counts, sign * 8.0
    assert [watch_motion(c, h) for _ in range(4)] == [Trip.NONE] * 3 + [Trip.HANDLE_TORQUE]
    h.handle_Nm = 0.25 * (counts > 0) - 0.25 * (counts < 0)
    assert watch_motion(c, h) == Trip.NONE
    h.handle_Nm = sign * 8.0
    assert [watch_motion(c, h) for _ in range(4)] == [Trip.NONE] * 3 + [Trip.HANDLE_TORQUE]


def test_a_display_that_the_hand_does_not_feel_trips_when_it_lasts():
    bench = binary(mismatch_cycles=3, mismatch_share=0.25, still_handle_Nm=0.01)
    c, h = bench.c, bench.h
    h.phase, h.v_counts, h.felt_v_counts, h.mean_v_counts, h.felt_wrong = Phase.RUN, 40.0, 40.0, 40.0, 3
    h.felt_error_Nm = h.mean_error_Nm = 8.0
    h.handle_Nm = 8.0
    assert watch_motion(c, h) == Trip.HANDLE_TORQUE
    assert (h.felt_wrong, h.mismatch) == (4, 0)


@BOTH
def test_without_a_measured_torque_the_commanded_one_works(sign):
    bench = binary(net_work_J=1.0, torque_commanded=1.0, torque_Nm_raw=0.0)
    bench.h.v_counts, bench.h.moved_counts, bench.h.torque_Nm = sign * 32.0, sign * 32, sign * 2.0  # 1 J a cycle
    assert watch_motion(bench.c, bench.h) == Trip.NONE
    assert bench.h.work_sum == 1.0
    bench.h.v_counts = bench.h.moved_counts = sign
    assert watch_motion(bench.c, bench.h) == Trip.NET_WORK


def test_without_a_measured_current_the_commanded_one_heats_the_coil():
    bench = binary(coil_limit_A2=2.0, coil_A_raw=0.0, coil_A_Nm=0.5)
    bench.h.brake_Nm = 4.0  # 2 A
    bench.h.handle_Nm = 4.0
    assert watch_motion(bench.c, bench.h) == Trip.NONE
    assert bench.h.coil_A2 == 2.0
    assert watch_motion(bench.c, bench.h) == Trip.COIL_I2T
    assert bench.h.coil_A2 == 3.0


def test_measured_and_commanded_current_add_up_with_their_signs():
    bench = binary(coil_A_raw=0.5, coil_A_Nm=0.5)
    bench.h.brake_Nm, bench.h.image[Image.COIL_CURRENT] = 4.0, 2
    watch_motion(bench.c, bench.h)
    assert bench.h.coil_A2 == 4.5


# devices


def test_healthy_devices_trip_nothing():
    assert watch_devices(healthy().c, healthy().h, T0) == Trip.NONE


@pytest.mark.parametrize("trip", [Trip.EMCY_MOTOR, Trip.EMCY_BRAKE])
def test_an_emcy_trips_with_its_sender(trip):
    bench = healthy()
    bench.h.emcy = int(trip)
    assert watch_devices(bench.c, bench.h, T0) == trip


def test_so_many_cycles_without_all_tpdos_trip():
    bench = healthy()
    bench.h.missed_in_a_row = bench.c.missed_cycles - 1
    assert watch_devices(bench.c, bench.h, T0) == Trip.NONE
    bench.h.missed_in_a_row += 1
    assert watch_devices(bench.c, bench.h, T0) == Trip.TPDO_LOST


def test_one_tpdo_that_is_older_than_so_many_cycles_trips():
    bench = healthy()
    bench.h.oldest_tpdo = bench.c.missed_cycles
    assert watch_devices(bench.c, bench.h, T0) == Trip.NONE
    bench.h.oldest_tpdo += 1
    assert watch_devices(bench.c, bench.h, T0) == Trip.TPDO_LOST


@pytest.mark.parametrize("node", ["motor", "brake"])
@pytest.mark.parametrize("timeout_ns", [1, 150 * MS])
def test_a_heartbeat_that_is_older_than_its_time_trips(node, timeout_ns):
    bench = healthy()
    k = ["motor", "brake"].index(node)
    bench.c.heartbeat_timeout_ns[k] = timeout_ns
    heard = bench.h.heard_ns[k]
    assert watch_devices(bench.c, bench.h, heard + timeout_ns) == Trip.NONE
    bench.h.heard_ns[1 - k] = heard + timeout_ns
    bench.h.suspect_node = 7
    assert watch_devices(bench.c, bench.h, heard + timeout_ns + 1) == Trip[f"HEARTBEAT_{node.upper()}"]
    assert bench.h.suspect_node == k
    bench.c.heartbeat_timeout_ns[k] = 0  # 0: not watched
    assert watch_devices(bench.c, bench.h, heard + timeout_ns + 1) == Trip.NONE


@pytest.mark.parametrize("node", ["motor", "brake"])
@pytest.mark.parametrize("state", [0, 4, 6, 127])
def test_a_node_that_is_not_operational_trips(node, state):
    bench = healthy()
    bench.h.nmt[["motor", "brake"].index(node)] = state
    assert watch_devices(bench.c, bench.h, T0) == Trip.NMT_STATE


def test_two_fresh_statuswords_without_voltage_trip():
    bench = healthy()
    c, h = bench.c, bench.h
    word = h.image[Image.STATUSWORD]

    def judged(status, fresh=1):
        h.image[Image.STATUSWORD], h.fresh = status, fresh
        return watch_devices(c, h, T0)

    low = word & ~VOLTAGE_ENABLED
    assert [judged(s) for s in (low, word, low)] == [Trip.NONE] * 3
    assert judged(low, fresh=0) == Trip.NONE
    assert judged(low) == Trip.VOLTAGE
    assert judged(word, fresh=0) == Trip.VOLTAGE  # an old word takes nothing back


# all


@pytest.mark.parametrize("motor", [True, False])
@pytest.mark.parametrize("brake", [True, False])
@pytest.mark.parametrize("phase", [Phase.ENABLE, Phase.ENABLE + 1, Phase.RUN, Phase.SAFE])
def test_from_enabling_on_motor_and_brake_have_to_stay_enabled(motor, brake, phase):
    bench = healthy()
    h = bench.h
    enabled, disabled = int(PowerState.OPERATION_ENABLED), int(PowerState.SWITCHED_ON)
    h.drive, h.brake_drive = enabled if motor else disabled, enabled if brake else disabled
    h.phase, h.deadman_ok = int(phase), 1
    leaves = Phase.ENABLE < phase < Phase.SAFE and not (motor and brake)
    assert watch(bench.c, h, Trip.NONE, T0) == (Trip.DRIVE_STATE if leaves else Trip.NONE)


# the motor's torque beside its commands


def pushing(commands, measured_Nm, **control):
    """The trips of cycles in which the motor's commands were these, and 6077h told `measured_Nm`."""
    bench = binary(**{"motor_mismatch_Nm": 0.25, "motor_mismatch_cycles": 2, "motor_lag_decay": 0.5} | control)
    c, h = bench.c, bench.h
    h.image[Image.TORQUE] = round(measured_Nm / c.torque_Nm_raw)
    trips = []
    for torque_Nm in commands:
        h.torque_Nm = torque_Nm
        trips.append(Trip(int(watch_motion(c, h))))
    return trips


QUIET, TRIPPED = Trip.NONE, Trip.MOTOR_TORQUE


@BOTH
def test_a_motor_that_pushes_when_none_is_asked_for_trips_after_its_time(sign):
    assert pushing([0.0] * 4, sign * 0.2578125) == [QUIET, QUIET, TRIPPED, TRIPPED]
    assert pushing([0.0] * 4, sign * 0.25) == [QUIET] * 4


@BOTH
def test_a_motor_that_pushes_against_its_command_trips(sign):
    assert pushing([sign * 0.5] * 4, sign * 0.75) == [QUIET] * 4
    assert pushing([sign * 0.5] * 4, sign * -0.5) == [QUIET, QUIET, TRIPPED, TRIPPED]


@BOTH
def test_a_command_of_just_now_explains_the_torque_for_the_drives_lag(sign):
    assert pushing([sign * 1.0, 0, 0, 0, 0, 0], sign * 0.5) == [QUIET] * 5 + [TRIPPED]


def test_one_cycle_that_fits_begins_the_count_anew():
    bench = binary(motor_mismatch_Nm=0.25, motor_mismatch_cycles=2)
    bench.h.motor_mismatch, bench.h.torque_Nm = 2, 0.0
    assert watch_motion(bench.c, bench.h) == Trip.NONE
    assert bench.h.motor_mismatch == 0


def test_a_motor_whose_torque_is_not_measured_is_not_watched():
    assert pushing([0.0] * 9, 3.0, motor_mismatch_Nm=FAR)[-1] is QUIET


# what a world outside gives and takes


@pytest.mark.parametrize(
    ("elastic_Nm", "stored_J", "most_J", "work_J", "kept_J"),
    [
        (2.0, 0.0, 10.0, 2.0, 2.0),  # the hand puts in
        (2.0, 9.5, 10.0, 2.0, 10.0),  # no more is kept than can be returned
        (-2.0, 5.0, 10.0, -2.0, 3.0),  # it gets back
        (-2.0, 0.5, 10.0, -0.5, 0.0),  # but not more than it has put in
        (-2.0, 0.0, 10.0, 0.0, 0.0),
        (0.0, 5.0, 1.0, 0.0, 1.0),
        (1.0, 0.0, 10.0, 1.0, 1.0),
        (0.0, 1.0, 0.5, 0.0, 0.5),
    ],
)
@BOTH
def test_what_a_worlds_springs_return_was_stored_before(elastic_Nm, stored_J, most_J, work_J, kept_J, sign):
    bench = binary()
    h = bench.h
    h.moved_counts, h.world_elastic_Nm, h.world_J, h.world_most_J = 64 * sign, elastic_Nm * sign, stored_J, most_J
    assert watch_motion(bench.c, h) == Trip.NONE
    assert (h.work[0], h.work_sum, h.world_J) == (work_J, work_J, kept_J)


def test_the_account_of_a_worlds_springs_needs_a_new_position():
    bench = binary()
    h = bench.h
    h.fresh, h.moved_counts, h.world_elastic_Nm, h.world_J, h.world_most_J = 0, 64, 2.0, 3.0, 10.0
    watch_motion(bench.c, h)
    assert (h.work[0], h.world_J) == (0.0, 3.0)


@BOTH
def test_what_a_joint_stores_is_weighed_at_the_tip(sign):
    bench = binary(is_joint=1)
    h = bench.h
    h.moved_counts, h.world_elastic_Nm, h.unpaid_J, h.world_most_J = 32 * sign, 2.0, 0.25, 10.0
    watch_motion(bench.c, h)
    assert (h.work[0], h.world_J) == (sign * 1.0 + 0.25, 0.0)


def test_the_push_of_a_storing_law_is_without_the_worlds_part():
    bench = binary(stores=1)
    h = bench.h
    h.moved_counts, h.pushed_Nm, h.world_Nm = 32, 3.0, 1.0
    watch_motion(bench.c, h)
    assert (h.work[0], h.contact_J) == (1.0, -1.0)
