"""Adapters of python-can without hardware, each with the far end of its bus: virtual, socketcand, and slcan on a
pseudo-terminal with a firmware of ours.
"""

from __future__ import annotations

import os
import threading
import tty
from contextlib import contextmanager
from itertools import count

import can

from coulombus.sim_bus.server.socketcand_server import SocketcandServer
from coulombus.wire.address import parse_address

ADAPTERS = ("virtual", "socketcand", "slcan")
_numbers = count()


@contextmanager
def far_end(interface):
    """Yield the address of an adapter, as for --bus, and python-can's bus at its far end."""
    with {"virtual": _virtual, "socketcand": _socketcand, "slcan": _slcan}[interface]() as ends:
        yield ends


@contextmanager
def _virtual():
    name = f"far{next(_numbers)}"
    with can.Bus(interface="virtual", channel=name) as far:
        yield f"can:virtual:{name}", far


@contextmanager
def served(**options):
    """Yield a server whose clients hear each other; it is served in a thread."""
    with SocketcandServer(parse_address("socketcand:127.0.0.1:0", ("socketcand",)), **options) as server:
        over = threading.Event()

        def serve():
            while not over.is_set():
                if server.wait(0.02):
                    server.receive()
                server.ask()

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield server
        finally:
            over.set()
            thread.join()


@contextmanager
def _socketcand():
    with served() as server:
        port = server.address.name.rpartition(":")[2]
        with can.Bus(interface="socketcand", channel="x", host="127.0.0.1", port=int(port)) as far:
            yield f"can:socketcand:x?host=127.0.0.1&port={port}", far


@contextmanager
def _slcan():
    master, slave = os.openpty()
    tty.setraw(slave)
    name = f"far{next(_numbers)}"
    with can.Bus(interface="virtual", channel=name) as far, can.Bus(interface="virtual", channel=name) as wire:
        firmware = Firmware(master, slave, wire)
        try:
            yield f"can:slcan:{os.ttyname(slave)}?sleep_after_open=0&bitrate=500000", far
        finally:
            firmware.end()
            os.close(slave)
            os.close(master)


class Firmware:
    """An adapter with Lawicel's protocol: `t` and `T` with base and extended identifier, `r` and `R` remote frames."""

    def __init__(self, fd, slave, wire):
        self.fd, self.slave, self.wire, self.commands, self.over = fd, slave, wire, [], threading.Event()
        self.threads = [threading.Thread(target=loop) for loop in (self.from_pc, self.from_bus)]
        for thread in self.threads:
            thread.start()

    def from_pc(self):
        line = b""
        while not self.over.is_set() and (byte := os.read(self.fd, 1)) != b"\0":
            line += byte
            if byte == b"\r":
                self.obey(line[:-1].decode())
                line = b""

    def obey(self, text):
        self.commands.append(text)
        if text[:1].lower() not in ("t", "r"):
            return
        digits = 8 if text[0].isupper() else 3
        remote, length = text[0] in "rR", int(text[1 + digits])
        self.wire.send(
            can.Message(
                arbitration_id=int(text[1 : 1 + digits], 16),
                is_extended_id=digits == 8,
                is_remote_frame=remote,
                dlc=length,
                data=None if remote else bytes.fromhex(text[2 + digits :][: 2 * length]),
            )
        )

    def from_bus(self):
        while not self.over.is_set():
            if (message := self.wire.recv(0.02)) is not None:
                letter = "r" if message.is_remote_frame else "t"
                number = f"{message.arbitration_id:0{8 if message.is_extended_id else 3}X}"
                head = (letter.upper() if message.is_extended_id else letter) + number
                os.write(self.fd, f"{head}{message.dlc}{bytes(message.data).hex().upper()}\r".encode())

    def end(self):
        self.over.set()
        os.write(self.slave, b"\0")  # ends the reading of the PC's bytes
        for thread in self.threads:
            thread.join()
