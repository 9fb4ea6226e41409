"""What the tests of the analyses share."""

from functools import cache

import pytest

from coulombus.analysis.theory import plane_orbit


@pytest.fixture(scope="session", autouse=True)
def each_matrix_exponential_once():
    """The search for a tip's frequency needs that of one loop at thousands of angles."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plane_orbit, "_steps", cache(plane_orbit._steps))
        yield
