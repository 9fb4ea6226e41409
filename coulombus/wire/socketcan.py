"""Linux's own CAN: a raw socket on an interface, or the reason why there is none."""

from __future__ import annotations

import socket
import struct
from pathlib import Path

from coulombus.wire.address import BusUnavailable

__all__ = ["can_socket", "interface_is_up", "is_virtual"]

SIOCGIFFLAGS, IFF_UP = 0x8913, 1


def can_socket(name: str) -> socket.socket:
    """Return a raw CAN socket bound to the interface `name` (blocking, with the kernel's default
    options).

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        (exit status 4) This kernel has no CAN, or the interface is missing or down; the text says
        what to do.
    """
    unavailable = f"no bus socketcan:{name}: "
    try:
        raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except (OSError, AttributeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise BusUnavailable(
            unavailable
            + f"this system has no SocketCAN ({reason}); try `sudo modprobe can-raw`, or use a coulombus: bus"
        ) from None
    try:
        raw.bind((name,))
        up = interface_is_up(raw, name)
    except OSError as error:
        raw.close()
        raise BusUnavailable(
            unavailable + f"{error.strerror}; see `ip link show type can`, or make a virtual one: "
            f"sudo modprobe vcan && sudo ip link add {name} type vcan && sudo ip link set {name} up"
        ) from None
    if not up:
        raw.close()
        raise BusUnavailable(
            unavailable
            + f"the interface is down; bring it up: sudo ip link set {name} up (the first time, a controller "
            f"needs its bit rate, too: sudo ip link set {name} up type can bitrate 1000000)"
        )
    return raw


def interface_is_up(target: socket.socket, name: str) -> bool:
    """Tell whether the interface `name` is up; `target` is any socket. OSError if there is no such
    interface.
    """
    import fcntl  # only Linux has fcntl and SocketCAN

    answer = fcntl.ioctl(target, SIOCGIFFLAGS, struct.pack("16sH14x", name.encode(), 0))
    return bool(struct.unpack_from("H", answer, 16)[0] & IFF_UP)


def is_virtual(name: str) -> bool:
    """Tell whether an interface of Linux has no hardware behind it (vcan, vxcan). An slcan has hardware:
    a serial adapter.
    """
    return "virtual" in Path("/sys/class/net", name).resolve().parts and not name.startswith("slcan")
