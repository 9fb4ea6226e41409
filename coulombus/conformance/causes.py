"""The causes of a run's failures: a fault shared by several cases is reported once."""

from __future__ import annotations

from dataclasses import dataclass

from coulombus.conformance.runner import Report

__all__ = ["FailureCause", "causes", "reasons"]


@dataclass(frozen=True)
class FailureCause:
    """A fault of the device: its text, the clause that forbids it, the failed cases, and the frames of the first."""

    text: str
    clause: str
    cases: tuple[str, ...]
    frames: tuple[str, ...]


def causes(report: Report) -> list[FailureCause]:
    """Return the causes of the failures, in decreasing number of failed cases."""
    outcomes: dict[str, list[int]] = {}
    for number, outcome in enumerate(report.outcomes):
        if outcome.result == "fail":
            outcomes.setdefault(outcome.cause, []).append(number)
    listed = []
    for text, numbers in outcomes.items():
        first = report.outcomes[numbers[0]]
        cases = tuple(report.outcomes[number].case.id for number in numbers)
        listed.append(FailureCause(text if len(cases) > 1 else first.reason, first.clause, cases, first.frames))
    return sorted(listed, key=lambda cause: -len(cause.cases))


def reasons(report: Report) -> list[str]:
    """Return the text for each case in the list: its reason, or the number of its shared cause.

    A reason already given by the cause's first case is not repeated.
    """
    numbers = {case: number for number, cause in enumerate(causes(report), 1) for case in cause.cases}
    shared = {case for cause in causes(report) if len(cause.cases) > 1 for case in cause.cases}
    printed: set[str] = set()
    texts = []
    for outcome in report.outcomes:
        text = outcome.reason
        if outcome.case.id in shared:
            text = f"cause {numbers[outcome.case.id]}" + ("" if text in printed else f": {text}")
            printed.add(outcome.reason)
        texts.append(text)
    return texts
