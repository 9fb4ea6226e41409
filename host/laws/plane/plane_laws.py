"""Loading and compilation of laws in the plane: built-in laws, and functions in the user's files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from coulombus.host.laws.law import Declaration, Parameters, declaration_of
from coulombus.host.laws.laws import BUILTIN_LAWS, LawError, load_declared
from coulombus.host.laws.parameters import set_parameters
from coulombus.host.laws.plane.plane_coulomb import plane_coulomb
from coulombus.host.laws.plane.plane_dahl import plane_dahl
from coulombus.host.laws.plane.plane_karnopp import plane_karnopp
from coulombus.host.laws.plane.plane_law import (
    IN_PLANE,
    PlaneLawFunction,
    PlaneLawRecord,
    PlaneMotionRecord,
    PlaneStateRecord,
)
from coulombus.host.laws.plane.plane_line import plane_line
from coulombus.host.laws.plane.plane_lugre import plane_lugre
from coulombus.host.laws.plane.plane_viscous import plane_viscous
from coulombus.host.laws.plane.plane_wall import plane_wall
from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import RecordArray, new_records
from coulombus.rigs.rig import Rig

__all__ = ["PLANE_LAWS", "PlaneLaw", "builtin_laws", "load_plane_law"]

IN_PLANE.built_in.update(
    (law.name, law)
    for law in map(
        declaration_of, (plane_coulomb, plane_karnopp, plane_viscous, plane_wall, plane_line, plane_lugre, plane_dahl)
    )
    if law is not None
)
PLANE_LAWS: Mapping[str, Declaration] = MappingProxyType(IN_PLANE.built_in)
"""The built-in laws in the plane by their names."""


def builtin_laws(rig: Rig) -> Mapping[str, Declaration]:
    """Return the built-in laws for a rig by their names: laws of one axis, or laws in the plane."""
    return BUILTIN_LAWS if rig.kinematics is None else PLANE_LAWS


@kernel
def _drive(
    law_function: PlaneLawFunction,
    motion: PlaneMotionRecord,
    law: PlaneLawRecord,
    state: PlaneStateRecord,
    t_s: npt.NDArray[np.float64],
    x_m: npt.NDArray[np.float64],
    v_m_s: npt.NDArray[np.float64],
    psi_N: npt.NDArray[np.float64],
) -> int:
    """Evaluate the law along a motion; return the first sample with a force that is not finite, or -1."""
    for k in range(len(t_s)):
        before = max(k - 1, 0)
        motion.dt_s = t_s[k] - t_s[before] if k > 0 else t_s[1] - t_s[0]
        for i in range(2):
            motion.x_m[i] = x_m[k, i]
            motion.v_m_s[i] = v_m_s[k, i]
        fx, fy = law_function(motion, law, state)
        psi_N[k, 0], psi_N[k, 1] = fx, fy
        if not (math.isfinite(fx) and math.isfinite(fy)):
            return k
        state.psi_N[0], state.psi_N[1] = fx, fy
    return -1


@dataclass(frozen=True)
class PlaneLaw:
    """A compiled law in the plane with its parameters.

    Attributes
    ----------
    name : the name in the rig file
    function : the compiled function for kernels
    declaration, parameters : None for a law without named parameters
    """

    name: str
    function: PlaneLawFunction
    declaration: Declaration | None
    parameters: Parameters | None

    def record(self) -> RecordArray[PlaneLawRecord]:
        """Return the parameters for kernels, as an array of one record."""
        record = new_records(PlaneLawRecord)
        if self.declaration is not None and self.parameters is not None:
            self.declaration.fill(record[0], self.parameters)
        return record

    def along(
        self, t_s: npt.ArrayLike, x_m: npt.ArrayLike, v_m_s: npt.ArrayLike | None = None
    ) -> npt.NDArray[np.float64]:
        """Return the force at each sample of a motion [N], shape (n, 2), from the relaxed state.

        Parameters
        ----------
        t_s : ascending times, two or more [s]
        x_m : positions at these times, shape (n, 2) [m]
        v_m_s : velocities at these times, shape (n, 2) [m/s]; None: the slope of the interval that ends
            there, 0 at the first

        Raises
        ------
        coulombus.host.laws.laws.LawError
            the law returned a force that is not finite
        """
        times, places = np.ascontiguousarray(t_s, np.float64), np.ascontiguousarray(x_m, np.float64)
        if v_m_s is None:
            slopes = np.diff(places, axis=0) / np.diff(times)[:, None]
            velocities = np.vstack((np.zeros((1, 2)), slopes))
        else:
            velocities = np.ascontiguousarray(v_m_s, np.float64)
        forces = np.zeros_like(places)
        motion, state = new_records(PlaneMotionRecord), new_records(PlaneStateRecord)
        failed = _drive(self.function, motion[0], self.record()[0], state[0], times, places, velocities, forces)
        if failed >= 0:
            raise LawError(
                f"law {self.name!r} returned {forces[failed].tolist()} N at t_s={times[failed]:g}; "
                "expected two finite numbers"
            )
        return forces


def load_plane_law(name: str, overrides: Sequence[str] = (), directory: Path | None = None) -> PlaneLaw:
    """Return a law in the plane by its name, with its default parameters except for "KEY=VALUE".

    Parameters
    ----------
    name : one of `PLANE_LAWS`, ``file.py:function`` or ``module:function``
    directory : folder in which a file is searched before the current folder

    Raises
    ------
    coulombus.host.laws.laws.LawError
        there is no such law, or it does not compile
    coulombus.rigs.rig.RigError
        the law does not have a parameter, or its value is refused
    """
    function, declared = load_declared(name, directory, IN_PLANE)
    if declared is None:
        if overrides:
            raise LawError(f"--set {overrides[0]}: the law {name} names no parameters; declare them with plane_law")
        return PlaneLaw(name, function, None, None)
    return PlaneLaw(name, function, declared, set_parameters(declared, overrides))
