"""Serves programs outside at a run: states of each cycle to all of them, models from one of them.

A thread of the host's process does this. The data plane sends the states into a queue and takes the
models from memory; it never waits for this thread, and this thread never waits for a program:

- A program that reads slowly has a backlog of its own. Beyond it states are left out, and `lost` in the
  later ones tells how many.
- A program that sends fast is read a few records at a time.
- A program that sends anything but records is disconnected.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from coulombus.host.errors import HostError
from coulombus.host.world.model_check import ModelRefused
from coulombus.host.world.protocol import (
    MAGIC,
    SIZES,
    VERSION,
    WITH_STATES,
    Kind,
    Named,
    Refusal,
    Welcome,
    head_of,
    read_greeting,
    records_in,
)
from coulombus.host.world.records import MODEL, STATE, offset_of
from coulombus.system.exit import say

__all__ = ["Display", "WorldServer", "WorldSocketError"]

CLIENTS, BACKLOG = 16, 64
SILENT_NS = 1_000_000_000
"""Longest time from the connection to HELLO."""
MOST_BACKLOG = 2000 * SIZES[Kind.STATE]
"""Bytes that wait for a slow program: two seconds of an axis at 1 kHz."""
AT_ONCE = 8
"""Records that are read from a program at a time."""
LOOK_S = 0.1
_LOST = struct.Struct("<q")
_LOST_AT, _SEQUENCE_AT, _AXIS_AT = (offset_of(STATE, name) for name in ("lost", "sequence", "axis"))
STATE_HEAD = _LOST.pack(head_of(Kind.STATE))
AHEAD_NS = 1_000_000_000
"""A model from so far in the future has the stamp of another clock."""


class WorldSocketError(HostError):
    """The socket for a world cannot be created; the text gives the reason."""

    exit_status = 4


class Display(Protocol):
    """What the server needs of the run."""

    def welcome(self) -> Welcome:
        """Return the answer to HELLO."""

    def parameters(self) -> Sequence[Named]:
        """Return the parameters that a model may set, and the limits."""

    def why_not(self, key: str | None, now_ns: int) -> str | None:
        """Return the reason why a program with this key may send no model now; None if it may.

        Key None: of the program that has control, whose key was right.
        """

    def render(self, model: Any) -> None:
        """Let the cycle render a `ModelRecord`, or raise `ModelRefused`."""


class _Program:
    """A connected program."""

    def __init__(self, connection: socket.socket, now_ns: int) -> None:
        connection.setblocking(False)
        self.connection, self.since_ns = connection, now_ns
        self.greeted, self.key, self.states = False, "", False
        self.read, self.unsent = bytearray(), bytearray()
        self.sequence, self.lost = 0, 0
        self.is_gone = False

    def send(self, record: bytes) -> None:
        """Send a record, or append it to the backlog; if that is full, disconnect."""
        if not self._put(record):
            self.is_gone = True

    def send_state(self, record: bytes) -> None:
        """Send a state with the number of lost ones; without room it is lost, too."""
        if self.lost:
            record = record[:_LOST_AT] + _LOST.pack(self.lost) + record[_LOST_AT + 8 :]
        if not self._put(record):
            self.lost += 1

    def _put(self, record: bytes) -> bool:
        if self.unsent:
            if len(self.unsent) + len(record) > MOST_BACKLOG:
                return False
            self.unsent += record
            return True
        sent = self._write(record)
        self.unsent += record[sent:]
        return True

    def _write(self, data: bytes | bytearray) -> int:
        try:
            return self.connection.send(data, socket.MSG_NOSIGNAL | socket.MSG_DONTWAIT)
        except BlockingIOError:
            return 0
        except OSError:
            self.is_gone = True
            return len(data)

    def flush(self) -> None:
        """Send of the backlog what there is room for."""
        if self.unsent:
            del self.unsent[: self._write(self.unsent)]

    def receive(self) -> list[tuple[Kind, bytes]]:
        """Return the next records, at most `AT_ONCE`."""
        room = AT_ONCE * SIZES[Kind.MODEL] - len(self.read)
        try:
            data = self.connection.recv(room)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        self.is_gone = self.is_gone or not data
        self.read += data
        records = records_in(self.read, AT_ONCE)
        if records is None:
            self.refuse("not a record of this protocol; docs/worlds.md has each byte")
        return records or []

    def refuse(self, reason: str) -> None:
        """Report the reason, and disconnect."""
        self.send(Refusal(0, 0, reason).record())
        self.is_gone = True


class WorldServer:
    """Listens at `path` until `close`.

    Parameters
    ----------
    states : socket from which the data plane's states are read, a `StateRecord` each
    display : the run

    Raises
    ------
    WorldSocketError
        the socket cannot be created
    """

    def __init__(self, path: Path, states: socket.socket, display: Display) -> None:
        self._path, self._states, self._display = path, states, display
        self._programs: list[_Program] = []
        self._controller: _Program | None = None
        self._claims = 0
        self._last: dict[int, int] = {}
        self._states_over = False
        self.accepted = self.refused = 0
        self._stop, self._wake = socket.socketpair()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
        try:
            with suppress(FileNotFoundError):  # of a killed host: this process has claimed the bus
                path.unlink()
            self._listener.bind(str(path))
            self._listener.listen(BACKLOG)
        except OSError as error:
            self._listener.close()
            raise WorldSocketError(f"{path}: the socket for a world cannot be made: {error.strerror}") from None
        self._thread = threading.Thread(target=self._run, name="world", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Disconnect all programs, and remove the socket; may be called again."""
        if self._listener.fileno() < 0:
            return
        self._wake.close()
        self._thread.join()
        with suppress(OSError):
            os.unlink(self._path)
        for connection in (self._listener, self._stop, *(program.connection for program in self._programs)):
            connection.close()

    @property
    def controlled(self) -> bool:
        """Whether a program has control: it has sent models, and is connected."""
        return self._controller is not None

    @property
    def readers(self) -> int:
        """Number of programs that read states."""
        return sum(program.states for program in self._programs)

    # the thread

    def _run(self) -> None:
        try:
            while self._serve_once():
                pass
        except Exception as error:
            say(f"coulombus: the socket for a world is closed: {type(error).__name__}: {error}")
            for program in self._programs:
                with suppress(OSError):
                    program.connection.shutdown(socket.SHUT_RDWR)
            self._controller = None

    def _serve_once(self) -> bool:
        """Wait for something to do, and do it; return False when the server is closed."""
        poll = select.poll()
        for reader in (self._stop, self._listener, *([] if self._states_over else [self._states])):
            poll.register(reader, select.POLLIN)
        by_fd = {}
        for program in self._programs:
            events = select.POLLIN | (select.POLLOUT if program.unsent else 0)
            poll.register(program.connection, events)
            by_fd[program.connection.fileno()] = program
        ready = dict(poll.poll(LOOK_S * 1000))
        if self._stop.fileno() in ready:
            if not self._states_over:
                self._pass_on_states()  # the last ones
            return False
        if self._states.fileno() in ready:
            self._pass_on_states()
        for fd, events in ready.items():
            if fd not in by_fd:
                continue
            program = by_fd[fd]
            if events & select.POLLOUT:
                program.flush()
            if events & (select.POLLIN | select.POLLHUP | select.POLLERR):
                for kind, record in program.receive():
                    self._accept_record(program, kind, record)
        if self._listener.fileno() in ready:
            self._let_in()
        now_ns = time.monotonic_ns()
        for program in self._programs:
            silent = not program.greeted and now_ns - program.since_ns > SILENT_NS
            if program.is_gone or silent:
                self._let_go(program)
        return True

    def _let_in(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except (BlockingIOError, ConnectionAbortedError):
            return
        program = _Program(connection, time.monotonic_ns())
        if len(self._programs) >= CLIENTS:
            program.refuse(f"{CLIENTS} programs are connected, and no more are let in")
            connection.close()
            return
        self._programs = [*self._programs, program]

    def _let_go(self, program: _Program) -> None:
        program.connection.close()
        self._programs = [other for other in self._programs if other is not program]
        if self._controller is program:
            self._controller = None

    def _pass_on_states(self) -> None:
        for _ in range(AT_ONCE):
            try:
                record = self._states.recv(SIZES[Kind.STATE], socket.MSG_DONTWAIT)
            except BlockingIOError:
                return
            if len(record) != SIZES[Kind.STATE]:  # the data plane has ended
                self._states_over = True
                return
            record = STATE_HEAD + record[8:]
            missing = self._missing(record)
            for program in self._programs:
                if program.states:
                    program.lost += missing
                    program.send_state(record)

    def _missing(self, record: bytes) -> int:
        """Return the number of states of this axis between the last one and this one: the queue was full."""
        axis, sequence = int(_LOST.unpack_from(record, _AXIS_AT)[0]), int(_LOST.unpack_from(record, _SEQUENCE_AT)[0])
        last = self._last.get(axis, sequence - 1)
        self._last[axis] = sequence
        return max(sequence - last - 1, 0)

    def _accept_record(self, program: _Program, kind: Kind, record: bytes) -> None:
        if not program.greeted:
            self._greet(program, kind, record)
        elif kind == Kind.MODEL:
            self._take_model(program, record)
        else:
            twice = kind == Kind.HELLO
            program.refuse("HELLO came twice" if twice else f"{kind.name} is no record of a program")

    def _greet(self, program: _Program, kind: Kind, record: bytes) -> None:
        greeting = read_greeting(record) if kind == Kind.HELLO else None
        if greeting is None or greeting.magic != MAGIC:
            program.refuse("the first record is not HELLO")
            return
        if greeting.version != VERSION:
            program.refuse(f"version {greeting.version} of the protocol: expected {VERSION}")
            return
        program.greeted, program.key = True, greeting.key
        program.send(self._display.welcome().record())
        for named in self._display.parameters():
            program.send(named.record())
        program.states = bool(greeting.flags & WITH_STATES)

    def _take_model(self, program: _Program, record: bytes) -> None:
        model = np.frombuffer(record, MODEL)[0].copy()
        now_ns = time.monotonic_ns()
        try:
            self._claim(program, now_ns)
            _age(model, now_ns)
            sequence = int(model["sequence"])
            if sequence <= program.sequence:
                raise ModelRefused(f"sequence is {sequence}: expected more than {program.sequence}")
            model["profile"] = self._claims << 32 | int(model["profile"]) & 0xFFFFFFFF
            self._display.render(model)
            program.sequence = sequence
            self.accepted += 1
        except ModelRefused as refused:
            self.refused += 1
            program.send(Refusal(int(model["sequence"]), int(refused.again), str(refused)).record())

    def _claim(self, program: _Program, now_ns: int) -> None:
        """Give `program` control if no other program has it."""
        if self._controller not in (None, program):
            raise ModelRefused("another program has control")
        reason = self._display.why_not(None if self._controller is program else program.key, now_ns)
        if reason is not None:
            raise ModelRefused(reason)
        if self._controller is None:
            self._controller = program
            self._claims += 1


def _age(model: Any, now_ns: int) -> None:
    """Shorten the time to live by the age of the message."""
    stamp_ns = int(model["t_ns"])
    if stamp_ns == 0:
        return
    age_ns = now_ns - stamp_ns
    if age_ns < -AHEAD_NS or stamp_ns < 0:
        raise ModelRefused(f"t_ns is {stamp_ns}: expected CLOCK_MONOTONIC of this machine, or 0")
    left_ns = int(model["life_ns"]) - max(age_ns, 0)
    if int(model["life_ns"]) > 0 and left_ns <= 0:
        raise ModelRefused(
            f"late: it was sent {age_ns * 1e-6:.1f} ms ago, and lives {int(model['life_ns']) * 1e-6:g} ms", again=True
        )
    model["life_ns"] = left_ns
