"""A program outside: `connect` to a running display, read its states, and say what the hand meets."""

from __future__ import annotations

import asyncio
import select
import socket
import time
from collections import deque
from collections.abc import AsyncIterator, Iterator
from dataclasses import replace
from types import TracebackType
from typing import Any

import numpy as np

from coulombus.host.errors import HostError
from coulombus.host.world.model_check import ModelRefused
from coulombus.host.world.model_parts import LIFE_S, Model, Part, PlaneProfile, TorqueProfile
from coulombus.host.world.protocol import (
    SIZES,
    Greeting,
    Kind,
    Named,
    Refusal,
    Welcome,
    read_named,
    read_refusal,
    read_welcome,
    records_in,
)
from coulombus.host.world.records import MODEL, STATE
from coulombus.host.world.state import State, state_of
from coulombus.rigs.arguments import WrongCall
from coulombus.system.full_queue import connect_by
from coulombus.wire.address import WORLD_SUFFIX, BusAddress, parse_address, socket_path

__all__ = ["Hand", "NoWorld", "connect", "world_path"]

CHUNK = 1 << 16
WAIT_S = 3.0
START_S = 120.0
"""Longest time to wait for the first state: the host may compile, bring the nodes up, and wait for a hand."""
RENEW = 3.0
"""A model is sent again after this part of its time to live."""


class NoWorld(HostError):
    """No host lets a world in on this bus, or it has ended."""

    exit_status = 4


def world_path(address: BusAddress) -> Any:
    """Return the path of the socket of the host on a bus."""
    name = address.name if address.is_virtual else f"{address.kind}-{address.name}"
    return socket_path(f"{name}{WORLD_SUFFIX}")


def _settle(ready: asyncio.Future[None]) -> None:
    if not ready.done():
        ready.set_result(None)


class Hand:
    """The display as the device of a program: its states, and what the hand meets.

    No method waits except `next`, the iteration, and `state` before the first state. A model is sent
    again by every call, as long as the program makes calls; when they end, it fades.

    Attributes
    ----------
    missed : models that the host could not take in time; what was sent later holds
    welcome : the host's period, mode and largest time to live
    parameters : the parameters that a model may set, with their bounds; with slot -1 the limits
    """

    def __init__(self, connection: socket.socket, timeout_s: float = WAIT_S) -> None:
        self._connection, self._timeout_s = connection, timeout_s
        self._read = bytearray()
        self._states: deque[State] = deque()
        self._newest: State | None = None
        self._refusals: deque[Refusal] = deque()
        self._ended = False
        self._models: dict[int, Model] = {}
        self._sent_ns: dict[int, int] = {}
        self._numbers: dict[int, int] = {}
        self.missed = 0
        self._sequence = self._profiles = 0
        self._profile: TorqueProfile | PlaneProfile | None = None
        self.welcome: Welcome
        self.parameters: tuple[Named, ...] = ()
        connection.setblocking(False)
        self._greet()

    def _greet(self) -> None:
        records: list[bytes] = []
        self._begin: list[bytes] | None = records
        deadline = time.monotonic() + self._timeout_s
        while not records or len(records) <= read_welcome(records[0]).parameters:
            if not self._wait(deadline - time.monotonic()):
                raise NoWorld("the host gives no answer")
            self._receive()
        self._begin = None
        self.welcome = read_welcome(records[0])
        self.parameters = tuple(map(read_named, records[1:]))

    # reading

    def _wait(self, seconds: float) -> bool:
        """Wait until something can be read; return whether it can."""
        return bool(select.select([self._connection], [], [], max(seconds, 0.0))[0])

    @property
    def _patience_s(self) -> float:
        """Longest time to wait for a state."""
        return START_S if self._newest is None else self._timeout_s

    @property
    def _silence(self) -> str:
        return f"the host has sent no state for {self._patience_s:g} s"

    def _receive(self) -> None:
        """Read all that has come."""
        while not self._ended:
            try:
                data = self._connection.recv(CHUNK)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            self._ended = not data
            self._read += data
            self._sort(records_in(self._read, CHUNK) or [])
            if len(data) < CHUNK:
                break
        if self._refusals and self._refusals[0].sequence == 0:
            raise NoWorld(f"the host refuses: {self._refusals[0].reason}")
        if self._ended and self._begin is not None:
            raise NoWorld("the host has ended")

    def _sort(self, records: list[tuple[Kind, bytes]]) -> None:
        for kind, record in records:
            if kind == Kind.STATE:
                self._states.append(state_of(np.frombuffer(record, STATE)[0]))
            elif kind == Kind.REFUSED:
                self._refusals.append(read_refusal(record))
            elif self._begin is not None:
                self._begin.append(record)

    def _update(self) -> None:
        """Read, renew the models, and raise what the host has refused."""
        self._receive()
        self._renew()
        while self._refusals:
            refusal = self._refusals.popleft()
            if refusal.again:
                self.missed += 1
                continue
            self._models = {a: model for a, model in self._models.items() if self._numbers[a] != refusal.sequence}
            raise ModelRefused(f"model {refusal.sequence}: {refusal.reason}")

    @property
    def state(self) -> State:
        """The newest state; earlier ones that were not read are skipped.

        Raises
        ------
        NoWorld
            the host has ended, or sends no state
        ModelRefused
            the host has refused a model; the text gives the reason
        """
        self._update()
        if self._newest is None and not self._states:
            return self.next()
        if self._states:
            self._newest = self._states[-1]
            self._states.clear()
        if self._ended:
            raise NoWorld("the host has ended")
        assert self._newest is not None
        return self._newest

    def next(self) -> State:
        """Wait for the next state, and return it: one for each cycle and axis, in their order.

        Raises
        ------
        NoWorld
            the host has ended, or sends no state within the time-out
        ModelRefused
            the host has refused a model; the text gives the reason
        """
        if not self._states:
            self._update()
        while not self._states:
            if self._ended:
                raise NoWorld("the host has ended")
            if not self._wait(self._patience_s):
                raise NoWorld(self._silence)
            self._update()
        self._renew()
        self._newest = self._states.popleft()
        return self._newest

    def __iter__(self) -> Iterator[State]:
        """Yield each state until the host ends; `State.lost` counts those that were left out."""
        while True:
            try:
                state = self.next()
            except NoWorld:
                if self._ended:
                    return
                raise
            yield state

    async def anext(self) -> State:
        """Return the next state, as `next`, in a coroutine."""
        while not self._states and not self._ended:
            await self._readable()
            self._update()
        return self.next()

    async def __aiter__(self) -> AsyncIterator[State]:
        """Yield each state until the host ends, in a coroutine."""
        while True:
            try:
                state = await self.anext()
            except NoWorld:
                if self._ended:
                    return
                raise
            yield state

    async def _readable(self) -> None:
        loop = asyncio.get_running_loop()
        ready: asyncio.Future[None] = loop.create_future()
        loop.add_reader(self._connection, _settle, ready)
        try:
            await asyncio.wait_for(ready, self._patience_s)
        except TimeoutError:
            raise NoWorld(self._silence) from None
        finally:
            loop.remove_reader(self._connection)

    # saying

    def render(self, *parts: Part | Model, axis: int = 0, **values: Any) -> int:
        """Say what the hand meets from the next cycle on; return the number of the model.

        Parameters
        ----------
        parts : a `Model`, or its parts: at most one each of Wall, Spring, LinearField, TorqueProfile; for an
            arm of PlaneWall, PlaneSpring, PlaneField, PlaneProfile. Other parts of the last model end; its law's
            share and parameters stay.
        axis : axis of the rig, from 0
        values : `law`, `life_s`, `parameters` of the `Model`

        Raises
        ------
        coulombus.rigs.arguments.WrongCall
            a part or value is wrong
        NoWorld, ModelRefused
            as `state`
        """
        if len(parts) == 1 and isinstance(parts[0], Model):
            model = parts[0]
        else:
            model = self._models.get(axis, Model(life_s=min(LIFE_S, self.welcome.longest_life_ns * 1e-9)))
            model = model.with_parts(*parts)  # type: ignore[arg-type]
        return self._say(axis, replace(model, **values))

    def set(self, *, axis: int = 0, **parameters: float) -> int:
        """Set parameters of the rig's law, beside those set before; the parts of the model stay.

        Raises
        ------
        coulombus.rigs.arguments.WrongCall
            the law has no such parameter
        NoWorld, ModelRefused
            as `state`
        """
        model = self._models.get(axis, Model())
        return self._say(axis, replace(model, parameters={**model.parameters, **parameters}))

    def _say(self, axis: int, model: Model) -> int:
        slots = {named.name: named.slot for named in self.parameters if named.axis == axis and named.slot >= 0}
        if not 0 <= axis < self.welcome.axes:
            raise WrongCall(f"axis is {axis}: expected from 0 to {self.welcome.axes - 1}")
        record = model.record(slots)
        if model.profile is not None and model.profile is not self._profile:
            self._profile, self._profiles = model.profile, self._profiles + 1
        self._models[axis] = model
        record["profile"], record["axis"] = self._profiles, axis
        self._send(axis, record)
        self._update()
        return self._sequence

    def _renew(self) -> None:
        """Send the models again whose time to live has begun to run out."""
        now_ns = time.monotonic_ns()
        for axis, model in self._models.items():
            if (now_ns - self._sent_ns[axis]) * RENEW * 1e-9 > model.life_s and not self._ended:
                slots = {named.name: named.slot for named in self.parameters if named.axis == axis and named.slot >= 0}
                record = model.record(slots, profile=self._profiles)
                record["axis"] = axis
                self._send(axis, record)

    def _send(self, axis: int, record: Any) -> None:
        self._sequence += 1
        self._numbers[axis] = self._sequence
        now_ns = self._sent_ns[axis] = time.monotonic_ns()
        record["sequence"], record["t_ns"] = self._sequence, now_ns
        data = record.tobytes()
        assert len(data) == SIZES[Kind.MODEL] == MODEL.itemsize
        try:
            sent = self._connection.send(data, socket.MSG_NOSIGNAL)
        except BlockingIOError:
            return  # the host has many models of this program to read: this one is left out
        except OSError:
            self._ended = True
            return
        if sent < len(data):  # the rest must follow, or the host cannot read the next record
            self._connection.settimeout(self._timeout_s)
            try:
                self._connection.sendall(data[sent:], socket.MSG_NOSIGNAL)
            except OSError:
                self._ended = True
            finally:
                self._connection.setblocking(False)

    # the end

    def close(self) -> None:
        """Leave the host; the model fades when its time to live is over."""
        self._connection.close()

    def __enter__(self) -> Hand:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def connect(bus: str = "bench", *, key: str = "", timeout_s: float = WAIT_S) -> Hand:
    """Connect to the host that displays on a bus (``coulombus run --world``).

    docs/worlds.md has an example. Leave the host by ``with`` or `Hand.close`.

    Parameters
    ----------
    bus : an address; a plain name is a virtual bus
    key : the arm key, which the host of a real rig has printed; a program that only reads needs none
    timeout_s : longest time to wait for the host's answer, and for a state

    Raises
    ------
    NoWorld
        no host lets a world in on this bus
    coulombus.wire.address.AddressError
        `bus` is not an address
    """
    if not isinstance(bus, str):
        raise WrongCall(f'bus is {bus!r}: expected a bus\' name or address, as in connect("coulombus:bench")')
    address = parse_address(bus if ":" in bus else f"coulombus:{bus}")
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        try:
            connect_by(connection, world_path(address), time.monotonic() + timeout_s)
        except TimeoutError:
            raise TimeoutError("it lets nobody in: it hangs, or too many programs wait") from None
        connection.settimeout(timeout_s)
        connection.sendall(Greeting(key=key).record(), socket.MSG_NOSIGNAL)
        return Hand(connection, timeout_s)
    except (FileNotFoundError, ConnectionRefusedError):
        connection.close()
        raise NoWorld(f"no host lets a world in on bus {address}: start `coulombus run --world`") from None
    except OSError as error:
        connection.close()
        raise NoWorld(f"the host on bus {address}: {error.strerror or error}") from None
    except BaseException:
        connection.close()
        raise
