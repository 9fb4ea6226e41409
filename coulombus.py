"""The command line: a thin dispatcher to the verbs, which import what they need only when they run.

As a module it offers the two functions that a script needs::

    from coulombus import read, simulate
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

import click

from analysis.command import analyse, identify_command
from conformance.command import conformance
from eds.command import eds
from eds.command_line import EXIT_STATUS, Verbs
from lab.check_command import check
from lab.replay_command import bridge, replay
from lab.run_command import run_command, stop
from lab.sim_command import node_command, sim
from lab.simulate_command import demo, simulate_command
from scope.command import dbc, decode, watch
from wire.plan_command import plan_command

if TYPE_CHECKING:
    from lab.simulate import simulate
    from scope.recording import read

__all__ = ["main", "read", "simulate"]

VERBS = (
    *(demo, simulate_command, sim, node_command, run_command, stop, watch, decode, dbc, replay, bridge),
    *(check, plan_command, eds, conformance, analyse, identify_command),
)


def __getattr__(name: str) -> Any:
    if name == "simulate":
        from lab.simulate import simulate

        return simulate
    if name == "read":
        from scope.recording import read

        return read
    raise AttributeError(f"module 'coulombus' has no attribute {name!r}")


@click.group(
    cls=Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}, epilog=EXIT_STATUS
)
@click.version_option(package_name="coulombus", prog_name="coulombus")
def main() -> None:
    """Friction you can feel, over a CAN bus.

    A DC motor drive and an MR brake as CANopen nodes, a host that runs a friction law at 1 kHz through PDOs, and a bit-exact virtual
    bus with a simulated rig that stands in for the hardware.

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

if __name__ == "__main__":
    main()
