"""Simulate and record one run for a figure; refusals state the remedy."""

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
"""Least ratio of the modelled to the true friction, as accurate as identification."""


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
    """Return the remedy if the controller's model has less friction than the simulated rig, else ""."""
    plant = axis.simulation.plant
    believed, true = axis.mechanics.friction_Nm, plant.coulomb_Nm + plant.brake_off_state_Nm
    if believed >= BELIEF_SHARE * true:
        return ""
    return (
        f"; identify first: mechanics.friction_Nm is {believed:g} Nm, the simulated rig has {true:g} Nm "
        f"(plant.coulomb_Nm + plant.brake_off_state_Nm); set mechanics.friction_Nm to what 'coulombus identify' finds, and "
        f"mode.{mode}.motor_limit_Nm to at least 1.2 times that"
    )


def displayed(rig: Rig, mode: str, path: Path, what: str, *, seed: int = 0) -> Path:
    """Run the rig's whole schedule in `mode`, record it at `path`, and return the recording.

    Parameters
    ----------
    what : name of the run in an error

    Raises
    ------
    coulombus.host.errors.SafetyTrip
        arming was refused, the run tripped, or it displayed nothing; the text has the reason and the remedy
    """
    axis = rig.one_axis()
    result = simulate(rig, mode, axis.phase_starts_s[-1], record=path, seed=seed)
    where = f"rig {rig.name!r}, mode {mode}, {what}"
    if result.trip is not None:
        raise SafetyTrip(f"{where}: the run tripped: {result.trip}{_belief(axis, mode)}")
    if not phases(blocks(path)):
        raise SafetyTrip(f"{where}: the display never began; give the rig a schedule ([[phase]])")
    return path
