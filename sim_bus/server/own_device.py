"""User-defined CANopen device in a few lines of Python: an EDS, callbacks, values.

    from coulombus import Device

    device = Device("my.eds", node_id=5)

    @device.written("6200:01")
    def switch(value):
        print("the outputs are", value)

    device.serve("coulombus:bench")

The node is the compiled node of ``coulombus node``. The callbacks run in their own thread: their
exceptions are reported and have no other effect, and a slow callback delays only the other
callbacks. Python runs one thread at a time, so a callback with a long computation should release
the interpreter now and then; waiting for a file or a socket releases it.

A callback receives the newest value: of several writes since its last call, only the last.
"""

from __future__ import annotations

import queue
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from coulombus.eds.description import Value, object_key
from coulombus.node import device as node_device
from coulombus.node.profile import Key
from coulombus.rigs.arguments import a_number, path_text
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.server.live_nodes import LiveNodes, run_nodes
from coulombus.sim_bus.server.server import BusServer
from coulombus.system.exit import say
from coulombus.wire.address import parse_address

__all__ = ["Device"]

MOST_WAITING = 1000
"""Largest number of pending calls; further calls are dropped and counted."""

_Call: TypeAlias = Callable[[], object]
_F = TypeVar("_F", bound=Callable[..., object])


class Device:
    """A node with callbacks.

    Parameters
    ----------
    eds : path of the EDS file
    node_id : 1 to 127
    period_s : interval at which values are copied and writes are detected

    Raises
    ------
    coulombus.eds.reader.EdsError
        the file is no EDS
    """

    def __init__(self, eds: str | Path, node_id: int, *, period_s: float = 0.01) -> None:
        a_number(node_id, "node_id", "5", whole=True)
        self._nodes = LiveNodes(((Path(path_text(eds, "eds", 'Device("my_device.eds", node_id=5)')), node_id),))
        self._nodes.on_begin = self._begin
        self.description = self._nodes.descriptions[0]
        self.missed = 0
        """Number of dropped calls because the callbacks were too slow."""
        self._period_ns = round(period_s * 1e9)
        self._written: dict[Key, list[Callable[[Any], object]]] = {}
        self._sync: list[_Call] = []
        self._pending: deque[tuple[Key, Value]] = deque()
        self._values: dict[Key, Value] = {}
        self._downloads: deque[Key] = deque()
        self._calls: queue.Queue[_Call] = queue.Queue(MOST_WAITING)
        self._node: node_device.Device | None = None
        self._server: BusServer | None = None
        self._sync_ns, self._rpdo_ns = -1, [0]
        self._fresh: set[int] = set()

    # the program's interface

    def written(self, name: str) -> Callable[[_F], _F]:
        """Return a decorator for a function that is called with an object's value after a client or a
        PDO has written it.

        `name` is ``"6200:01"`` or the object's name in the EDS.

        Raises
        ------
        KeyError
            the EDS has no such object
        """
        key = self._key(name)

        def take(function: _F) -> _F:
            self._written.setdefault(key, []).append(function)
            return function

        return take

    def sync(self, function: _F) -> _F:
        """Call a function without arguments after each SYNC."""
        self._sync.append(function)
        return function

    def __getitem__(self, name: str) -> Value:
        """Return an object's present value."""
        key = self._key(name)
        if key in self._values:
            return self._values[key]
        if self._node is not None:
            return self._node.dictionary[key]
        return self.description.variable(*key).default

    def __setitem__(self, name: str, value: Value) -> None:
        """Set an object, within `period_s`; TPDOs on events follow.

        Raises
        ------
        KeyError
            the EDS has no such object
        TypeError, ValueError
            the object does not have this type, or cannot hold the value
        """
        key = self._key(name)
        variable = self.description.variable(*key)
        if variable.whole is not None:
            if not isinstance(value, int):
                raise TypeError(f"{name}: got {value!r}, expected an integer")
            if not variable.whole[0] <= value <= variable.whole[1]:
                raise ValueError(f"{name}: got {value}, expected {variable.whole[0]} to {variable.whole[1]}")
        self._values[key] = value
        self._pending.append((key, value))

    def serve(self, bus: str, seconds: float | None = None) -> None:
        """Serve the node on ``coulombus:NAME`` or ``socketcan:IF`` until the time is over or a signal
        comes; ends the program with the exit status of ``coulombus node``.

        Raises
        ------
        coulombus.wire.address.BusUnavailable
            the bus does not exist
        """
        sys.setswitchinterval(5e-4)  # the node gets the interpreter soon, whatever a callback does
        worker = threading.Thread(target=self._work, name="call-backs", daemon=True)
        worker.start()
        run_nodes(self._nodes, parse_address(bus), seconds)

    # in the bus's thread

    def _begin(self, server: BusServer) -> None:
        self._server, self._node = server, server.world.devices[0]
        self._node.on_download = lambda index, subindex: self._downloads.append((index, subindex))
        self._rpdo_ns = self._node.record["rpdo_ns"].tolist()
        server.world.at(0, self._tick)

    def _tick(self, network: VirtualNetwork) -> None:
        node, server = self._node, self._server
        assert node is not None
        assert server is not None
        while self._pending:
            key, value = self._pending.popleft()
            node[key] = value
            node.record["next_ns"] = min(int(node.record["next_ns"]), network.t_ns)
            if self._values.get(key) == value:
                self._values.pop(key, None)
        keys = set()
        while self._downloads:
            keys.add(self._downloads.popleft())
        keys |= self._mapped(node)
        for key in keys & self._written.keys():
            for function in self._written[key]:
                self._call(partial(function, node.dictionary[key]))
        sync_ns = int(node.record["sync_ns"])
        if sync_ns != self._sync_ns:
            if sync_ns > 0:
                for call in self._sync:
                    self._call(call)
            self._sync_ns = sync_ns
        late = max(server.now_ns() - network.t_ns, 0) // self._period_ns
        network.at(network.t_ns + (late + 1) * self._period_ns, self._tick)

    def _mapped(self, node: node_device.Device) -> set[Key]:
        """Return the objects that RPDOs have written since the last call, except RPDOs that wait for their SYNC."""
        record = node.record
        times: list[int] = record["rpdo_ns"].tolist()
        self._fresh |= {k for k, (now, before) in enumerate(zip(times, self._rpdo_ns, strict=True)) if now != before}
        self._rpdo_ns = times
        acted = {k for k in self._fresh if not record["rpdo_waits"][k]}
        self._fresh -= acted
        keys = set()
        for k in acted:
            first = 0x1600 + k
            for subindex in range(1, node.dictionary.number(first) + 1):
                entry = node.dictionary.number(first, subindex)
                keys.add((entry >> 16, entry >> 8 & 0xFF))
        return keys

    def _call(self, call: _Call) -> None:
        try:
            self._calls.put_nowait(call)
        except queue.Full:
            self.missed += 1

    # in the callbacks' thread

    def _work(self) -> None:
        while True:
            self._carry_out(self._calls.get())

    @staticmethod
    def _carry_out(call: _Call) -> None:
        try:
            call()
        except Exception:
            say(f"coulombus: a call-back failed:\n{traceback.format_exc()}")

    def _key(self, name: str) -> Key:
        key = object_key(name, self.description)
        if isinstance(key, str):
            raise KeyError(f"{name}: expected {key}")
        return key
