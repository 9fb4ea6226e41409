"""Participants of a virtual-time network written in Python."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Protocol

from coulombus.wire.frame import Queue, data_word, push

__all__ = ["Heard", "Station", "StationBus"]


@dataclass(frozen=True)
class Heard:
    """A frame from the bus; `can_id` with Linux's flags (`wire.frame`), `t_ns` its end of frame."""

    t_ns: int
    can_id: int
    length: int
    data: bytes
    source: int
    """Number of the sending station: a device's row, a station's `number`, -1 the host."""


class StationBus(Protocol):
    """A station's interface to its network (`sim_bus.network.network.VirtualNetwork`)."""

    @property
    def t_ns(self) -> int:
        """Present time in ns."""

    @property
    def out(self) -> Queue:
        """Frames requested to be sent."""

    def run_until(self, t_ns: int, condition: Callable[[], bool] | None = None) -> None:
        """Let time pass until `t_ns`, or until `condition` holds."""

    def station(
        self, can_ids: Collection[int] | None = None, on_frame: Callable[[Heard], None] | None = None
    ) -> Station:
        """Return a new station."""


class Station:
    """A participant written in Python; created by `VirtualNetwork.station`."""

    def __init__(
        self,
        network: StationBus,
        number: int,
        can_ids: frozenset[int] | None,
        on_frame: Callable[[Heard], None] | None,
    ) -> None:
        self.number, self.can_ids = number, can_ids
        self.heard: list[Heard] = []
        """Frames heard and not yet read; stays empty if `on_frame` is given."""
        self._network, self._on_frame = network, on_frame

    def send(self, can_id: int, data: bytes = b"", *, at_ns: int | None = None, length: int | None = None) -> None:
        """Request to send a frame, now or from `at_ns` on; `length` gives the DLC of a remote frame.

        Raises
        ------
        ValueError
            more than eight bytes
        """
        if len(data) > 8:
            raise ValueError(f"{len(data)} bytes of data; a frame of CAN 2.0 carries at most 8")
        size = len(data) if length is None else length
        ready = self._network.t_ns if at_ns is None else at_ns
        push(self._network.out, self.number, ready, can_id, size, data_word(bytes(data)))

    def take(self, can_id: int | None = None) -> list[Heard]:
        """Remove the frames heard (with this identifier) from `heard`, and return them."""
        frames = [frame for frame in self.heard if can_id in (None, frame.can_id)]
        self.heard = [frame for frame in self.heard if can_id not in (None, frame.can_id)]
        return frames

    def wait_for(self, can_id: int, timeout_ns: int) -> Heard | None:
        """Let time pass until a frame `can_id` comes, and return it, or None after `timeout_ns`.

        The frame stays in `heard`.
        """
        seen, network = len(self.heard), self._network
        network.run_until(network.t_ns + timeout_ns, lambda: any(f.can_id == can_id for f in self.heard[seen:]))
        return next((frame for frame in self.heard[seen:] if frame.can_id == can_id), None)

    def hear(self, frame: Heard) -> None:
        """Process a frame of another station."""
        if self._on_frame is not None:
            self._on_frame(frame)
        else:
            self.heard.append(frame)
