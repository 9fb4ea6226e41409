"""``coulombus export``: write a recording for other programs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json, remark
from coulombus.cli.option_types import OutputFile, output_named_after
from coulombus.cli.options import OverwriteOption, RecordingArgument, SignalsOption, option, with_options
from coulombus.cli.rig_options import LogOptions
from coulombus.cli.tables import progress
from coulombus.system.exit import say, verdict

__all__ = ["export_command"]

KINDS = ("csv", "parquet", "mf4", "mcap", "hdf5", "mat", "candump", "asc", "blf")
UNITS = {"us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}


class _Time(click.ParamType):  # type: ignore[type-arg]  # generic to some versions' types only
    """A duration with its unit, in whole ns."""

    name = "time"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        text = str(value)
        unit = next((unit for unit in UNITS if text.endswith(unit)), "")
        try:
            ns = round(float(text.removesuffix(unit)) * UNITS[unit])
        except (KeyError, ValueError, OverflowError):
            ns = 0
        if not 1_000 <= ns <= 3_600_000_000_000:
            self.fail(f"{text!r}: expected a time from 1us to 3600s, with its unit, as in 1ms", param, ctx)
        return ns


def _kind_of(out: Path | None, suffixes: Mapping[str, str]) -> str:
    """Return the format of the suffix of `out`."""
    kinds = {suffix: kind for kind, suffix in suffixes.items()}
    if out is not None and out.suffix.lower() in kinds:
        return kinds[out.suffix.lower()]
    raise click.UsageError(f"Name the format: --to {'|'.join(suffixes)}, or --out FILE with one of {' '.join(kinds)}")


@click.command("export", epilog=EXIT_STATUS)
@with_options
def export_command(
    file: RecordingArgument,
    kind: Annotated[
        str | None, option("--to", "Format to write.  [default: that of --out's ending]", type=click.Choice(KINDS))
    ],
    signals: SignalsOption,
    grid_ns: Annotated[
        int | None,
        option(
            "--grid",
            "A row each 1ms (us, ms, s), values held.  [default: a row for each frame of a PDO, as it came]",
            type=_Time(),
            metavar="TIME",
        ),
    ],
    out: Annotated[
        Path | None,
        option("-o", "--out", "Output file.  [default: FILE, with another ending]", type=OutputFile(), metavar="F"),
    ],
    log: LogOptions,
    overwrite: OverwriteOption,
    as_json: Annotated[bool, option("--json", "Print what was written as JSON to stdout.")],
) -> None:
    """Write a recording as other programs read it: signals by name in SI units (csv, parquet, mf4,
    mcap, hdf5, mat), or whole frames (candump, asc, blf).

    The file is written whole or not at all, in a memory that does not grow with the recording.
    parquet, mf4 and hdf5 need libraries: pip install -e '.[export]' in the clone.

    \b
    Examples:
      coulombus export run.pcapng --to csv
      coulombus export run.pcapng --to mf4 --grid 1ms -o run.mf4
      coulombus export run.pcapng --to parquet --signals motor.position_rad,brake.setpoint_Nm
      coulombus export candump.log --eds 5=drive.eds --to mf4
      coulombus export run.pcapng --to candump -o run.log && canplayer -I run.log vcan0=can0
    """
    with errors():
        from coulombus.recording.export.export import KINDS as SUFFIXES
        from coulombus.recording.export.export import export

        if kind is None:
            kind = _kind_of(out, SUFFIXES)
        if kind in ("candump", "asc", "blf") and (signals is not None or grid_ns is not None):
            raise click.UsageError(f"{kind} has whole frames: leave --signals and --grid out")
        files = log.files()
        place = out or output_named_after(file, SUFFIXES[kind], overwrite)
        with progress(not as_json, "exported") as report:
            exported = export(
                file,
                place,
                kind,
                signals=signals,
                grid_ns=grid_ns,
                rig=log.rig_name,
                channel=log.channels,
                eds=files,
                force=overwrite,
                progress=lambda t_s: report(kind, t_s, None),
            )
        with verdict(0):
            remark(exported.remarks)
            if as_json:
                document = {
                    "file": str(exported.path),
                    "to": exported.kind,
                    "until_s": exported.until_s,
                    "rows": exported.rows,
                }
                print_json({**document, "signals": list(exported.signals), "remarks": list(exported.remarks)})
            else:
                what = (
                    f"{exported.rows} rows of {len(exported.signals)} signals"
                    if exported.signals
                    else f"{exported.rows} frames"
                )
                say(f"{exported.path}: {what}, {exported.until_s:.3f} s")
