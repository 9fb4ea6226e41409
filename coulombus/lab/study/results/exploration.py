r"""How a hand explored a display, from its recording.

The angle :math:`\theta` of the handle is the motor's encoder, the torque :math:`\tau` the handle's
transducer, both at the rig's rate. The speed is the difference of the angle over `WINDOW_S`, so that
one count of the encoder is no motion:

.. math:: path = \sum |\Delta\theta|, \qquad work = \sum \tau\, \Delta\theta .

Only the display counts, from its first phase to its end.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt

from coulombus.recording.reading import read
from coulombus.recording.signals import Recording

__all__ = ["Exploration", "explored", "mean_of"]

WINDOW_S = 0.02
MOVING_RAD_S = 0.1
TURN_RAD = 0.02
"""A reversal is a way back by so much."""


@dataclass(frozen=True)
class Exploration:
    """Figures of one display, or the mean of several.

    Attributes
    ----------
    path_rad : how far the handle turned, both ways counted
    range_rad : from its lowest to its highest angle
    reversals : how often it turned back by `TURN_RAD`
    moving : share of the time at more than `MOVING_RAD_S`
    speed_rad_s : mean speed while it moved; 0: it did not
    peak_rad_s : largest speed
    peak_Nm : largest torque of the hand; None of a rig without a transducer
    work_J : what the hand gave to the handle; None of a rig without a transducer
    """

    path_rad: float
    range_rad: float
    reversals: float
    moving: float
    speed_rad_s: float
    peak_rad_s: float
    peak_Nm: float | None
    work_J: float | None

    def as_dict(self) -> dict[str, float | None]:
        """Return it as plain values for JSON."""
        return asdict(self)


def explored(path: Path) -> Exploration | None:
    """Return how the hand explored the display that was recorded; None where nothing was shown.

    Raises
    ------
    coulombus.recording.pcapng_blocks.RecordingError
        it is no recording
    """
    recording = read(path)
    angle = recording["motor.position_rad"]
    began, ended = _span(recording)
    inside = (angle.t_s >= began) & (angle.t_s <= ended)
    t_s, theta = angle.t_s[inside], angle.values[inside]
    if len(t_s) < 2:
        return None
    lag = min(max(1, round(WINDOW_S / float(np.median(np.diff(t_s))))), len(t_s) - 1)
    speed = np.abs(theta[lag:] - theta[:-lag]) / (t_s[lag:] - t_s[:-lag])
    moving = speed > MOVING_RAD_S
    peak_Nm = work_J = None
    if "brake.handle_torque_Nm" in recording.signals:
        torque = recording["brake.handle_torque_Nm"]
        if len(torque.t_s):
            push = np.interp(t_s, torque.t_s, torque.values)
            peak_Nm = float(np.abs(push).max())
            work_J = float(np.sum((push[1:] + push[:-1]) / 2 * np.diff(theta)))
    return Exploration(
        path_rad=float(np.abs(np.diff(theta)).sum()),
        range_rad=float(np.ptp(theta)),
        reversals=float(_reversals(theta)),
        moving=float(moving.mean()),
        speed_rad_s=float(speed[moving].mean()) if moving.any() else 0.0,
        peak_rad_s=float(speed.max()),
        peak_Nm=peak_Nm,
        work_J=work_J,
    )


def _span(recording: Recording) -> tuple[float, float]:
    phases = [t_s for t_s, text in recording.markers if text.startswith("phase ") and text != "phase end"]
    ends = [t_s for t_s, text in recording.markers if text == "phase end"]
    return min(phases, default=-np.inf), max(ends, default=np.inf)


def _reversals(theta: npt.NDArray[np.float64]) -> int:
    """Return how often an angle turned back by `TURN_RAD`."""
    count, going, extreme = 0, 0, float(theta[0])
    for angle in theta.tolist():
        if (going >= 0 and angle > extreme) or (going < 0 and angle < extreme):
            extreme = angle
            going = going or (1 if angle - theta[0] >= TURN_RAD else 0)
        elif abs(angle - extreme) >= TURN_RAD:
            count += going != 0
            going, extreme = (-1 if angle < extreme else 1), angle
    return count


def mean_of(explorations: list[Exploration]) -> Exploration:
    """Return the mean of each figure over displays; None where one has none."""
    means = {}
    for quantity in fields(Exploration):
        values = [getattr(each, quantity.name) for each in explorations]
        means[quantity.name] = None if None in values else float(np.mean(values))
    return Exploration(**means)  # type: ignore[arg-type]
