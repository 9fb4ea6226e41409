"""`coulombus help`: a command's options, the list of all commands, the exit statuses."""

from __future__ import annotations

from typing import Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, STATUSES
from coulombus.cli.main import SECTIONS, main
from coulombus.cli.options import argument, with_options
from coulombus.cli.tables import echo
from coulombus.system.wrap_text import hanging

__all__ = ["help_"]

JSON = """With --json, an error that ends a command before its result is also an object on
stdout:
  {"event": "error", "error": TEXT, "exit_status": N}
"""


@click.command("help", epilog=EXIT_STATUS)
@with_options
@click.pass_context
def help_(
    context: click.Context,
    topic: Annotated[tuple[str, ...], argument(nargs=-1, metavar="[COMMAND [SUBCOMMAND] | TRIP | EMCY | all | exit]")],
) -> None:
    """Explain a COMMAND, a TRIP or an EMCY code; list all commands (all), or the exit statuses (exit).

    \b
    Examples:
      coulombus help run
      coulombus help tpdo_lost
      coulombus help 8250h
    """
    assert context.parent is not None
    if topic == ("all",):
        echo(_all_commands())
    elif topic == ("exit",):
        echo(_exit_statuses())
    else:
        echo(_of_the_runbook(topic) or _explained(context.parent, topic))


def _of_the_runbook(topic: tuple[str, ...]) -> str | None:
    """Return the text on a trip or an EMCY code. A command's name is the command's, unless it is in capitals."""
    from coulombus.host.run.runbook import TRIP_NAMES, explained
    from coulombus.rigs.errors import nearest

    if len(topic) != 1 or topic[0] in main.commands:
        return None
    if (text := explained(topic[0])) is not None:
        return text
    near = nearest(topic[0], (*TRIP_NAMES, "exit", "all"))
    if near and ("_" in topic[0] or not nearest(topic[0], main.commands)):
        raise click.UsageError(f"No command, trip or EMCY code '{topic[0]}'{near}")
    return None


def _all_commands() -> str:
    widest = max(len(name) for verbs in SECTIONS.values() for name in verbs)
    sections = (
        "\n".join([f"{title}:", *(f"  {name:{widest}}  {text}" for name, text in verbs.items())])
        for title, verbs in SECTIONS.items()
    )
    return "\n\n".join(sections)


def _exit_statuses() -> str:
    lines = (hanging(f"{status:>3}  {text}", 80, 5) for status, text in STATUSES.items())
    return "\n".join([*lines, "", JSON.rstrip()])


def _explained(context: click.Context, topic: tuple[str, ...]) -> str:
    """Return the help of the command named by the words of `topic`; without words, of the program."""
    command: click.Command = main
    for name in topic:
        if not isinstance(command, click.Group):
            raise click.UsageError(f"{context.command_path} has no commands; got {name!r}.", context)
        _, subcommand, _ = click.Group.resolve_command(command, context, [name])  # fails with similar names
        assert subcommand is not None
        command, context = subcommand, click.Context(subcommand, info_name=name, parent=context)
    return command.get_help(context)
