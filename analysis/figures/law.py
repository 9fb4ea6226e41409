"""A law along a motion: the motion, the torque over time, and the loop that they make."""

from __future__ import annotations

from typing import TYPE_CHECKING

from coulombus.recording.pictures.style import BLUE, VERMILION, figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from coulombus.host.laws.along import Driven

__all__ = ["draw_law"]


def draw_law(driven: Driven) -> Figure:
    """Draw the angle and the torque over the time, and the torque over the angle."""
    samples = driven.samples
    with figure(8.0, 5.2, 2, 2) as (made, panels):
        (motion, loop), (torque, speed) = panels
        motion.plot(samples["t_s"], samples["x_rad"], color=BLUE)
        motion.set(title="motion", xlabel="time [s]", ylabel="angle [rad]")
        torque.plot(samples["t_s"], samples["torque_Nm"], color=VERMILION)
        torque.set(title="friction", xlabel="time [s]", ylabel="torque [Nm]")
        loop.plot(samples["x_rad"], samples["torque_Nm"], color=VERMILION)
        loop.set(title="over the angle", xlabel="angle [rad]", ylabel="torque [Nm]")
        speed.plot(samples["v_rad_s"], samples["torque_Nm"], color=VERMILION)
        speed.set(title="over the speed", xlabel="speed [rad/s]", ylabel="torque [Nm]")
    return made
