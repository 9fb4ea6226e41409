"""``coulombus status``: state of the host on a bus."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.options import BusesOption, JsonOption, RigOption, with_options
from coulombus.cli.rig_options import host_addresses
from coulombus.cli.tables import echo
from coulombus.system.exit import verdict

if TYPE_CHECKING:
    from coulombus.wire.address import BusAddress

__all__ = ["status"]


@click.command(epilog=EXIT_STATUS)
@with_options
def status(
    rig_name: RigOption,
    bus_names: BusesOption,
    as_json: JsonOption,
) -> None:
    """Ask the host that runs on a bus what it is doing: phase, torques, lateness, counters.

    The host answers beside its data plane, whose cycle is not disturbed. Ends with 4 where no host
    runs, or none answers; then it says when and why the last one ended. Without --bus and --rig that
    is the last host of this user on whatever bus. For a line ten times a second, start the host with
    `coulombus run --status SOCKET` and read that socket.

    \b
    Examples:
      coulombus status
      coulombus status --bus socketcan:can0 --json
      socat UNIX-CONNECT:/tmp/rig.status -
    """
    with errors():
        addresses = host_addresses(rig_name, bus_names, ended=True)
        states = [_state(address) for address in addresses]
        with verdict(0):
            if as_json:
                print_json(states[0] if len(states) == 1 else states)
            else:
                for state in states:
                    _print_state(state)


def _state(address: BusAddress) -> dict[str, Any]:
    """Return the state of the host on a bus.

    Raises
    ------
    coulombus.host.run.control_socket.NoHost
        No host responds; the text has the end of the last one.
    """
    from coulombus.host.run.control_socket import NoHost, ask_status, host_runs
    from coulombus.host.run.last_word import ending, last_word
    from coulombus.host.run.runbook import advice

    try:
        return ask_status(address)
    except NoHost as error:
        word = None if host_runs(address) else last_word(address)
        if word is None:
            raise
        counts = f"{word['lost_pdos']} PDOs lost, {word['missed_deadlines']} deadlines missed"
        text = f"{error}; the last one ended {ending(word)} ({word['cycles']} cycles, {counts})"
        command = advice(word["trip"] or "")
        raise NoHost(f"{text}; what to do: {command}" if command else text) from None


def _print_state(state: dict[str, Any]) -> None:
    """Print a host's state as text."""
    shown = state.get("display_s")
    since = "not yet displaying" if shown is None else f"displaying for {_number(shown)} s"
    rows = [
        f"{state.get('bus')}: rig {state.get('rig')}, mode {state.get('mode')}, {since}, {state.get('cycles')} cycles"
    ]
    for axis in state.get("axes") or ():
        rows.append(
            f"  {axis.get('axis') or 'axis'}: {axis.get('phase')}, at {_number(axis.get('position_rad'))} rad, "
            f"{_number(axis.get('velocity_rad_s'))} rad/s"
        )
        torques = (("motor", "motor_torque_Nm"), ("brake", "brake_torque_Nm"), ("handle", "handle_torque_Nm"))
        rows.append("    torque: " + ", ".join(f"{name} {_number(axis.get(key))} Nm" for name, key in torques))
    for name, text in (("wakeup_us", "woke late by"), ("sync_to_rpdo_us", "SYNC to RPDO")):
        if spread := state.get(name):
            rows.append(f"  {text}: " + ", ".join(f"{key} {_number(value)}" for key, value in spread.items()) + " us")
    counted = {name: n for name, n in (state.get("counters") or {}).items() if n and name != "rx_frames"}
    rows.append("  counted: " + (", ".join(f"{name} {n}" for name, n in counted.items()) or "nothing amiss"))
    if state.get("recording"):
        rows.append(f"  recording: {state['recording']}")
    if state.get("trip"):
        rows.append(f"  trip: {state['trip']}")
    for row in rows:
        echo(row)


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, (int, float)) else "-"
