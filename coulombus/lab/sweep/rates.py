r"""Rates with confidence intervals of Clopper and Pearson.

For `k` of `n` runs the interval is exact: it covers the true rate with at least its confidence,

.. math:: p_- = B^{-1}(\alpha/2;\ k,\ n - k + 1), \qquad p_+ = B^{-1}(1 - \alpha/2;\ k + 1,\ n - k)

with the quantiles of the beta distribution (Clopper, Pearson 1934, doi:10.1093/biomet/26.4.404).
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CONFIDENCE", "Rate", "clopper_pearson"]

CONFIDENCE = 0.95


def clopper_pearson(count: int, of: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the ends of the interval for `count` of `of`; 0 to 1 without runs.

    Raises
    ------
    ValueError
        `count` exceeds `of`, or the confidence is not between 0 and 1
    """
    if not 0 <= count <= of or not 0 < confidence < 1:
        raise ValueError(f"{count} of {of} at {confidence}; expected 0 <= count <= of, and a confidence within 0 and 1")
    from scipy.special import betaincinv

    tail = (1 - confidence) / 2
    low = float(betaincinv(count, of - count + 1, tail)) if count else 0.0
    high = float(betaincinv(count + 1, of - count, 1 - tail)) if count < of else 1.0
    return low, high


@dataclass(frozen=True)
class Rate:
    """Number of runs in which a condition holds, with the interval of the true rate."""

    name: str
    count: int
    of: int

    @property
    def interval(self) -> tuple[float, float]:
        """The interval at `CONFIDENCE`."""
        return clopper_pearson(self.count, self.of)

    @property
    def text(self) -> str:
        """The rate as a sentence: "still in 997 of 1000 runs (99.13 to 99.94 %)"."""
        low, high = self.interval
        return f"{self.name} in {self.count} of {self.of} runs ({100 * low:.2f} to {100 * high:.2f} %)"

    def as_dict(self) -> dict[str, float]:
        """Return count, of, and the ends of the interval."""
        low, high = self.interval
        return {"count": self.count, "of": self.of, "low": low, "high": high}
