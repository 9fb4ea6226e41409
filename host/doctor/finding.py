"""Outcomes of checks, and their execution, which never raises."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple, TypeAlias

from coulombus.host.doctor.machine import CannotRead
from coulombus.system.quoting import comment

__all__ = ["Check", "CheckResult", "Outcome", "examine", "script"]


class Outcome(NamedTuple):
    """Outcome of a check: whether it is ok, what it found, and the command that fixes it.

    Without such a command, the fix is a comment of the shell: ``# ...``.
    """

    ok: bool
    found: str
    fix: str = ""


Check: TypeAlias = tuple[str, Callable[[], Outcome]]
"""A check's name (SUBJECT.NAME) and its function."""


@dataclass(frozen=True)
class CheckResult:
    """The outcome of the check `check`."""

    check: str
    ok: bool
    found: str
    fix: str = ""
    figures: dict[str, Any] = field(default_factory=dict)
    """Figures of the latency test; else empty."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, without empty `figures`."""
        fields = asdict(self)
        return fields if self.figures else {name: fields[name] for name in fields if name != "figures"}


def examine(checks: Iterable[Check]) -> list[CheckResult]:
    """Run the checks.

    An unreadable value is reported as unknown, not as ok.
    """
    findings = []
    for name, check in checks:
        try:
            outcome = check()
        except CannotRead as error:
            outcome = Outcome(False, str(error), "# look at it by hand")
        except Exception as error:
            text = f"this check failed: {type(error).__name__}: {error}"
            outcome = Outcome(False, text, "# internal error, please report it")
        findings.append(CheckResult(name, outcome.ok, _line(outcome.found), "" if outcome.ok else outcome.fix))
    return findings


def _line(text: str) -> str:
    return " ".join(text.split())


def script(findings: Iterable[CheckResult]) -> str:
    """Return a shell script of all fixes, each once, with the findings as comments."""
    lines = ["#!/bin/sh", "# made by `coulombus doctor --fix`: read it before you run it", "set -eu", ""]
    done: set[str] = set()
    for finding in findings:
        if finding.ok or finding.fix in done:
            continue
        done.add(finding.fix)
        lines += [f"# {finding.check}: {comment(finding.found)}", finding.fix or "# no command fixes it", ""]
    if not done:
        lines += ["# nothing to fix", ""]
    return "\n".join(lines)
