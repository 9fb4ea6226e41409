"""Values of a parametrized test that ``make test`` leaves out."""

import pytest


def thorough(*values):
    """Return the cases of one parameter that are run by ``scripts/ci`` alone."""
    return [pytest.param(value, marks=pytest.mark.thorough) for value in values]
