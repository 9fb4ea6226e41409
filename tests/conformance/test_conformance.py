"""The conformance run against our nodes, sound and mutated, in virtual time."""

from __future__ import annotations

import csv
from functools import lru_cache

import pytest

from conformance_bench import VirtualLink, description, new_unit, run_cases
from conformance_mutants import MUTANTS, MutantLink
from coulombus.conformance.catalogue import catalogue
from coulombus.conformance.tester.registry import FUNCTIONS
from coulombus.conformance.tester.unit import Timing, Unit
from coulombus.eds.reader import parse_eds
from coulombus.node.brake404 import BRAKE404
from places import CASES, beside


def test_every_case_has_a_function_and_a_text():
    assert [case.id for case in catalogue()] == list(dict.fromkeys(case.id for case in catalogue()))
    assert {case.id for case in catalogue()} == FUNCTIONS.keys()
    assert all(case.name and case.objective for case in catalogue())
    assert all(FUNCTIONS[case.id].func.__doc__ for case in catalogue())
    assert sum(not case.is_additional for case in catalogue()) == 127


@beside(CASES)
def test_the_catalogue_is_the_list_with_its_abort_codes():
    rows = list(csv.DictReader(CASES.read_text().splitlines()))
    ours = [case for case in catalogue() if not case.is_additional]
    assert [case.id for case in ours] == [row["case"] for row in rows]
    for case, row in zip(ours, rows, strict=True):
        codes = {int(code.rstrip("h"), 16) for code in row["accepted_abort_codes"].split()}
        assert not codes or set(case.codes) == codes, case.id


@lru_cache
def sound(name):
    return run_cases(new_unit(name))


@pytest.mark.parametrize("name", ["motor", "mr_brake"])
def test_our_nodes_pass(name):
    failed = {outcome.case.id: outcome.reason for outcome in sound(name).outcomes if outcome.result == "fail"}
    assert not failed
    assert sum(outcome.result == "pass" for outcome in sound(name).outcomes if not outcome.case.is_additional) == 127


@pytest.mark.thorough
def test_a_device_that_produces_sync_from_the_start_may_refuse_1019():
    """CiA 301: 1019h changes only while 1006h is 0; the tester sets it so."""
    text = description("mr_brake").text.replace("DefaultValue=0x00000080\n", "DefaultValue=0x40000080\n", 1)
    head, period = text.split("[1006]\n")
    eds = parse_eds(
        (head + "[1006]\n" + period.replace("DefaultValue=0\n", "DefaultValue=100000\n", 1)).encode(), "brake.eds"
    )
    assert (eds.default(0x1005, 0, 1), eds.default(0x1006, 0, 1)) == (0x40000080, 100000)
    report = run_cases(Unit(VirtualLink(eds, 1, BRAKE404), eds, 1, Timing()))
    assert {outcome.case.id: outcome.reason for outcome in report.outcomes if outcome.result == "fail"} == {}


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_a_mutant_is_caught(mutant):
    assert next(outcome for outcome in sound(mutant.device).outcomes if outcome.case.id == mutant.case).result == "pass"
    link_type = type("Link", (MutantLink,), {"mutant": mutant})
    outcome = run_cases(new_unit(mutant.device, link_type), mutant.case).outcomes[0]
    assert outcome.result == "fail", outcome.reason
    assert outcome.reason
    assert outcome.frames


class Stalled(VirtualLink):
    """A device that stands still for most of the time in which it is to miss a heartbeat, as a
    simulated one does with its machine.
    """

    ahead = 0

    def now_ns(self):
        return self.t + self.ahead

    def receive(self, until_ns):
        if self.ahead == 0 and not self.sent and 350_000_000 < until_ns - self.now_ns() < 370_000_000:
            self.ahead = until_ns - self.now_ns() - 1_000_000
        return super().receive(until_ns - self.ahead)


def test_a_fault_that_comes_late_is_waited_for():
    """P.7 said "not applicable" where the drive had not yet found its heartbeat lost."""
    unit = new_unit("motor", Stalled)
    assert run_cases(unit, "P.7").outcomes[0].result == "pass"
    assert unit.link.ahead > 300_000_000
