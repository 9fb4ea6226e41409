"""The report of a run as JSON, JUnit XML, Markdown and HTML.

A fault shared by several cases is reported once, as a cause of failures.

For people: verdict, causes, then the cases, those that failed first. For programs: the
cases in the order of the catalogue.
"""

from __future__ import annotations

import html
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from coulombus.conformance.runner import Outcome, Report
from coulombus.system.foreign_text import one_line, printable
from coulombus.system.quoting import xml

__all__ = [
    "WORDS",
    "FailureCause",
    "as_dict",
    "causes",
    "heading",
    "junit",
    "markdown",
    "reasons",
    "summary",
    "verdict",
    "write_junit",
    "write_report",
]

WORDS = {"pass": "pass", "fail": "FAIL", "not_applicable": "not applicable", "error": "ERROR of the tester"}
_SHOWN = ("fail", "error")
_FIRST = ("fail", "error", "pass", "not_applicable")
"""Order of the results in a report for people."""
STYLE = """
:root { color-scheme: light dark; --line: #bbb; --soft: #f4f4f4; --fail: #fdd; --error: #fed; --pass: #efe; --grey: #666; }
@media (prefers-color-scheme: dark) { :root { --line: #555; --soft: #222; --fail: #5b1f1f; --error: #5b3a14; --pass: #17351c; --grey: #aaa; } }
body { font: 15px/1.45 system-ui, sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; }
h2 { font-size: 1.1em; } td, th { padding: .2em .8em; text-align: left; vertical-align: top; }
table { border-collapse: collapse; } tr { border-bottom: 1px solid var(--line); }
.fail { background: var(--fail); } .error { background: var(--error); } .pass { background: var(--pass); }
.not_applicable { color: var(--grey); } .verdict { font-weight: 600; padding: .5em .8em; }
pre { background: var(--soft); padding: 1em; overflow-x: auto; }
@media print { :root { color-scheme: light; } body { margin: 0; } tr, pre { break-inside: avoid; } thead { display: table-header-group; } }
"""


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


def heading(number: int, cause: FailureCause) -> str:
    """Return the line above a cause's frames: what it is, the clause, and the cases that it fails."""
    cases = f"{len(cause.cases)} cases: " if len(cause.cases) > 1 else "case "
    return f"cause {number}: {cause.text} ({cause.clause}; {cases}{', '.join(cause.cases)})"


def as_dict(report: Report) -> dict[str, Any]:
    """Return the report as JSON has it; the frames are those of a failure or an error."""
    return {
        "passed": report.count("pass"),
        "failed": report.count("fail"),
        "not_applicable": report.count("not_applicable"),
        "errors": report.count("error"),
        "complete": report.ended_by is None,
        "remarks": list(report.remarks),
        "causes": [
            {"cause": cause.text, "clause": cause.clause, "cases": list(cause.cases), "frames": list(cause.frames)}
            for cause in causes(report)
        ],
        "cases": [
            {
                "id": outcome.case.id,
                "name": outcome.case.name,
                "result": outcome.result,
                "reason": outcome.reason,
                **({"frames": list(outcome.frames)} if outcome.result in _SHOWN else {}),
            }
            for outcome in report.outcomes
        ],
    }


def summary(report: Report) -> str:
    """Return one line: how many cases passed, failed, do not apply."""
    listed = [outcome for outcome in report.outcomes if not outcome.case.is_additional]
    passed = sum(outcome.result == "pass" for outcome in listed)
    counts = (
        f"{report.count('pass')} passed, {report.count('fail')} failed, {report.count('not_applicable')} not applicable"
    )
    if errors := report.count("error"):
        counts += f", {errors} ended by an error of the tester"
    counts += f" ({passed} passed of the {len(listed)} listed cases)"
    return counts if report.ended_by is None else f"{counts}; the run was ended before its last case"


def verdict(report: Report) -> tuple[str, str]:
    """Return the kind of a run's result, "pass", "fail" or "error", and its sentence."""
    failed, errors = report.count("fail"), report.count("error")
    if failed:
        count = len(causes(report))
        return "fail", f"FAILED: {_number(failed, 'case')}, {_number(count, 'cause')}"
    if errors or report.ended_by is not None:
        return "error", "NOT COMPLETE: no case failed, and not every case has a result"
    return "pass", f"PASSED: {_number(report.count('pass'), 'case')}"


def _number(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _failures_first(report: Report) -> list[tuple[Outcome, str]]:
    """Return the cases with their reasons: failures, errors, passes, those that do not apply."""
    pairs = zip(report.outcomes, reasons(report), strict=True)
    return sorted(pairs, key=lambda pair: _FIRST.index(pair[0].result))


def junit(report: Report) -> ElementTree.Element:
    """Return the report as JUnit XML: one suite, a case that does not apply is skipped."""
    suite = ElementTree.Element(
        "testsuite",
        name=f"conformance of node {report.node_id}",
        tests=str(len(report.outcomes)),
        failures=str(report.count("fail")),
        skipped=str(report.count("not_applicable")),
        errors=str(report.count("error")),
        time=f"{sum(outcome.seconds for outcome in report.outcomes):.3f}",
    )
    for outcome in report.outcomes:
        name = f"{outcome.case.id} {outcome.case.name}"
        test = ElementTree.SubElement(
            suite, "testcase", classname="conformance", name=name, time=f"{outcome.seconds:.3f}"
        )
        if outcome.result in _SHOWN:
            kind = "failure" if outcome.result == "fail" else "error"
            failure = ElementTree.SubElement(test, kind, message=xml(outcome.reason))
            failure.text = xml("\n".join((outcome.reason, *outcome.frames)))
        elif outcome.result == "not_applicable":
            ElementTree.SubElement(test, "skipped", message=xml(outcome.reason))
    suites = ElementTree.Element("testsuites")
    suites.append(suite)
    return suites


def write_junit(report: Report, path: Path) -> None:
    """Write the report as JUnit XML."""
    tree = ElementTree.ElementTree(junit(report))
    ElementTree.indent(tree)
    tree.write(path, encoding="utf-8", xml_declaration=True)


def markdown(report: Report) -> str:
    """Return the report as Markdown: verdict, each cause with its frames, and a table of the cases,
    failures first.
    """
    lines = [
        f"# Conformance of {_cell(report.device)}, node {report.node_id}",
        "",
        f"**{verdict(report)[1]}.**",
        "",
        f"EDS: `{report.eds}`. {summary(report)}.",
        "",
        *(f"- {_cell(remark)}" for remark in report.remarks),
        "",
    ]
    for number, cause in enumerate(causes(report), 1):
        lines += [f"## {_cell(heading(number, cause))}", "", "```", *cause.frames, "```", ""]
    for outcome in _errors(report):
        lines += [f"## {outcome.case.id} {_cell(outcome.case.name)}", "", _cell(outcome.reason), ""]
        lines += ["```", *outcome.frames, "```", ""]
    lines += ["| case | name | result | reason |", "|---|---|---|---|"]
    lines += [
        f"| {outcome.case.id} | {_cell(outcome.case.name)} | {WORDS[outcome.result]} | {_cell(reason)} |"
        for outcome, reason in _failures_first(report)
    ]
    return "\n".join(lines) + "\n"


def page(report: Report) -> str:
    """Return the report as an HTML page of its own: light or dark, and to be printed."""
    text = html.escape
    rows = "".join(
        f'<tr class="{outcome.result}"><td>{text(outcome.case.id)}<td>{text(outcome.case.name)}'
        f"<td>{WORDS[outcome.result]}<td>{text(reason)}</tr>\n"
        for outcome, reason in _failures_first(report)
    )
    remarks = "".join(f"<li>{text(remark)}\n" for remark in report.remarks)
    details = "".join(
        f"<h2>{text(head)}</h2><pre>{text(chr(10).join(frames))}</pre>\n"
        for head, frames in (
            *((heading(number, cause), cause.frames) for number, cause in enumerate(causes(report), 1)),
            *((f"{outcome.case.id} {outcome.reason}", outcome.frames) for outcome in _errors(report)),
        )
    )
    title = text(f"Conformance of {report.device}, node {report.node_id}")
    kind, sentence = verdict(report)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>\n'
        f'<h1>{title}</h1><p class="verdict {kind}">{text(sentence)}</p><p>EDS: {text(report.eds)}. {summary(report)}.</p>\n'
        f"<ul>{remarks}</ul>{details}"
        f"<table><thead><tr><th>case<th>name<th>result<th>reason</tr></thead>\n{rows}</table></html>\n"
    )


def write_report(report: Report, path: Path) -> None:
    """Write the readable report; the ending says whether Markdown or HTML."""
    content = page(report) if path.suffix.lower() in (".html", ".htm") else markdown(report)
    path.write_text(printable(content), encoding="utf-8")


def _errors(report: Report) -> list[Outcome]:
    return [outcome for outcome in report.outcomes if outcome.result == "error"]


def _cell(text: str) -> str:
    return one_line(text).replace("|", "\\|")
