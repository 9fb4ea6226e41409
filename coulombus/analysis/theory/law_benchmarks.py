r"""Published benchmarks of the laws, their describing functions, and the energy that they return.

A benchmark compares a law's result with an independent one: a closed form, or the continuous
equations integrated by an implicit method (Radau).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from coulombus.analysis.theory.law_passivity import CLAIMS
from coulombus.host.laws.along import Asked, GivenLaw, given_law
from coulombus.host.laws.laws import BUILTIN_LAWS
from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import Record, RecordArray, Records, new_records

__all__ = [
    "CANUDAS",
    "Benchmark",
    "SineResponse",
    "benchmarks",
    "break_away",
    "continuous",
    "course_of",
    "describing_function",
    "energy",
    "lines",
    "plain",
    "stick_slip",
    "sweep",
]

Floats = npt.NDArray[np.float64]

CANUDAS = {
    "F_c_Nm": 1.0,
    "F_s_Nm": 1.5,
    "v_s_rad_s": 0.001,
    "sigma_0_Nm_rad": 1e5,
    "sigma_1_Nms_rad": math.sqrt(1e5),
    "sigma_2_Nms_rad": 0.4,
}
"""The parameters of Canudas de Wit et al. 1995, table I, for a mass of 1 kg."""

SPRING, PULL = 2.0, 0.1
"""Stick-slip experiment: stiffness [N/m], speed of the spring's end [m/s]."""


class Pushed(Record):
    """A mass pushed against a law's friction."""

    mass: float
    spring: float
    speed: float  # of the spring's end
    force_rate: float  # of a force that acts without a spring
    step_s: float


class CourseRow(Record):
    """A step of its course."""

    t_s: float
    x: float
    v: float
    friction: float


@kernel
def _push(request: Asked, law_function: Any, pushed: Pushed, course: RecordArray[CourseRow], every: int) -> None:
    """Simulate a mass under a law: pulled by a spring with a moving end, pushed by a growing force;
    keep each `every`-th step.
    """
    motion, h = request.motion, pushed.step_s
    motion.dt_s = h
    x = v = t = 0.0
    for k in range(len(course) * every):
        motion.x_rad = x
        motion.v_rad_s = v
        motion.v_counts = v * h / request.count_rad
        psi = law_function(motion, request.law, request.state)
        if k % every == 0:
            row = course[k // every]
            row.t_s = t
            row.x = x
            row.v = v
            row.friction = psi
        force = pushed.spring * (pushed.speed * t - x) + pushed.force_rate * t
        v += h * (force - psi) / pushed.mass
        x += h * v
        t = (k + 1) * h


def course_of(law: GivenLaw, seconds: float, every: int, **pushed: float) -> Records:
    """Return each `every`-th step of 10 us of a mass of 1 kg under a law, as `CourseRow`.

    Parameters
    ----------
    pushed : fields of `Pushed`
    """
    record, request = new_records(Pushed), new_records(Asked)
    record["mass"], record["step_s"] = 1.0, 1e-5
    for name, value in pushed.items():
        record[name] = value
    request["count_rad"] = 1e-9
    if law.declaration is not None and law.parameters is not None:
        law.declaration.fill(request[0]["law"], law.parameters)
    course = new_records(CourseRow, math.ceil(seconds / (float(record["step_s"][0]) * every)))
    _push(request[0], law.pointer, record[0], course, every)
    return course


def _lugre(**values: float) -> GivenLaw:
    return given_law("lugre", [f"{key}={value!r}" for key, value in {**CANUDAS, **values}.items()])


def _begins(t: Floats, v: Floats, level: float = 0.05) -> Floats:
    """Return the times at which the speed rises above `level`: the starts of the slips, linearly interpolated."""
    k = np.flatnonzero((v[1:] > level) & (v[:-1] <= level))
    return np.asarray(t[k] + (level - v[k]) / (v[k + 1] - v[k]) * (t[k + 1] - t[k]), np.float64)


def stick_slip(law: GivenLaw) -> tuple[float, float]:
    """Return the period of stick-slip [s] of 1 kg on a spring of 2 N/m that is pulled at 0.1 m/s,
    and the largest friction [N]: Canudas de Wit et al. 1995, Fig. 6.
    """
    course = course_of(law, 40.0, 100, spring=SPRING, speed=PULL)
    return float(np.diff(_begins(course["t_s"], course["v"])).mean()), float(course["friction"].max())


def break_away(law: GivenLaw, rate: float) -> float:
    """Return the largest friction [N] on 1 kg under a force that grows by `rate` [N/s]:
    Canudas de Wit et al. 1995, Fig. 4.
    """
    seconds = 2.5 / rate
    return float(course_of(law, seconds, max(1, round(seconds * 10)), force_rate=rate)["friction"].max())


@dataclass(frozen=True)
class ContinuousCourse:
    """A mass of 1 kg under LuGre's continuous equations."""

    t_s: Floats
    x: Floats
    v: Floats
    friction: Floats


def continuous(
    force: Callable[[float], float], seconds: float, times: Floats | None = None, *, spring: float = 0.0
) -> ContinuousCourse:
    """Integrate LuGre's equations with the parameters `CANUDAS` by the Radau method.

    Parameters
    ----------
    force : on the mass [N], of the time [s]
    times : of the course [s]; None: the steps of the method
    spring : from the mass to the origin [N/m]
    """
    from scipy.integrate import solve_ivp

    F_c, F_s, v_s, s_0, s_1, s_2 = CANUDAS.values()

    def friction(v: Any, z: Any) -> tuple[Any, Any]:
        g = F_c + (F_s - F_c) * np.exp(-((v / v_s) ** 2))
        z_rate = v - s_0 * np.abs(v) / g * z
        return s_0 * z + s_1 * z_rate + s_2 * v, z_rate

    def rates(t: float, y: Floats) -> list[float]:
        psi, z_rate = friction(y[1], y[2])
        return [y[1], force(t) - spring * y[0] - psi, z_rate]

    def jacobian(t: float, y: Floats) -> list[list[float]]:
        _, v, z = y
        peak = (F_s - F_c) * math.exp(-((v / v_s) ** 2))
        g, slope = F_c + peak, -2.0 * v / v_s**2 * peak
        to_z = -s_0 * abs(v) / g
        to_v = 1.0 - s_0 * z * (math.copysign(1.0, v) / g - abs(v) * slope / g**2)
        return [[0.0, 1.0, 0.0], [-spring, -s_1 * to_v - s_2, -s_0 - s_1 * to_z], [0.0, to_v, to_z]]

    options: dict[str, Any] = {"rtol": 1e-7, "atol": 1e-10, "max_step": seconds / 2000, "jac": jacobian}
    solution = solve_ivp(rates, (0, seconds), [0.0, 0.0, 0.0], "Radau", times, **options)
    x, v, z = solution.y
    return ContinuousCourse(solution.t, x, v, friction(v, z)[0])


@dataclass(frozen=True)
class Benchmark:
    """A law's result, and its expected value."""

    law: str
    what: str
    unit: str
    expected: float
    by: str
    """Source of `expected`."""
    found: float
    tolerance: float

    @property
    def ok(self) -> bool:
        """Whether the result is as expected."""
        return abs(self.found - self.expected) <= self.tolerance


EACH = 2000
"""Samples between two turning points."""


def _loop(law: str, turns: Sequence[float], each: int = EACH, **values: float) -> tuple[Floats, Any]:
    pieces = [np.linspace(a, b, each, endpoint=False) for a, b in pairwise(turns)]
    x = np.concatenate([*pieces, [turns[-1]]])
    driven = given_law(law, [f"{key}={value!r}" for key, value in values.items()]).along(np.arange(len(x)) * 1e-3, x)
    return x, driven


def _lugre_benchmarks() -> Iterator[Benchmark]:
    law = _lugre()
    pulled = continuous(lambda t: SPRING * PULL * t, 40.0, spring=SPRING)
    expected = float(np.diff(_begins(pulled.t_s, pulled.v)).mean())
    period, largest_N = stick_slip(law)
    yield Benchmark("lugre", "stick-slip, period (1995, Fig. 6)", "s", expected, "Radau", period, 1e-3)
    expected = float(pulled.friction.max())
    yield Benchmark("lugre", "stick-slip, largest friction", "N", expected, "Radau", largest_N, 2e-3)
    for rate in (1.0, 5.0, 20.0, 50.0):
        ramped = continuous(lambda t, rate=rate: rate * t, 2.5 / rate)  # type: ignore[misc]
        breakaway_N = break_away(law, rate)
        what = f"break-away at {rate:g} N/s (1995, Fig. 4)"
        yield Benchmark("lugre", what, "N", float(ramped.friction.max()), "Radau", breakaway_N, 5e-3)


def benchmarks() -> tuple[Benchmark, ...]:
    """Compute all benchmarks."""
    results = list(_lugre_benchmarks())
    A, F_c, sigma = 0.05, 1.0, 100.0
    _, driven = _loop("dahl", (0, A, -A, A, -A, A, -A, A))
    loss = float(driven.work_J[-1] - driven.work_J[-1 - 2 * EACH])
    closed = 4 * F_c * (A - F_c / sigma * math.tanh(sigma * A / F_c))
    results.append(Benchmark("dahl", "loss of a turn of +-0.05 rad", "J", closed, "closed form", loss, 1e-5))
    only: dict[str, Any] = dict.fromkeys(("k_2_Nm_rad", "k_3_Nm_rad", "k_4_Nm_rad"), 1e-9)
    only |= {"w_1": 1e6, "w_2": 1e-6, "w_3": 1e-6, "w_4": 1e-6, "F_s_Nm": 1.0, "sigma_1_Nms_rad": 0.0}
    _, driven = _loop("leuven", (0, A, -A, A, -A, A, -A, A), **only)
    loss = float(driven.work_J[-1] - driven.work_J[-1 - 2 * EACH])
    results.append(
        Benchmark("leuven", "the same with one element, which is Dahl's", "J", closed, "closed form", loss, 1e-5)
    )
    _, driven = _loop("gms", (0, 0.03, -0.02, 0.01, -0.005, 0.01, -0.02, 0.03), F_s_Nm=1.0, C_Nm_s=1e9)
    torque = driven.samples["torque_Nm"]
    error = max(abs(float(torque[EACH * a] - torque[EACH * b])) for a, b in ((5, 3), (6, 2), (7, 1)))
    results.append(Benchmark("gms", "return-point error of two inner loops (2005)", "Nm", 0.0, "theory", error, 1e-9))
    shakes = (0, *(5.5e-3, 2.5e-3) * 200, 4e-3)
    for name in ("elastoplastic", "lugre"):
        x, driven = _loop(name, shakes, 50, sigma_1_Nms_rad=0.0)
        drift = float(x[-1] - driven.samples["torque_Nm"][-1] / 100.0)
        if name == "elastoplastic":
            what = "drift after 200 shakes below break-away (2002)"
            results.append(Benchmark(name, what, "rad", 0.0, "theory", drift, 1e-12))
        else:
            results.append(Benchmark(name, "the same drift, which it has", "rad", 4e-3, "theory: all", drift, 1e-3))
    x, driven = _loop("kikuuwe", (0, 0.04, -0.04, 0.01, 0.04), 100, B_Nms_rad=0.0)
    play, e = [0.0], 0.0
    for dx in np.diff(x):
        e = min(max(e + dx, -0.01), 0.01)
        play.append(100 * e)
    error = float(np.abs(driven.samples["torque_Nm"] - play).max())
    results.append(Benchmark("kikuuwe", "error to the set-valued law (2006)", "Nm", 0.0, "theory", error, 1e-9))
    x, driven = _loop("bliman_sorine", (0, 0.1), 20000)
    peak = math.log(1.5 / (0.5 * 0.25)) / (1 / 0.005 - 1 / 0.02)
    top = 1.5 * (1 - math.exp(-peak / 0.005)) - 0.5 * (1 - math.exp(-peak / 0.02))
    torque = driven.samples["torque_Nm"]
    results.append(Benchmark("bliman_sorine", "peak from rest", "Nm", top, "closed form", float(torque.max()), 1e-5))
    return tuple(results)


def describing_function(law: GivenLaw, a: float, frequency_Hz: float, samples: int = 20_000) -> complex:
    r"""Return :math:`\Psi(a, f)` [Nm s/rad] of any law: the fundamental of its torque under
    :math:`v = a \sin\theta`, divided by a; numerically, of the sixth period.
    """
    theta = np.arange(6 * samples + 1) * (2 * math.pi / samples)
    x = a / (2 * math.pi * frequency_Hz) * (1 - np.cos(theta))
    torque = law.along(theta / (2 * math.pi * frequency_Hz), x, 1e-12).samples["torque_Nm"][-samples:]
    last = theta[-samples:]
    return complex(float(torque @ np.sin(last)), float(torque @ np.cos(last))) * 2 / (samples * a)


def energy(law: GivenLaw, seed: int = 0) -> tuple[float, float]:
    r"""Return the least work [J] absorbed by a law during a motion of five sines, and the total
    exchanged energy, :math:`\int |\psi v|\,dt`.

    For a law that is passive from its relaxed state the absorbed work is never negative.
    """
    draw, t = np.random.default_rng(seed), np.arange(200_001) * 1e-4
    x = sum(
        draw.uniform(0.02, 0.1) * (np.sin(2 * math.pi * f * t + phase) - math.sin(phase))
        for f, phase in zip(draw.uniform(0.2, 3.0, 5), draw.uniform(0, 2 * math.pi, 5), strict=True)
    )
    driven = law.along(t, np.asarray(x), 1e-12)
    return float(driven.work_J.min()), float(np.abs(np.diff(driven.work_J)).sum())


@dataclass(frozen=True)
class SineResponse:
    """A law with its defaults under v = a sin: its describing function, and its energy."""

    law: str
    psi: complex
    """Psi at a = 1 rad/s and 1 Hz [Nm s/rad]."""
    least_J: float
    turned_J: float

    @property
    def passive(self) -> bool:
        """Whether it never returned more than it had absorbed along these sines, within a share of
        1e-6; `law_passivity.CLAIMS` covers every motion.
        """
        return self.least_J >= -1e-6 * self.turned_J


def sweep() -> tuple[SineResponse, ...]:
    """Compute describing function and energy of every law."""
    laws = [given_law(name) for name in BUILTIN_LAWS]
    return tuple(SineResponse(law.name, describing_function(law, 1.0, 1.0), *energy(law)) for law in laws)


def lines(results: Sequence[Benchmark], swept: Sequence[SineResponse]) -> Iterator[str]:
    """Yield the results as the tables of docs/laws.md."""
    yield "| law | benchmark | expected | by | found | |"
    yield "|---|---|---|---|---|---|"
    for benchmark in results:
        verdict = "ok" if benchmark.ok else "FAIL"
        value = f"{benchmark.found:.4g}" if abs(benchmark.found) > benchmark.tolerance or benchmark.expected else "0"
        expected, by, unit = f"{benchmark.expected:.4g}", benchmark.by, benchmark.unit
        yield f"| `{benchmark.law}` | {benchmark.what} | {expected} {unit} | {by} | {value} {unit} | {verdict} |"
    yield ""
    yield "| law | Re Psi [Nm s/rad] | Im Psi [Nm s/rad] | gave back too much, five sines | passive |"
    yield "|---|---|---|---|---|"
    for each in swept:
        imaginary = each.psi.imag if abs(each.psi.imag) >= 5e-4 else 0.0
        gave = "no" if each.passive else "yes"
        yield f"| `{each.law}` | {each.psi.real:.3f} | {imaginary:.3f} | {gave} | {CLAIMS[each.law].verdict} |"


def plain(results: Sequence[Benchmark], swept: Sequence[SineResponse]) -> dict[str, Any]:
    """Return the results as plain values."""
    return {
        "benchmarks": [{**asdict(benchmark), "ok": benchmark.ok} for benchmark in results],
        "laws": [
            {
                "law": response.law,
                "psi": [response.psi.real, response.psi.imag],
                "least_J": response.least_J,
                "turned_J": response.turned_J,
                "passive": response.passive,
                "passive_if": CLAIMS[response.law].verdict,
                "passive_why": CLAIMS[response.law].why,
            }
            for response in swept
        ],
    }
