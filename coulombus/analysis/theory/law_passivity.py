r"""Passivity of friction laws: theorems, and a search for counterexamples.

A law is passive from its relaxed state if :math:`\int_0^t \psi v\,dt' \ge -S_0` for every motion and
every t, with :math:`S_0` the energy of its relaxed state: 0, except for a potential that starts
above its minimum. A storage function S(z) >= 0 with :math:`\dot S \le \psi v` proves it.

`CLAIMS` has the verdict, the reason and the source for each law. `search` seeks a motion that
refutes it: legs of constant speed over random distances at random speeds, over several decades,
with random parameters. Legs are divided finely enough that the trapezium rule's error is a small
share of the exchanged energy.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.host.laws.along import GivenLaw, given_law

__all__ = ["CLAIMS", "PassivityClaim", "Refutation", "least_work", "search", "trials"]

Floats = npt.NDArray[np.float64]
Numbers: TypeAlias = Sequence[float] | Floats

LEGS, PIECES = 8, 400
"""Legs of a motion, and samples of a leg."""
FIRST = 1e-4
"""The first piece of a leg, as a share of it: the torque of the new speed starts there."""
SPEEDS_RAD_S = (1e-2, 1e4)
WAYS_RAD = (1e-4, 0.3)
COUNTS = ("karnopp", "coulomb")
"""Laws with a band in encoder counts per sample: their output depends on the sampling time."""
PERIOD_S = 1e-3
SAMPLED_SPEEDS_RAD_S = (0.02, 20.0)
SAMPLED_WAYS_RAD = (1e-4, 0.02)
STARTS, STEPS = 12, 150
"""Random motions, and number of small random changes of each that make it worse for the law."""
SHARE = 1e-3
"""Share of the exchanged energy below which work is integration error."""


@dataclass(frozen=True)
class PassivityClaim:
    """Claim on a law's passivity."""

    verdict: str
    """``yes``, ``no``, or ``if`` and the condition."""
    why: str
    """Storage function or reason, and its source."""
    passive: tuple[str, ...] = ()
    """Overrides with which the condition holds."""
    refuted: tuple[str, ...] | None = None
    """Overrides with which it does not hold; None: the law is passive at any parameters."""


_BRISTLES = "if sigma_2 >= sigma_1 (F_s - F_c)/F_c"

CLAIMS = MappingProxyType(
    {
        "karnopp": PassivityClaim(
            "if the stick entry is the paper's",
            "the continuous entry x - psi/K_p winds the spring without work: F_d^2/(2 K_p) at each entry",
            ("stick_entry=paper",),
            (),
        ),
        "coulomb": PassivityClaim("yes", "psi v >= 0"),
        "stribeck": PassivityClaim("yes", "psi v >= 0"),
        "regularised": PassivityClaim("yes", "psi v >= 0"),
        "dahl": PassivityClaim("yes", "S = F^2/(2 sigma)"),
        "lugre": PassivityClaim(
            _BRISTLES,
            "S = sigma_0 z^2/2 (Barabanov, Ortega 2000, doi:10.1109/9.847131)",
            ("sigma_2_Nms_rad=0.02",),
            (),
        ),
        "elastoplastic": PassivityClaim(_BRISTLES, "S = sigma_0 z^2/2, and alpha <= 1", ("sigma_2_Nms_rad=0.02",), ()),
        "gms": PassivityClaim(
            "if F_s = F_c",
            "S = sum F_i^2/(2 k_i); else a slipping element gains force with time, without way",
            ("F_s_Nm=1.0",),
            ("F_s_Nm=2.0", "C_Nm_s=1e4"),
        ),
        "leuven": PassivityClaim(_BRISTLES, "S = sum F_i^2/(2 k_i)", ("sigma_2_Nms_rad=0.02",), ()),
        "bliman_sorine": PassivityClaim("yes", "along the way f_1/(1 + eta eps p) - f_2/(1 + eps p) is positive real"),
        "kikuuwe": PassivityClaim("yes", "S = K e^2/2, at every period"),
        "wall": PassivityClaim("yes", "S = the potential of sat(K p)"),
        "detent": PassivityClaim("yes", "S = the potential of A sin, lowest at the start"),
        "texture": PassivityClaim("yes", "psi v >= 0"),
        "viscous": PassivityClaim("yes", "psi v >= 0"),
        "inertia": PassivityClaim(
            "if most_Nm does not bind",
            "S = J v_f^2/2; at its end it takes less for a speed than it gives back",
            (),
            ("filter_s=1e-3", "most_Nm=0.1"),
        ),
    }
)
"""Claims for each built-in law."""


@dataclass(frozen=True)
class Refutation:
    """A motion along which a law returned more than it had absorbed."""

    law: str
    least_J: float
    """Negative."""
    turned_J: float
    """Energy exchanged until then."""
    speeds_rad_s: tuple[float, ...]
    """Signed speed of each leg."""
    ways_rad: tuple[float, ...]


def _motion(speeds: Floats, ways: Floats) -> tuple[Floats, Floats]:
    shares = np.concatenate(([FIRST], np.linspace(0.0, 1.0, PIECES + 1)[1:]))
    t: list[Floats] = [np.zeros(1)]
    x: list[Floats] = [np.zeros(1)]
    for speed, way in zip(speeds, ways, strict=True):
        t.append(t[-1][-1] + shares * (way / abs(speed)))
        x.append(x[-1][-1] + shares * np.copysign(way, speed))
    return np.concatenate(t), np.concatenate(x)


def _sampled(speeds: Floats, ways: Floats, period_s: float) -> tuple[Floats, Floats]:
    legs = [np.full(max(round(way / (abs(v) * period_s)), 1), v) for v, way in zip(speeds, ways, strict=True)]
    x: Floats = np.concatenate(([0.0], np.cumsum(np.concatenate(legs) * period_s)))
    t: Floats = np.arange(len(x), dtype=np.float64) * period_s
    return t, x


def least_work(law: GivenLaw, speeds_rad_s: Numbers, ways_rad: Numbers) -> tuple[float, float]:
    """Return the absorbed work [J] of `law` where its ratio to the exchanged energy is least, and
    that energy [J]; after the first leg of a motion.

    A law that compares encoder counts is evaluated at `PERIOD_S`, with a constant torque per step;
    any other in `PIECES` per leg, by the trapezium rule.
    """
    speeds, ways = np.asarray(speeds_rad_s, np.float64), np.asarray(ways_rad, np.float64)
    if law.name in COUNTS:
        t, x = _sampled(speeds, ways, PERIOD_S)
        begin = max(round(ways[0] / (abs(speeds[0]) * PERIOD_S)), 1)
        work = np.concatenate(([0.0], np.cumsum(law.along(t, x).samples["torque_Nm"][1:] * np.diff(x))))
    else:
        t, x = _motion(speeds, ways)
        begin, work = PIECES, law.along(t, x).work_J
    turned = np.cumsum(np.abs(np.diff(work, prepend=0.0)))
    k = begin + int(np.argmin(work[begin:] / np.maximum(turned[begin:], 1e-300)))
    return float(work[k]), float(turned[k])


def search(law: GivenLaw, *, starts: int = STARTS, steps: int = STEPS, seed: int = 0) -> Refutation | None:
    """Return the motion with the largest excess of returned over absorbed energy, relative to the
    exchanged energy; None if there is no excess.

    Each of `starts` random motions is changed `steps` times at random; a change is kept if it is worse for the law.
    """
    draw = np.random.default_rng(seed)
    counts = law.name in COUNTS
    ends = (SAMPLED_SPEEDS_RAD_S, SAMPLED_WAYS_RAD) if counts else (SPEEDS_RAD_S, WAYS_RAD)
    low, high = np.log(np.array(ends).T)[:, :, None]
    worst: tuple[float, Refutation] | None = None
    for _ in range(starts):
        sizes, senses = draw.uniform(low, high, (2, LEGS)), draw.choice((-1.0, 1.0), LEGS)
        best = np.inf
        for step in range(steps + 1):
            tried, turns = sizes, senses
            if step:
                moved = draw.random((2, LEGS)) < 0.3
                tried = np.clip(sizes + moved * draw.normal(0.0, 0.7, (2, LEGS)), low, high)
                turns = np.where(draw.random(LEGS) < 0.1, -senses, senses)
            speeds, ways = np.exp(tried[0]) * turns, np.exp(tried[1])
            least, turned = least_work(law, speeds, ways)
            share = least / max(turned, 1e-300)
            if share >= best:
                continue
            best, sizes, senses = share, tried, turns
            if share < -SHARE and (worst is None or share < worst[0]):
                worst = share, Refutation(law.name, least, turned, tuple(speeds.tolist()), tuple(ways.tolist()))
    return None if worst is None else worst[1]


def trials(name: str) -> Iterator[tuple[str, Refutation | None]]:
    """Yield the results of `search` for the cases of a claim, ``holds`` and ``refuted``."""
    claim = CLAIMS[name]
    yield "holds", search(given_law(name, claim.passive))
    if claim.refuted is not None:
        yield "refuted", search(given_law(name, claim.refuted))
