"""Detection of a CAN bus' bit rate, without disturbing its traffic.

A controller at the wrong rate answers every frame of other nodes with an error frame. So the interface
first listens at each rate in listen-only mode, in which it sends neither acknowledge nor error frames. On
a bus without traffic it then sends SDO requests at each rate, because there is no traffic to disturb.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

from coulombus.eds.cia301 import CobId
from coulombus.eds.sdo_frames import head
from coulombus.host.errors import NodeMissing
from coulombus.wire.address import BusAddress, BusUnavailable
from coulombus.wire.bus_link import BusLink, FrameLink

__all__ = ["RATES", "Commands", "choose"]

RATES = (1_000_000, 500_000, 250_000, 125_000, 800_000, 100_000, 50_000, 20_000, 10_000)
LISTEN_S, ASK_S, COMMAND_S = 1.0, 0.3, 10.0
NODES = range(1, 128)

Commands = Callable[[Sequence[str]], str]
"""Runs a command and returns its output; raises BusUnavailable if it fails."""


def run(command: Sequence[str]) -> str:
    """Run a command of iproute2.

    Raises
    ------
    BusUnavailable
        (exit status 4) it is not installed, or failed; the text has the command for a manual run
    """
    line = " ".join(command)
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=COMMAND_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BusUnavailable(f"`{line}` cannot be run: {error}") from None
    if done.returncode:
        why = done.stderr.strip().splitlines()[-1:] or ["it failed"]
        raise BusUnavailable(f"{why[0]}; with the rights for it: sudo {line}")
    return done.stdout


def choose(
    name: str,
    show: Callable[[int], None] = lambda rate: None,
    *,
    commands: Commands = run,
    link: Callable[[BusAddress], BusLink] = BusLink,
) -> int:
    """Find the bit rate of a bus, leave the interface up at it, and return it [bit/s].

    If no rate is found, the interface is restored.

    Parameters
    ----------
    show : called with each bit rate before it is tried

    Raises
    ------
    BusUnavailable
        (exit status 4) the interface has no bit rate, or must not be configured
    NodeMissing
        (5) no node was heard at any bit rate
    """
    before = _before(name, commands)
    quiet: list[int] = []
    heard_rate = None
    try:
        for rate in RATES:
            show(rate)
            _set(name, rate, commands, listen=True)
            with link(BusAddress("socketcan", name)) as bus:
                if _hears(bus, LISTEN_S):
                    heard_rate = rate
                    break
                if not bus.error_frames:
                    quiet.append(rate)
        else:
            if len(quiet) == len(RATES):  # no traffic that requests could disturb
                heard_rate = _rate_by_request(name, commands, link, show)
    finally:
        if heard_rate is None:
            with suppress(BusUnavailable):
                _set_back(name, before, commands)
    if heard_rate is None:
        raise NodeMissing(
            f"no node was heard on socketcan:{name} at any bit rate; is a device powered and the bus terminated?"
        )
    _set(name, heard_rate, commands)
    return heard_rate


def _rate_by_request(
    name: str, commands: Commands, link: Callable[[BusAddress], BusLink], show: Callable[[int], None]
) -> int | None:
    for rate in RATES:
        show(rate)
        _set(name, rate, commands)
        with link(BusAddress("socketcan", name)) as bus, suppress(BusUnavailable):
            for node_id in NODES:
                bus.send(CobId.SDO_RX + node_id, head(0x40, 0x1000, 0))
                if bus.error_frames:
                    break
            if _hears(bus, ASK_S) and not bus.error_frames:
                return rate
    return None


def _hears(link: FrameLink, seconds: float) -> bool:
    return link.receive(link.now_ns() + round(seconds * 1e9)) is not None


class _Before(NamedTuple):
    """Earlier state of the interface: bit rate (0: not set yet), bus-error reporting, up or down."""

    rate: int
    reports: bool
    up: bool


def _before(name: str, commands: Commands) -> _Before:
    try:
        links = json.loads(commands(("ip", "-details", "-json", "link", "show", name)))
        flags, info = links[0].get("flags", ()), links[0]["linkinfo"]
        kind, data = info["info_kind"], info.get("info_data", {})
        rate = int(data.get("bittiming", {}).get("bitrate", 0))
        before = _Before(rate, "BERR-REPORTING" in data.get("ctrlmode", ()), "UP" in flags)
    except (ValueError, LookupError, TypeError, AttributeError):
        raise BusUnavailable(f"socketcan:{name} tells no bit rate (ip -details link show {name})") from None
    if kind != "can":
        raise BusUnavailable(f"socketcan:{name} is a {kind} interface, which has no bit rate")
    return before


def _set_back(name: str, before: _Before, commands: Commands) -> None:
    """Restore the interface; an interface that had no bit rate stays down."""
    if before.rate:
        _set(name, before.rate, commands)
    if not (before.rate and before.reports and before.up):
        commands(("ip", "link", "set", name, "down"))
    if not before.reports:
        with suppress(BusUnavailable):
            commands(("ip", "link", "set", name, "type", "can", "berr-reporting", "off"))
    if before.rate and before.up and not before.reports:
        commands(("ip", "link", "set", name, "up"))


def _set(name: str, rate: int, commands: Commands, *, listen: bool = False) -> None:
    commands(("ip", "link", "set", name, "down"))
    mode = ("listen-only", "on" if listen else "off")
    commands(("ip", "link", "set", name, "type", "can", "bitrate", str(rate), *mode))
    with suppress(BusUnavailable):  # optional: some drivers lack it, and detection works without it
        commands(("ip", "link", "set", name, "type", "can", "berr-reporting", "on"))
    commands(("ip", "link", "set", name, "up"))
