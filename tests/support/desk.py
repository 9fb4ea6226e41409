"""Devices in virtual time in the place of the bus that a verb opens."""

from __future__ import annotations

from coulombus.wire.address import BusUnavailable, parse_address
from devices_bench import DevicesLink

__all__ = ["BUS", "put_on_desk"]

BUS = ("--bus", "coulombus:desk")
HOLDERS = ("coulombus.host.devices.bitrates", "coulombus.host.devices.scan", "coulombus.cli.sdo_shell")


class DeskLink(DevicesLink):
    """The bus ``coulombus:desk``."""

    address, error_frames, error_classes, bitrate_bit_s = parse_address("coulombus:desk"), 0, 0, 1_000_000
    left = 10**9

    def __enter__(self):
        return self

    def __exit__(self, *_):
        """There is nothing to close."""

    def send(self, can_id, data=b"", length=None):
        self.left -= 1
        if self.left < 0:
            raise BusUnavailable("bus coulombus:desk is gone: its process ended")
        super().send(can_id, data, length)


def put_on_desk(monkeypatch):
    """Return the link that every verb opens from now on."""
    link = DeskLink()
    for module in (*HOLDERS, "coulombus.wire.bus_link"):  # whoever imports it first, now, holds the right one later
        monkeypatch.setattr(f"{module}.BusLink", lambda address, filters=(): link)
    return link
