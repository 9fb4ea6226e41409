r"""The operator's impedance :math:`Z_o(s)`: rational, passive, with a realisation for simulation.

Polynomials are tuples of coefficients in descending powers of s. A mass, damper and spring,
:math:`Z_o = m_o s + b_o + k_o/s`, is ``(m_o, b_o, k_o)`` over ``(1, 0)``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.system.errors import CoulombusError

__all__ = ["Floats", "Operator", "OperatorParts", "ParameterError"]

Floats: TypeAlias = npt.NDArray[np.float64]
Complexes: TypeAlias = npt.NDArray[np.complex128]

ON_AXIS = 1e-9
"""Distance, in units of the largest pole, below which a pole is on the imaginary axis."""


class ParameterError(CoulombusError, ValueError):
    """A parameter is refused; the text has its name, its value and the reason."""

    exit_status = 2


@dataclass(frozen=True)
class OperatorParts:
    """Z_o(s) = inertia s + damping + C (sI - A)^-1 B: for simulation, with v as the input and a force as the output."""

    inertia: float
    damping: float
    A: Floats
    B: Floats
    C: Floats
    rest: Floats
    """Final states after the handle is moved by 1 m and held: a spring keeps its force, a Maxwell element relaxes."""


@dataclass(frozen=True)
class Operator:
    """A passive operator, Z_o(s) = numerator / denominator [Ns/m].

    The default is the paper's, 1.287 s + 29.33 + 178/s.

    Raises
    ------
    ParameterError
        NaN, improper (more than one pole at infinity), or not passive (not positive real), with the
        reason
    """

    numerator: tuple[float, ...] = (1.287, 29.33, 178.0)
    denominator: tuple[float, ...] = (1.0, 0.0)

    def __post_init__(self) -> None:
        for name, values in (("numerator", self.numerator), ("denominator", self.denominator)):
            if not values or not all(math.isfinite(value) for value in values):
                raise ParameterError(f"operator {name} {values}: expected finite numbers in descending powers of s")
        if not any(self.denominator):
            raise ParameterError("operator denominator is 0")
        numerator, denominator = _reduced(self.numerator, self.denominator)
        object.__setattr__(self, "numerator", numerator)
        object.__setattr__(self, "denominator", denominator)
        reason = _why_not_passive(np.array(numerator), np.array(denominator))
        if reason:
            raise ParameterError(f"operator Z_o = {_text(numerator)} / {_text(denominator)} {reason}")

    @classmethod
    def mass_damper_spring(cls, inertia: float, damping: float, stiffness: float) -> Operator:
        """Return Z_o(s) = inertia s + damping + stiffness / s, in kg, Ns/m and N/m."""
        for name, value in (("inertia", inertia), ("damping", damping), ("stiffness", stiffness)):
            if not value >= 0 or not math.isfinite(value):
                raise ParameterError(f"operator {name} {value}: a passive operator needs a finite value >= 0")
        return cls((inertia, damping, stiffness), (1.0, 0.0))

    @classmethod
    def parse(cls, text: str) -> Operator:
        """Return the operator of a text such as ``"1.287,29.33,178/1,0"``: coefficients in
        descending powers of s.
        """
        try:
            numerator, denominator = (tuple(float(part) for part in side.split(",")) for side in text.split("/"))
        except ValueError:
            raise ParameterError(f"operator {text!r}: expected 'n2,n1,n0/d1,d0', as in '1.287,29.33,178/1,0'") from None
        return cls(numerator, denominator)

    def __call__(self, s: Complexes | complex) -> Complexes:
        """Return Z_o(s) [Ns/m]."""
        value: Complexes = np.polyval(self.numerator, s) / np.polyval(self.denominator, s)
        return value

    def parts(self) -> OperatorParts:
        """Return mass, damper and a state-space realisation of the rest (controllable companion
        form).
        """
        denominator = np.array(self.denominator)
        quotient, remainder = np.polydiv(np.array(self.numerator), denominator)
        inertia, damping = (quotient[0], quotient[1]) if len(quotient) == 2 else (0.0, quotient[0])
        n = len(denominator) - 1
        A = np.zeros((n, n))
        B, C, rest = np.zeros(n), np.zeros(n), np.zeros(n)
        if n:
            A[0] = -denominator[1:] / denominator[0]
            A[1:, :-1] = np.eye(n - 1)
            B[0] = 1.0
            tail = remainder[-n:] / denominator[0]
            C[n - len(tail) :] = tail
            if denominator[-1] == 0.0:  # the spring's state: the last state integrates, and the others are 0 at rest
                rest[-1] = denominator[0] / denominator[-2]
        return OperatorParts(float(inertia), float(damping), A, B, C, rest)


def _text(polynomial: tuple[float, ...]) -> str:
    powers = range(len(polynomial) - 1, -1, -1)
    terms = [
        f"{c:g}" + ("" if p == 0 else " s" if p == 1 else f" s^{p}") for c, p in zip(polynomial, powers, strict=True)
    ]
    return "(" + " + ".join(terms) + ")"


def _reduced(
    numerator: tuple[float, ...], denominator: tuple[float, ...]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Strip leading zeros, cancel common factors s, and make the denominator's leading coefficient
    1.
    """
    n, d = list(map(float, numerator)), list(map(float, denominator))
    while len(n) > 1 and n[0] == 0.0:
        n.pop(0)
    while len(d) > 1 and d[0] == 0.0:
        d.pop(0)
    while len(n) > 1 and len(d) > 1 and n[-1] == 0.0 and d[-1] == 0.0:
        n.pop()
        d.pop()
    if n == [0.0]:
        d = [1.0]
    return tuple(c / d[0] for c in n), tuple(c / d[0] for c in d)


def _why_not_passive(n: Floats, d: Floats) -> str:
    """Return the reason why n/d is not positive real, or "".

    Positive real: no pole in Re s > 0, poles on the imaginary axis and at infinity simple with a
    positive residue, Re Z(jw) >= 0. Source: M. E. Van Valkenburg, Introduction to Modern Network
    Synthesis, 1960.
    """
    excess = len(n) - len(d)
    if excess > 1:
        return f"is improper: its numerator's degree exceeds its denominator's by {excess}, and a passive one's by at most 1"
    if excess == 1 and n[0] < 0:
        return f"is not passive: its inertia {n[0]:g} is negative"
    poles = np.roots(d)
    scale = max(1.0, float(np.max(np.abs(poles), initial=0.0)))
    slope = np.polyder(d)
    for pole in poles:
        if pole.real > ON_AXIS * scale:
            return f"is not passive: it has an unstable pole at {pole:.4g}"
        if abs(pole.real) <= ON_AXIS * scale:
            if np.sum(np.abs(poles - pole) < 1e-5 * scale) > 1:
                return f"is not passive: its pole at {pole:.4g} on the imaginary axis is not simple"
            residue = np.polyval(n, pole) / np.polyval(slope, pole)
            if residue.real < 0 or abs(residue.imag) > 1e-6 * abs(residue):
                return f"is not passive: its pole at {pole:.4g} has the residue {residue:.4g}, which is not positive"
    w = _where_resistance_is_negative(n, d)
    return "" if w is None else f"is not passive: Re Z_o(jw) < 0 at w = {w:.4g} rad/s"


def _where_resistance_is_negative(n: Floats, d: Floats) -> float | None:
    """Return a w with Re Z(jw) < 0, or None: the sign of the polynomial Re(n(jw) d(-jw)) between
    its roots in w^2.
    """

    def split(p: Floats) -> tuple[Floats, Floats]:
        """Even and odd part as polynomials in x = w^2 (descending): p(jw) = even(x) + jw odd(x)."""
        ascending = p[::-1]
        even = [(-1) ** (k // 2) * ascending[k] for k in range(0, len(p), 2)]
        odd = [(-1) ** (k // 2) * ascending[k] for k in range(1, len(p), 2)] or [0.0]
        return np.array(even[::-1]), np.array(odd[::-1])

    (n_even, n_odd), (d_even, d_odd) = split(n), split(d)
    resistance = np.polyadd(np.polymul(n_even, d_even), np.polymul([1.0, 0.0], np.polymul(n_odd, d_odd)))
    size = np.polyadd(
        np.polymul(np.abs(n_even), np.abs(d_even)), np.polymul([1.0, 0.0], np.polymul(np.abs(n_odd), np.abs(d_odd)))
    )
    roots = np.roots(resistance)
    edges = np.sort(
        np.concatenate(([0.0], roots.real[(np.abs(roots.imag) < 1e-9 * (1 + np.abs(roots))) & (roots.real > 0)]))
    )
    between = np.append(0.5 * (edges[1:] + edges[:-1]), 2.0 * edges[-1] + 1.0)
    for x in between:
        if np.polyval(resistance, x) < -1e-9 * np.polyval(size, x):
            return math.sqrt(x)
    return None
