"""Parameters that change while the law displays: taken whole between two cycles, ramped, bounded,
and refused with a reason.
"""

from __future__ import annotations

import pytest

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.live_parameters import follow, offer
from coulombus.host.cycle.parameter_changes import ChangeRefused, LiveParameters, NotTaken
from coulombus.host.cycle.records import SLOTS, LiveRecord, OrderRecord, Phase, Slot
from coulombus.kernels.decorator import Entry
from coulombus.kernels.records import dtype_of
from coulombus.rigs.rig import load_rig
from host_bench import HostBench


class Live(HostBench):
    """A bench whose host is in its law, and whose parameters are live."""

    def __init__(self, mode="active", *overrides):
        super().__init__(mode, *overrides)
        self.enter(Phase.RUN)
        self.control, self.each = self.k.control, (self.k,)
        self.control["release_Nm"] = 1.0  # no change is made longer by it
        self.parameters = LiveParameters(self)

    def __iter__(self):
        return iter(self.each)

    def set(self, over_s=0.1, **values):
        return self.want(self.parameters.change(values, over_s=over_s))

    def want(self, change):
        self.k.live["wanted"] = change.number
        return change

    def refused(self, over_s=0.1, **values):
        before = dict(self.parameters._axes[0].value), int(self.k.live["wanted"][0])
        with pytest.raises(ChangeRefused) as error:
            self.parameters.change(values, over_s=over_s)
        assert (self.parameters._axes[0].value, int(self.k.live["wanted"][0])) == before
        assert error.value.exit_status == 2
        return str(error.value)


@pytest.fixture
def bench():
    return Live()


def test_a_change_is_ramped_in_so_many_cycles_and_then_stands(bench):
    bench.set(over_s=0.1, F_s_Nm=0.7, F_d_Nm=0.5)
    found = []
    for _ in range(102):
        bench.cycle()
        found.append((float(bench.axis.law.F_s), float(bench.axis.law.F_d)))
    assert found[0] == (1.2 + (0.7 - 1.2) * (1 / 100), 1.0 + (0.5 - 1.0) * (1 / 100))
    assert found[49] == (1.2 + (0.7 - 1.2) * 0.5, 1.0 + (0.5 - 1.0) * 0.5)
    assert found[98] != (0.7, 0.5)
    assert found[99:] == [(0.7, 0.5)] * 3
    assert (float(bench.axis.law.K_p), bench.phase) == (100.0, Phase.RUN)


@pytest.mark.parametrize(
    ("values", "cycles"),
    [
        ({"F_s_Nm": 0.7, "F_d_Nm": 0.5}, 250),  # 0.5 Nm at 0.002 Nm a cycle
        ({"F_s_Nm": 1.1, "F_d_Nm": 0.4}, 300),  # the longer fall
        ({"F_s_Nm": 1.15, "F_d_Nm": 1.0}, 100),
        ({"F_s_Nm": 1.4}, 100),  # more torque throws nobody
        ({"K_p_Nm_rad": 1.0}, 100),
    ],
)
def test_a_torque_falls_no_faster_than_a_loaded_hand_is_let_go(bench, values, cycles):
    bench.control["release_Nm"] = 0.002
    change = bench.set(over_s=0.1, **values)
    assert (change.cycles, change.over_s) == (cycles, cycles / 1000)


@pytest.mark.parametrize(
    ("force_N", "rates_Nm", "cycles"),
    [(2.0, (0.001, 0.002), 200), (2.0, (0.002, 0.001), 300), (2.9, (0.002, 0.001), 100), (4.0, (0.001, 0.001), 100)],
)
def test_a_force_of_the_tip_falls_no_faster_than_the_joints_that_bear_it(force_N, rates_Nm, cycles):
    """By 1 N: 0.2 Nm at a joint with a lever of 0.2 m, 0.3 Nm at one with 0.3 m."""
    k = Controllers(load_rig("plane", ["law.plane_karnopp.F_s_N=3.0", "law.plane_karnopp.F_d_N=2.0"]), "hybrid")
    k.control["period_ns"], k.control["release_Nm"] = 1_000_000, rates_Nm
    k.axes["plane"]["pose"]["jacobian"][0] = [[0.12, 0.0], [0.16, -0.3]]
    change = LiveParameters(k).change({"F_s_N": force_N}, k.rig.axes[0].name, over_s=0.1)
    assert (change.cycles, change.over_s) == (cycles, cycles / 1000)


def test_an_undo_falls_no_faster_either(bench):
    bench.set(F_s_Nm=1.4)
    bench.cycles(101)
    bench.control["release_Nm"] = 0.001
    assert bench.parameters.undo(over_s=0.1).cycles == 200


def test_nothing_changes_before_the_next_cycle_begins(bench):
    bench.cycle()
    bench.set(F_s_Nm=1.3)
    assert float(bench.axis.law.F_s) == 1.2
    bench.finish()
    assert (float(bench.axis.law.F_s), int(bench.axis.live.taken)) == (1.2, 0)
    bench.cycle()
    assert float(bench.axis.law.F_s) > 1.2
    assert int(bench.axis.live.taken) == 1


def test_an_order_that_is_not_wanted_yet_does_nothing(bench):
    bench.parameters.change({"F_s": 1.3}, over_s=0.1)
    bench.cycles(5)
    assert float(bench.axis.law.F_s) == 1.2


def test_a_second_change_goes_on_from_where_the_first_has_come(bench):
    bench.set(over_s=0.1, F_s_Nm=1.4)
    bench.cycles(50)
    half = float(bench.axis.law.F_s)
    assert half == pytest.approx(1.3)
    bench.set(over_s=0.2, F_d_Nm=0.8)
    bench.cycle()
    assert 0 < float(bench.axis.law.F_s) - half < 1e-3  # F_s goes on to where it was wanted, by the new time
    bench.cycles(199)
    assert (float(bench.axis.law.F_s), float(bench.axis.law.F_d)) == (1.4, 0.8)


@pytest.mark.parametrize("K_p", [400.0, 8000.0])
@pytest.mark.parametrize("counts", [3, -3])
def test_another_K_p_keeps_the_force_of_a_stuck_handle(K_p, counts):
    bench = Live("active", "mode.active.K_p_Nm_rad=2000.0")
    bench.cycles(5)
    for k in range(abs(counts)):
        bench.counts = (k + 1) * counts / abs(counts)
        bench.cycles(3)
    force = float(bench.axis.state.psi_Nm)
    assert 0.05 < abs(force) < 1.2
    bench.set(over_s=0.1, K_p_Nm_rad=K_p)
    forces = []
    for _ in range(110):
        bench.cycle()
        forces.append(float(bench.axis.state.psi_Nm))
    assert float(bench.axis.law.K_p) == K_p
    assert forces == pytest.approx([force] * 110, abs=1e-12)
    bench.counts += counts / abs(counts)  # and one count more is the new spring's
    bench.cycles(3)
    step = abs(float(bench.axis.state.psi_Nm)) - abs(force)
    assert step == pytest.approx(min(K_p * abs(float(bench.c.rad_count)), 1.2 - abs(force)), rel=1e-9)


def test_the_compensation_is_a_share_of_the_friction(bench):
    bench.set(compensation=0.25)
    bench.cycles(100)
    assert float(bench.c.compensation_Nm) == 0.25 * float(bench.c.friction_Nm)


def test_the_numbers_of_a_law_of_ones_own_stay():
    bench = Live("active", "law.user=[1.5, -2.0]")
    bench.set(F_d_Nm=0.9)
    bench.cycles(101)
    assert list(bench.axis.law.user[:3]) == [1.5, -2.0, 0.0]
    assert len(bench.axis.live.last) == SLOTS == Slot.USER + len(bench.axis.law.user)


@pytest.mark.parametrize(
    ("mode", "name", "value", "told"),
    [
        ("active", "F_s_Nm", 1.51, "F_s_Nm=1.51: expected from 0 to 1.5 Nm (mode.active.motor_limit_Nm"),
        ("active", "F_s_Nm", -0.1, "expected from 0 to 1.5 Nm"),
        ("active", "F_s_Nm", float("nan"), "F_s_Nm=nan"),
        ("active", "F_s_Nm", float("inf"), "F_s_Nm=inf"),
        ("active", "K_p_Nm_rad", 0.0, "K_p_Nm_rad=0: expected more than 0 to 1e+07 Nm/rad"),
        ("active", "K_p_Nm_rad", 5e-324, "K_p_Nm_rad=4.94066e-324: expected from 1e-09 to 1e+07 Nm/rad"),
        ("active", "K_p_Nm_rad", 2e7, "the rig file's range ends there"),
        ("active", "compensation", 0.98, "expected from 0 to 0.97 (the rig file's range ends there)"),
        ("hybrid", "F_s_Nm", 400.0, "(limits.brake_torque_Nm ends there)"),
        ("passive", "F_d_Nm", 400.0, "(limits.brake_torque_Nm ends there)"),
    ],
)
def test_what_is_beyond_a_bound_is_refused_with_the_bound(mode, name, value, told):
    assert told in Live(mode).refused(**{name: value})


@pytest.mark.parametrize("mode", ["active", "passive", "hybrid"])
def test_what_is_at_its_bound_is_taken(mode):
    bench = Live(mode)
    (high,) = (row["high"] for row in bench.parameters.rows()[0] if row["name"] == "F_s_Nm")
    bench.set(F_s_Nm=high, F_d_Nm=high)
    bench.cycles(101)
    assert float(bench.axis.law.F_d) == high


def test_slip_above_stiction_is_refused_as_a_pair(bench):
    assert "F_d_Nm=1.3 with F_s_Nm=1.2: expected F_d_Nm at most F_s_Nm" in bench.refused(F_d_Nm=1.3)
    assert "F_d_Nm=1 with F_s_Nm=0.9" in bench.refused(F_s_Nm=0.9)
    bench.set(F_s_Nm=0.9, F_d_Nm=0.9)


def test_what_the_motor_shows_in_slip_counts_with_the_compensation():
    friction_Nm = 0.14
    bench = Live("active", "mode.active.motor_limit_Nm=1.0", "mode.active.F_s_Nm=1.0", "mode.active.F_d_Nm=1.0")
    bench.set(compensation=0.5)
    bench.cycles(101)
    bench = Live("active", "law.function='coulomb'", "mode.active.motor_limit_Nm=1.0", "mode.active.F_d_Nm=1.1")
    assert float(bench.c.friction_Nm) == friction_Nm
    assert "F_d_Nm=1.1 with compensation=0.1: mode.active.motor_limit_Nm" in bench.refused(compensation=0.1)


def test_a_law_without_stiction_has_no_parameter_of_it():
    bench = Live("active", "law.function='coulomb'")
    assert [row["name"] for row in bench.parameters.rows()[0]] == ["F_d_Nm", "compensation"]
    assert "F_s_Nm: the law coulomb has none; there is F_d_Nm, compensation" in bench.refused(F_s_Nm=1.0)
    bench.set(F_d_Nm=1.4)  # more than F_s, which is not its


LUGRE = (
    "law.function='lugre'",
    "law.lugre.F_s_Nm=1.3",
    "law.lugre.F_c_Nm=0.9",
    "law.lugre.sigma_0_Nm_rad=40.0",
)


def test_the_named_parameters_of_a_law_are_live():
    bench = Live("active", *LUGRE)
    rows = {row["name"]: row for row in bench.parameters.rows()[0]}
    assert list(rows) == [
        *("F_c_Nm", "F_s_Nm", "v_s_rad_s", "sigma_0_Nm_rad", "sigma_1_Nms_rad", "sigma_2_Nms_rad"),
        "compensation",
    ]
    row = rows["sigma_0_Nm_rad"]
    assert (row["unit"], row["value"], row["now"], row["low"], row["high"]) == ("Nm/rad", 40.0, 40.0, 0.0, 1e9)
    assert row["above_low"] is True
    assert rows["F_s_Nm"]["high"] == 1.5  # the motor's, as it says how much is displayed
    bench.set(F_c=0.5, sigma_0=80)
    bench.cycles(50)
    assert list(bench.axis.law.user[:4]) == pytest.approx([0.7, 1.3, 0.5, 60.0])
    bench.cycles(51)
    assert list(bench.axis.law.user[:4]) == [0.5, 1.3, 0.5, 80.0]
    assert (float(bench.axis.law.F_s), float(bench.axis.law.K_p)) == (1.2, 100.0)  # the mode's: not this law's


def test_what_named_parameters_ask_of_each_other_is_held():
    bench = Live("active", *LUGRE)
    assert "F_c_Nm=1.4 with F_s_Nm=1.3: expected F_c_Nm at most F_s_Nm" in bench.refused(F_c=1.4)
    assert "F_s_Nm=1.6: expected more than 0 to 1.5 Nm (mode.active.motor_limit_Nm" in bench.refused(F_s=1.6)
    assert "F_d: the law lugre has none; there is F_c_Nm" in bench.refused(F_d=1.0)
    bench.set(F_c=1.4, F_s=1.4)


def test_a_name_is_known_without_its_unit_and_the_nearest_is_told(bench):
    assert [one.name for one in bench.set(F_s=1.3, K_p=90).values] == ["F_s_Nm", "K_p_Nm_rad"]
    bench.cycle()
    assert "there is K_p_Nm_rad, F_s_Nm, F_d_Nm, compensation; did you mean 'compensation'?" in bench.refused(compens=1)
    assert "F_s_Nm is given twice" in bench.refused(F_s=1.3, F_s_Nm=1.3)
    assert "expected NAME=VALUE" in bench.refused()


def test_how_long_a_change_takes_has_bounds(bench):
    assert "within 0.05 s: expected 0.1 to 60 s" in bench.refused(over_s=0.05, F_s=1.3)
    assert "within nan s" in bench.refused(over_s=float("nan"), F_s=1.3)


def test_an_axis_is_named_where_the_rig_has_some(bench):
    with pytest.raises(ChangeRefused, match="axis 'y': the rig has no named axes"):
        bench.parameters.change({"F_s": 1.3}, "y")


def test_a_change_waits_for_the_one_before(bench):
    bench.set(F_s=1.3)
    with pytest.raises(NotTaken, match="the host does not cycle"):
        bench.parameters.change({"F_s": 1.4})
    bench.cycle()
    bench.set(F_s=1.4)


def test_undo_takes_the_changes_back_one_after_another(bench):
    for F_s in (1.3, 1.4):
        bench.set(F_s=F_s)
        bench.cycles(101)
    for F_s in (1.3, 1.2):
        change = bench.want(bench.parameters.undo(0.1))
        assert change.undo
        bench.cycles(101)
        assert float(bench.axis.law.F_s) == F_s
    with pytest.raises(ChangeRefused, match="there is no change to undo"):
        bench.parameters.undo()


def test_the_marker_has_old_and_new_value_to_the_last_bit(bench):
    assert bench.set(F_s=1.3, K_p=90, over_s=0.25).marker == (
        "set F_s_Nm 1.2 -> 1.3 Nm, K_p_Nm_rad 100 -> 90 Nm/rad in 0.25 s "
        f"[1: F_s_Nm={(1.2).hex()}>{(1.3).hex()} K_p_Nm_rad={(100.0).hex()}>{(90.0).hex()} in 250]"
    )


def test_what_is_on_its_way_is_told(bench):
    bench.set(F_s=1.4)
    bench.cycles(50)
    row = next(one for one in bench.parameters.rows()[0] if one["name"] == "F_s_Nm")
    assert (row["value"], row["now"], row["low"], row["high"]) == (1.4, pytest.approx(1.3), 0.0, 1.5)


# one order, cycle by cycle

_follow = Entry(follow)
LAW = ("K_p", "F_s", "F_d")


def ordered(bench, number, cycles, *values):
    """Order K_p, F_s, F_d and compensation, which begin at 100 Nm/rad, 1.2, 1 and 0 Nm."""
    user = [float(number) for number in bench.axis.law.user]
    offer(bench.k.live[0], number, [*values, *user], cycles)
    bench.k.live["wanted"] = number


def test_compiled_code_reads_two_orders_aligned():
    live, order = dtype_of(LiveRecord), dtype_of(OrderRecord)
    assert live.isalignedstruct
    assert order.isalignedstruct
    assert live["offered"].shape == (2,)


def test_every_value_begins_where_it_stands(bench):
    bench.c.compensation_Nm = 0.02
    ordered(bench, 1, 4, 60.0, 0.8, 0.6, 0.1)
    _follow(bench.axis)
    assert [float(bench.axis.law[name]) for name in LAW] == [90.0, 1.2 + (0.8 - 1.2) / 4, 1.0 + (0.6 - 1.0) / 4]
    assert float(bench.c.compensation_Nm) == 0.02 + (0.1 - 0.02) / 4


@pytest.mark.parametrize("cycles", [0, -1, 1])
def test_an_order_without_a_way_is_taken_in_one_cycle(bench, cycles):
    ordered(bench, 1, cycles, 60.0, 0.8, 0.6, 0.0)
    _follow(bench.axis)
    assert [float(bench.axis.law[name]) for name in LAW] == [60.0, 0.8, 0.6]


def test_the_last_cycle_has_the_ordered_value_to_its_last_bit(bench):
    """1.2 + (0.1 - 1.2) is not 0.1."""
    ordered(bench, 1, 3, 100.0, 0.1, 0.1, 0.0)
    assert 1.2 + (0.1 - 1.2) != 0.1
    for _ in range(3):
        _follow(bench.axis)
    assert float(bench.axis.law.F_s) == 0.1


@pytest.mark.parametrize(
    ("stuck", "phase", "K_p", "moved"),
    [
        (1, Phase.RUN, 50.0, True),
        (1, Phase.RUN, 100.0, False),
        (0, Phase.RUN, 50.0, False),
        (1, Phase.SAFE, 50.0, False),
        (0, Phase.SAFE, 50.0, False),
    ],
)
def test_only_of_a_stuck_handle_in_the_law_is_the_spring_moved(bench, stuck, phase, K_p, moved):
    """A force of 0.3 Nm at 100 Nm/rad is one at 50 Nm/rad of twice the way."""
    bench.axis.state.stuck, bench.h.phase = stuck, int(phase)
    bench.axis.motion.x_rad, bench.axis.state.x_stuck = 0.4, 0.1
    assert 0.4 - (0.4 - 0.1) != 0.1  # a spring that stays must not be computed again
    ordered(bench, 1, 1, K_p, 1.1, 0.9, 0.0)
    _follow(bench.axis)
    assert float(bench.axis.law.K_p) == K_p
    if moved:
        assert float(bench.axis.state.x_stuck) == pytest.approx(-0.2)
    else:
        assert float(bench.axis.state.x_stuck) == 0.1
