"""SDO servers of a device: their identifiers, their responses to the bus, and what clients may read and write.

1200h always exists, 1201h to 127Fh exist if the EDS has them and their identifiers are valid (bit
31 clear). Each server has its own state, so several clients are served at once. The core
(`node.deadlines`) aborts a transfer without progress; its deadline and the abort frame are in the
node's record.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from coulombus.eds.cia301 import ARRAY, RECORD, Abort
from coulombus.eds.convert import eds_text
from coulombus.eds.data import encode
from coulombus.kernels.decorator import Entry
from coulombus.node import core
from coulombus.node.communication_objects import Communication
from coulombus.node.dictionary import Dictionary, decode
from coulombus.node.profile import Profile, SdoAbort
from coulombus.node.record import SDO_TIMEOUT_NS, NodeRecord
from coulombus.node.sdo_kernels import forget_segments, queue_segments
from coulombus.node.sdo_server import SdoServer, abort_frame
from coulombus.node.store import RESTORE, STORE, StoredParameters
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import Queue, data_bytes, data_word, push

__all__ = ["Access", "SdoService"]

_COMMUNICATION = range(0x1000, 0x2000)
_HISTORY, _STORE_EDS = 0x1003, 0x1021
_STRUCTURE = 0xFF

_LIMIT_PAIRS: Mapping[int, tuple[int, int]] = {0x607B: (1, 2), 0x607D: (1, 2)}
"""Objects whose two sub-indices are a minimum and its maximum (CiA 402: position range limit, software
position limit).
"""

_RECORDS: tuple[tuple[range, int], ...] = (
    (range(0x1018, 0x1019), 0x0023),
    (range(0x1200, 0x1300), 0x0022),
    (range(0x1400, 0x1600), 0x0020),
    (range(0x1600, 0x1800), 0x0021),
    (range(0x1800, 0x1A00), 0x0020),
    (range(0x1A00, 0x1C00), 0x0021),
)
"""Data types of the records of CiA 301, by index."""


class Access:
    """Backend of a device's SDO servers; `written` and `carries` tell the core which objects were written
    (`Profile.acts`).
    """

    def __init__(
        self,
        dictionary: Dictionary,
        communication: Communication,
        parameters: StoredParameters,
        profile: Profile,
        changed: Callable[[int, int], None],
    ) -> None:
        self._dictionary = dictionary
        self._communication = communication
        self._parameters = parameters
        self._profile = profile
        self._changed = changed
        self.written = False
        self.carries = 0

    def upload(self, index: int, subindex: int) -> bytes:
        """Return the bytes of an object if it may be read."""
        if subindex == _STRUCTURE:
            return self._structure(index)
        variable = self._dictionary.check_read(index, subindex)
        if index == _HISTORY:
            self._communication.collect(index)
            if subindex > self._dictionary.number(_HISTORY):
                raise SdoAbort(Abort.NO_DATA)
        elif index == _STORE_EDS:
            return eds_text(self._dictionary.description).encode()
        return encode(variable, self._dictionary[index, subindex])

    def check_download(self, index: int, subindex: int, size: int | None) -> int:
        """Abort unless `size` bytes may be written; return the largest allowed number."""
        if subindex == _STRUCTURE:
            self._structure(index)
            raise SdoAbort(Abort.READ_ONLY)
        return self._dictionary.check_write(index, subindex, size)

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object; an abort changes nothing."""
        try:
            value = decode(self._dictionary.find(index, subindex), data)
        except SdoAbort as abort:  # the EDS's limit of a map's count is its number of entries
            place = self._communication.pdos.locate(index)
            if place and place[2] and subindex == 0 and abort.code == Abort.VALUE_HIGH:
                raise SdoAbort(Abort.PDO_LENGTH) from None
            raise
        if isinstance(value, int):
            if index in (STORE, RESTORE):
                self._parameters.command(index, subindex, value)
                return
            if index in _COMMUNICATION:
                self._communication.check(index, subindex, value)
            elif index in _LIMIT_PAIRS:
                self._check_pair(index, subindex, value)
            else:
                self._profile.check(self._dictionary, index, subindex, value)
        elif isinstance(value, float) and not math.isfinite(value):
            raise SdoAbort(Abort.VALUE)
        before = self._dictionary[index, subindex]
        self._dictionary[index, subindex] = value
        self.written = True
        self.carries |= self._profile.acts.get((index, subindex), 0)
        if value != before:
            self._parameters.changed(index, subindex)
        self._changed(index, subindex)

    def _structure(self, index: int) -> bytes:
        """Return sub-index FFh: object code in bits 0-7, data type in bits 8-23 (CiA 301, 7.4.6.2); for an array,
        the data type of its elements.
        """
        entry = self._dictionary.description.objects.get(index)
        if entry is None:
            raise SdoAbort(Abort.NO_OBJECT)
        variable = entry.variables.get(1 if entry.object_type == ARRAY else 0)
        code = variable.data_type if variable else 0
        if entry.object_type == RECORD:
            code = next((code for indices, code in _RECORDS if index in indices), 0)
        return (entry.object_type | (code & 0xFFFF) << 8).to_bytes(4, "little")

    def _check_pair(self, index: int, subindex: int, value: int) -> None:
        pair = _LIMIT_PAIRS[index]
        if all((index, k) in self._dictionary for k in pair):
            low, high = (value if k == subindex else self._dictionary.number(index, k) for k in pair)
            if low > high:
                raise SdoAbort(Abort.MAX_BELOW_MIN)


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
        self._deadlines[which] = NEVER_NS
        self._close_segments(which)
        if self._node["outbox_count"]:
            forget_segments(self._node, -1 if number is None else number)

    # requests

    def serve(self, t_ns: int, can_id: int, length: int, word: int, out: Queue) -> None:
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
        if was_open and (t_ns > deadline_ns or deadline_ns == NEVER_NS):
            server.drop()  # the transfer had no progress: the core has aborted it, or would have now
        if (word >> 8 & 0xFFFF) >= _MEASURED and word & 0x60 in (0x40, 0x20):
            self._refresh(self._node, t_ns)
        access = self._access
        access.written, access.carries = False, 0
        server.unsent = self._unsent(k)
        response = server.request(data_bytes(word, 8))
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
            self._deadlines[k] = NEVER_NS
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
