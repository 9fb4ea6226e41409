"""Fig. 13: friction at the handle: identified, compensated by the result, and identified again."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coulombus.analysis.rig.runs import displayed, need_modes
from coulombus.recording.friction.identify import Identification, identify
from coulombus.rigs.rig import Rig, load_rig

__all__ = ["EXPERIMENT", "FrictionStudy", "friction_study"]

COMPENSATION = 0.97


@dataclass(frozen=True)
class FrictionStudy:
    """Fig. 13: friction at the handle: identified, compensated by the result, and identified again."""

    before: Identification
    after: Identification
    compensation_Nm: float
    """Commanded torque of the motor in slip."""

    @property
    def coulomb_before_Nm(self) -> float:
        """Coulomb friction felt without compensation."""
        return self.before.felt.coulomb_Nm.value

    @property
    def coulomb_after_Nm(self) -> float:
        """Coulomb friction felt with the compensation."""
        return self.after.felt.coulomb_Nm.value

    @property
    def viscous_Nms_rad(self) -> float:
        """Viscous friction felt without compensation."""
        viscous = self.before.felt.viscous_Nms_rad
        return math.nan if viscous is None else viscous.value

    def as_dict(self) -> dict[str, Any]:
        """Return the figures of `coulombus analyse --json`, and both identifications."""
        return {
            "coulomb_before_Nm": self.coulomb_before_Nm,
            "coulomb_after_Nm": self.coulomb_after_Nm,
            "viscous_Nms_rad": self.viscous_Nms_rad,
            "compensation_Nm": self.compensation_Nm,
            "before": self.before.as_dict(),
            "after": self.after.as_dict(),
        }


STROKES = (
    (0.5, 1.2),
    (1.5, 0.8),
    (3.0, 0.6),
)  # speed [rad/s], length of a move [s]: slow moves give Coulomb, fast ones the slope
EXPERIMENT = ", ".join(
    ["{kind='rest', duration_s=1.0}"]
    + [
        f"{{kind='stroke', duration_s={4 * (move + 0.1):g}, speed_rad_s={speed}, move_s={move}, dwell_s=0.1}}"
        for speed, move in STROKES
    ]
)


def _stroked(rig: Rig, directory: Path, name: str, seed: int) -> Identification:
    what = f"identification experiment ({name} compensation)"
    return identify(displayed(rig, "hybrid", directory / f"{name}.pcapng", what, seed=seed))


def friction_study(rig: Rig | None = None, *, seed: int = 0) -> FrictionStudy:
    """Run the identification experiment before and after the compensation, through PDOs with the
    quantised encoder.

    The hand strokes the handle back and forth at three speeds, in mode hybrid with F_s = F_d = 0:
    the brake's coil is off, so the felt friction is the device's own, including the brake's
    off-state torque. In the first run the motor's torque limit is 0, so there is no sign check, and
    no estimate of the friction is needed. In the second run the motor gives 97 % of the identified
    Coulomb friction; nothing else about the motor is used.

    Parameters
    ----------
    rig : default is the bench rig; its own schedule is not used

    Raises
    ------
    coulombus.host.errors.SafetyTrip
        a run tripped; the text has the run and the reason
    coulombus.recording.friction.sliding.IdentifyError
        the hand does not slide the handle
    coulombus.rigs.rig.RigError
        the rig has no mode hybrid
    """
    rig = load_rig("bench") if rig is None else rig
    need_modes(rig, "hybrid")
    rig = rig.variant(
        f"phase=[{EXPERIMENT}]",
        "mode.hybrid.F_s_Nm=0.0",
        "mode.hybrid.F_d_Nm=0.0",
        "mode.hybrid.compensation=0.0",
        "mode.hybrid.motor_limit_Nm=0.0",
    )
    with tempfile.TemporaryDirectory(prefix="coulombus-") as directory:
        before = _stroked(rig, Path(directory), "before", seed)
        coulomb_Nm = before.felt.coulomb_Nm.value
        compensated = rig.variant(
            f"mechanics.friction_Nm={coulomb_Nm!r}",
            f"mode.hybrid.compensation={COMPENSATION}",
            f"mode.hybrid.motor_limit_Nm={1.2 * coulomb_Nm!r}",
        )
        after = _stroked(compensated, Path(directory), "after", seed)
    return FrictionStudy(before, after, COMPENSATION * coulomb_Nm)
