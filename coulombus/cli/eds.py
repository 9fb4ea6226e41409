"""`coulombus eds` and its verbs."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from urllib.parse import quote

import click

from coulombus.cli.device_options import (
    BesideOption,
    DevicesBusOption,
    LiveLine,
    NodeArgument,
    TimeoutOption,
    open_link,
)
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import InputPath, OutputFile
from coulombus.cli.options import JsonOption, OverwriteOption, argument, option, with_options
from coulombus.cli.tables import echo
from coulombus.system.exit import say, verdict

if TYPE_CHECKING:
    from coulombus.eds.pdo import PdoLayout

__all__ = ["eds"]

READABLE, REFUSED = 0, 3


@click.group("eds", epilog=EXIT_STATUS)
def eds() -> None:
    """Look at electronic data sheets (EDS, DCF, XDD, XDC), the files that describe CANopen devices."""


@eds.command("check", epilog=EXIT_STATUS)
@with_options
def check_command(
    files: Annotated[Sequence[str], argument(nargs=-1, required=True, metavar="FILE...")],
    node_id: Annotated[int, option("Node id for $NODEID.", type=click.IntRange(1, 127), default=1)],
    pdos: Annotated[bool, option("Draw every PDO that maps something.")],
    sarif: Annotated[bool, option("SARIF 2.1.0 to stdout, for code hosts and editors.")],
    as_json: JsonOption,
) -> None:
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
                rows = [{key: result[key] for key in result if key != "drawn"} for result in results]
                echo(json.dumps(rows, indent=2))
            elif sarif:
                echo(json.dumps(_sarif(results), indent=2))
            else:
                for result in results:
                    _print(result, pdos)


@eds.command("convert", epilog=EXIT_STATUS)
@with_options
def convert_command(
    a: Annotated[Path, argument(metavar="A", type=InputPath())],
    b: Annotated[Path, argument(metavar="B", type=OutputFile(".eds", ".dcf", ".xdd", ".xdc"))],
    overwrite: OverwriteOption,
    as_json: JsonOption,
) -> None:
    """Write the EDS, DCF, XDD or XDC file A as B, in the form of B's ending.

    B has every object with its name, type, access, default, limits, PDO mapping, unit and
    description, and the data of the file and of the device. What B's form cannot say is printed, a
    line each. An EDS or XDD has no configured values: those of a DCF or XDC are left out.

    \b
    Examples:
      coulombus eds convert drive.eds drive.xdd
      coulombus eds convert drive.xdd drive.eds --overwrite
      coulombus eds convert axis5.dcf axis5.xdc --json | jq .left_out
    """
    with errors():
        from coulombus.eds.convert import converted
        from coulombus.recording.output_file import new_file

        text, left_out = converted(a, b.suffix.lower())
        with new_file(b, force=overwrite) as path:
            path.write_text(text, encoding="utf-8", newline="\n")
        with verdict(0):
            if as_json:
                print_json({"file": str(b), "left_out": list(left_out)})
                return
            for what in left_out:
                echo(f"{b}: left out: {what}")
            echo(f"{b}: written")


@eds.command("diff", epilog=EXIT_STATUS)
@with_options
def diff_command(
    a: Annotated[Path, argument(metavar="A", type=InputPath())],
    b: Annotated[Path, argument(metavar="B", type=InputPath())],
    as_json: JsonOption,
) -> None:
    """Compare two EDS, DCF, XDD or XDC files, object by object.

    A line is PLACE SUBJECT: value in A -> value in B. Notations do not count: 0x10 is 16. Ends with
    0 when the files describe the same, with 1 when not.

    \b
    Examples:
      coulombus eds diff old.eds new.eds
      coulombus eds diff drive.eds drive.xdd --json | jq length
    """
    with errors():
        from coulombus.eds.eds_changes import changes
        from coulombus.eds.reader import read_eds

        differences = list(changes(read_eds(a), read_eds(b)))
        with verdict(1 if differences else 0):
            if as_json:
                print_json([change._asdict() for change in differences])
                return
            for change in differences:
                echo(str(change))
            echo(f"{_number(len(differences), 'difference')}" if differences else "the same")


def _range(ctx: click.Context, param: click.Parameter, texts: tuple[str, ...]) -> tuple[tuple[int, int], ...]:
    """Return the first and last index of each stretch, given as 2000-20FF or 2000."""
    ranges = []
    for text in texts:
        match = re.fullmatch(r"(?:0x)?([0-9A-Fa-f]{4})h?(?:-(?:0x)?([0-9A-Fa-f]{4})h?)?", text.strip())
        first, last = (int(match[1], 16), int(match[2] or match[1], 16)) if match else (1, 0)
        if not 0x1000 <= first <= last:
            raise click.BadParameter(f"{text!r}: expected indices from 1000 to FFFF, as 2000-20FF")
        ranges.append((first, last))
    return tuple(ranges)


@eds.command("from-device", epilog=EXIT_STATUS)
@with_options
def from_device_command(
    node_id: NodeArgument,
    bus_name: DevicesBusOption,
    out: Annotated[
        Path | None,
        option("-o", "--out", "Write the file there.  [default: stdout]", type=OutputFile(".eds"), metavar="F.eds"),
    ],
    ranges: Annotated[
        tuple[tuple[int, int], ...],
        option(
            "--range",
            "Only these indices, as 2000-20FF. May be given several times.  [default: 1000-9FFF]",
            callback=_range,
            metavar="A-B",
        ),
    ],
    try_access: Annotated[bool, option("Write each object's own value back, to see whether it can be written.")],
    timeout_s: TimeoutOption,
    beside: BesideOption,
    overwrite: OverwriteOption,
) -> None:
    """Make an EDS file of a device that has none, by its own answers to SDO.

    Every index is read, which takes some minutes. Types are those of the sizes; names, signs and
    access come from CiA 301 and the device's profile, as far as they are known. Any other object is
    read-only, unless --try-access writes its value back: not where a host is at work, and not where
    a write of the value could act. PDO maps are those that the device has now.

    \b
    Examples:
      coulombus eds from-device 5 --bus socketcan:can0 -o drive.eds
      coulombus eds from-device 5 --bus coulombus:bench --range 1000-1FFF --range 2000-20FF
    """
    with errors():
        from coulombus.eds.convert import eds_text_of
        from coulombus.host.devices.dictionary_scan import EVERYWHERE, DictionaryScan
        from coulombus.host.sdo.sdo_client import LATE_S, SdoClient
        from coulombus.recording.output_file import new_file

        with open_link(bus_name, beside=beside or not try_access) as link, LiveLine() as show:
            client = SdoClient(link, node_id, timeout_s, late_s=LATE_S)
            scan = DictionaryScan(client, ranges or EVERYWHERE, lambda index: show(f"{index:04X}h"), try_access)
            content = scan.content()
        text = eds_text_of(content)
        if out is not None:
            with new_file(out, force=overwrite) as path:
                path.write_text(text, encoding="utf-8", newline="\n")
        with verdict(0):
            for remark in scan.remarks:
                say(f"coulombus: {remark}")
            if out is None:
                echo(text, nl=False)
            else:
                echo(f"{out}: {_number(sum(row.subindex < 0 for row in content.rows), 'object')} of node {node_id}")


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
