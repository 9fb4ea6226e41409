r"""Comparison of the torque that the hand feels with the one that is displayed, compiled.

    c : the CONTROL record of an axis        h : its HOST record

The transducer's torque :math:`f_h` must balance brake, friction and motor. With the brake's expected torque and the
friction together as :math:`\lambda`, the motor's torque :math:`\tau` and the direction of motion :math:`s`, the error is

.. math:: r = f_h + \tau - s\lambda - b v \quad\text{(moving)}, \qquad
          r = \mathrm{sgn}(f_h + \tau)\,\max(|f_h + \tau| - \lambda, 0) \quad\text{(at rest)}.

First-order lags follow it. :math:`\bar r` and :math:`\bar v` smooth noise, and the limit cycle of a law on the
motor, over 50 ms. :math:`e` follows :math:`(\bar r - J \dot{\bar v})\,\mathrm{sgn}\,\bar v`, at rest its magnitude, over
250 ms: the torque of an inertia that the rig file lacks, such as an arm's links, changes its sign within a stroke
and cancels. The size :math:`m` follows :math:`\lambda + |\tau| + 3 J |\dot{\bar v}|`. A handle that rests within
:math:`\lambda` says nothing, and nothing changes.

:math:`|e| > 0.6\,\mu m` is counted and gives a remark; :math:`|e| > \mu m` for `mismatch_cycles` trips, with the share
:math:`\mu` of `limits.handle_mismatch_share`. Both are at least a part of the torque with which a handle counts as
loaded. The joints of an arm are compared one by one: a force at the tip is wrong if, and only if, a joint's torque is.
"""

from __future__ import annotations

import math

from coulombus.host.cycle.records import ControlRecord, HostRecord, Phase
from coulombus.kernels.decorator import kernel

__all__ = ["MEAN_S", "SMOOTH_S", "compare_felt"]

SMOOTH_S, MEAN_S = 0.05, 0.25
"""Time constants of the error's smoothing and of its mean."""
SPEED_STEP = 0.2  # the direction of motion has a lag of five cycles: one count is not motion yet
STOPPED_SHARE = 0.2  # below this share of the smoothed speed the handle has stopped
INERTIA_DOUBT = 3.0  # an arm's links have more inertia than their joint
REMARK_SHARE = 0.6  # of the error that trips
LOADED_SHARE = 0.5  # least error that is counted, as a share of `still_handle_Nm`


@kernel
def _direction(v_counts: float, band_counts: float) -> float:
    """Return the sign of a speed, or 0 within the band."""
    return 1.0 if v_counts > band_counts else -1.0 if v_counts < -band_counts else 0.0


@kernel
def compare_felt(c: ControlRecord, h: HostRecord, motor_Nm: float) -> bool:
    """Compare the torques of a cycle; return whether the hand has not felt what is displayed for too long."""
    if h.phase != Phase.RUN or not h.fresh or not c.still_handle_Nm < math.inf:
        return False
    band_counts = SPEED_STEP * c.velocity_band_counts
    sign = 1.0 if c.rad_count > 0.0 else -1.0
    h.felt_v_counts += SPEED_STEP * (h.v_counts - h.felt_v_counts)
    change_counts = c.smooth_step * (h.v_counts - h.mean_v_counts)
    h.mean_v_counts += change_counts
    level_Nm = h.brake_lagged_Nm + c.friction_Nm
    borne_Nm = h.handle_Nm + motor_Nm
    moving = sign * _direction(h.felt_v_counts, max(band_counts, STOPPED_SHARE * abs(h.mean_v_counts)))
    if moving != 0.0:
        v = h.v_counts * c.rad_count * 1e9 / c.period_ns
        error_Nm = borne_Nm - moving * level_Nm - c.viscous * v
    else:
        excess_Nm = max(abs(borne_Nm) - level_Nm, 0.0)
        error_Nm = excess_Nm if borne_Nm > 0.0 else -excess_Nm
    h.felt_error_Nm += c.smooth_step * (error_Nm - h.felt_error_Nm)
    along = sign * _direction(h.mean_v_counts, band_counts)
    if moving == 0.0 and error_Nm == 0.0:
        return False
    inertia_Nm = c.inertia * change_counts * c.rad_count * (1e9 / c.period_ns) ** 2
    smooth_Nm = h.felt_error_Nm - inertia_Nm
    shown_Nm = smooth_Nm * along if along != 0.0 else abs(smooth_Nm)
    h.mean_error_Nm += c.mean_step * (shown_Nm - h.mean_error_Nm)
    size_Nm = level_Nm + abs(motor_Nm) + INERTIA_DOUBT * abs(inertia_Nm)
    h.mean_size_Nm += c.mean_step * (size_Nm - h.mean_size_Nm)
    most_Nm, least_Nm = c.mismatch_share * h.mean_size_Nm, LOADED_SHARE * c.still_handle_Nm
    if abs(h.mean_error_Nm) > max(REMARK_SHARE * most_Nm, least_Nm):
        h.implausible_torque += 1
    implausible = abs(h.mean_error_Nm) > max(most_Nm, 2.0 * least_Nm)
    h.felt_wrong = h.felt_wrong + 1 if implausible else 0
    return bool(h.felt_wrong > c.mismatch_cycles)
