"""Control socket of a running host: stop, status, mark and set requests; detects a second host.

The requests, and their answers as JSON:

- ``stop`` (``coulombus stop``): the host answers ``accepted`` as soon as it has read the request, and the
  result at its end. After ``accepted``, the end of the connection is the end of the host. Before, the
  connection may end for any reason, and the rig may still be armed.
- ``status`` (``coulombus status``): the state, at once.
- ``mark TEXT`` (``coulombus mark``): sets a marker in the recording.
- ``set`` with a JSON object (``coulombus set``, the page): changes parameters (`host.run.changes`).
"""

from __future__ import annotations

import json
import re
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from coulombus.host.errors import HostError, SafetyTrip
from coulombus.system.full_queue import connect_by
from coulombus.wire.address import HOST_SUFFIX, AddressError, BusAddress, parse_address, socket_names, socket_path

__all__ = [
    "HostSocket",
    "NoHost",
    "NotChanged",
    "NotMarked",
    "StopRequest",
    "address_of",
    "ask_change",
    "ask_mark",
    "ask_status",
    "control_path",
    "host_runs",
    "hosts_here",
    "stop_host",
]

STOP_TIMEOUT_S = 30.0
"""Longest time to the host's end after it has accepted a stop."""
LET_IN_S = 3.0
"""Longest time for the host to accept a stop."""
MESSAGE_BYTES = 1 << 16
STOP, ACCEPTED, STATUS, MARK, SET = b"stop", b"accepted", b"status", b"mark ", b"set "
STATUS_TIMEOUT_S = 3.0
ASKERS = 16
"""Largest number of connected clients.

One more replaces the client that has been silent for longest.
"""
SILENT_S = 1.0
"""Longest time for which a client may be connected without a request."""
BACKLOG = 8
TOLD = {"mode": (str,), "cycles": (int,), "trip": (str, type(None))}
"""Entries of a host's result, with their types."""
RETRY_S = 0.01


class NoHost(HostError):
    """No host runs on the bus, or it did not accept the request, or it did not end."""

    exit_status = 4


class NotMarked(HostError):
    """The host refused a marker; the text gives the reason."""

    exit_status = 2


class NotChanged(HostError):
    """The host refused a change of parameters; the text gives the reason."""

    exit_status = 2


def control_path(address: BusAddress) -> Path:
    """Return the path of the control socket of the host on a bus."""
    name = address.name if address.is_virtual else f"{address.kind}-" + re.sub(r"[^A-Za-z0-9_.-]", "_", address.name)
    return socket_path(f"{name}{HOST_SUFFIX}")


def _new() -> socket.socket:
    return socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)


def _probe(path: Path) -> bool | None:
    """Return True if a host answers, False for a stale socket of a killed host, None for no socket."""
    with _new() as probe:
        try:
            probe.connect(str(path))
        except FileNotFoundError:
            return None
        except ConnectionRefusedError:
            return False
        except BlockingIOError:  # the backlog is full: a host listens
            return True
    return True


def host_runs(address: BusAddress) -> bool:
    """Return whether a host of this machine has the bus; sends it no request. No host runs on an adapter of python-can."""
    return not address.is_adapter and _probe(control_path(address)) is True


def hosts_here() -> list[BusAddress]:
    """Return the buses on which a host of this user and machine runs; sends no request."""
    names = (name.removesuffix(HOST_SUFFIX) for name in socket_names() if name.endswith(HOST_SUFFIX))
    return [address for address in map(address_of, names) if host_runs(address)]


def _no_host(address: BusAddress) -> str:
    """Return that no host runs on a bus, and on which others one does."""
    others = ", ".join(map(str, hosts_here()))
    return f"no host runs on bus {address}" + (f"; on this machine one runs on {others}" if others else "")


def address_of(name: str) -> BusAddress:
    """Return the address whose `control_path` has this name."""
    with suppress(AddressError):
        address = parse_address(name.replace("-", ":", 1))
        if control_path(address).name == f"{name}{HOST_SUFFIX}":
            return address
    return BusAddress("coulombus", name)


class _Client:
    """A connected client."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        self.connection, self.since, self.accepted = connection, time.monotonic(), False

    def asks(self, door: HostSocket) -> bool | None:
        """Read and answer a request; return whether it is a stop request.

        None: the connection is finished. The client has disconnected, has its answer, sent an invalid
        request, or was silent for too long.
        """
        try:
            message = self.connection.recv(MESSAGE_BYTES)
        except BlockingIOError:
            return False if self.accepted or time.monotonic() - self.since < SILENT_S else None
        except OSError:
            return None
        if message == STATUS:
            self.send(door.status())
        for verb, answer in ((MARK, door.mark), (SET, door.change)):
            if message.startswith(verb):
                self.send(answer(message[len(verb) :].decode(errors="replace")))
        if message != STOP:
            return None
        self.accepted = True
        self.send(ACCEPTED)
        return True

    def send(self, message: bytes) -> None:
        with suppress(OSError):  # the client has disconnected; its request holds
            self.connection.send(message)


class HostSocket:
    """Claims the buses at `addresses` for this process, and serves a control socket of each.

    Three functions return the answers, and may be set later: `status` for the state, `mark` for a marker
    with a text, `change` for a change of parameters from a JSON text.

    Raises
    ------
    SafetyTrip
        another host of this machine has one of the buses
    """

    def __init__(self, *addresses: BusAddress) -> None:
        self._listeners: list[tuple[Path, socket.socket]] = []
        self._askers: list[_Client] = []
        self.status: Callable[[], bytes] = lambda: b"{}"
        self.mark: Callable[[str], bytes] = lambda text: b"{}"
        self.change: Callable[[str], bytes] = lambda text: b"{}"
        try:
            for address in addresses:
                self._claim(address)
        except BaseException:
            self.close()
            raise

    def _claim(self, address: BusAddress) -> None:
        path = control_path(address)
        heard = _probe(path)
        if heard:
            raise SafetyTrip(_occupied(address))
        if heard is False:  # without a socket before, a socket found by bind belongs to a host that starts
            path.unlink(missing_ok=True)
        listener = _new()
        try:
            listener.bind(str(path))
        except OSError:
            listener.close()
            raise SafetyTrip(f"another host starts on bus {address}") from None
        self._listeners.append((path, listener))
        listener.listen(BACKLOG)

    def stop_wanted(self) -> bool:
        """Serve all clients; return whether one has requested a stop since the last call.

        OSError: the socket accepts no more clients.
        """
        self._let_in()
        stop = False
        for asker in list(self._askers):
            asks = asker.asks(self)
            stop = stop or bool(asks)
            if asks is None:
                self._let_go(asker)
        return stop

    def _let_in(self) -> None:
        for _, listener in self._listeners:
            self._let_in_at(listener)

    def _let_in_at(self, listener: socket.socket) -> None:
        for _ in range(ASKERS):  # a bound: a client that reconnects repeatedly must not block the run
            try:
                connection, _ = listener.accept()
            except BlockingIOError:
                return
            except ConnectionAbortedError:
                continue
            if len(self._askers) == ASKERS:
                silent = next((asker for asker in self._askers if not asker.accepted), None)
                if silent is None:
                    connection.close()
                    continue
                self._let_go(silent)
            self._askers.append(_Client(connection))

    def _let_go(self, asker: _Client) -> None:
        self._askers.remove(asker)
        asker.connection.close()

    def close(self, result: dict[str, Any] | None = None) -> None:
        """Send the result to the clients that requested a stop, and release the buses.

        May be called again; never raises.
        """
        if self._listeners:
            with suppress(Exception):  # accepts requests of the last moment
                self.stop_wanted()
        for path, listener in self._listeners:
            with suppress(OSError):
                path.unlink()
            listener.close()
        self._listeners = []
        for asker in self._askers:
            if result is not None and asker.accepted:
                asker.send(json.dumps(result).encode())
            asker.connection.close()
        self._askers.clear()


def _occupied(address: BusAddress) -> str:
    return f"another host runs on bus {address}; end it first with `coulombus stop --bus {address}`"


class StopRequest:
    """Requests a safe stop of the host on a bus; `result` waits for its end, and reports errors.

    Parameters
    ----------
    timeout_s : time for the whole request: connection and acceptance, at most `LET_IN_S`, and the host's end
    """

    def __init__(self, address: BusAddress, timeout_s: float = STOP_TIMEOUT_S) -> None:
        self.address, self._timeout_s = address, timeout_s
        self._let_in_s = min(LET_IN_S, timeout_s)
        now = time.monotonic()
        self._heard_by, self._deadline = now + self._let_in_s, now + timeout_s
        self._failure: str | None = None
        self._socket = _new()
        try:
            connect_by(self._socket, control_path(self.address), self._heard_by)
            self._socket.send(STOP)
        except TimeoutError:
            self._fail(f"does not accept a connection within {self._let_in_s:g} s: it no longer serves its socket")
        except (FileNotFoundError, ConnectionRefusedError):
            self._failure = _no_host(address)
        except OSError as error:
            self._fail(f"cannot be asked to stop: {error.strerror or error}")

    def _fail(self, text: str) -> None:
        self._failure = f"the host on bus {self.address} {text}; it may be armed still: see to the rig itself"

    def _receive(self, deadline: float) -> bytes:
        self._socket.settimeout(max(1e-3, deadline - time.monotonic()))
        return self._socket.recv(MESSAGE_BYTES)

    def result(self) -> dict[str, Any]:
        """Wait for the host's end and return its result.

        The result is empty if the host accepted the request and ended without one.

        Raises
        ------
        NoHost
            no host runs there, it did not accept the request, or it did not end
        """
        with self._socket:
            if self._failure is None:
                try:
                    return self._hear()
                except TimeoutError:
                    self._fail(f"has not stopped within {self._timeout_s:g} s")
                except OSError as error:
                    self._fail(f"broke off: {error.strerror or error}")
        raise NoHost(self._failure)

    def _hear(self) -> dict[str, Any]:
        try:
            first = self._receive(self._heard_by)
        except TimeoutError:
            self._fail(
                f"has not stopped within {self._let_in_s:g} s, nor taken the request: it starts (and takes it later), "
                "it ends, or it does not look after its door any more"
            )
            raise NoHost(self._failure) from None
        if first != ACCEPTED:
            self._fail(
                "closed the connection and did not take the request" if not first else "gave no answer that is one"
            )
            raise NoHost(self._failure)
        message = self._receive(self._deadline)
        if not message:
            return {}
        try:
            answer = json.loads(message)
        except (ValueError, RecursionError):  # RecursionError: deeply nested brackets
            answer = None
        if not isinstance(answer, dict) or not all(
            isinstance(answer.get(key, 0.5), kinds) for key, kinds in TOLD.items()
        ):
            self._fail("took the request, but what it told of its end cannot be read")
            raise NoHost(self._failure)
        return answer


def stop_host(address: BusAddress, timeout_s: float = STOP_TIMEOUT_S) -> dict[str, Any]:
    """Request a safe stop of the host on a bus, wait for its end, and return its result
    (`StopRequest.result`).

    Raises
    ------
    NoHost
        no host runs there, it did not accept the request, or it did not end
    """
    return StopRequest(address, timeout_s).result()


def ask_status(address: BusAddress, timeout_s: float = STATUS_TIMEOUT_S) -> dict[str, Any]:
    """Return the state of the host on a bus.

    Raises
    ------
    NoHost
        no host runs there, or its answer is not valid
    """
    return _ask(address, STATUS, timeout_s)


def ask_mark(address: BusAddress, text: str, timeout_s: float = STATUS_TIMEOUT_S) -> dict[str, Any]:
    """Request a marker in the recording of the host on a bus; return its answer.

    The answer has ``marker``, the recorded text, and ``recording``, the path.

    Raises
    ------
    NoHost
        no host runs there, or its answer is not valid
    NotMarked
        the host does not record, or refuses the text
    """
    answer = _ask(address, MARK + text.encode(errors="replace"), timeout_s)
    if "error" in answer:
        raise NotMarked(f"the host on bus {address}: {answer['error']}")
    return answer


def ask_change(address: BusAddress, request: dict[str, Any], timeout_s: float = STATUS_TIMEOUT_S) -> dict[str, Any]:
    """Request a change of parameters from the host on a bus; return its answer (`host.run.changes`).

    Raises
    ------
    NoHost
        no host runs there, or its answer is not valid
    NotChanged
        the host refuses; nothing is changed
    """
    message = SET + json.dumps(request).encode(errors="replace")
    deadline = time.monotonic() + timeout_s
    while True:
        answer = _ask(address, message, timeout_s)
        if "error" not in answer:
            return answer
        if not answer.get("again") or time.monotonic() > deadline:
            raise NotChanged(f"the host on bus {address}: {answer['error']}")
        time.sleep(RETRY_S)


def _ask(address: BusAddress, message: bytes, timeout_s: float) -> dict[str, Any]:
    """Send a message to the host on a bus, and return its answer."""
    with _new() as asker:
        try:
            connect_by(asker, control_path(address), time.monotonic() + timeout_s)
            asker.send(message)
            asker.settimeout(timeout_s)
            answer = json.loads(asker.recv(MESSAGE_BYTES))
        except (FileNotFoundError, ConnectionRefusedError):
            raise NoHost(_no_host(address)) from None
        except TimeoutError:
            text = f"the host on bus {address} gives no answer: it starts, or it ends"
            raise NoHost(text) from None
        except OSError as error:
            raise NoHost(f"the host on bus {address} broke off: {error.strerror or error}") from None
        except (ValueError, RecursionError):
            raise NoHost(f"the host on bus {address} gave no answer that is one") from None
    if not isinstance(answer, dict) or not answer:
        raise NoHost(f"the host on bus {address} gave no answer that is one")
    return answer
