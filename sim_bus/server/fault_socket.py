"""Socket through which other programs of the same user break a running bus: `coulombus inject`, `clear`, the page.

Each process that has nodes on the virtual bus NAME listens beside it: at NAME.faults if it serves the bus, else at
NAME.PID.faults. A request and its answer are a JSON object each. Only a process of the same user gets one
(SO_PEERCRED).
"""

from __future__ import annotations

import json
import os
import select
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, Future
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from coulombus.sim_bus.faults.live_faults import BUS, FaultRefused, LiveFaults, NodeUnknown
from coulombus.sim_bus.server.server import BusServer
from coulombus.sim_bus.server.socket_file import locked, peer, unlink_own
from coulombus.system.exit import say
from coulombus.wire.address import FAULTS_SUFFIX, BusAddress, BusUnavailable, bus_names, socket_names, socket_path

__all__ = ["BusFaults", "FaultSocket", "fault_buses", "fault_sockets"]

MESSAGE_BYTES = 1 << 18
PATIENCE_S = 5.0
LOOK_S = 0.1
"""Interval at which the strikes of acting faults are passed to the recording."""
BACKLOG = 8


class FaultSocket:
    """Serves the requests for the faults of a server's bus at `address`, until `close`."""

    def __init__(self, server: BusServer, address: BusAddress) -> None:
        self._server, self._address = server, address
        self._faults = LiveFaults(server.world, server.mark)
        name = address.name if not server.joined else f"{address.name}.{os.getpid()}"
        self._path = socket_path(name + FAULTS_SUFFIX)
        self._wake = os.eventfd(0, os.EFD_CLOEXEC)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            with locked(self._path.parent):  # the bus itself is this process's: a file here is a killed one's
                self._path.unlink(missing_ok=True)
                self._listener.bind(str(self._path))
                self._listener.listen(BACKLOG)
            self._inode = self._path.stat().st_ino
        except BaseException:
            self._listener.close()
            os.close(self._wake)
            raise
        self._thread = threading.Thread(target=self._serve, name="faults", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the service, and remove the socket's file."""
        os.eventfd_write(self._wake, 1)
        self._thread.join()
        unlink_own(self._path, self._inode)
        self._listener.close()
        os.close(self._wake)

    def _serve(self) -> None:
        acts = False
        while True:
            ready, _, _ = select.select([self._listener.fileno(), self._wake], (), (), LOOK_S if acts else None)
            if self._wake in ready:
                return
            if self._listener.fileno() in ready:
                with suppress(OSError):  # the client has gone
                    connection, _ = self._listener.accept()
                    with connection:
                        connection.settimeout(PATIENCE_S)
                        connection.send(json.dumps(self._answer(connection)).encode())
            with suppress(CancelledError, TimeoutError):
                acts = self._server.call(lambda: self._faults.acts).result(PATIENCE_S)

    def _answer(self, connection: socket.socket) -> dict[str, Any]:
        """Read a request, and return its answer."""
        message = connection.recv(MESSAGE_BYTES)
        if (uid := peer(connection).uid) != os.geteuid():
            text = f"bus {self._address} belongs to user {os.geteuid()}, and takes no fault from user {uid}"
            return {"error": text, "exit_status": BusUnavailable.exit_status}
        try:
            request = json.loads(message)
            answer = self._at_present(lambda: self._do(request))
        except FaultRefused as error:
            return {"error": str(error), "exit_status": error.exit_status}
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            return {"error": f"the request cannot be read: {type(error).__name__}: {error}", "exit_status": 2}
        except (CancelledError, TimeoutError):
            return {"error": f"bus {self._address} ends", "exit_status": BusUnavailable.exit_status}
        return answer

    def _at_present(self, action: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Perform an action on the world at the present time, in its thread, and return its result."""
        result: Future[dict[str, Any]] = Future()

        def act(_: object) -> None:
            try:
                result.set_result(action())
            except Exception as error:
                result.set_exception(error)

        world = self._server.world
        self._server.call(lambda: world.at(max(self._server.now_ns(), world.t_ns), act)).result(PATIENCE_S)
        return result.result(PATIENCE_S)

    def _do(self, request: Mapping[str, Any]) -> dict[str, Any]:
        faults, done = self._faults, []
        if (command := request.get("inject")) is not None:
            lasts_s = command.get("for_s")
            values = {str(key): str(value) for key, value in command.get("values", {}).items()}
            where = str(command["on"])
            done.append(
                faults.inject(str(command["fault"]), where, None if lasts_s is None else float(lasts_s), values)
            )
        elif (command := request.get("clear")) is not None:
            done += faults.clear(str(command.get("fault", "")), str(command.get("on", "")))
        return {"bus": str(self._address), "serves": not self._server.joined, "done": done, **faults.state()}


@contextmanager
def fault_sockets(server: BusServer) -> Iterator[None]:
    """Serve the requests for the faults of a server's virtual buses; a socket that cannot be made is only reported."""
    with ExitStack() as left:
        for address in server.addresses:
            if address.is_virtual:
                try:
                    left.callback(FaultSocket(server, address).close)
                except (OSError, ValueError) as error:  # for example a name that is too long with its suffix
                    say(f"coulombus: no fault can be injected on bus {address}: {error}")
        yield


class BusFaults:
    """The faults of a virtual bus that other processes serve and have nodes on.

    Raises
    ------
    BusUnavailable
        there is no such bus, or it is another user's
    """

    def __init__(self, address: BusAddress) -> None:
        if not address.is_virtual:
            raise BusUnavailable(f"bus {address}: faults are injected into simulated nodes on a bus coulombus:NAME")
        self.address = address

    def state(self) -> dict[str, Any]:
        """Return nodes, possible faults of the wire, and what acts, of all processes on the bus."""
        answers = list(self._answers().values())
        return {
            "bus": str(self.address),
            "nodes": [node for answer in answers for node in answer["nodes"]],
            "wire": [kind for answer in answers for kind in answer["wire"]],
            "acting": [fault for answer in answers for fault in answer["acting"]],
        }

    def inject(
        self, fault: str, where: str, for_s: float | None = None, values: Mapping[str, str] | None = None
    ) -> str:
        """Inject a fault into the process that has the node, or serves the bus; return its text.

        Raises
        ------
        FaultRefused
            there is no such fault or node, or it cannot act there now
        """
        answers = self._answers()
        command = {"fault": fault, "on": where, "for_s": for_s, "values": dict(values or {})}
        owners = [path for path, answer in answers.items() if where in _names(answer)]
        serving = [path for path, answer in answers.items() if answer["serves"]]
        if where != BUS and not owners:
            names = ", ".join(name for answer in answers.values() for name in _names(answer))
            raise NodeUnknown(f"there is no node '{where}' on bus {self.address}; it has {names or 'none'}")
        path = (serving if where == BUS else owners)[0]
        text: str = _ask(path, self.address, {"inject": command})["done"][0]
        return text

    def clear(self, fault: str = "", where: str = "") -> list[str]:
        """End the faults of a kind, at a place, or all; return their texts."""
        texts: list[str] = []
        unknown: NodeUnknown | None = None
        answers = self._answers()
        for path in answers:
            try:
                texts += _ask(path, self.address, {"clear": {"fault": fault, "on": where}})["done"]
            except NodeUnknown as error:
                unknown = error
        if unknown is not None and not any(where in _names(answer) for answer in answers.values()):
            raise unknown
        return texts

    def _answers(self) -> dict[Path, dict[str, Any]]:
        """Return the state of each process on the bus."""
        answers = {}
        for path in _sockets().get(self.address.name, []):
            with suppress(FileNotFoundError, ConnectionRefusedError):  # a killed process's
                answer = _ask(path, self.address, {})
                if answer["bus"] == str(self.address):
                    answers[path] = answer
        if not answers:
            buses = ", ".join(map(str, fault_buses()))
            rest = f"; there is {buses}" if buses else f": start `coulombus emulate --bus {self.address}`"
            raise BusUnavailable(f"no simulated node is on bus {self.address}{rest}")
        return answers


def _names(answer: Mapping[str, Any]) -> list[str]:
    """Return the names and node ids of a process' nodes."""
    return list(dict.fromkeys(str(node[key]) for node in answer["nodes"] for key in ("name", "node_id")))


def _sockets() -> dict[str, list[Path]]:
    """Return the sockets of this module by bus."""
    buses, paths = bus_names(), dict[str, list[Path]]()
    for name in socket_names():
        stem = name.removesuffix(FAULTS_SUFFIX)
        if stem != name:
            first, _, last = stem.rpartition(".")
            joined = first and last.isdigit() and stem not in buses  # a bus may have the name bench.7
            paths.setdefault(first if joined else stem, []).append(socket_path(name))
    return paths


def fault_buses() -> list[BusAddress]:
    """Return the buses of this user on which faults can be injected."""
    return [BusAddress("coulombus", name) for name, paths in _sockets().items() if any(map(_answers_at, paths))]


def _answers_at(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        probe.settimeout(PATIENCE_S)
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True


def _ask(path: Path, address: BusAddress, request: Mapping[str, Any]) -> dict[str, Any]:
    """Send a request to a process, and return its answer."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as client:
        client.settimeout(PATIENCE_S)
        try:
            client.connect(str(path))
            client.send(json.dumps(request).encode())
            answer = json.loads(client.recv(MESSAGE_BYTES))
        except (FileNotFoundError, ConnectionRefusedError):
            raise
        except PermissionError:
            raise BusUnavailable(f"bus {address} belongs to another user: its faults are that user's") from None
        except (OSError, ValueError) as error:
            raise BusUnavailable(f"the process of bus {address} does not answer: {error}") from None
    if "error" in answer:
        kinds = {NodeUnknown.exit_status: NodeUnknown, BusUnavailable.exit_status: BusUnavailable}
        raise kinds.get(answer.get("exit_status"), FaultRefused)(answer["error"])
    return dict(answer)
