"""One simulated run behind a figure: recorded, or refused with what to do about it."""

from __future__ import annotations

from pathlib import Path

from coulombus.host.errors import SafetyTrip
from coulombus.lab.simulate import simulate
from coulombus.recording.measures import phases
from coulombus.recording.reading import blocks
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig, RigError

__all__ = ["displayed", "need_modes"]

BELIEF_SHARE = 0.97
"""The belief counts as right from this share of the true friction on: identification is as good."""


def need_modes(rig: Rig, *modes: str) -> None:
    """Refuse a rig without the modes that a study runs.

    Raises
    ------
    coulombus.rigs.rig.RigError
        a mode is missing
    """
    missing = [mode for mode in modes if mode not in rig.modes]
    if missing:
        raise RigError(
            [
                f"rig {rig.name!r} has no [mode.{mode}], which this study runs; it has {', '.join(rig.modes)}: add it"
                for mode in missing
            ]
        )


def _belief(axis: Axis, mode: str) -> str:
    """Return what to do where the controller believes in less friction than the simulated rig has;
    "" where it does not.
    """
    plant = axis.simulation.plant
    believed, true = axis.mechanics.friction_Nm, plant.coulomb_Nm + plant.brake_off_state_Nm
    if believed >= BELIEF_SHARE * true:
        return ""
    return (
        f"; identify first: the belief mechanics.friction_Nm is {believed:g} Nm, the simulated rig has {true:g} Nm "
        f"(plant.coulomb_Nm + plant.brake_off_state_Nm); set mechanics.friction_Nm to what 'coulombus identify' finds, and "
        f"mode.{mode}.motor_limit_Nm to at least 1.2 times that"
    )


def displayed(rig: Rig, mode: str, path: Path, what: str, *, seed: int = 0) -> Path:
    """Run the rig's whole schedule in `mode`, record it at `path`, and return that.

    Parameters
    ----------
    what : the run's name in an error

    Raises
    ------
    coulombus.host.errors.SafetyTrip
        arming was refused, the run tripped, or it showed nothing; the text says why and what to do
    """
    axis = rig.one_axis()
    result = simulate(rig, mode, axis.phase_starts_s[-1], record=path, seed=seed)
    where = f"rig {rig.name!r}, mode {mode}, {what}"
    if result.trip is not None:
        raise SafetyTrip(f"{where}: the run tripped: {result.trip}{_belief(axis, mode)}")
    if not phases(blocks(path)):
        raise SafetyTrip(f"{where}: the display never began; give the rig a schedule ([[phase]])")
    return path
