"""Callbacks for the signals of a bus by name: `live`."""

from __future__ import annotations

import logging
import math
import os
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from coulombus.recording.pdo_columns import signal_of
from coulombus.rigs.arguments import WrongCall
from coulombus.rigs.buses import one_bus
from coulombus.rigs.rig import Rig, load_rig
from coulombus.rigs.signals import RigPdo
from coulombus.wire.adapter import open_bus
from coulombus.wire.address import WITH_ADAPTERS
from coulombus.wire.client import BusDown, BusFull, OpenBus
from coulombus.wire.handshake import Flags, Hello

__all__ = ["Callback", "LiveBus", "live"]

WAIT_S = 0.1
ASK_S = 1.0

logger = logging.getLogger(__name__)


@dataclass(eq=False)
class Callback:
    """A registered function; `calls` and `errors` count its calls and exceptions.

    `error` is its first exception. `end` unregisters it; a running call is not interrupted.
    """

    names: tuple[str, ...]
    function: Callable[..., object]
    calls: int = 0
    errors: int = 0
    error: Exception | None = None
    _newest: dict[str, float] = field(default_factory=dict, repr=False)
    _ended: bool = field(default=False, repr=False)

    def end(self) -> None:
        """Stop calling the function."""
        self._ended = True

    def _deliver(self, t_s: float, pdo: RigPdo, places: tuple[int, ...], word: int) -> None:
        for place in places:
            value = pdo.value(place, word)
            self._newest[pdo.signals[place].name] = value if math.isfinite(value) else math.nan
        if self._ended or len(self._newest) < len(set(self.names)):
            return
        self.calls += 1
        try:
            self.function(t_s, *(self._newest[name] for name in self.names))
        except Exception as error:
            self.errors += 1
            if self.error is None:
                self.error = error
                logger.exception("the call-back of %s raised; reported once, then counted", ", ".join(self.names))


class LiveBus:
    """Listens to a bus in a separate thread until `close` or the end of ``with``.

    `malformed` counts, by "motor.TPDO1", frames of a PDO with a length other than the rig's; they
    call nothing. The first of each PDO, and the first lost frames, are logged as a warning.
    """

    def __init__(self, client: OpenBus, rig: Rig) -> None:
        self.rig = rig
        self._client = client
        self._pdos = {pdo.layout.cob_id: pdo for pdo in rig.pdos()}
        self.malformed: dict[str, int] = {}
        self._has_warned = False
        self._callbacks: tuple[Callback, ...] = ()
        self._wanting: dict[int, list[tuple[Callback, tuple[int, ...]]]] = {}
        """By identifier: who wants signals of this PDO, and their places in it."""
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._failure: OSError | None = None
        self._thread = threading.Thread(target=self._run, name="bus call-backs", daemon=True)
        self._thread.start()

    def __enter__(self) -> LiveBus:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def on(self, signals: str | Iterable[str], function: Callable[..., object]) -> Callback:
        """Call ``function(t_s, value, ...)`` with each frame that carries one of the signals.

        `t_s` is the frame's stamp [s since 1970]; the values are in SI, in the order of the names,
        the newest of each. With several signals, the first call comes after each was received once.
        All functions are called in one thread, one after another, in the order of the frames and
        of `on`: a slow function delays the others. An exception is logged once and counted in the
        `Callback`; all functions continue to be called.

        Raises
        ------
        coulombus.recording.signals.UnknownSignal
            The rig has no such signal; the text has the nearest names.
        ValueError
            No signal is named.
        """
        names = (signals,) if isinstance(signals, str) else tuple(signals)
        if not names:
            raise ValueError('no signal is named: on("motor.position_rad", f) or on(["...", "..."], f)')
        for name in names:
            signal_of(self.rig.pdos(), name, f"rig {self.rig.name}")
        callback = Callback(names, function)
        with self._lock:
            self._callbacks = (*(other for other in self._callbacks if not other._ended), callback)
            self._wanting = {can_id: self._wanting_of(pdo) for can_id, pdo in self._pdos.items()}
        return callback

    def _wanting_of(self, pdo: RigPdo) -> list[tuple[Callback, tuple[int, ...]]]:
        wanting = []
        for callback in self._callbacks:
            places = tuple(place for place, signal in enumerate(pdo.signals) if signal.name in callback.names)
            if places:
                wanting.append((callback, places))
        return wanting

    @property
    def lost(self) -> int:
        """Frames lost in this listener's queue because the callbacks are slower than the bus. The
        virtual bus is queried once a second.
        """
        return self._client.lost

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until the bus is closed, with a time limit [s]; return whether it is.

        Raises
        ------
        coulombus.wire.address.BusUnavailable
            The bus closed.
        """
        self._thread.join(seconds)
        if self._failure is not None:
            raise self._failure
        return not self._thread.is_alive()

    def close(self) -> None:
        """Stop calling functions, and leave the bus; a callback may call this, too."""
        self._stop.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        with self._client as client:
            last_question_s = time.monotonic()
            while not self._stop.is_set():
                try:
                    client.wait(WAIT_S)
                    while not self._stop.is_set() and (frames := client.receive()):
                        for t_ns, can_id, length, data in frames:
                            self._process(t_ns, can_id, length, data)
                        if time.monotonic() - last_question_s > ASK_S:
                            break
                    if time.monotonic() - last_question_s > ASK_S:
                        last_question_s = time.monotonic()
                        client.ask()
                    self._warn_of_losses()
                except (BusDown, BusFull):
                    self._stop.wait(WAIT_S)
                except OSError as error:
                    self._failure = error
                    return

    def _warn_of_losses(self) -> None:
        if self.lost and not self._has_warned:
            self._has_warned = True
            text = "%s: %d frames were lost: the call-backs are slower than the bus; reported once, then counted"
            logger.warning(text, self._client.address, self.lost)

    def _count_malformed(self, pdo: RigPdo, length: int) -> None:
        name = f"{pdo.node}.{pdo.name}"
        self.malformed[name] = self.malformed.get(name, 0) + 1
        if self.malformed[name] == 1:
            text = "%s came with %d bytes, the rig has %d: is this the rig of this bus? reported once, then counted"
            logger.warning(text, name, length, pdo.layout.length)

    def _process(self, t_ns: int, can_id: int, length: int, data: bytes) -> None:
        pdo = self._pdos.get(can_id)
        if pdo is None:
            return
        if pdo.layout.length != length:
            self._count_malformed(pdo, length)
            return
        word = int.from_bytes(data, "little")
        for callback, places in self._wanting.get(can_id, ()):
            if self._stop.is_set():
                return
            callback._deliver(t_ns / 1e9, pdo, places, word)


def live(bus: str = "bench", rig: str | os.PathLike[str] = "bench", channel: str | None = None) -> LiveBus:
    """Listen to a bus, and call functions with its signals::

        with live("bench") as bus:
            bus.on("brake.handle_torque_Nm", lambda t_s, torque_Nm: print(t_s, torque_Nm))
            bus.wait(10)

    It sends nothing. `bus` is an address, as ``socketcan:can0`` or
    ``can:slcan:/dev/ttyACM0?bitrate=500000``; a plain name is a virtual bus. `rig` is a rig or a
    path of a rig file, `channel` the bus of a rig with several.

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        There is no such bus.
    coulombus.wire.address.AddressError
        `bus` is not an address, or the rig has several buses and `channel` is none of them.
    coulombus.rigs.arguments.WrongCall
        `bus` is not a string, or `rig` is neither a rig's name nor a path.
    """
    if not isinstance(bus, str):
        raise WrongCall(f'bus is {bus!r}: expected a bus\' name or address, as in live("socketcan:can0")')
    rig_on_bus, address = one_bus(load_rig(rig), bus if ":" in bus else f"coulombus:{bus}", channel, WITH_ADAPTERS)
    return LiveBus(open_bus(address, Hello(Flags.LISTEN_ONLY)), rig_on_bus)
