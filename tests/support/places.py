"""Where things stand: the repository, and what stands beside a developer's copy of it.

No test reaches outside of the repository but by `CORPUS` and `CASES`; where these are absent it is skipped, by `beside`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pytest

ROOT = Path(__file__).resolve().parents[2]
RIGS = ROOT / "coulombus" / "rigs"
EDS = ROOT / "eds"
CORPUS = ROOT.parent / "shared" / "eds-corpus"
"""EDS files of drives' makers, which are not the project's to pass on."""
CASES = ROOT.parent / "shared" / "conformance" / "cases.csv"
"""The cases of a conformance test plan."""


def beside(place: Path) -> pytest.MarkDecorator:
    """A test that needs `place`: skipped with its reason where it is absent."""
    import pytest  # the site is built from places, too, and without it

    return pytest.mark.skipif(not place.exists(), reason=f"{place.name} does not stand beside this copy")
