r"""The parameters of the paper's loop, checked: device, operator, friction, sampling, delay, encoder.

.. math:: m\dot v + b v + Z_o v = f_h - \psi, \qquad \psi_k = c\,\mathrm{sgn}(\hat v_k), \qquad \hat v_k = (x_k - x_{k-1})/T

:math:`\psi_k` acts from :math:`kT + \tau` for one period. The defaults are the paper's section
4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from coulombus.analysis.theory.operators import Operator, ParameterError

__all__ = ["Operator", "ParameterError", "Parameters"]

GRID_OF_DELAYS = 1e-9
"""Distance from a whole number of periods, relative to a period, below which a delay counts as whole."""


@dataclass(frozen=True)
class Parameters:
    """All parameters of the loop's analysis, in SI units of a linear axis.

    Raises
    ------
    ParameterError
        a parameter is refused, with the reason: NaN, a negative mass or damping, no mass at all, a
        period or friction that is not positive, a delay that is negative or not shorter than the
        window
    """

    mass_kg: float = 0.1
    damping_Ns_m: float = 0.5
    operator: Operator = field(default_factory=Operator)
    friction_N: float = 10.0
    period_s: float = 1e-3
    delay_s: float = 0.0
    resolution_m: float = 0.0
    """Encoder's resolution; 0: none, as in the paper's simulation."""
    window_s: float = 10.0
    """Duration of a simulation, as in Fig. 10."""

    def __post_init__(self) -> None:
        for name in ("mass_kg", "damping_Ns_m", "friction_N", "period_s", "delay_s", "resolution_m", "window_s"):
            value = getattr(self, name)
            if not math.isfinite(value):
                raise ParameterError(f"{name} = {value}: expected a finite number")
            if value < 0:
                raise ParameterError(f"{name} = {value:g} is negative")
            if value == 0 and name in ("friction_N", "period_s", "window_s"):
                raise ParameterError(f"{name} = 0: must be positive")
        if self.total_mass_kg <= 0:
            raise ParameterError("mass_kg = 0 and the operator has no inertia: the velocity would jump with the force")
        if self.delay_s >= self.window_s:
            raise ParameterError(
                f"delay_s = {self.delay_s:g} is not shorter than window_s = {self.window_s:g}: the force would never act"
            )
        if self.period_s >= self.window_s:
            raise ParameterError(f"period_s = {self.period_s:g} is not shorter than window_s = {self.window_s:g}")

    @property
    def total_mass_kg(self) -> float:
        """Device and the operator's inertia, in kg."""
        return self.mass_kg + self.operator.parts().inertia

    @property
    def delay_parts(self) -> tuple[int, float]:
        """The delay as whole cycles and the rest in s, in [0, T)."""
        cycles = self.delay_s / self.period_s
        whole = math.floor(cycles + GRID_OF_DELAYS)
        rest = (cycles - whole) * self.period_s
        return whole, rest if rest > GRID_OF_DELAYS * self.period_s else 0.0

    @property
    def nyquist_Hz(self) -> float:
        """Half of the sampling rate, in Hz."""
        return 0.5 / self.period_s
