"""A virtual bus in a thread: the protocol of wire.hello from its text, without pacing, nodes or any
of the project's code.

It takes clients, answers their greetings, and gives each message of frames to all others, filtered.
"""

import os
import selectors
import socket
import struct
import threading
from contextlib import contextmanager, suppress

MAGIC = 0x53424C43


class TinyBus:
    def __init__(self, path, *, version=1, status=None, bitrate=1_000_000, mute=False):
        self.version, self.status, self.bitrate, self.mute = version, status, bitrate, mute
        self.frames = []  # all that clients sent
        self.greetings = []
        self.lost = 0
        self._clients = {}
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.bind(str(path))
        self._listener.listen(8)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._wake, self._wait = os.pipe()[::-1]
        self._selector.register(self._wait, selectors.EVENT_READ)
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def deliver(self, *frames):
        """Give frames (can_id, data) to all clients as one message."""
        message = b"".join(struct.pack("=IB3x8s", can_id, len(data), data) for can_id, data in frames)
        self.deliver_bytes(message)

    def deliver_bytes(self, message, source=None):
        with self._lock:
            for client, (flags, filters) in list(self._clients.items()):
                if client is source and not flags & 1:
                    continue
                told = bytearray(message)
                if client is source:
                    told[5::16] = bytes((1,)) * (len(message) // 16)
                kept = (
                    message
                    if len(message) % 16
                    else b"".join(
                        told[i : i + 16]
                        for i in range(0, len(message), 16)
                        if _passes(struct.unpack_from("=I", message, i)[0], flags, filters)
                    )
                )
                if kept:
                    with suppress(OSError):  # it has just gone, or does not read
                        client.send(kept, socket.MSG_DONTWAIT)

    def close(self):
        if not self._thread.is_alive():
            return
        os.write(self._wake, b"x")
        self._thread.join(5)
        for key in list(self._selector.get_map().values()):  # those that have not greeted, too
            if isinstance(key.fileobj, socket.socket):
                key.fileobj.close()
        self._selector.close()
        os.close(self._wake)
        os.close(self._wait)

    def _serve(self):
        while True:
            for key, _ in self._selector.select():
                if key.fileobj == self._wait:
                    return
                if key.fileobj is self._listener:
                    client, _ = self._listener.accept()
                    self._selector.register(client, selectors.EVENT_READ)
                else:
                    self._receive(key.fileobj)

    def _receive(self, client):
        try:
            message = client.recv(1 << 16)
        except ConnectionResetError:  # it went without reading all; what it sent is still here, and then its end
            return
        except OSError:
            message = b""
        if not message:
            self._selector.unregister(client)
            with self._lock:
                self._clients.pop(client, None)
            client.close()
        elif len(message) % 16 == 8:
            self._greet(client, message)
        elif len(message) % 16 == 0:
            with self._lock:
                listens = self._clients[client][0] & 2
            if not listens:
                self.frames += struct.iter_unpack("=IB3x8s", message)
                self.deliver_bytes(message, client)

    def _greet(self, client, message):
        if self.mute:
            return
        magic, version, flags, count = struct.unpack_from("<IHHH", message)
        filters = list(struct.iter_unpack("<II", message[10 : 10 + 8 * count]))
        self.greetings.append((flags, filters))
        ok = magic == MAGIC and version == self.version
        status = self.status if self.status is not None else 0 if ok else 1
        with self._lock:
            if status == 0:
                self._clients[client] = (flags, filters)
            with suppress(OSError):  # it has gone: its end is the next that the selector tells
                client.send(struct.pack("<IHHIIQ", MAGIC, self.version, status, self.bitrate, 17, self.lost))


def _passes(can_id, flags, filters):
    if can_id & 0x20000000:
        return bool(flags & 4)
    return not filters or any((can_id & mask) == (wanted & mask) for wanted, mask in filters)


@contextmanager
def tiny_bus(name="bench", **options):
    """Serve `name` in the directory that XDG_RUNTIME_DIR names."""
    directory = os.path.join(os.environ["XDG_RUNTIME_DIR"], "coulombus")
    os.makedirs(directory, mode=0o700, exist_ok=True)
    path = os.path.join(directory, name)
    bus = TinyBus(path, **options)
    try:
        yield bus
    finally:
        bus.close()
        os.unlink(path)
