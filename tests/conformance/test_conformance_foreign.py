"""No case fails a device that does otherwise than ours and as the standards allow it; and what the
tester itself cannot do is its own fault.
"""

from __future__ import annotations

import pytest

from conformance_bench import KIND_OF
from conformance_foreign import FOREIGN, ForeignLink
from coulombus.conformance.runner import check_before, run, select
from coulombus.conformance.tester.unit import Timing, Unit


@pytest.mark.parametrize("other", FOREIGN, ids=lambda other: other.name)
def test_what_is_allowed_does_not_fail(other):
    link_type = type("Link", (ForeignLink,), {"mutant": other})
    eds = other.description()
    unit = Unit(link_type(eds, 1, KIND_OF[other.device]), eds, 1, Timing())
    check_before(unit)
    results = {outcome.case.id: (outcome.result, outcome.reason) for outcome in run(unit, select(other.cases)).outcomes}
    assert {number: why for number, why in results.items() if why[0] not in other.expected} == {}
