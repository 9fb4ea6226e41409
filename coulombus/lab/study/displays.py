"""Where a display is shown: in virtual time on the simulated rig, or on a bus.

Each is a `Run` of its own, brought up, armed and safely ended like any other. `stop` may be called from
another thread at any time: the display that is on ends safely, and none begins behind it.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Protocol

from coulombus.host.run.result import RunResult
from coulombus.host.run.run import Run
from coulombus.lab.simulate import virtual_run
from coulombus.wire.address import BusAddress

__all__ = ["BusDisplays", "Displays", "VirtualDisplays"]

AGAIN_S = 0.05


class Displays(Protocol):
    """Shows one display after the other."""

    def __call__(self, display: Run) -> RunResult:
        """Show it, and return what came of it."""

    def stop(self) -> None:
        """End the display that is on, safely."""


class VirtualDisplays:
    """Shows in virtual time, to the simulated hand."""

    def __call__(self, display: Run) -> RunResult:
        """Show it, and return what came of it."""
        return virtual_run(display)

    def stop(self) -> None:
        """Do nothing: a display in virtual time is over at once, and no hand is there."""


class BusDisplays:
    """Shows on a bus, with the switch, limits and trips of ``coulombus run``.

    Parameters
    ----------
    more : settings of the rig beside the study's, as those of a shared machine
    """

    def __init__(self, address: BusAddress, more: Sequence[str] = ()) -> None:
        self._address, self._more = address, tuple(more)
        self._over = threading.Event()
        self._over.set()

    def __call__(self, display: Run) -> RunResult:
        """Show it, and return what came of it."""
        from coulombus.host.run.real_run import real_run
        from coulombus.system.stop_signals import Signals

        run = replace(display, rig=display.rig.variant(*self._more), virtual=False)
        self._over.clear()
        try:
            if threading.current_thread() is not threading.main_thread():  # signals are the main thread's
                return real_run(run, bus=self._address)
            with Signals() as signals:
                return real_run(run, bus=self._address, signals=signals)
        finally:
            self._over.set()

    def stop(self) -> None:
        """Ask the host for a safe stop, until the display is over."""
        if not self._over.is_set():
            threading.Thread(target=self._ask, name="stop", daemon=True).start()

    def _ask(self) -> None:
        from coulombus.host.errors import HostError
        from coulombus.host.run.control_socket import stop_host

        while not self._over.is_set():
            with suppress(HostError):  # the host has not opened its door yet, or is at its end
                stop_host(self._address)
            self._over.wait(AGAIN_S)
