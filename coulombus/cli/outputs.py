"""Output options of ``coulombus run``, and the resulting outputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from coulombus.cli.bundle import bundle, repeated
from coulombus.cli.common import force_option
from coulombus.cli.option_types import PICTURE, RecordingPlace

if TYPE_CHECKING:
    from coulombus.host.run.markers import BitMark
    from coulombus.host.run.run import Outputs
    from coulombus.rigs.rig import Rig

__all__ = ["OutputOptions", "outputs_options"]

SEGMENT = "100MB"
"""Default size at which a segment ends."""
ZSTD = "zstd"


@dataclass(frozen=True)
class OutputOptions:
    """The given options."""

    record: Path | None
    rotate: str | None
    keep: str | None
    compress: str | None
    status: Path | None
    meta: tuple[str, ...]
    mark_on: tuple[str, ...]
    overwrite: bool
    histogram: Path | None

    @property
    def segmented(self) -> bool:
        """Whether the recording is a folder of segments."""
        return self.record is not None and self.record.is_dir()

    @property
    def files(self) -> dict[str, Path]:
        """Output files: option -> path."""
        places = {"--record": self.record, "--histogram": self.histogram, "--status": self.status}
        return {option: path for option, path in places.items() if path is not None}

    def refusable(self) -> Iterable[Path]:
        """Return the files that are refused if they exist: not folders or sockets."""
        return [
            path
            for option, path in self.files.items()
            if option != "--status" and not (self.segmented and option == "--record")
        ]

    def words(self) -> list[str]:
        """Return the command-line words of all options except the files."""
        words = ["--overwrite"] if self.overwrite else []
        if self.segmented:
            words += ["--rotate", self.rotate or SEGMENT, *(["--keep", self.keep] if self.keep else [])]
            words += ["--compress", self.compress or ZSTD]
        return words + repeated("--meta", self.meta) + repeated("--mark-on", self.mark_on)

    def outputs(self, rig: Rig) -> Outputs:
        """Return the outputs of the run on `rig`.

        Raises
        ------
        click.UsageError
            The options are incompatible.
        """
        from dataclasses import replace

        from coulombus.host.run.run import Outputs
        from coulombus.recording.segments import parse_rotation, parse_size

        rotation = None if self.rotate is None else parse_rotation(self.rotate)
        keep = None if self.keep is None else parse_size(self.keep)
        if self.segmented:
            compress = self.compress in (None, ZSTD)
            rotation = replace(rotation or parse_rotation(SEGMENT), keep_bytes=keep, compress=compress)
            if keep is not None and keep < 2 * (rotation.most_bytes or 0):
                raise click.UsageError(
                    f"--keep {keep} bytes: expected at least two segments of {rotation.most_bytes} bytes"
                )
        elif rotation is not None or keep is not None or self.compress is not None:
            raise click.UsageError(
                "--rotate, --keep and --compress are of a folder: give one with --record, as in "
                "--record runs --rotate 1h"
            )
        return Outputs(
            record=self.record,
            rotation=rotation,
            meta=self._said(),
            mark_on=self._bits(rig),
            histogram=self.histogram,
            status=self.status,
            force=self.overwrite,
        )

    def _bits(self, rig: Rig) -> tuple[BitMark, ...]:
        """Return the bits named by --mark-on."""
        from coulombus.host.run.markers import bit_mark

        if self.mark_on and self.record is None:
            raise click.UsageError("--mark-on marks a recording: give --record, too")
        try:
            return tuple(bit_mark(text, rig) for text in self.mark_on)
        except ValueError as error:
            raise click.BadParameter(str(error), param_hint="--mark-on") from None

    def _said(self) -> dict[str, str]:
        """Return the pairs of --meta."""
        if self.meta and self.record is None:
            raise click.UsageError("--meta is of a recording: give --record, too")
        pairs: dict[str, str] = {}
        for text in self.meta:
            key, equals, value = text.partition("=")
            if not equals or not key.strip() or key in pairs:
                reason = "twice" if key in pairs else "expected KEY=VALUE, as in subject=S01"
                raise click.BadParameter(f"{text!r}: {reason}", param_hint="--meta")
            pairs[key] = value
        return pairs


def _readable(parser: str) -> Callable[[click.Context, click.Parameter, str | None], str | None]:
    """Return an option callback that refuses a text which `recording.segments` cannot read, before a folder is made."""

    def check(context: click.Context, option: click.Parameter, text: str | None) -> str | None:
        from coulombus.recording import segments

        try:
            if text is not None:
                getattr(segments, parser)(text)
        except ValueError as error:
            raise click.BadParameter(str(error)) from None
        return text

    return check


outputs_options = bundle(
    "outputs",
    OutputOptions,
    click.option(
        "--record",
        type=RecordingPlace(),
        metavar="PLACE",
        help="Record every frame there: in a new file F.pcapng, or in segments in a folder.",
    ),
    click.option(
        "--rotate",
        is_eager=True,
        callback=_readable("parse_rotation"),
        metavar="SIZE|TIME",
        help=f"--record is a folder; a new segment after this size or time: 100MB, 1h.  [default of a folder: {SEGMENT}]",
    ),
    click.option(
        "--keep",
        callback=_readable("parse_size"),
        metavar="SIZE",
        help="Keep this much in that folder, and remove the oldest segments: 20GB.  [default: all]",
    ),
    click.option(
        "--compress",
        type=click.Choice([ZSTD, "none"]),
        help=f"Compress finished segments, in a process of the lowest priority.  [default of a folder: {ZSTD}]",
    ),
    click.option(
        "--status",
        type=click.Path(readable=False, path_type=Path),
        metavar="SOCKET",
        help="Make a socket there that sends the state, a JSON line every 100 ms, to each reader.",
    ),
    click.option("--meta", multiple=True, metavar="KEY=VALUE", help="Attach this to the recording: subject=S01."),
    click.option(
        "--mark-on",
        multiple=True,
        metavar="SIGNAL:MASK=TEXT",
        help="Mark the recording when these bits of a signal become 1: motor.deadman:0x20000=pedal.",
    ),
    force_option,
    click.option("--histogram", type=PICTURE, metavar="F.png", help="Draw wake-up and SYNC-to-RPDO times there."),
)
