"""The command line: a thin dispatcher to the verbs, which import what they need only when
they run.
"""

from __future__ import annotations

import logging

import click

from coulombus.verbs.analyse import analyse, identify_command
from coulombus.verbs.check import check
from coulombus.verbs.commission import commission
from coulombus.verbs.conformance import conformance
from coulombus.verbs.doctor import doctor
from coulombus.verbs.eds_verb import eds
from coulombus.verbs.experiment import experiment_command
from coulombus.verbs.export import export_command
from coulombus.verbs.failures import EXIT_STATUS, Verbs
from coulombus.verbs.hz import hz, pdo
from coulombus.verbs.init import init
from coulombus.verbs.law import law
from coulombus.verbs.look import dbc, decode, watch
from coulombus.verbs.lss import lss
from coulombus.verbs.mark import mark
from coulombus.verbs.measure import measure
from coulombus.verbs.nmt import nmt
from coulombus.verbs.plan import plan_command
from coulombus.verbs.plot import diff, plot_command
from coulombus.verbs.replay import bridge, replay
from coulombus.verbs.run import run_command, stop
from coulombus.verbs.scan import scan
from coulombus.verbs.sdo import sdo
from coulombus.verbs.set_verb import set_command
from coulombus.verbs.sim import node_command, sim
from coulombus.verbs.simulate import demo, simulate_command
from coulombus.verbs.status import status
from coulombus.verbs.sweep import sweep_command
from coulombus.verbs.systemd import systemd
from coulombus.verbs.tools import tools

__all__ = ["main"]

SECTIONS = {
    "Simulate": (demo, simulate_command, sim, sweep_command, experiment_command, law),
    "Run a rig": (run_command, status, stop, mark, set_command),
    "Look at a bus and its devices": (watch, hz, scan, sdo, nmt, lss, node_command, bridge, conformance),
    "Use recordings": (decode, plot_command, diff, export_command, replay, identify_command),
    "Describe and set up a rig": (init, check, plan_command, measure, commission, doctor, systemd, eds),
    "Names for other tools, and theory": (pdo, dbc, tools, analyse),
}
VERBS = tuple(verb for section in SECTIONS.values() for verb in section)


class Coulombus(Verbs):
    """All verbs, listed by what one wants to do."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the verbs of each section, a line each."""
        widest = max(len(name) for name in self.commands)
        for title, verbs in SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl([((verb.name or "").ljust(widest), verb.get_short_help_str(80)) for verb in verbs])


@click.group(
    cls=Coulombus,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog=EXIT_STATUS,
)
@click.version_option(package_name="coulombus", prog_name="coulombus")
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


for verb in VERBS:
    main.add_command(verb)
