"""The running host's door: a socket beside the bus', by which ``coulombus stop`` asks for a safe stop, and by which a second host knows of it."""

from __future__ import annotations

import json
import re
import socket
from contextlib import suppress
from pathlib import Path
from typing import Any

from host.errors import HostError, SafetyTrip
from wire.address import BusAddress, socket_path

__all__ = ["HostSocket", "NoHost", "control_path", "stop_host"]

STOP_TIMEOUT_S = 30.0
MESSAGE_BYTES = 1 << 16


class NoHost(HostError):
    """No host runs on the bus."""

    exit_status = 4


def control_path(address: BusAddress) -> Path:
    """Return the path of the control socket of the host on a bus."""
    name = address.name if address.kind == "coulombus" else "socketcan-" + re.sub(r"[^A-Za-z0-9_.-]", "_", address.name)
    return socket_path(f"{name}.host")


def _new() -> socket.socket:
    return socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)


class HostSocket:
    """Claims the bus at `address` for this process.

    Raises
    ------
    SafetyTrip
        another host of this machine has the bus
    """

    def __init__(self, address: BusAddress) -> None:
        self._path = control_path(address)
        self._askers: list[socket.socket] = []
        with _new() as probe:
            try:
                probe.connect(str(self._path))
            except FileNotFoundError:
                pass
            except ConnectionRefusedError:  # left behind by a host that was killed
                self._path.unlink(missing_ok=True)
            else:
                raise SafetyTrip(
                    f"another host runs on bus {address}; end it first with `coulombus stop --bus {address}`"
                )
        self._listener = _new()
        try:
            self._listener.bind(str(self._path))
        except OSError:
            self._listener.close()
            raise SafetyTrip(f"another host starts on bus {address}") from None
        self._listener.listen(8)
        self._listener.setblocking(False)

    def stop_wanted(self) -> bool:
        """Tell whether somebody has asked for a stop since the last time."""
        wanted = False
        with suppress(BlockingIOError):
            while True:
                asker, _ = self._listener.accept()
                asker.setblocking(False)
                self._askers.append(asker)
        for asker in list(self._askers):
            try:
                message = asker.recv(MESSAGE_BYTES)
            except BlockingIOError:
                continue
            except OSError:
                message = b""
            if message == b"stop":
                wanted = True
            else:  # gone, or talking nonsense
                self._askers.remove(asker)
                asker.close()
        return wanted

    def close(self, result: dict[str, Any] | None = None) -> None:
        """Tell those who asked what came of it, and let go of the bus."""
        if self._listener.fileno() < 0:
            return
        with suppress(OSError):
            self._path.unlink()
        self._listener.close()
        for asker in self._askers:
            with suppress(OSError):
                if result is not None:
                    asker.send(json.dumps(result).encode())
            asker.close()


def stop_host(address: BusAddress, timeout_s: float = STOP_TIMEOUT_S) -> dict[str, Any]:
    """Ask the host on a bus to stop safely, wait for its end, and return what it tells (empty: it ended without a word).

    Raises
    ------
    NoHost
        none runs there, or it does not come to an end
    """
    with _new() as asker:
        try:
            asker.connect(str(control_path(address)))
            asker.send(b"stop")
            asker.settimeout(timeout_s)
            message = asker.recv(MESSAGE_BYTES)
        except (FileNotFoundError, ConnectionRefusedError):
            raise NoHost(f"no host runs on bus {address}") from None
        except TimeoutError:
            raise NoHost(f"the host on bus {address} has not stopped within {timeout_s:g} s") from None
        except OSError:  # it was killed
            message = b""
    result: dict[str, Any] = json.loads(message) if message else {}
    return result
