"""Lengths that do not match the PDO's map or the service (CiA 301, 7.2.2.5)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from coulombus.eds.cia301 import CobId
from coulombus.explain.bus import Bus
from coulombus.explain.frames import Block, Frames

__all__ = ["Lengths"]


class Lengths:
    """Compares the length of every PDO with its map, and with its earlier length."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._last: dict[int, int] = {}
        self._fits: dict[int, bool] = {}

    def add_frames(self, block: Block) -> None:
        """Process a block."""
        for key, group in block.groups.items():
            pdo_map = self.bus.maps.get(key)
            if pdo_map is None:
                self._service(key, group)
            if pdo_map is None or pdo_map.source == "assumed":
                continue
            expected = pdo_map.length or self._last.get(key, int(group.length[0]))
            self._last[key] = expected
            fits = group.length >= expected if pdo_map.direction == "rpdo" else group.length == expected
            changes = np.flatnonzero(np.diff(fits, prepend=self._fits.get(key, True)))
            self._fits[key] = bool(fits[-1])
            for i, behind in pairwise([*changes.tolist(), len(group)]):
                t_ns, row = int(group.t_ns[i]), int(group.rows[i])
                if fits[i]:
                    self.clues.end("pdo_length", pdo_map.node, t_ns, "the length fits again", subject=key)
                    continue
                text = f"{pdo_map.name} ({key:03X}h) has {group.length[i]} bytes, its map ({pdo_map.source}) {expected}"
                clue = self.clues.begin("pdo_length", pdo_map.node, t_ns, text, row=row, subject=key)
                clue.count += behind - i - 1
            if not fits[0] and (not len(changes) or changes[0] > 0):
                self.clues.more(
                    "pdo_length", pdo_map.node, int(changes[0]) if len(changes) else len(group), subject=key
                )

    def _service(self, key: int, group: Frames) -> None:
        """Note frames of a service of CiA 301 with a length that it does not have."""
        name, shortest, longest = _service_of(key)
        unfit = np.flatnonzero((group.length < shortest) | (group.length > longest))
        if not name or not len(unfit):
            return
        expected = f"{shortest}" if shortest == longest else f"{shortest} or {longest}"

        def text(i: int) -> str:
            return f"{name} ({key:03X}h) with {group.length[unfit[i]]} bytes, expected {expected}"

        is_request = CobId.SDO_RX <= key < CobId.HEARTBEAT  # a client sends it
        node = key & 0x7F if is_request else self.bus.sender(key)
        clue = self.clues.series("service_length", node, group.t_ns[unfit], group.rows[unfit], text, subject=key)
        if clue is not None and is_request:
            clue.who = "client"


def _service_of(key: int) -> tuple[str, int, int]:
    """Return the service of an identifier, its least and its greatest length; "" for no service."""
    if key in (CobId.NMT, CobId.SYNC, CobId.TIME):
        return {CobId.NMT: ("NMT", 2, 2), CobId.SYNC: ("SYNC", 0, 1), CobId.TIME: ("TIME", 6, 6)}[CobId(key)]
    if key in (CobId.LSS_TX, CobId.LSS_RX):
        return "LSS", 8, 8
    services = {CobId.EMCY: ("EMCY", 8, 8), CobId.SDO_TX: ("SDO", 8, 8), CobId.SDO_RX: ("SDO", 8, 8)}
    services[CobId.HEARTBEAT] = "heartbeat", 1, 1
    function = key & 0x780
    return services[CobId(function)] if key & 0x7F and key == key & 0x7FF and function in services else ("", 0, 8)
