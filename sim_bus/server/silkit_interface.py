"""SIL Kit's C interface by ctypes, as far as a CAN network and its simulator need it.

The names are SIL Kit's, without their prefix; the package `silkit-py` brings the shared library.
Every structure begins with a header that names its type (`Head`). The network simulator's part is
marked experimental by SIL Kit.
"""

from __future__ import annotations

import ctypes as ct
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

from coulombus.recording.extras import MissingExtra
from coulombus.system.errors import CoulombusError

__all__ = [
    "CAN_NETWORK",
    "COORDINATED",
    "HANDLER",
    "STEP_HANDLER",
    "ControllerFunctions",
    "ErrorStateEvent",
    "FrameEvent",
    "FrameRequest",
    "Head",
    "LifecycleConfiguration",
    "ModeRequest",
    "NetworkFunctions",
    "RateRequest",
    "Receivers",
    "SilKit",
    "SilKitError",
    "SilKitFrame",
    "StateEvent",
    "TransmitEvent",
]

CAN_NETWORK = 1
COORDINATED = 10
CAN, PARTICIPANT, NETWORK_SIMULATION = 1, 7, 8
LIBRARY = "SilKit.dll" if sys.platform == "win32" else "libSilKit.so"


class SilKitError(CoulombusError):
    """The library is none of SIL Kit's, a call of it failed, or the simulation does not go on."""

    exit_status = 4


class Head(ct.Structure):
    """Begin of every structure: its service, type and version; a new structure has its own."""

    KIND: ClassVar[tuple[int, int, int]]
    _fields_: ClassVar[Any] = [("head", ct.c_uint64), ("reserved", ct.c_uint64 * 3)]

    def __init__(self, *values: Any) -> None:
        service, kind, version = self.KIND
        super().__init__(0x534B << 48 | service << 40 | kind << 32 | version << 24, (0, 0, 0), *values)


class SilKitFrame(Head):
    """A CAN frame; classical frames leave `sdt`, `vcid` and `af` 0."""

    KIND = CAN, 1, 1
    _fields_: ClassVar[Any] = [
        ("can_id", ct.c_uint32), ("flags", ct.c_uint32), ("dlc", ct.c_uint16), ("sdt", ct.c_uint8), ("vcid", ct.c_uint8), ("af", ct.c_uint32),
        ("data", ct.c_void_p), ("size", ct.c_size_t),
    ]  # fmt: skip
    EXTENDED, REMOTE, OTHER_FORMATS = 1 << 9, 1 << 4, 1 << 12 | 1 << 15


class FrameEvent(Head):
    """A frame at its end; `context` is the sender's."""

    KIND = CAN, 3, 1
    _fields_: ClassVar[Any] = [
        ("t_ns", ct.c_uint64), ("frame", ct.POINTER(SilKitFrame)), ("direction", ct.c_uint8), ("context", ct.c_void_p),
    ]  # fmt: skip
    SENT, RECEIVED = 1, 2


class TransmitEvent(Head):
    """Fate of a requested frame."""

    KIND = CAN, 2, 2
    _fields_: ClassVar[Any] = [
        ("context", ct.c_void_p),
        ("t_ns", ct.c_uint64),
        ("status", ct.c_int32),
        ("can_id", ct.c_uint32),
    ]
    TRANSMITTED, CANCELED, QUEUE_FULL = 1, 2, 4


class StateEvent(Head):
    """State of a controller."""

    KIND = CAN, 4, 1
    _fields_: ClassVar[Any] = [("t_ns", ct.c_uint64), ("state", ct.c_int32)]
    STARTED = 2


class ErrorStateEvent(Head):
    """Error state of a controller."""

    KIND = CAN, 5, 1
    _fields_: ClassVar[Any] = [("t_ns", ct.c_uint64), ("state", ct.c_int32)]
    NONE, ACTIVE, PASSIVE, BUS_OFF = 0, 1, 2, 3


class FrameRequest(Head):
    """Request of a controller to send a frame."""

    KIND = NETWORK_SIMULATION, 9, 1
    _fields_: ClassVar[Any] = [("frame", ct.POINTER(SilKitFrame)), ("context", ct.c_void_p)]


class RateRequest(Head):
    """Bit rates that a controller sets."""

    KIND = NETWORK_SIMULATION, 7, 1
    _fields_: ClassVar[Any] = [("bit_s", ct.c_uint32), ("fd_bit_s", ct.c_uint32), ("xl_bit_s", ct.c_uint32)]


class ModeRequest(Head):
    """State that a controller requests."""

    KIND = NETWORK_SIMULATION, 8, 1
    _fields_: ClassVar[Any] = [("flags", ct.c_int32), ("state", ct.c_int32)]


class Receivers(Head):
    """Controllers that an event is for."""

    KIND = NETWORK_SIMULATION, 1, 1
    _fields_: ClassVar[Any] = [("count", ct.c_size_t), ("descriptors", ct.POINTER(ct.c_uint64))]


class ControllerFunctions(Head):
    """Functions of a simulated controller, called with its pointer."""

    KIND = NETWORK_SIMULATION, 3, 1
    RATE = ct.CFUNCTYPE(None, ct.c_void_p, ct.POINTER(RateRequest))
    FRAME = ct.CFUNCTYPE(None, ct.c_void_p, ct.POINTER(FrameRequest))
    MODE = ct.CFUNCTYPE(None, ct.c_void_p, ct.POINTER(ModeRequest))
    _fields_: ClassVar[Any] = [("on_rate", RATE), ("on_frame", FRAME), ("on_mode", MODE)]


class NetworkFunctions(Head):
    """Functions of a simulated network: a controller appears or leaves; the way to send events."""

    KIND = NETWORK_SIMULATION, 2, 1
    APPEARS = ct.CFUNCTYPE(None, ct.POINTER(ct.c_void_p), ct.POINTER(ct.c_void_p), ct.c_uint64, ct.c_void_p)
    LEAVES = ct.CFUNCTYPE(None, ct.c_uint64, ct.c_void_p)
    PRODUCER = ct.CFUNCTYPE(None, ct.c_void_p, ct.c_void_p)
    _fields_: ClassVar[Any] = [("appears", APPEARS), ("leaves", LEAVES), ("producer", PRODUCER)]


class LifecycleConfiguration(Head):
    """How a participant starts and stops: here `COORDINATED` by a system controller."""

    KIND = PARTICIPANT, 2, 1
    _fields_: ClassVar[Any] = [("mode", ct.c_int8)]


HANDLER = ct.CFUNCTYPE(None, ct.c_void_p, ct.c_void_p)
"""Type of a lifecycle's handlers, and of the handler for the end of all other participants' steps."""
STEP_HANDLER = ct.CFUNCTYPE(None, ct.c_void_p, ct.c_void_p, ct.c_uint64, ct.c_uint64)


class SilKit:
    """The shared library, that of the package `silkit-py` without `path`.

    Raises
    ------
    MissingExtra
        the package is not installed
    SilKitError
        the library cannot be loaded, or has no network simulator
    """

    def __init__(self, path: str | Path | None = None) -> None:
        if path is None:
            package = find_spec("SilKit_py")
            if package is None or not package.submodule_search_locations:
                raise MissingExtra(
                    "SIL Kit is not installed; do: pip install '.[silkit]' in the clone, with Python >= 3.12"
                )
            path = Path(package.submodule_search_locations[0]) / LIBRARY
        try:
            self._library = ct.CDLL(str(path))
            self._error = self._library.SilKit_GetLastErrorString
            self._simulator = self._library.SilKit_Experimental_NetworkSimulator_Create
        except (OSError, AttributeError) as error:
            raise SilKitError(f"{path}: {error}; expected SIL Kit 4.0.55 or later") from None
        self._error.restype = ct.c_char_p

    def call(self, name: str, *arguments: Any) -> None:
        """Call ``SilKit_`` `name`; structures are passed by reference.

        Raises
        ------
        SilKitError
            it returned an error
        """
        code = getattr(self._library, "SilKit_" + name)(*(ct.byref(a) if isinstance(a, Head) else a for a in arguments))
        if code:
            raise SilKitError(f"SilKit_{name} returned {code}: {(self._error() or b'').decode(errors='replace')}")

    def make(self, name: str, *arguments: Any) -> ct.c_void_p:
        """Call ``SilKit_`` `name`, which writes a pointer to its first argument, and return the pointer."""
        pointer = ct.c_void_p()
        self.call(name, ct.byref(pointer), *arguments)
        return pointer
