"""Hand-over of a loaded hand from the motor to the brake, compiled, and its settings.

At an orderly end the display goes on while the brake rises to its own torque plus what the motor displays; then the
law's gain, and with it the motor's torque, falls to 0. At a trip the motor ends at once, and the brake rises as fast as
it can (docs/safety.md, The safe state).

    c : the CONTROL record of an axis        h : its HOST record
"""

from __future__ import annotations

from collections.abc import Sequence

from coulombus.eds.own_devices import identity_from_1018h, is_own
from coulombus.host.cycle.brake_model import DEFAULT_LAG_S, rise
from coulombus.host.cycle.output_limits import brake_bears_motor, law_pushes
from coulombus.host.cycle.records import ControlRecord, HostRecord, Phase
from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import Records
from coulombus.rigs.axis import Axis

__all__ = ["bear", "end_together", "hands_over", "ramp_gain", "set_hand_over", "take_over"]

RISE_LAGS, FADE_S = 3.0, 0.05
"""Rise of the brake in units of its lags, and the time in which the motor's torque ends."""


def set_hand_over(c: ControlRecord, axis: Axis, mode: str) -> None:
    """Set the hand-over of an axis in a mode.

    The motor's torque ends slowly, as in the safe state, if the brake cannot bear as much as the motor.
    """
    period_s = axis.bus.period_s
    pushes = law_pushes(axis) or axis.world is not None
    c["hands_over"] = mode == "active" or (mode == "hybrid" and pushes)
    lag_s = axis.brake.coil_lag_s + axis.brake.fluid_lag_s or DEFAULT_LAG_S
    c["rise_cycles"] = max(1, round(RISE_LAGS * lag_s / period_s))
    fade_s = FADE_S if brake_bears_motor(axis, mode) else axis.limits.safe_ramp_s
    c["fade_cycles"] = max(1, round(fade_s / period_s))
    c["ends_by_nmt"] = is_own("motor", identity_from_1018h(axis.description("motor")))


def end_together(controls: Sequence[Records]) -> None:
    """Let all axes of a bus hand over for as long as the slowest does."""
    for name in ("rise_cycles", "fade_cycles"):
        longest = max(int(control[name][0]) for control in controls)
        for control in controls:
            control[name] = longest


@kernel
def take_over(c: ControlRecord, h: HostRecord) -> None:
    """Set the torque that the brake bears from now on: its own torque, as expected behind its lags, and what
    the motor displayed before any doubt.
    """
    h.level_Nm = min(h.brake_lagged_Nm + h.displayed_Nm, c.brake_limit_Nm)
    h.takes_over = 1 if h.displayed_Nm > 0.0 else 0


@kernel
def bear(c: ControlRecord, h: HostRecord) -> float:
    """Return the set-point [Nm] with which the brake bears `level_Nm`; a brake that takes over rises as fast as
    it can.
    """
    return float(rise(c, h, h.level_Nm) if h.takes_over else h.level_Nm)


@kernel
def hands_over(c: ControlRecord, h: HostRecord) -> bool:
    """Return whether an orderly end still displays, because the brake takes over from the motor first."""
    return bool(h.stop == 1 and c.hands_over and h.phase == Phase.RUN and h.end_cycles < c.rise_cycles + c.fade_cycles)


@kernel
def ramp_gain(c: ControlRecord, h: HostRecord) -> None:
    """Let the law's gain rise to 1; at an orderly end let it fall to 0, once the brake has risen."""
    if h.end_cycles == 0:
        h.gain = min(h.gain + c.gain_step, 1.0)
    elif h.end_cycles > c.rise_cycles:
        h.gain = max(h.gain - 1.0 / c.fade_cycles, 0.0)
