"""Forward a live bus to third-party tools: each PDO on arrival, its signals by name in SI.

`Foxglove` serves Foxglove's WebSocket protocol with its SDK; `PlotJuggler` sends JSON by UDP for
PlotJuggler's "UDP Server". Both use the loopback only, and nothing is sent to the bus.
"""

from __future__ import annotations

import json
import math
import socket
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from coulombus.monitor.callbacks import LiveBus
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo
from coulombus.system.errors import CoulombusError
from coulombus.system.stop_signals import StopSignals
from coulombus.wire.adapter import open_bus
from coulombus.wire.address import BusAddress
from coulombus.wire.handshake import Flags, Hello

__all__ = ["Foxglove", "PlotJuggler", "PortError", "Sink", "forward"]

LOOPBACK = "127.0.0.1"
BACKLOG = 1 << 14
"""Messages that Foxglove's server queues for a sleeping browser; then it drops the oldest."""
LOOK_S = 0.1

Values = Mapping[str, int | float | None]


class PortError(CoulombusError):
    """The port of a tool cannot be used."""

    exit_status = 2


class Sink(Protocol):
    """A receiving tool; `url` is its address or that of its server."""

    url: str

    def send(self, pdo: RigPdo, t_ns: int, values: Values) -> None:
        """Send a PDO's values, with the frame's stamp [ns since 1970]."""

    def close(self) -> None:
        """Release the port."""


class PlotJuggler:
    """Sends a datagram for each PDO: ``{"timestamp": 1.7e9, "motor.position_rad": 0.1}``.

    `unheard` counts datagrams without a listener.
    """

    def __init__(self, port: int) -> None:
        self.url = f"udp://{LOOPBACK}:{port}"
        self.unheard = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.connect((LOOPBACK, port))
        except OSError as error:
            self._socket.close()
            raise PortError(f"port {port} of {LOOPBACK}: {error.strerror}; choose another one") from None

    def send(self, pdo: RigPdo, t_ns: int, values: Values) -> None:
        """Send the values; without a listener they are lost."""
        try:
            self._socket.send(json.dumps({"timestamp": t_ns / 1e9, **values}, allow_nan=False).encode())
        except OSError:  # no listener, or its buffer is full
            self.unheard += 1

    def close(self) -> None:
        """Release the port."""
        self._socket.close()


class Foxglove:
    """Serves the PDOs of a rig as topics ``/motor/TPDO1``, as the MCAP export names them."""

    def __init__(self, rig: Rig, port: int) -> None:
        try:
            import foxglove
        except ModuleNotFoundError:
            text = "Foxglove's SDK is not installed: pip install -e '.[foxglove]' in the clone"
            raise PortError(text) from None
        foxglove.set_log_level("ERROR")
        self._context = context = foxglove.Context()  # kept: without it the channels are closed
        self._channels = {
            pdo.layout.cob_id: foxglove.Channel(
                f"/{pdo.node}/{pdo.name}",
                schema=_schema(pdo),
                context=context,
                metadata={signal.name: signal.unit for signal in pdo.signals},
            )
            for pdo in rig.pdos()
        }
        try:
            self._server = foxglove.start_server(
                name=f"coulombus {rig.name}", host=LOOPBACK, port=port, context=context, message_backlog_size=BACKLOG
            )
        except (OSError, RuntimeError) as error:
            raise PortError(f"port {port} of {LOOPBACK} cannot be served: {error}; choose another one") from None
        self.url = f"ws://{LOOPBACK}:{self._server.port}"

    def send(self, pdo: RigPdo, t_ns: int, values: Values) -> None:
        """Send the values to subscribers."""
        self._channels[pdo.layout.cob_id].log(_nested(values), log_time=t_ns)

    def close(self) -> None:
        """Stop the server."""
        self._server.stop()


def forward(
    rig: Rig, address: BusAddress, sink: Sink, *, seconds: float | None, ready: Callable[[str], None]
) -> dict[str, Any]:
    """Forward a bus to a tool until a signal, or for `seconds`; return a summary.

    Parameters
    ----------
    ready : called with the sink's address, once listening to the bus

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        There is no bus, or it closed meanwhile.
    """
    sent = 0

    def hand_on(pdo: RigPdo) -> Callable[..., None]:
        names = tuple(signal.name for signal in pdo.signals)

        def send(t_s: float, *values: float) -> None:
            nonlocal sent
            finite = {name: value if math.isfinite(value) else None for name, value in zip(names, values, strict=True)}
            sink.send(pdo, round(t_s * 1e9), finite)
            sent += 1

        return send

    with StopSignals() as stop, LiveBus(open_bus(address, Hello(Flags.LISTEN_ONLY)), rig) as bus:
        called = [bus.on([signal.name for signal in pdo.signals], hand_on(pdo)) for pdo in rig.pdos() if pdo.signals]
        ready(sink.url)
        end = math.inf if seconds is None else time.monotonic() + seconds
        while not stop.wait(min(LOOK_S, max(0.0, end - time.monotonic()))) and time.monotonic() < end:
            bus.wait(0)  # BusUnavailable
    error = next((callback.error for callback in called if callback.error is not None), None)
    if error is not None:
        raise error
    return {
        "pdos": sent,
        "unheard": getattr(sink, "unheard", 0),
        "lost": bus.lost,
        "malformed": sum(bus.malformed.values()),
    }


def _nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values nested by the parts of their names, as in Foxglove's message paths."""
    tree: dict[str, Any] = {}
    for name, value in values.items():
        *path, last = name.split(".")
        place = tree
        for part in path:
            place = place.setdefault(part, {})
        place[last] = value
    return tree


def _schema(pdo: RigPdo) -> dict[str, Any]:
    """Return the JSON schema of a PDO's message."""

    def schema(tree: dict[str, Any]) -> dict[str, Any]:
        leaf = {key: value if "type" in value else schema(value) for key, value in tree.items()}
        return {"type": "object", "properties": leaf}

    return schema(
        _nested({signal.name: {"type": "number", "description": f"[{signal.unit or '1'}]"} for signal in pdo.signals})
    )
