"""The steps of a motion: the laws that compare counts depend on them, the others do not."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.host.laws.along import given_law


def last_torque(name, rate_Hz, *overrides):
    t = np.arange(round(0.2 * rate_Hz) + 1) / rate_Hz
    return float(given_law(name, overrides).along(t, 1.0 * t).samples["torque_Nm"][-1])


@pytest.mark.parametrize(
    ("name", "overrides", "at_1_kHz", "at_10_kHz"),
    [
        ("karnopp", (), 1.0, 1.2),
        ("coulomb", ("velocity_band_counts=2",), 1.0, 0.0),
        ("coulomb", (), 1.0, 1.0),
    ],
)
def test_a_band_in_counts_is_a_way_between_two_samples(name, overrides, at_1_kHz, at_10_kHz):
    assert last_torque(name, 1e3, *overrides) == at_1_kHz
    assert last_torque(name, 1e4, *overrides) == at_10_kHz


@pytest.mark.parametrize("name", ["dahl", "lugre", "gms", "leuven", "bliman_sorine", "stribeck"])
def test_the_steps_of_a_ramp_change_no_other_law(name):
    assert last_torque(name, 1e4) == pytest.approx(last_torque(name, 1e3), rel=1e-9)
