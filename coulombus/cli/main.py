"""The command line: a thin dispatcher to the verbs.

A verb is imported on demand, and imports its dependencies when it runs.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from importlib import import_module

import click

from coulombus.cli.errors import Verbs
from coulombus.cli.tables import echo

__all__ = ["main"]

SECTIONS: Mapping[str, Mapping[str, str]] = {
    "Simulate": {
        "demo": "Show the paper's experiment: motor alone, then hybrid",
        "simulate": "Run a simulated rig in virtual time",
        "emulate": "Stand in for devices and rig, on a bus, in real time",
        "inject": "Break a running simulated bus or device",
        "clear": "Repair what inject has broken",
        "sweep": "Simulate many rigs and hands, and count rates",
        "experiment": "Show a study to a subject, trial by trial",
        "law": "List the friction laws, or drive one along a motion",
    },
    "Run a rig": {
        "run": "Run the host in real time on a bus with devices",
        "status": "Ask a running host for its state",
        "stop": "Stop a running host safely",
        "mark": "Mark the recording of a running host",
        "set": "Change the law's parameters of a running host",
        "world": "Let WebSocket clients use the display of a running host",
    },
    "Bus and devices": {
        "watch": "Show a bus live, in SI units",
        "hz": "Measure rate and jitter of each identifier",
        "scan": "Find the devices on a bus",
        "sdo": "Read and write objects of a device (SDO)",
        "nmt": "Start, stop or reset nodes (NMT)",
        "lss": "Give devices node ids and bit rates (CiA 305)",
        "node": "Serve any EDS file as a live device",
        "bridge": "Join two buses",
        "conformance": "Test a CANopen device against its EDS and CiA 301, 305, 402",
    },
    "Recordings": {
        "explain": "Say what went wrong in a log or on a bus, and what to check",
        "decode": "Print a recording frame by frame, in SI units",
        "plot": "Draw a recording's signals",
        "diff": "Compare two recordings",
        "export": "Write a recording as CSV, Parquet, MAT, MF4, MCAP, BLF ...",
        "replay": "Play a recording onto a bus, or check it bit for bit",
        "identify": "Identify friction from a recording, with intervals",
    },
    "Set up a rig": {
        "init": "Draft a rig file from EDS files or from live devices",
        "check": "Check a rig file and its EDS files",
        "plan": "Compute whether a rig's traffic fits on its bus",
        "measure": "Measure response times of devices and host",
        "commission": "Measure a rig, and write the figures into its rig file",
        "doctor": "Check whether this PC is fit for a rig",
        "systemd": "Write systemd units for host, simulation and bridge",
        "eds": "Check EDS and DCF files",
    },
    "Theory, tools, help": {
        "pdo": "Draw the rig's PDOs bit by bit",
        "dbc": "Write a DBC file of the rig's PDOs",
        "tools": "Write files for Wireshark, cantools, PlotJuggler, Foxglove",
        "analyse": "Compute the theory of the paper, with figures",
        "warm-up": "Compile in advance what all commands need",
        "help": "Explain a command, list them all, or the exit statuses",
    },
}
"""The verbs, each a module of this folder, with a one-line summary."""
TEXTS: Mapping[str, str] = {name: text for verbs in SECTIONS.values() for name, text in verbs.items()}


FORMER: Mapping[str, str] = {"sim": "emulate"}
"""Former names of verbs, which still work."""
FIRST = ("demo", "simulate", "run", "watch", "explain", "check")
"""Verbs for beginners."""


class Commands(Mapping[str, click.Command]):
    """The verbs by name, in the order of `SECTIONS`; each is imported on lookup."""

    def __getitem__(self, name: str) -> click.Command:
        name = FORMER.get(name, name)
        text = TEXTS[name]
        things = vars(import_module(f"{__package__}.{name.replace('-', '_')}")).values()
        verb = next(thing for thing in things if isinstance(thing, click.Command) and thing.name == name)
        verb.short_help = text
        return verb

    def __iter__(self) -> Iterator[str]:
        return iter(TEXTS)

    def __len__(self) -> int:
        return len(TEXTS)

    def __contains__(self, name: object) -> bool:
        return name in TEXTS or name in FORMER


class Coulombus(Verbs):
    """All verbs; the help fits a terminal of 24 lines."""

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the first verbs, the names of all, and pointers to more help; no verb is imported."""
        formatter.write(
            "Friction you can feel, over a CAN bus.\n\nUsage: coulombus COMMAND [OPTIONS] [ARGUMENTS], or coulombus --version\n"
        )
        with formatter.section("Start with"):
            formatter.write_dl([(name, TEXTS[name]) for name in FIRST])
        with formatter.section("All commands"):
            formatter.write_dl([(title, " ".join(verbs)) for title, verbs in SECTIONS.items()])
        with formatter.section("Help"):
            formatter.write_dl([(f"coulombus help {topic}", text) for topic, text in TOPICS.items()])


TOPICS: Mapping[str, str] = {
    "COMMAND": "its options (also COMMAND --help)",
    "all": "each command in a line",
    "exit": "the exit statuses",
}
"""Topics of `coulombus help`."""

LIBRARIES = ("numba", "llvmlite", "numpy", "scipy", "pydantic", "python-can", "canopen")
"""Libraries whose versions a bug report needs."""


def _tell_versions(context: click.Context, option: click.Parameter, is_set: bool) -> None:
    if not is_set or context.resilient_parsing:
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
    """Friction you can feel, over a CAN bus."""
    for library in ("can", "canopen"):  # their errors also raise exceptions, whose text is printed
        logging.getLogger(library).addHandler(logging.NullHandler())
