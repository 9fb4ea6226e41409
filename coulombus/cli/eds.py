"""`coulombus eds` and its verbs."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import click

from coulombus.cli.common import json_option, verdict
from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.tables import echo

if TYPE_CHECKING:
    from coulombus.eds.pdo import PdoLayout

__all__ = ["eds"]

READABLE, REFUSED = 0, 3


@click.group("eds", epilog=EXIT_STATUS)
def eds() -> None:
    """Look at electronic data sheets (EDS, DCF, XDD, XDC), the files that describe CANopen devices."""


@eds.command("check", epilog=EXIT_STATUS)
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@click.option("--node-id", type=click.IntRange(1, 127), default=1, show_default=True, help="Node id for $NODEID.")
@click.option("--pdos", is_flag=True, help="Draw every PDO that maps something.")
@click.option("--sarif", is_flag=True, help="SARIF 2.1.0 to stdout, for code hosts and editors.")
@json_option
def check_command(files: Sequence[str], node_id: int, pdos: bool, sarif: bool, as_json: bool) -> None:
    """Say everything that is wrong with EDS, DCF, XDD or XDC files, and what is assumed instead.

    A line is FILE:LINE: SEVERITY: what; assumed what. A warning has one sensible reading; after an
    error something is missing; "refused" is what cannot be read right and is never guessed: a PDO,
    which is then not valid at start while everything else is used, or a file without objects. Ends
    with 0 when every file can be used, warnings or not, and with 3 when one is refused or cannot be
    opened.

    \b
    Examples:
      coulombus eds check vendor.eds
      coulombus eds check --pdos --node-id 5 eds/motor.eds
      coulombus eds check --json *.eds | jq '.[] | select(.readable | not) | .file'
      coulombus eds check --sarif *.eds > eds.sarif
    """
    with errors():
        if as_json and sarif:
            raise click.UsageError("--json and --sarif: choose one form of the output")
        results = [_check(file, node_id) for file in files]
        with verdict(READABLE if all(result["readable"] for result in results) else REFUSED):
            if as_json:
                kept = [{key: result[key] for key in result if key != "drawn"} for result in results]
                echo(json.dumps(kept, indent=2))
            elif sarif:
                echo(json.dumps(_sarif(results), indent=2))
            else:
                for result in results:
                    _print(result, pdos)


def _check(file: str, node_id: int) -> dict[str, Any]:
    """Return the `--json` object of one file; `drawn` has the diagrams of its PDOs."""
    from coulombus.eds.check import check
    from coulombus.eds.reader import EdsError, read_eds

    result: dict[str, Any] = {
        "file": file,
        "readable": False,
        "objects": 0,
        "pdos": 0,
        "diagnoses": [],
        "refused": [],
        "drawn": [],
    }
    try:
        report = check(read_eds(file), node_id)
    except EdsError as error:
        result["refused"] = [_refusal(file, str(error))]
        return result
    return result | {
        "readable": True,
        "objects": len(report.description.objects),
        "pdos": len(report.pdos),
        "diagnoses": [
            {"line": d.line, "severity": d.severity, "text": d.text, "assumed": d.assumed} for d in report.diagnoses
        ],
        "refused": [_refusal(file, text) for text in report.refusals],
        "drawn": [_drawing(pdo) for pdo in report.pdos if pdo.entries],
    }


def _sarif(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the results as a log of SARIF 2.1.0 (OASIS): a rule for each severity; "refused" is an error, too."""
    from importlib.metadata import version

    entries = []
    for result in results:
        file = {"uri": quote(Path(result["file"]).as_posix())}
        rows = [(d["severity"], d["line"], f"{d['text']}; assumed {d['assumed']}") for d in result["diagnoses"]]
        rows += [("refused", r["line"], r["text"]) for r in result["refused"]]
        for severity, line, text in rows:
            place: dict[str, Any] = {"artifactLocation": file}
            place |= {} if line is None else {"region": {"startLine": line}}
            level = "warning" if severity == "warning" else "error"
            entry = {"ruleId": severity, "level": level, "message": {"text": text}}
            entries.append({**entry, "locations": [{"physicalLocation": place}]})
    rules = [{"id": severity} for severity in ("warning", "error", "refused")]
    tool = {"driver": {"name": "coulombus eds check", "version": version("coulombus"), "rules": rules}}
    schema = "https://json.schemastore.org/sarif-2.1.0.json"
    return {"$schema": schema, "version": "2.1.0", "runs": [{"tool": tool, "results": entries}]}


def _drawing(pdo: PdoLayout) -> str:
    identifier = "not valid" if pdo.cob_id < 0 else f"{pdo.cob_id:03X}h"
    return (
        f"{pdo.direction.upper()}{pdo.number}, {identifier}, transmission type {pdo.transmission}:\n\n{pdo.diagram()}\n"
    )


def _refusal(file: str, text: str) -> dict[str, Any]:
    """Split ``file:line: text`` of an `EdsError`; a file that cannot be read has no line."""
    rest = text.removeprefix(f"{file}:")
    line, _, what = rest.partition(": ")
    return {"line": int(line), "text": what} if line.isdecimal() else {"line": None, "text": rest.strip()}


def _print(result: dict[str, Any], pdos: bool) -> None:
    file = result["file"]
    for d in result["diagnoses"]:
        echo(f"{file}:{d['line']}: {d['severity']}: {d['text']}; assumed {d['assumed']}")
    without = "; the PDO is not valid at start" if result["readable"] else ""
    for r in result["refused"]:
        line = "" if r["line"] is None else f":{r['line']}"
        echo(f"{file}{line}: refused: {r['text']}{without}")
    if pdos:
        for drawing in result["drawn"]:
            echo(f"\n{drawing}")
    count = Counter(d["severity"] for d in result["diagnoses"])
    verdict = "readable" if result["readable"] else "refused"
    if result["readable"] and result["refused"]:
        verdict += f" but for {_number(len(result['refused']), 'PDO')}"
    summary = f"{_number(count['error'], 'error')}, {_number(count['warning'], 'warning')}"
    size = f"{_number(result['objects'], 'object')}, {_number(result['pdos'], 'PDO')}"
    echo(f"{file}: {verdict}: {size}, {summary}")


def _number(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")
