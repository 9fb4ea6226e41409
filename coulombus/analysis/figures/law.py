"""Plot of a law along a motion: the motion, the torque over time, and the hysteresis loop."""

from __future__ import annotations

from typing import TYPE_CHECKING

from coulombus.recording.pictures.style import BLACK, VERMILION, figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from coulombus.host.laws.along import Driven, GivenLaw

__all__ = ["draw_law"]


PARAMETERS_IN_A_LINE = 4


def titled(given: GivenLaw) -> str:
    """Return a law's name and its parameters, wrapped for a plot."""
    texts = given.parameter_texts
    lines = [texts[k : k + PARAMETERS_IN_A_LINE] for k in range(0, len(texts), PARAMETERS_IN_A_LINE)]
    return "\n".join([f"law {given.name}", *(", ".join(line) for line in lines)])


def draw_law(given: GivenLaw, driven: Driven) -> Figure:
    """Draw the angle and the torque over the time, and the torque over the angle and the speed; the
    title has the law's parameters.
    """
    samples = driven.samples
    with figure(8.0, 5.2, 2, 2) as (made, panels):
        (motion, loop), (torque, speed) = panels
        made.suptitle(titled(given), fontsize=9, x=0.01, ha="left")
        motion.plot(samples["t_s"], samples["x_rad"], color=BLACK)
        motion.set(title="motion", xlabel="time [s]", ylabel="angle [rad]")
        torque.plot(samples["t_s"], samples["torque_Nm"], color=VERMILION)
        torque.set(title="friction", xlabel="time [s]", ylabel="torque [Nm]")
        loop.plot(samples["x_rad"], samples["torque_Nm"], color=VERMILION)
        loop.set(title="over the angle", xlabel="angle [rad]", ylabel="torque [Nm]")
        speed.plot(samples["v_rad_s"], samples["torque_Nm"], color=VERMILION)
        speed.set(title="over the speed", xlabel="speed [rad/s]", ylabel="torque [Nm]")
    return made
