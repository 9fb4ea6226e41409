"""SDO servers of a device: their identifiers, and their responses to the bus.

1200h always exists, 1201h to 127Fh exist if the EDS has them and their identifiers are valid (bit
31 clear). Each server has its own state, so several clients are served at once. The core
(`node.deadlines`) aborts a transfer without progress; its deadline and the abort frame are in the
node's record.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coulombus.eds.cia301 import Abort
from coulombus.kernels.decorator import Entry
from coulombus.node import core
from coulombus.node.communication_objects import Communication
from coulombus.node.constants import FAR_FUTURE_NS, SDO_TIMEOUT_NS
from coulombus.node.record import NodeRecord
from coulombus.node.sdo_access import Access
from coulombus.node.sdo_kernels import forget_segments, queue_segments
from coulombus.node.sdo_server import SdoServer, abort_frame
from coulombus.wire.frame import Queue, data_bytes, data_word, push

__all__ = ["SdoService"]

_MEASURED = 0x2000
"""First index of objects that the device measures; they are updated before they are read."""


@dataclass
class _Channel:
    number: int
    rx: int
    tx: int
    server: SdoServer


class SdoService:
    """SDO servers of a device, by its record; `access` is their backend."""

    def __init__(self, access: Access, communication: Communication, node: NodeRecord) -> None:
        self._access, self._communication = access, communication
        self._node = node
        self._deadlines = self._node["sdo_deadline_ns"]
        self._channels: dict[int, _Channel] = {}
        self._push = Entry(push)
        self._refresh = Entry(core.refresh_inputs)

    # identifiers

    def refresh(self) -> None:
        """Update the channels from 1200h to 127Fh; a changed channel discards its transfer."""
        channels = {}
        for number, rx, tx in self._communication.sdo_servers():
            before = self._channels.get(rx)
            if before is not None and (before.number, before.tx) == (number, tx):
                channels[rx] = before
            else:
                self.drop(number)
                channels[rx] = _Channel(number, rx, tx, SdoServer(self._access))
        for rx, before in self._channels.items():
            if channels.get(rx) is not before:
                self._close_segments(before.number)
        self._channels = channels
        first = next(((rx, channel.tx) for rx, channel in channels.items() if channel.number == 0), (-1, -1))
        self._node["sdo_rx_id"], self._node["sdo_tx_id"] = first
        self._node["sdo_used"] = max((channel.number + 1 for channel in channels.values()), default=0)

    def serves(self, can_id: int) -> bool:
        """Tell whether a server uses an identifier for its requests."""
        return can_id in self._channels

    def drop(self, number: int | None = None) -> None:
        """Discard the open transfer of one server or of all (reset, STOPPED)."""
        for channel in self._channels.values():
            if number in (None, channel.number):
                channel.server.drop()
        which = slice(None) if number is None else number
        self._deadlines[which] = FAR_FUTURE_NS
        self._close_segments(which)
        if self._node["outbox_count"]:
            forget_segments(self._node, -1 if number is None else number)

    # requests

    def serve(self, t_ns: int, can_id: int, length: int, data: int, out: Queue) -> None:
        """Serve a request on `can_id`."""
        row = self._node
        if length != 8:
            row["dropped_length"] += 1
            return
        channel = self._channels[can_id]
        server, k = channel.server, channel.number
        if row["segments_id"][k]:
            self._take_segments(channel)
        was_open = server.transfer is not None
        deadline_ns = int(self._deadlines[k])
        if was_open and (t_ns > deadline_ns or deadline_ns == FAR_FUTURE_NS):
            server.drop()  # the transfer had no progress: the core has aborted it, or would have now
        if (data >> 8 & 0xFFFF) >= _MEASURED and data & 0x60 in (0x40, 0x20):
            self._refresh(self._node, t_ns)
        access = self._access
        access.written, access.carries = False, 0
        server.unsent = self._unsent(k)
        response = server.request(data_bytes(data, 8))
        if was_open and row["outbox_count"] and not server.again:
            forget_segments(self._node, k)  # any request cancels the queued segments
        if response is not None:
            self._push(out, self._node["station"], t_ns + int(row["processing_ns"]), channel.tx, 8, data_word(response))
        if server.burst:
            words = np.array([data_word(segment) for segment in server.burst], np.int64)
            if not queue_segments(self._node, t_ns, k, channel.tx, words):
                self._refuse(channel, t_ns, out)
        if server.transfer is not None:
            self._keep_deadline(channel, t_ns)
            self._open_segments(channel)
        elif was_open:
            self._deadlines[k] = FAR_FUTURE_NS
        if access.written:
            core.written(self._node, t_ns, access.carries, out)

    def _unsent(self, k: int) -> int:
        """Return the number of queued segments of one server in the outbox."""
        row, count = self._node, int(self._node["outbox_count"])
        if not count:
            return 0
        places = (int(row["outbox_first"]) + np.arange(count)) % len(row["outbox_channel"])
        return int(np.count_nonzero(row["outbox_channel"][places] == k))

    def _take_segments(self, channel: _Channel) -> None:
        """Pass the segments that the core collected to the server, and close the channel's row."""
        row, k = self._node, channel.number
        count = int(row["segments_count"][k])
        if count:
            channel.server.add_segments(
                row["segments_word"][k, :count].astype("<i8").view(np.uint8).reshape(-1, 8)[:, 1:].tobytes()
            )
        self._close_segments(k)

    def _close_segments(self, which: int | slice) -> None:
        """Stop collecting segments in the core, for one server or for all."""
        self._node["segments_id"][which] = 0
        self._node["segments_open"] = np.count_nonzero(self._node["segments_id"])

    def _open_segments(self, channel: _Channel) -> None:
        """Let the core collect the segments that the server expects, if any."""
        following, last = channel.server.expected
        if following >= last:
            return
        row, k = self._node, channel.number
        row["segments_next"][k], row["segments_last"][k] = following, last
        row["segments_count"][k] = 0
        row["segments_id"][k] = channel.rx
        row["segments_open"] += 1

    def _refuse(self, channel: _Channel, t_ns: int, out: Queue) -> None:
        """Abort the transfer, because there is no room for another block: too many clients read at once."""
        place = channel.server.transfer or (0, 0)
        channel.server.drop()
        word = data_word(abort_frame(*place, Abort.MEMORY))
        self._push(out, self._node["station"], t_ns + int(self._node["processing_ns"]), channel.tx, 8, word)

    def _keep_deadline(self, channel: _Channel, t_ns: int) -> None:
        """Let the core check the deadline of the open transfer from now on."""
        row, k = self._node, channel.number
        place = channel.server.transfer
        assert place is not None
        self._deadlines[k] = t_ns + SDO_TIMEOUT_NS
        row["sdo_abort_id"][k] = channel.tx
        row["sdo_abort_word"][k] = data_word(abort_frame(*place, Abort.TIMEOUT))
        if t_ns + SDO_TIMEOUT_NS < row["next_ns"]:
            row["next_ns"] = t_ns + SDO_TIMEOUT_NS
