r"""Curves of the literature beside those of the compiled laws.

A published curve is computed from the published equations and parameters by SciPy (Radau's method for
a mass that moves, Dormand and Prince's of order 8 along a given motion), not by a kernel of this
project. No point is read off a printed figure. The compiled law gets
the same motion, sampled as the host's cycle samples it, or moves the same mass. The deviation is the
largest difference of two such curves at the same instant, as a share of the range of the published
ordinate.

Left out, because no complete set of published numbers is certain: the parameters of Kikuuwe's own
examples (his algorithm is compared with its differential equation instead), and the magnetic
hysteresis of a published MR brake.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.analysis.theory.law_benchmarks import CANUDAS, PULL, SPRING, continuous, course_of
from coulombus.host.laws.along import GivenLaw, given_law
from coulombus.host.laws.laws import BUILTIN_LAWS

__all__ = ["LiteratureCurve", "LiteratureLine", "lines", "literature_curves", "plain"]

Floats: TypeAlias = npt.NDArray[np.float64]

CYCLE_S = 1e-3
"""Sampling of a given motion: the host's cycle."""
EVERY = 100
"""Steps of 10 us between two points of a mass that moves."""
LAG_RAD_S = (1.0, 10.0, 25.0)
LAG_MEAN, LAG_AMPLITUDE = 1.5e-3, 1e-3
FORCE_RATES = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 40.0, 50.0)
DAHL_EXPONENTS = (0.5, 1.0, 1.5, 2.0)
DAHL_SPAN = 3.0
"""Half the travel of a loop, in units of F_c/sigma."""
KIKUUWE_AMPLITUDES = (0.005, 0.02, 0.05)
TABLE_1 = "parameters of table I"


@dataclass(frozen=True)
class LiteratureLine:
    """A line of a figure, twice: both at the same instants or abscissas.

    Attributes
    ----------
    label : the parameter of the line
    x, published : the published equations
    x_law, law : the compiled law
    """

    label: str
    x: Floats
    published: Floats
    x_law: Floats
    law: Floats

    @property
    def deviation(self) -> float:
        """The largest difference of the ordinates, as a share of the published range."""
        return float(np.abs(self.law - self.published).max() / np.ptp(self.published))


@dataclass(frozen=True)
class LiteratureCurve:
    """A figure of the literature, with its lines.

    Attributes
    ----------
    name : of the file that the figure is drawn to
    law : the compiled law
    title : the quantity, and the figure in the paper
    obtained : what the published lines are computed from
    axes : labels of abscissa and ordinate, with units
    """

    name: str
    law: str
    title: str
    obtained: str
    axes: tuple[str, str]
    lines: tuple[LiteratureLine, ...]

    @property
    def source(self) -> str:
        """DOIs of the law's papers."""
        return ", ".join(f"doi:{doi}" for doi in BUILTIN_LAWS[self.law].dois)

    @property
    def deviation(self) -> float:
        """The largest deviation of its lines."""
        return max(line.deviation for line in self.lines)

    @property
    def deviation_text(self) -> str:
        """The deviation in per cent; what an integration cannot tell from 0 is a bound."""
        return "below 0.001 %" if self.deviation < 1e-5 else f"{100 * self.deviation:.2g} %"


def _law(name: str, **values: float) -> GivenLaw:
    return given_law(name, [f"{key}={value!r}" for key, value in values.items()])


def _along(law: GivenLaw, t_s: Floats, x: Floats) -> Floats:
    return np.asarray(law.along(t_s, x, 1e-12).samples["torque_Nm"], np.float64)


def _integrated(rate: Callable[[float, float], float], t_s: Floats, limits: Sequence[float] = ()) -> Floats:
    """Integrate one state from 0; a step ends at each of `limits` [s], where the rate jumps."""
    from scipy.integrate import solve_ivp

    ends = [float(t_s[0]), *limits, float(t_s[-1])]
    pieces, state = [np.zeros(1)], 0.0
    for begin, end in pairwise(ends):
        times = np.append(t_s[(t_s > begin) & (t_s < end)], end)
        options: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-13, "max_step": (end - begin) / 200}
        solution = solve_ivp(lambda t, y: [rate(t, y[0])], (begin, end), [state], "DOP853", times, **options)
        pieces.append(solution.y[0])
        state = float(solution.y[0, -1])
    return np.concatenate(pieces)


def _lugre_rate(v: float, z: float) -> float:
    F_c, F_s, v_s, s_0, _, _ = CANUDAS.values()
    return v - s_0 * abs(v) / (F_c + (F_s - F_c) * math.exp(-((v / v_s) ** 2))) * z


def _presliding() -> LiteratureCurve:
    corners = np.array([0.0, 10.0, 15.0, 35.0, 40.0, 60.0])
    levels = 0.95 * CANUDAS["F_s_Nm"] * np.array([0.0, 1.0, 1.0, -1.0, -1.0, 1.0])
    t_s = np.arange(0.0, 60.0 + 1e-9, CYCLE_S)
    moved = continuous(lambda t: float(np.interp(t, corners, levels)), 60.0, t_s)
    law = _along(_law("lugre", **CANUDAS), t_s, moved.x)
    line = LiteratureLine("force to 0.95 F_s and back", moved.x * 1e6, moved.friction, moved.x * 1e6, law)
    obtained = f"{TABLE_1}; 1 kg; ramps of 10 and 20 s, holds of 5 s (not printed)"
    return LiteratureCurve(
        *("lugre-presliding", "lugre", "pre-sliding displacement (1995, Fig. 2)", obtained),
        *(("displacement [um]", "friction [N]"), (line,)),
    )


def _frictional_lag() -> LiteratureCurve:
    shown = []
    for omega in LAG_RAD_S:
        seconds = 4 * math.pi / omega + 0.1

        def speed(t: Any, omega: float = omega) -> Any:
            return LAG_MEAN + LAG_AMPLITUDE * np.sin(omega * t)

        t_s = np.arange(0.0, seconds, CYCLE_S)
        x = LAG_MEAN * t_s + LAG_AMPLITUDE / omega * (1.0 - np.cos(omega * t_s))
        z = _integrated(lambda t, z, speed=speed: _lugre_rate(float(speed(t)), z), t_s)  # type: ignore[misc]
        v = speed(t_s)
        z_rate = np.array([_lugre_rate(*pair) for pair in zip(v, z, strict=True)])
        published = CANUDAS["sigma_0_Nm_rad"] * z + CANUDAS["sigma_1_Nms_rad"] * z_rate + CANUDAS["sigma_2_Nms_rad"] * v
        law = _along(_law("lugre", **CANUDAS), t_s, x)
        turn = t_s > seconds - 2 * math.pi / omega
        v_mm = v[turn] * 1e3
        shown.append(LiteratureLine(f"{omega:g} rad/s", v_mm, published[turn], v_mm, law[turn]))
    obtained = f"{TABLE_1}; 1, 10 and 25 rad/s; speed 1.5 + sin mm/s (not printed)"
    return LiteratureCurve(
        *("lugre-lag", "lugre", "frictional lag (1995, Fig. 3)", obtained),
        *(("speed [mm/s]", "friction [N]"), tuple(shown)),
    )


def _break_away() -> LiteratureCurve:
    law, published, computed = _law("lugre", **CANUDAS), [], []
    for rate in FORCE_RATES:
        ramped = continuous(lambda t, rate=rate: rate * t, 2.5 / rate)  # type: ignore[misc]
        published.append(float(ramped.friction.max()))
        course = course_of(law, 2.5 / rate, max(1, round(25 / rate)), force_rate=rate)
        computed.append(float(course["friction"].max()))
    rates = np.array(FORCE_RATES)
    line = LiteratureLine("largest friction", rates, np.array(published), rates, np.array(computed))
    return LiteratureCurve(
        *(
            "lugre-break-away",
            "lugre",
            "break-away force (1995, Fig. 4)",
            f"{TABLE_1}; 1 kg; largest friction of a ramp",
        ),
        *(("force rate [N/s]", "break-away force [N]"), (line,)),
    )


def _stick_slip() -> LiteratureCurve:
    course = course_of(_law("lugre", **CANUDAS), 30.0, EVERY, spring=SPRING, speed=PULL)
    t_s = np.asarray(course["t_s"], np.float64)
    pulled = continuous(lambda t: SPRING * PULL * t, 30.0, t_s, spring=SPRING)
    line = LiteratureLine("position of the mass", t_s, pulled.x, t_s, np.asarray(course["x"], np.float64))
    return LiteratureCurve(
        *("lugre-stick-slip", "lugre", "stick-slip (1995, Fig. 6)", f"{TABLE_1}; 1 kg, 2 N/m, 0.1 m/s"),
        *(("time [s]", "position [m]"), (line,)),
    )


def _dahl() -> LiteratureCurve:
    turns = (0.0, DAHL_SPAN, -DAHL_SPAN, DAHL_SPAN)
    ends = [float(way) for way in np.cumsum([abs(b - a) for a, b in pairwise(turns)])]
    t_s = np.arange(0.0, ends[-1] + 1e-9, CYCLE_S)  # at the speed 1
    x = np.interp(t_s, [0.0, *ends], turns)
    shown = []
    for exponent in DAHL_EXPONENTS:

        def rate(t: float, F: float, exponent: float = exponent) -> float:
            sense = -1.0 if ends[0] < t <= ends[1] else 1.0
            left = max(1.0 - F * sense, 0.0)
            return sense * (left**exponent if left > 0.0 else 0.0)

        published = _integrated(rate, t_s, ends[:2])
        law = _along(_law("dahl", F_c_Nm=1.0, sigma_Nm_rad=1.0, alpha=exponent), t_s, x)
        shown.append(LiteratureLine(f"exponent {exponent:g}", x, published, x, law))
    return LiteratureCurve(
        *("dahl-loops", "dahl", "loops (1968)", "normalised: no parameter but the exponent"),
        *(("displacement [F_c/sigma]", "friction [F_c]"), tuple(shown)),
    )


def _kikuuwe() -> LiteratureCurve:
    law = _law("kikuuwe")
    F_c, K, B = (value for _, value in law.parameters)
    t_s = np.arange(0.0, 2.0, CYCLE_S)
    omega, shown = 2 * math.pi, []
    for amplitude in KIKUUWE_AMPLITUDES:

        def force(t: Any, e: Any, amplitude: float = amplitude) -> Any:
            return np.clip(K * e + B * amplitude * omega * np.cos(omega * t), -F_c, F_c)

        e = _integrated(lambda t, e, force=force: (float(force(t, e)) - K * e) / B, t_s)  # type: ignore[misc]
        x = amplitude * np.sin(omega * t_s)
        shown.append(LiteratureLine(f"{amplitude:g} rad", x, force(t_s, e), x, _along(law, t_s, x)))
    obtained = "the law's differential equation, with the defaults of this project"
    return LiteratureCurve(
        *("kikuuwe-loops", "kikuuwe", "loops of the algorithm (2006)", obtained),
        *(("angle [rad]", "torque [Nm]"), tuple(shown)),
    )


def literature_curves() -> tuple[LiteratureCurve, ...]:
    """Compute all curves: LuGre 1995, Dahl 1968, Kikuuwe et al. 2006."""
    return (_presliding(), _frictional_lag(), _break_away(), _stick_slip(), _dahl(), _kikuuwe())


def lines(computed: Sequence[LiteratureCurve]) -> Iterator[str]:
    """Yield the curves as a table, as docs/laws.md has it."""
    yield "| law | curve | obtained from | source | deviation |"
    yield "|---|---|---|---|---|"
    for curve in computed:
        yield f"| `{curve.law}` | {curve.title} | {curve.obtained} | {curve.source} | {curve.deviation_text} |"


def plain(computed: Sequence[LiteratureCurve]) -> list[dict[str, Any]]:
    """Return the curves as plain values, without their points."""
    return [
        {
            "curve": curve.name,
            "law": curve.law,
            "title": curve.title,
            "obtained": curve.obtained,
            "source": curve.source,
            "deviation": curve.deviation,
            "lines": {line.label: line.deviation for line in curve.lines},
        }
        for curve in computed
    ]
