"""Addresses of a rig's buses: the values of ``--bus`` and ``--channel``.

``--bus`` is ``B`` for a rig with one bus, ``CHANNEL=B`` for each of several. The default is the virtual bus
``coulombus:RIG``, or ``coulombus:RIG.CHANNEL`` for each of several.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

from coulombus.rigs.rig import Rig, known_rigs, packaged_rig
from coulombus.system.quoting import shell
from coulombus.wire.address import AddressError, BusAddress, Kind, default_address, parse_address

__all__ = ["bus_addresses", "one_bus"]


def bus_addresses(
    rig: Rig, texts: Sequence[str] = (), channel: str | None = None, also: Collection[Kind] = ()
) -> dict[str, BusAddress]:
    """Return the address of each of the rig's buses, or of the bus `channel` only; `also` as in `parse_address`.

    Raises
    ------
    AddressError
        a channel that the rig does not have, two addresses for one channel, or no address
    """
    if channel is not None and channel not in rig.channels:
        raise AddressError(f"--channel {channel}: the rig has {_names(rig)}")
    if channel is not None:
        texts = [text if _parted(text)[1] else f"{channel}={text}" for text in texts]
    addresses = _all_addresses(rig, texts, also)
    return addresses if channel is None else {channel: addresses[channel]}


def one_bus(rig: Rig, text: str | None, channel: str | None, also: Collection[Kind] = ()) -> tuple[Rig, BusAddress]:
    """Return the rig's part on one bus, and the address of that bus; `also` as in `parse_address`.

    Raises
    ------
    AddressError
        as above, or the rig has several buses and `channel` names none
    """
    if channel is None and len(rig.channels) > 1:
        raise AddressError(f"the rig has {_names(rig)}; name one with --channel")
    ((name, address),) = bus_addresses(rig, () if text is None else (text,), channel, also).items()
    return rig.on(name), address


def _names(rig: Rig) -> str:
    named = [channel for channel in rig.channels if channel]
    return f"the buses {', '.join(named)}" if named else "one bus, without a name"


def _parted(text: str) -> tuple[str, str, str]:
    """Return channel, "=" and address of ``CHANNEL=B``, or "", "" and ``B``; an adapter's options have a "=", too."""
    before, colon, rest = text.partition(":")
    channel, equals, kind = before.rpartition("=")
    return channel, equals, kind + colon + rest


def _all_addresses(rig: Rig, texts: Sequence[str], also: Collection[Kind]) -> dict[str, BusAddress]:
    name, channels = default_address(rig.name).name, rig.channels
    several = len(channels) > 1
    addresses: dict[str, BusAddress] = {}
    for text in texts:
        channel, equals, address = _parted(text)
        if several and not equals:
            raise AddressError(f"--bus {text}: the rig has {_names(rig)}; say which: {channels[0]}={text}")
        if channel not in channels and (equals or several):
            raise AddressError(f"--bus {text}: the rig has no bus '{channel}'; it has {_names(rig)}")
        channel = channel if several else channels[0]
        if channel in addresses:
            raise AddressError(f"--bus {text}: there is an address for this bus already, {addresses[channel]}")
        addresses[channel] = parse_address(address, also)
    usual = {channel: BusAddress("coulombus", f"{name}.{channel}" if several else name) for channel in channels}
    addresses = usual | addresses
    if len(set(addresses.values())) < len(addresses):
        raise AddressError(
            f"two of the rig's buses have one address: {', '.join(f'{c}={a}' for c, a in addresses.items())}"
        )
    start = f"coulombus emulate --rig {shell(_given_name(rig))}"
    for channel in channels:
        if addresses[channel] != usual[channel]:
            start += f" --bus {channel}={addresses[channel]}" if several else f" --bus {addresses[channel]}"
    return {channel: replace(addresses[channel], start=start) for channel in channels}


def _given_name(rig: Rig) -> str:
    """Return the rig as ``--rig`` takes it: a packaged one by its name, another one by its path."""
    path = Path(rig.path)
    return path.stem if path.stem in known_rigs() and path == packaged_rig(path.stem) else rig.path
