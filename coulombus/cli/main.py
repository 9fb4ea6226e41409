"""The command line: a thin dispatcher to the verbs. A verb is imported when it is asked for, and
imports what it needs when it runs.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from importlib import import_module

import click

from coulombus.cli.errors import EXIT_STATUS, Verbs
from coulombus.cli.tables import echo

__all__ = ["main"]

SECTIONS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "Simulate": {
        "demo": ("simulate:demo", "Show the paper's experiment: motor alone, then hybrid"),
        "simulate": ("simulate:simulate_command", "Run a simulated rig in virtual time"),
        "sim": ("sim:sim", "Serve a bus with simulated devices and rig in real time"),
        "sweep": ("sweep:sweep_command", "Simulate many rigs and hands, and count rates"),
        "experiment": ("experiment:experiment_command", "Show a study to a subject, trial by trial"),
        "law": ("law:law", "List the friction laws, or drive one along a motion"),
    },
    "Run a rig": {
        "run": ("run:run_command", "Run the host in real time on a bus with devices"),
        "status": ("status:status", "Ask a running host for its state"),
        "stop": ("run:stop", "Stop a running host safely"),
        "mark": ("mark:mark", "Mark the recording of a running host"),
        "set": ("set:set_command", "Change the law's parameters of a running host"),
    },
    "Look at a bus and its devices": {
        "watch": ("look:watch", "Show a bus live, in SI units"),
        "hz": ("hz:hz", "Measure rate and jitter of each identifier"),
        "scan": ("scan:scan", "Find the devices on a bus"),
        "sdo": ("sdo:sdo", "Read and write objects of a device (SDO)"),
        "nmt": ("nmt:nmt", "Start, stop or reset nodes (NMT)"),
        "lss": ("lss:lss", "Give devices node ids and bit rates (CiA 305)"),
        "node": ("sim:node_command", "Serve any EDS file as a live device"),
        "bridge": ("replay:bridge", "Join two buses"),
        "conformance": ("conformance:conformance", "Test a CANopen device against its EDS and CiA 301, 305, 402"),
    },
    "Use recordings": {
        "decode": ("look:decode", "Print a recording frame by frame, in SI units"),
        "plot": ("plot:plot_command", "Draw a recording's signals"),
        "diff": ("plot:diff", "Compare two recordings"),
        "export": ("export:export_command", "Write a recording as CSV, Parquet, MAT, MF4, MCAP, BLF ..."),
        "replay": ("replay:replay", "Play a recording onto a bus, or check it bit for bit"),
        "identify": ("identify:identify", "Identify friction from a recording, with intervals"),
    },
    "Describe and set up a rig": {
        "init": ("init:init", "Draft a rig file from EDS files or from live devices"),
        "check": ("check:check", "Check a rig file and its EDS files"),
        "plan": ("plan:plan_command", "Compute whether a rig's traffic fits on its bus"),
        "measure": ("measure:measure", "Measure response times of devices and host"),
        "commission": ("commission:commission", "Measure a rig, and write the figures into its rig file"),
        "doctor": ("doctor:doctor", "Check whether this PC is fit for a rig"),
        "systemd": ("systemd:systemd", "Write systemd units for host, simulation and bridge"),
        "eds": ("eds:eds", "Check EDS and DCF files"),
    },
    "Names for other tools, and theory": {
        "pdo": ("hz:pdo", "Draw the rig's PDOs bit by bit"),
        "dbc": ("look:dbc", "Write a DBC file of the rig's PDOs"),
        "tools": ("tools:tools", "Write files for Wireshark, cantools, PlotJuggler, Foxglove"),
        "analyse": ("analyse:analyse", "Compute the theory of the paper, with figures"),
    },
}
"""Each verb's place, a module of this folder and its function, and what it does in a line."""


class Commands(Mapping[str, click.Command]):
    """The verbs by name, in the order of `SECTIONS`; each is imported when it is looked up."""

    def __init__(self) -> None:
        self._rows = {name: row for section in SECTIONS.values() for name, row in section.items()}

    def __getitem__(self, name: str) -> click.Command:
        place, text = self._rows[name]
        module, _, function = place.partition(":")
        verb: click.Command = getattr(import_module(f"{__package__}.{module}"), function)
        verb.short_help = text
        return verb

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def __contains__(self, name: object) -> bool:
        return name in self._rows


class Coulombus(Verbs):
    """All verbs, listed by what one wants to do."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the verbs of each section, a line each; none is imported."""
        widest = max(map(len, self.commands))
        for title, verbs in SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(widest), text) for name, (_, text) in verbs.items()])


LIBRARIES = ("numba", "llvmlite", "numpy", "scipy", "pydantic", "python-can", "canopen")
"""Whose versions a report needs."""


def _tell_versions(context: click.Context, option: click.Parameter, asked: bool) -> None:
    if not asked or context.resilient_parsing:
        return
    import platform
    from importlib.metadata import version

    echo(f"coulombus, version {version('coulombus')}")
    echo(", ".join((f"Python {platform.python_version()}", *(f"{name} {version(name)}" for name in LIBRARIES))))
    echo(platform.platform())
    context.exit()


@click.group(
    cls=Coulombus,
    commands=Commands(),
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog=EXIT_STATUS,
)
@click.option(
    "--version",
    is_flag=True,
    expose_value=False,
    is_eager=True,
    callback=_tell_versions,
    help="Show the versions and exit.",
)
def main() -> None:
    """Friction you can feel, over a CAN bus.

    A DC motor drive and an MR brake as CANopen nodes, a host that runs a friction law at 1 kHz
    through PDOs, and a bit-exact virtual bus with a simulated rig that stands in for the hardware.

    \b
    Examples:
      coulombus demo
      coulombus sim                                  # in a terminal of its own
      coulombus run --mode hybrid --seconds 13       # when sim says ready
      coulombus simulate --mode hybrid --seconds 13 --record run.pcapng
      coulombus decode run.pcapng | less
      coulombus check --rig my-rig.toml
    """
    for library in ("can", "canopen"):  # what goes wrong there comes as an exception, whose text is told
        logging.getLogger(library).addHandler(logging.NullHandler())
