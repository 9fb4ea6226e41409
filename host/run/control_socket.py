"""The running host's door: a socket beside the bus', by which ``coulombus stop`` asks for a safe
stop, ``coulombus status`` for its state, and by which a second host knows of it.

The asker sends ``stop``. The host answers ``accepted`` as soon as it has read it, and at its end
what came of it, as JSON. Only after ``accepted`` is the end of the connection the end of the host;
before, it may be anything, and the rig may be armed still. Who sends ``status`` gets one JSON
object at once; so does who sends ``mark TEXT``, by which ``coulombus mark`` marks the recording,
and who sends ``set`` with a JSON object, by which ``coulombus set`` and the page change parameters
(`host.run.changes`).
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
from coulombus.wire.address import HOST_SUFFIX, AddressError, BusAddress, parse_address, socket_names, socket_path

__all__ = [
    "HostSocket",
    "NoHost",
    "NotChanged",
    "NotMarked",
    "StopRequest",
    "ask_change",
    "ask_mark",
    "ask_status",
    "control_path",
    "host_runs",
    "hosts_here",
    "stop_host",
]

STOP_TIMEOUT_S = 30.0
"""How long a stop that the host has taken may last."""
LET_IN_S = 3.0
"""How long the host may need to take it."""
MESSAGE_BYTES = 1 << 16
STOP, ACCEPTED, STATUS, MARK, SET = b"stop", b"accepted", b"status", b"mark ", b"set "
STATUS_TIMEOUT_S = 3.0
ASKERS = 16
"""Who may be connected at a time.

One more takes the place of the one that has been silent for longest.
"""
SILENT_S = 1.0
"""How long one may be connected and say nothing."""
BACKLOG = 8
TOLD = {"mode": (str,), "cycles": (int,), "trip": (str, type(None))}
"""What a host tells of its end, and of which types it is."""
RETRY_S = 0.01


class NoHost(HostError):
    """No host runs on the bus, or it did not take the request, or it did not end."""

    exit_status = 4


class NotMarked(HostError):
    """The host runs and marks nothing; the text says why."""

    exit_status = 2


class NotChanged(HostError):
    """The host runs and changes no parameter; the text says why."""

    exit_status = 2


def control_path(address: BusAddress) -> Path:
    """Return the path of the control socket of the host on a bus."""
    name = address.name if address.is_virtual else f"{address.kind}-" + re.sub(r"[^A-Za-z0-9_.-]", "_", address.name)
    return socket_path(f"{name}{HOST_SUFFIX}")


def _new() -> socket.socket:
    return socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)


def _probe(path: Path) -> bool | None:
    """Tell who is at a host's door: True, a host; False, nobody, a killed one left it; None, there
    is no door.
    """
    with _new() as probe:
        try:
            probe.connect(str(path))
        except FileNotFoundError:
            return None
        except ConnectionRefusedError:
            return False
        except BlockingIOError:  # so many wait that there is no room: it lives
            return True
    return True


def host_runs(address: BusAddress) -> bool:
    """Tell whether a host of this machine has the bus; nothing is asked of it."""
    return _probe(control_path(address)) is True


def hosts_here() -> list[BusAddress]:
    """Return the buses on which a host of this user and machine runs; nothing is asked of it."""
    names = (name.removesuffix(HOST_SUFFIX) for name in socket_names() if name.endswith(HOST_SUFFIX))
    return [address for address in map(_address_of, names) if host_runs(address)]


def _address_of(name: str) -> BusAddress:
    """Return the address whose `control_path` has this name."""
    with suppress(AddressError):
        address = parse_address(name.replace("-", ":", 1))
        if control_path(address).name == f"{name}{HOST_SUFFIX}":
            return address
    return BusAddress("coulombus", name)


class _Client:
    """Somebody at the door."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        self.connection, self.since, self.accepted = connection, time.monotonic(), False

    def asks(self, door: HostSocket) -> bool | None:
        """Tell whether a stop is asked for now; None: it has gone, has its answer, talks nonsense,
        or has said nothing for too long.
        """
        try:
            message = self.connection.recv(MESSAGE_BYTES)
        except BlockingIOError:
            return False if self.accepted or time.monotonic() - self.since < SILENT_S else None
        except OSError:
            return None
        if message == STATUS:
            self.tell(door.status())
        for verb, answer in ((MARK, door.mark), (SET, door.change)):
            if message.startswith(verb):
                self.tell(answer(message[len(verb) :].decode(errors="replace")))
        if message != STOP:
            return None
        self.accepted = True
        self.tell(ACCEPTED)
        return True

    def tell(self, message: bytes) -> None:
        with suppress(OSError):  # it has gone: what it asked for stands
            self.connection.send(message)


class HostSocket:
    """Claims the bus at `address` for this process.

    `status` makes the answer to who asks for the state, `mark` marks the recording with a text and
    makes the answer to that, `change` changes parameters as a JSON text says and makes the answer;
    all may be set later.

    Raises
    ------
    SafetyTrip
        another host of this machine has the bus
    """

    def __init__(self, address: BusAddress) -> None:
        self._path = control_path(address)
        self._askers: list[_Client] = []
        self.status: Callable[[], bytes] = lambda: b"{}"
        self.mark: Callable[[str], bytes] = lambda text: b"{}"
        self.change: Callable[[str], bytes] = lambda text: b"{}"
        heard = _probe(self._path)
        if heard:
            raise SafetyTrip(_occupied(address))
        if heard is False:  # where there was no door, one that is there now is a host's that starts
            self._path.unlink(missing_ok=True)
        self._listener = _new()
        try:
            self._listener.bind(str(self._path))
        except OSError:
            self._listener.close()
            raise SafetyTrip(f"another host starts on bus {address}") from None
        try:
            self._listener.listen(BACKLOG)
        except OSError:
            self.close()
            raise

    def stop_wanted(self) -> bool:
        """Tell whether somebody has asked for a stop since the last time.

        OSError: nobody can come in any more.
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
        for _ in range(ASKERS):  # a bound: who comes again and again holds up nobody
            try:
                connection, _ = self._listener.accept()
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
        """Tell those who asked what came of it, and let go of the bus.

        May be called again; raises nothing.
        """
        if self._listener.fileno() < 0:
            return
        with suppress(Exception):  # who asked at the last moment hears of it, too
            self.stop_wanted()
        with suppress(OSError):
            self._path.unlink()
        self._listener.close()
        for asker in self._askers:
            if result is not None and asker.accepted:
                asker.tell(json.dumps(result).encode())
            asker.connection.close()
        self._askers.clear()


def _occupied(address: BusAddress) -> str:
    return f"another host runs on bus {address}; end it first with `coulombus stop --bus {address}`"


class StopRequest:
    """Asks the host on a bus to stop safely; `result` waits for its end.

    What goes wrong is told there.

    Parameters
    ----------
    timeout_s : for all of it: to get in and be heard, which is `LET_IN_S` at most, and the host's end
    """

    def __init__(self, address: BusAddress, timeout_s: float = STOP_TIMEOUT_S) -> None:
        self.address, self._timeout_s = address, timeout_s
        self._let_in_s = min(LET_IN_S, timeout_s)
        now = time.monotonic()
        self._heard_by, self._deadline = now + self._let_in_s, now + timeout_s
        self._failure: str | None = None
        self._socket = _new()
        try:
            self._connect()
            self._socket.send(STOP)
        except TimeoutError:
            self._fail(f"does not let anybody in within {self._let_in_s:g} s: it does not look after its door any more")
        except (FileNotFoundError, ConnectionRefusedError):
            self._failure = f"no host runs on bus {address}"
        except OSError as error:
            self._fail(f"cannot be asked to stop: {error.strerror or error}")

    def _fail(self, text: str) -> None:
        self._failure = f"the host on bus {self.address} {text}; it may be armed still: see to the rig itself"

    def _connect(self) -> None:
        path = str(control_path(self.address))
        while True:
            try:
                return self._socket.connect(path)
            except BlockingIOError:  # no room among those who wait at its door: connect() would wait for ever
                if time.monotonic() >= self._heard_by:
                    raise TimeoutError from None
                time.sleep(RETRY_S)

    def _receive(self, deadline: float) -> bytes:
        self._socket.settimeout(max(1e-3, deadline - time.monotonic()))
        return self._socket.recv(MESSAGE_BYTES)

    def result(self) -> dict[str, Any]:
        """Wait for the host's end and return what it tells.

        Empty: it took the request and ended without a word.

        Raises
        ------
        NoHost
            none runs there, it did not take the request, or it does not come to an end
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
        except (ValueError, RecursionError):  # RecursionError: brackets within brackets
            answer = None
        if not isinstance(answer, dict) or not all(
            isinstance(answer.get(key, 0.5), kinds) for key, kinds in TOLD.items()
        ):
            self._fail("took the request, but what it told of its end cannot be read")
            raise NoHost(self._failure)
        return answer


def stop_host(address: BusAddress, timeout_s: float = STOP_TIMEOUT_S) -> dict[str, Any]:
    """Ask the host on a bus to stop safely, wait for its end, and return what it tells
    (`StopRequest.result`).

    Raises
    ------
    NoHost
        none runs there, it did not take the request, or it does not come to an end
    """
    return StopRequest(address, timeout_s).result()


def ask_status(address: BusAddress, timeout_s: float = STATUS_TIMEOUT_S) -> dict[str, Any]:
    """Ask the host on a bus for its state.

    Raises
    ------
    NoHost
        none runs there, or it gives no answer that is one
    """
    return _ask(address, STATUS, timeout_s)


def ask_mark(address: BusAddress, text: str, timeout_s: float = STATUS_TIMEOUT_S) -> dict[str, Any]:
    """Ask the host on a bus to mark its recording, and return what it tells: ``marker``, the text
    as it is recorded, and ``recording``, where.

    Raises
    ------
    NoHost
        none runs there, or it gives no answer that is one
    NotMarked
        it does not record, or refuses the text
    """
    answer = _ask(address, MARK + text.encode(errors="replace"), timeout_s)
    if "error" in answer:
        raise NotMarked(f"the host on bus {address}: {answer['error']}")
    return answer


def ask_change(address: BusAddress, order: dict[str, Any], timeout_s: float = STATUS_TIMEOUT_S) -> dict[str, Any]:
    """Ask the host on a bus for other parameters, and return what it tells (`host.run.changes`).

    Raises
    ------
    NoHost
        none runs there, or it gives no answer that is one
    NotChanged
        it refuses; nothing is changed
    """
    message = SET + json.dumps(order).encode(errors="replace")
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
            asker.connect(str(control_path(address)))
            asker.send(message)
            asker.settimeout(timeout_s)
            answer = json.loads(asker.recv(MESSAGE_BYTES))
        except (FileNotFoundError, ConnectionRefusedError):
            raise NoHost(f"no host runs on bus {address}") from None
        except (BlockingIOError, TimeoutError):
            text = f"the host on bus {address} gives no answer: it starts, or it ends"
            raise NoHost(text) from None
        except OSError as error:
            raise NoHost(f"the host on bus {address} broke off: {error.strerror or error}") from None
        except (ValueError, RecursionError):
            raise NoHost(f"the host on bus {address} gave no answer that is one") from None
    if not isinstance(answer, dict) or not answer:
        raise NoHost(f"the host on bus {address} gave no answer that is one")
    return answer
