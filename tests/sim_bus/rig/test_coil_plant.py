"""The coil in the simulated rig: its heat, what the iron remembers, and its two faults.

Against formulas of their own.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.rig.plant import COIL_OPEN, COIL_SHORT, TRUTH_COLUMNS, advance, coil_current, new_plant


class Rig:
    def __init__(self, *overrides: str) -> None:
        self.rig = load_rig("bench", ("operator.tremor_Nm=0.0", *overrides))
        self.plant = new_plant(self.rig.one_axis())
        self.p = self.plant[0]

    def run(self, ms: int, brake_Nm: float = 0.0, hand_Nm: float = 0.0) -> float:
        """Return the largest brake torque on the handle, without sign."""
        truth = np.zeros((20, len(TRUTH_COLUMNS)))
        largest = 0.0
        for _ in range(ms):
            self.p.brake_Nm = brake_Nm
            advance(self.p, np.full(2, hand_Nm), 20, 0, 20, truth, 0)
            largest = max(largest, float(np.abs(truth[:, TRUTH_COLUMNS.index("brake_Nm")]).max()))
        return largest


HEAT = ("plant.coil_thermal_K_W=10.0", "plant.coil_thermal_s=2.0", "plant.coil_resistance_ohm=5.0")


def test_the_temperature_is_constant_by_default():
    rig = Rig("plant.temperature_degC=40.0")
    rig.run(500, 5.0)
    assert rig.p.temperature == 40.0


def test_heating_and_cooling_follow_the_formula():
    rig = Rig(*HEAT)
    rig.run(1000, 4.0)
    rise = 10.0 * 5.0 * (4.0 * 0.2) ** 2  # K: R_th R i^2
    assert rig.p.temperature == pytest.approx(22 + rise * (1 - math.exp(-1.0 / 2.0)), abs=0.1)  # the coil's lag is 3 ms
    hot = float(rig.p.temperature)
    rig.run(1000, 0.0)
    assert rig.p.temperature == pytest.approx(22 + (hot - 22) * math.exp(-1.0 / 2.0), abs=0.1)


def test_the_temperature_does_not_depend_on_how_the_steps_are_cut():
    long, short = Rig(*HEAT), Rig(*HEAT)
    force, truth = np.zeros(2001), np.zeros((1, len(TRUTH_COLUMNS)))
    long.p.brake_Nm = short.p.brake_Nm = 3.0
    advance(long.p, force, 20, 0, 4000, truth, -1)
    for k in range(4000):
        advance(short.p, force, 20, k, 1, truth, -1)
    assert long.p.temperature == pytest.approx(short.p.temperature, abs=0.02)
    assert long.p.fluid == short.p.fluid


def test_the_coil_has_no_part_in_the_mechanics():
    cold, warm = Rig(), Rig(*HEAT)
    for rig in (cold, warm):
        rig.run(300, 1.0, 3.0)
    assert (cold.p.x, cold.p.v, cold.p.w_brake) == (warm.p.x, warm.p.v, warm.p.w_brake)


def test_remanence_is_a_share_of_the_largest_torque_and_a_pulse_takes_it_away():
    rig = Rig("plant.brake_remanence=0.1")
    rig.run(300, 4.0)
    rig.run(500, 0.0)
    assert rig.p.fluid == pytest.approx(0.4, rel=1e-3)
    rig.run(300, 2.0)  # less than before adds nothing
    assert rig.p.fluid == pytest.approx(2.0, rel=1e-3)
    rig.run(500, 0.0)
    assert rig.p.fluid == pytest.approx(0.4, rel=1e-3)
    rig.p.reverse_A = 0.4 * 0.2 * 1.05  # a little more than what stands for 0.4 Nm, as the lag never reaches it
    before = float(rig.p.fluid)
    for _ in range(20):
        rig.run(1)
        assert rig.p.fluid <= before + 1e-9  # the pulse does not brake more than what was there
    rig.p.reverse_A = 0.0
    rig.run(500, 0.0)
    assert rig.p.fluid == pytest.approx(0.0, abs=1e-3)


def test_half_a_pulse_takes_half_and_too_strong_a_one_brakes():
    rig = Rig("plant.brake_remanence=0.1")
    rig.run(300, 4.0)
    rig.run(300, 0.0)
    rig.p.reverse_A = 0.2 * 0.2
    rig.run(100)
    rig.p.reverse_A = 0.0
    rig.run(300)
    assert rig.p.fluid == pytest.approx(0.2, rel=1e-2)
    rig.p.reverse_A = 1.2 * 0.2
    rig.run(200)
    assert rig.p.fluid == pytest.approx(1.0, rel=1e-2)


def test_remanence_never_pushes_and_the_balance_closes():
    rig = Rig("plant.brake_remanence=0.2")
    truth = np.zeros((20 * 900, len(TRUTH_COLUMNS)))
    row = 0
    for k in range(900):
        rig.p.reverse_A = 0.1 if 600 <= k < 620 else 0.0
        hand = 3.0 * math.sin(0.02 * k)
        rig.p.brake_Nm = 3.0 if k < 300 else 0.0
        advance(rig.p, np.full(2, hand), 20, 0, 20, truth, row)
        row += 20
    t = dict(zip(TRUTH_COLUMNS, truth.T, strict=True))
    assert np.all(t["brake_Nm"] * t["speed_rad_s"] <= 0)
    work = sum(t[f"{name}_work_J"] for name in ("operator", "motor", "brake", "friction"))
    balance = work - t["viscous_loss_J"] - t["kinetic_energy_J"]
    assert np.max(np.abs(balance)) < 1e-9
    assert np.max(np.abs(t["operator_work_J"])) > 0.1


def test_an_open_coil_has_no_current_and_a_short_one_the_supply_s():
    rig = Rig()
    rig.run(200, 4.0)
    assert coil_current(rig.p, 4.0) == pytest.approx(0.8)
    rig.p.coil_fault = COIL_OPEN
    assert coil_current(rig.p, 4.0) == 0
    rig.run(200, 4.0)
    assert rig.p.fluid == pytest.approx(0.0, abs=1e-4)
    rig.p.coil_fault = COIL_SHORT
    assert coil_current(rig.p, 4.0) > 10
    assert coil_current(rig.p, 0.0) == 0
    rig.run(200, 4.0)
    assert rig.p.fluid == pytest.approx(0.0, abs=1e-4)
