"""The command line: a thin dispatcher to the verbs, which import what they need only when
they run.
"""

from __future__ import annotations

import logging

import click

from coulombus.verbs.analyse import analyse, identify_command
from coulombus.verbs.check import check
from coulombus.verbs.commission import commission
from coulombus.verbs.common import EXIT_STATUS, Verbs
from coulombus.verbs.conformance import conformance
from coulombus.verbs.doctor import doctor
from coulombus.verbs.eds_verb import eds
from coulombus.verbs.experiment import experiment_command
from coulombus.verbs.export import export_command
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

VERBS = (
    *(demo, simulate_command, sweep_command, experiment_command, sim, node_command),
    *(run_command, status, stop, mark, set_command, watch, hz, pdo, decode, dbc, tools, replay, bridge),
    *(export_command, plot_command, diff),
    *(scan, lss, sdo, nmt),
    *(init, doctor, systemd, check, measure, plan_command, commission),
    *(eds, conformance, analyse, identify_command, law),
)


@click.group(
    cls=Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}, epilog=EXIT_STATUS
)
@click.version_option(package_name="coulombus", prog_name="coulombus")
def main() -> None:
    """Friction you can feel, over a CAN bus.

    A DC motor drive and an MR brake as CANopen nodes, a host that runs a friction law at 1 kHz
    through PDOs, and a bit-exact virtual bus with a simulated rig that stands in for the hardware.

    \b
    Examples:
      coulombus demo
      coulombus sim & coulombus run --mode hybrid --seconds 13
      coulombus simulate --mode hybrid --seconds 13 --record run.pcapng
      coulombus decode run.pcapng | less
      coulombus check --rig my-rig.toml
    """
    for library in ("can", "canopen"):  # what goes wrong there comes as an exception, whose text is told
        logging.getLogger(library).addHandler(logging.NullHandler())


for verb in VERBS:
    main.add_command(verb)
