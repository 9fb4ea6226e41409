"""`coulombus plan --json` held against Davis, Burns, Bril and Lukkien 2007, computed anew from the
printed columns alone.
"""

from __future__ import annotations

from fractions import Fraction
from math import ceil

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.cli.plan import message_rows
from coulombus.rigs.plan.response_times import Errors
from coulombus.rigs.plan.rig_plan import Assumptions, plan
from coulombus.rigs.rig import load_rig

EXACT = (125_000, 250_000, 500_000, 800_000, 1_000_000)  # a bit is a whole number of nanoseconds
DATA_BYTES = {"NMT": 2, "SYNC": 0, "EMCY": 8, "SDO request": 8, "SDO response": 8, "heartbeat": 1}


def longest_bits(data_bytes):
    """Frame of 11 bits' identifier with all the stuffing that it may need, and the inter-frame
    space.
    """
    return 8 * data_bytes + 44 + (34 + 8 * data_bytes - 1) // 4 + 3


def exact(value):
    return Fraction(str(value))


def recomputed(rows, rank, bitrate, errors=0, errors_interval_us=1):
    """Return (blocking, response) of a row [us], None for a response that nothing bounds (equations
    10 to 13, 16 to 18).
    """
    tau = Fraction(1_000_000, bitrate)
    c = [row["bits"] * tau for row in rows]
    t, j = ([exact(row[key]) for row in rows] for key in ("period_us", "jitter_us"))
    blocking = max(c[rank + 1 :], default=Fraction(0))
    each = 31 * tau + max(c[: rank + 1])
    if sum(c[k] / t[k] for k in range(rank + 1)) + errors * each / exact(errors_interval_us) >= 1:
        return blocking, None

    def least(start, after):
        while (following := after(start)) != start:
            start = following
        return start

    def fault(window):
        return errors * ceil(window / exact(errors_interval_us)) * each

    busy = least(
        c[rank],
        lambda x: fault(x) + blocking + sum(ceil((x + j[k]) / t[k]) * c[k] for k in range(rank + 1)),
    )
    responses = []
    for q in range(ceil((busy + j[rank]) / t[rank])):
        ahead = blocking + q * c[rank]
        w = least(
            ahead,
            lambda x, ahead=ahead: (
                fault(x + c[rank]) + ahead + sum(ceil((x + j[k] + tau) / t[k]) * c[k] for k in range(rank))
            ),
        )
        responses.append(j[rank] + w - q * t[rank] + c[rank])
    return blocking, max(responses)


@st.composite
def rigs(draw):
    """Rigs from idle to overloaded."""
    name = draw(st.sampled_from(["bench", "paper", "two_axes"]))
    period_us = draw(st.sampled_from([500, 900, 1000, 1250, 1500, 2000, 3000, 5000, 10_000]))
    window = draw(st.sampled_from([0.3, 0.5, 0.74, 0.9, 0.99]))

    def seconds(*choices):
        return draw(st.sampled_from(choices))

    overrides = [
        f"bus.bitrate_bit_s={draw(st.sampled_from(EXACT))}",
        f"bus.period_s={period_us * 1e-6:.6f}",
        f"bus.tpdo_window_s={round(period_us * window) * 1e-6:.6f}",
        "plant.step_s=5e-5",
        f"host.heartbeat_s={seconds(0.005, 0.05)}",
        f"host.sdo_timeout_s={seconds(0.01, 0.5)}",
        f"host.compute_s={seconds(0.0, 1e-5, 1e-4)}",
        f"limits.missed_tpdo_cycles={draw(st.integers(1, 4))}",
        f"motor.setpoint_zero_cycles={draw(st.integers(1, 4))}",
    ]
    for node in ("motor", "brake"):
        overrides += [f"{node}.heartbeat_s={seconds(0.005, 0.02, 0.1)}", f"{node}.heartbeat_timeout_s=0.3"]
        overrides += [f"{node}.setpoint_fault_s={seconds(0.011, 0.1)}", f"{node}.sync_timeout_s={seconds(0.011, 0.1)}"]
    return name, overrides


@pytest.mark.thorough
@pytest.mark.slow
@settings(deadline=None, max_examples=60)
@given(rigs(), st.sampled_from([Errors(), Errors(), Errors(1, 10_000_000)]))
def test_the_columns_are_enough_to_compute_them_anew(chosen, errors):
    rig = load_rig(*chosen)
    first = plan(rig, assumptions=Assumptions(errors=errors))
    rows, rate = message_rows(first), rig.bus.bitrate_bit_s
    assert [row["can_id"] for row in rows] == sorted(row["can_id"] for row in rows)
    assert first.utilisation == pytest.approx(sum(row["bits"] * 1e6 / rate / row["period_us"] for row in rows))
    for rank, row in enumerate(rows):
        data_bytes = next((n for name, n in DATA_BYTES.items() if row["name"].endswith(name)), None)
        assert data_bytes is None or row["bits"] == longest_bits(data_bytes)
        blocking, response = recomputed(rows, rank, rate, errors.count, errors.interval_ns / 1e3)
        assert row["blocking_us"] == float(blocking)
        if response is None:
            assert not row["bounded"]
            assert row["response_us"] > row["deadline_us"]
        else:
            assert row["response_us"] == pytest.approx(float(response), abs=1e-6)


@pytest.mark.thorough
@settings(deadline=None, max_examples=100)
@given(rigs())
def test_a_plan_fits_when_every_response_meets_its_deadline_and_else_names_the_frame(chosen):
    rig_plan = plan(load_rig(*chosen))
    rows = message_rows(rig_plan)
    late = [row for row in rows if row["response_us"] > row["deadline_us"]]
    assert rig_plan.fits == (not late)
    assert rig_plan.fits == (rig_plan.reasons == ())
    for row in late:
        assert f"{row['name']} ({row['can_id']:03X}h)" in rig_plan.verdict()
    for row in rows:
        in_cycle = row["cycle_end_us"] is None or row["cycle_end_us"] <= row["cycle_deadline_us"]
        assert row["fits"] or not rig_plan.fits
        assert in_cycle or row["deadline_us"] <= row["cycle_deadline_us"]


def test_a_frame_that_may_miss_its_cycle_is_held_against_its_cycle():
    """At 800 kbit/s no watch of the bench rig trips, and yet its TPDOs may come after a window of
    550 us.
    """
    rig_plan = plan(load_rig("bench", ["bus.tpdo_window_s=550e-6"]), bitrate_bit_s=800_000)
    rows = {row["name"]: row for row in message_rows(rig_plan)}
    assert not rig_plan.fits
    assert rows["brake TPDO1"]["deadline_us"] == rows["brake TPDO1"]["cycle_deadline_us"] == 550.0
    assert rows["brake TPDO1"]["response_us"] > rows["brake TPDO1"]["cycle_end_us"] > 550.0
    assert rows["motor RPDO1"]["deadline_us"] == 3000.0  # in time for its cycle: its watch


def test_the_rigs_of_the_package_fit_with_what_the_simulated_devices_take():
    for name in ("bench", "paper", "two_axes"):
        assert plan(load_rig(name)).fits


def test_the_hosts_time_is_the_rig_files():
    assert plan(load_rig("bench", ["host.compute_s=180e-6"])).fits
    slow = plan(load_rig("bench", ["host.compute_s=190e-6"]))
    assert not slow.fits
    assert "brake RPDO1 (202h) is through 1084 us" in slow.verdict()
    assert plan(load_rig("bench", ["host.compute_s=190e-6"]), assumptions=Assumptions(host_ns=0)).fits
