"""A motion for a law on its own: its samples cover the whole time."""

import numpy as np
import pytest

from coulombus.host.laws.path import ramp, sine


@pytest.mark.parametrize("rate_Hz", [1000.0, 700.0, 3.0])
def test_a_motion_has_its_first_and_its_last_instant(rate_Hz):
    for path in (sine(0.5, 0.25, 3.0, rate_Hz), ramp(2.0, 3.0, rate_Hz)):
        assert (path.t_s[0], path.t_s[-1]) == (0.0, pytest.approx(3.0))
        assert np.diff(path.t_s) == pytest.approx(1.0 / rate_Hz)
    assert sine(0.5, 0.25, 3.0, rate_Hz).x_rad[-1] == pytest.approx(-0.5)
    assert ramp(2.0, 3.0, rate_Hz).x_rad[-1] == pytest.approx(6.0)
