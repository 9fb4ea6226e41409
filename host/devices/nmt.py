"""NMT commands to nodes, with a check of the result by heartbeat or boot-up."""

from __future__ import annotations

from dataclasses import dataclass

from coulombus.eds.cia301 import CobId, NmtCommand, NmtState
from coulombus.host.errors import HostError, NodeMissing
from coulombus.host.sdo.sdo_client import SdoClient
from coulombus.wire.bus_link import FrameLink

__all__ = ["BOOT_S", "COMMANDS", "TIMEOUT_S", "CommandResult", "command"]

COMMANDS = {
    "start": (NmtCommand.START, NmtState.OPERATIONAL),
    "stop": (NmtCommand.STOP, NmtState.STOPPED),
    "preop": (NmtCommand.ENTER_PRE_OPERATIONAL, NmtState.PRE_OPERATIONAL),
    "reset": (NmtCommand.RESET_NODE, NmtState.INITIALISING),
    "reset-communication": (NmtCommand.RESET_COMMUNICATION, NmtState.INITIALISING),
}
"""Word -> the command, and the state in the following heartbeat (a boot-up: INITIALISING)."""
HEARTBEAT = (0x1017, 0)
ASK_S, QUIET_S = 1.0, 0.5
TIMEOUT_S, BOOT_S = 2.0, 5.0
"""Longest wait for a heartbeat, and for a boot-up."""


@dataclass(frozen=True)
class CommandResult:
    """Result of an NMT command for one node.

    Attributes
    ----------
    state : state in the last heartbeat or boot-up; None: none arrived
    well : whether that is the commanded state; None: unknown, because the node sends no heartbeat
    odd_length : length of the last heartbeat whose length is not one byte; None without one
    """

    node_id: int
    state: NmtState | None
    well: bool | None
    odd_length: int | None = None

    def __str__(self) -> str:
        if self.state is not None:
            state = "booted" if self.state is NmtState.INITIALISING else self.state.name.lower().replace("_", "-")
            return f"node {self.node_id}: {state}" + ("" if self.well else ", which is not what was asked for")
        if self.odd_length is not None:
            return f"node {self.node_id}: its heartbeat has {self.odd_length} bytes; 1 is right (CiA 301)"
        if self.well is None:
            return f"node {self.node_id}: sent; it sends no heartbeat (1017h is 0) that would tell its state"
        return f"node {self.node_id}: no heartbeat and no boot-up came"


def command(
    link: FrameLink, word: str, node_id: int | None, timeout_s: float | None = None
) -> tuple[CommandResult, ...]:
    """Send an NMT command, and wait for the nodes' heartbeats or boot-ups.

    Parameters
    ----------
    word : key of `COMMANDS`
    timeout_s : longest wait [s]; None: `BOOT_S` after a reset, else `TIMEOUT_S`
    node_id : the node; None: all nodes, of which those heard within the time are returned

    Raises
    ------
    NodeMissing
        (exit status 5) all nodes were reset, and none booted
    """
    what, goal = COMMANDS[word]
    if timeout_s is None:
        timeout_s = BOOT_S if goal is NmtState.INITIALISING else TIMEOUT_S
    silent = node_id is not None and goal is not NmtState.INITIALISING and _has_no_heartbeat(link, node_id)
    while link.receive(link.now_ns()) is not None:  # frames from before the command
        pass
    link.send(CobId.NMT, bytes((what, node_id or 0)))
    heard: dict[int, NmtState] = {}
    odd: dict[int, int] = {}
    until_ns = link.now_ns() + round((min(QUIET_S, timeout_s) if silent else timeout_s) * 1e9)
    while (frame := link.receive(until_ns)) is not None:
        sender = frame.can_id - CobId.HEARTBEAT
        if not 1 <= sender <= 127 or node_id not in (None, sender):
            continue
        if len(frame.data) != 1:
            odd[sender] = frame.length
            continue
        state = frame.data[0] & 0x7F
        if state in tuple(NmtState) and heard.get(sender) is not goal:  # heartbeats follow a boot-up
            heard[sender] = NmtState(state)
        if node_id is not None and heard.get(sender) is goal:
            break
    if node_id is None:
        if not heard and goal is NmtState.INITIALISING:
            raise NodeMissing(f"no node booted within {timeout_s:g} s")
        return tuple(CommandResult(sender, state, state is goal) for sender, state in sorted(heard.items()))
    state_heard = heard.get(node_id)
    if state_heard is None:
        return (CommandResult(node_id, None, None if silent else False, odd.get(node_id)),)
    return (CommandResult(node_id, state_heard, state_heard is goal),)


def _has_no_heartbeat(link: FrameLink, node_id: int) -> bool:
    """Return whether 1017h is 0; a node that does not answer (it is stopped) may have a heartbeat."""
    try:
        return not any(SdoClient(link, node_id, ASK_S).upload(*HEARTBEAT, most=4))
    except HostError:
        return False
