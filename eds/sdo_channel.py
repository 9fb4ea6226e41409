"""Decoder of one server's SDO traffic: each frame with its transfer (CiA 301, section 7.2.4.3).

The meaning of a frame depends on the current transfer: a segment of a block transfer may begin with
any byte but 00h and 80h. If a recording begins within a transfer, its first frames may be
ambiguous; they are reported so until the numbers of two segments follow each other, or an
unambiguous frame comes.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from coulombus.eds import sdo_frames as forms
from coulombus.eds.cia301 import DATA_TYPES, abort_text
from coulombus.eds.description import Description
from coulombus.eds.sdo_frames import Form, form_of, named, where
from coulombus.eds.sdo_joining import Joined, Segments, SubBlocks

__all__ = ["NO_BEGINNING", "SdoChannel", "Transfer"]

Row: TypeAlias = dict[str, Any]

WITHIN_BLOCK = "Within a block transfer"
WITHIN = "Within a segmented or block transfer"
NO_BEGINNING = "its beginning is not in the recording"
NO_BLOCK_BEGINNING = "within a block transfer whose beginning is not in the recording"
NO_REQUEST = "its request is not in the recording, or this is a segment of a block transfer"
REPEATED = "repeated"
_BLOCK_UPLOAD = (
    *(forms.BLOCK_UPLOAD_INITIATE, forms.BLOCK_UPLOAD_INITIATED, forms.BLOCK_UPLOAD_START, forms.BLOCK_UPLOAD_ACK),
    *(forms.BLOCK_UPLOAD_END, forms.BLOCK_UPLOAD_ENDED),
)
_UPLOAD = (forms.UPLOAD_INITIATE, forms.UPLOAD_INITIATED, forms.UPLOAD_SEGMENT_REQUEST, *_BLOCK_UPLOAD)


@dataclass
class Transfer:
    """A transfer in progress.

    Attributes
    ----------
    place : index and sub-index, None if the initiation is not in the recording
    kind : "expedited", "segmented" or "block"; "" before the server has chosen
    joined : data so far
    requested : the recording has the client's initiation
    both : client and server have both sent frames: the first was no misread segment
    toggle : toggle bit of the segment that the next frame has to answer, None: no such segment
    crc : the client supports CRCs
    last : the last segment of a segmented download was received
    """

    upload: bool
    place: tuple[int, int] | None
    kind: str = ""
    joined: Joined = field(default_factory=Joined)
    requested: bool = False
    both: bool = False
    toggle: int | None = None
    crc: bool = False
    last: bool = False

    @property
    def service(self) -> str:
        """Name of the service, as far as it is known."""
        words = ("SDO", self.kind, "upload" if self.upload else "download")
        return " ".join(word for word in words if word)


def _unseen(upload: bool, joined: Segments | SubBlocks) -> Transfer:
    """Return a transfer whose initiation is not in the recording."""
    joined.whole = False
    return Transfer(upload, None, "block" if isinstance(joined, SubBlocks) else "segmented", joined)


class SdoChannel:
    """Follows the successive transfers of one server with its clients.

    Parameters
    ----------
    description
        The server's EDS file, for names and types; None if unknown.
    """

    def __init__(self, description: Description | None) -> None:
        self._description = description
        self._transfer: Transfer | None = None
        self.completed: Transfer | None = None
        """The transfer that the last frame completed; of an expedited upload the response is enough."""
        self._begun = False
        """Whether a frame came that is no segment of a block transfer."""
        self._before: tuple[bool, bytes] | None = None
        self._row: Row = {}
        self._number = 0
        """Number of the previous frame if it may be a segment of a block transfer that began before the
        recording; else 0.
        """

    @property
    def transfer(self) -> Transfer | None:
        """Transfer in progress; None if there is none, or if it ended with the last frame."""
        return self._transfer

    def row(self, data: bytes, from_server: bool) -> Row:
        """Return the decoded frame, and the state of its transfer.

        The keys are `service`, `phase`, and, as far as known, `index`, `subindex`, `name`,
        `value`, `size`, `block_size`, `number`, `segment`, `last`, `bytes`, `content` (of the frame
        that completes a transfer), `code`, `text`, `remark`.
        """
        self.completed = None
        if len(data) != 8:
            return {"service": "SDO", "malformed": f"{len(data)} bytes, expected 8"}
        again = self._before is not None and self._before[0] == from_server
        if again and self._before == (from_server, data):
            return {key: value for key, value in self._row.items() if key != "content"} | {"remark": REPEATED}
        if again and self._number and data[0] & 0x7F == self._number + 1:
            self._transfer = _unseen(from_server, SubBlocks(number=self._number))
        earlier = self._transfer
        self._row = self._abort(data) if data[0] == forms.ABORT else self._decode(data, from_server)
        self._before = (from_server, data)
        self._number = 0 if _is_known(self._transfer or earlier) else data[0] & 0x7F
        return self._row

    def _abort(self, data: bytes) -> Row:
        code, transfer, service = struct.unpack_from("<I", data, 4)[0], self._transfer, "SDO"
        if transfer is not None and (transfer.place is None or named(data) in (transfer.place, (0, 0))):
            service, self._transfer = transfer.service, None
        words = {"code": code, "text": abort_text(code)}
        return {"service": service, "phase": "Abort transfer", **self._object(named(data)), **words}

    def _decode(self, data: bytes, from_server: bool) -> Row:
        transfer, form = self._transfer, form_of(data[0], from_server)
        if transfer is not None and transfer.upload == from_server and transfer.kind == "block":
            if _is_segment(transfer, data, form):
                return self._block_segment(transfer, data)
        elif transfer is None and form is not None and not self._believable(form, data):
            form = None
        if form is None:
            return self._unknown(data, from_server)
        self._begun = True
        if form.initiates:
            return self._response(form, data) if from_server else self._request(form, data)
        if form in (forms.UPLOAD_SEGMENT, forms.DOWNLOAD_SEGMENT):
            return self._segment(form, data)
        if form in (forms.UPLOAD_SEGMENT_REQUEST, forms.DOWNLOAD_SEGMENT_RESPONSE):
            return self._segment_handshake(form, data)
        return self._block_handshake(form, data)

    def _believable(self, form: Form, data: bytes) -> bool:
        """Tell whether a frame that fits no transfer can be what its first byte says."""
        return data[0] in form.commands if self._begun else form.exact(data)

    def _unknown(self, data: bytes, from_server: bool) -> Row:
        if self._transfer is not None or self._begun or not data[0]:
            return {"service": "SDO", "phase": f"Unknown command {data[0]:02X}h"}
        self._transfer = transfer = _unseen(from_server, blocks := SubBlocks())
        blocks.add_segment(data)
        return {"service": transfer.service, "phase": WITHIN_BLOCK, "remark": NO_BEGINNING}

    # initiation

    def _request(self, form: Form, data: bytes) -> Row:
        self._transfer = transfer = Transfer(form in _UPLOAD, named(data), requested=True)
        says: Row = {}
        size = int.from_bytes(data[4:8], "little")
        if form is forms.BLOCK_UPLOAD_INITIATE:
            transfer.kind, transfer.crc, says = "block", bool(data[0] & 0x04), {"block_size": data[4]}
        elif form is forms.BLOCK_DOWNLOAD_INITIATE:
            transfer.kind, transfer.crc = "block", bool(data[0] & 0x04)
            transfer.joined.size = size if data[0] & 0x02 else None
        elif form is forms.DOWNLOAD_INITIATE and data[0] & 0x02:
            transfer.kind = "expedited"
            transfer.joined.add(_expedited(data))
            says = self._value(transfer)
        elif form is forms.DOWNLOAD_INITIATE:
            transfer.kind, transfer.joined = "segmented", Segments(size if data[0] & 0x01 else None)
        return self._line(transfer, form.phase, says | _size(transfer))

    def _response(self, form: Form, data: bytes) -> Row:
        upload, place, transfer, says = form in _UPLOAD, named(data), self._transfer, Row()
        if transfer is None or not transfer.requested or (transfer.upload, transfer.place) != (upload, place):
            if transfer is not None and transfer.requested and not transfer.both:  # the answer to an earlier request
                remark = f"the request is about {where(*(transfer.place or place))}"
                return self._line(Transfer(upload, place), form.phase, {"remark": remark})
            transfer, says["remark"] = Transfer(upload, place), NO_REQUEST
        elif transfer.both:
            return self._line(transfer, form.phase, {"remark": REPEATED})
        else:
            transfer.both = True
        self._transfer = transfer
        size = int.from_bytes(data[4:8], "little")
        if form is forms.BLOCK_UPLOAD_INITIATED:
            crc = transfer.crc and bool(data[0] & 0x04)
            transfer.kind, transfer.joined = "block", SubBlocks(size if data[0] & 0x02 else None, crc=crc)
        elif form is forms.BLOCK_DOWNLOAD_INITIATED:
            crc = transfer.crc and bool(data[0] & 0x04)
            transfer.kind, says["block_size"] = "block", data[4]
            # without the request the size is unknown, so a loss cannot be detected
            transfer.joined = SubBlocks(transfer.joined.size, transfer.both, most=data[4], crc=crc)
            return self._line(transfer, form.phase, says)
        elif upload and data[0] & 0x02:
            transfer.kind, transfer.joined = "expedited", Joined()
            transfer.joined.add(_expedited(data))
            says |= self._completed(transfer) if transfer.both else self._value(transfer)
            self._transfer, self.completed = None, transfer
        elif upload:
            transfer.kind, transfer.joined = "segmented", Segments(size if data[0] & 0x01 else None)
        elif transfer.kind == "expedited":
            says |= self._completed(transfer)
        return self._line(transfer, form.phase, says | (_size(transfer) if upload else {}))

    # segmented transfers

    def _segment(self, form: Form, data: bytes) -> Row:
        upload, transfer = form is forms.UPLOAD_SEGMENT, self._transfer
        if transfer is None or transfer.upload != upload or not isinstance(transfer.joined, Segments):
            ambiguous = bool(data[0])  # a block has no segment 0
            transfer = Transfer(upload, None, "" if ambiguous else "segmented")
            return self._line(transfer, WITHIN if ambiguous else form.phase, {"remark": NO_BEGINNING})
        remark = transfer.joined.add_segment(data)
        last = bool(data[0] & 0x01)
        says: Row = {"segment": data[1 : 8 - (data[0] >> 1 & 7)].hex(), "last": last, "bytes": transfer.joined.count}
        if upload:
            transfer.toggle = None
        else:
            transfer.toggle, transfer.last = data[0] & 0x10, last
        if remark:
            says["remark"] = remark
        elif upload and last:
            says |= self._completed(transfer)
        return self._line(transfer, form.phase, says)

    def _segment_handshake(self, form: Form, data: bytes) -> Row:
        """Process the request of an upload's segment, or the response to a download's."""
        upload, toggle, transfer = form in _UPLOAD, data[0] & 0x10, self._transfer
        if transfer is None or transfer.upload != upload or not isinstance(transfer.joined, Segments):
            place = transfer.place if transfer is not None and transfer.upload == upload else None
            self._transfer = transfer = _unseen(upload, Segments(toggle=toggle if upload else toggle ^ 0x10))
            transfer.place = place
        assert isinstance(transfer.joined, Segments)
        transfer.both = True
        says: Row = {"bytes": transfer.joined.count}
        if upload:
            if transfer.toggle not in (None, toggle):
                transfer.joined.missed(toggle ^ 0x10)
            transfer.toggle = toggle
        else:
            if transfer.toggle is None:
                transfer.joined.missed(toggle)
            elif transfer.toggle != toggle:
                says["remark"] = "the toggle bit is not that of the segment"
            transfer.toggle = None
            if transfer.last:
                says |= self._completed(transfer)
        return self._line(transfer, form.phase, says)

    # block transfers

    def _block_segment(self, transfer: Transfer, data: bytes) -> Row:
        blocks = transfer.joined
        if not isinstance(blocks, SubBlocks):  # the response to the initiation is not in the recording
            transfer.joined = blocks = SubBlocks(blocks.size, whole=False)
        remark = blocks.add_segment(data)
        says: Row = {"number": data[0] & 0x7F, "segment": data[1:].hex(), "last": bool(data[0] & 0x80)}
        says["bytes"] = blocks.count_in_order
        if remark:
            says["remark"] = remark
        return self._line(transfer, f"Block {'upload' if transfer.upload else 'download'} segment", says)

    def _block_handshake(self, form: Form, data: bytes) -> Row:
        """Process a frame of a block transfer that is neither its initiation nor a segment."""
        upload, transfer = form in _UPLOAD, self._transfer
        if transfer is None or transfer.upload != upload or transfer.kind != "block":
            self._transfer = transfer = _unseen(upload, SubBlocks())
        elif not isinstance(transfer.joined, SubBlocks):
            transfer.joined = SubBlocks(transfer.joined.size, whole=False)
        blocks = transfer.joined
        assert isinstance(blocks, SubBlocks)
        transfer.both = True
        says: Row = {}
        remark = ""
        if form in (forms.BLOCK_UPLOAD_ACK, forms.BLOCK_DOWNLOAD_ACK):
            remark = blocks.acknowledge(data[1], data[2])
            says = {"number": data[1], "block_size": data[2], "bytes": blocks.count_in_order}
        elif form in (forms.BLOCK_UPLOAD_END, forms.BLOCK_DOWNLOAD_END):
            remark = blocks.end(data[0] >> 2 & 7, int.from_bytes(data[1:3], "little"))
            says = {"bytes": blocks.count}
        elif form is not forms.BLOCK_UPLOAD_START:
            blocks.whole &= blocks.ended
            says = self._completed(transfer)
        return self._line(transfer, form.phase, says | ({"remark": remark} if remark else {}))

    # texts

    def _completed(self, transfer: Transfer) -> Row:
        """End the transfer with this frame: return the bytes, or why they are missing."""
        self._transfer = None
        lacking = transfer.joined.lacking()
        if lacking:
            return {"bytes": transfer.joined.count, "remark": lacking}
        self.completed = transfer
        content = bytes(transfer.joined.content)
        return {"bytes": len(content), "content": content.hex(), **self._value(transfer)}

    def _line(self, transfer: Transfer, phase: str, says: Row) -> Row:
        row: Row = {"service": transfer.service, "phase": phase}
        if transfer.place is not None:
            row |= self._object(transfer.place)
        elif "remark" not in says:
            says["remark"] = NO_BLOCK_BEGINNING if transfer.kind == "block" else NO_BEGINNING
        return row | says

    def _object(self, place: tuple[int, int]) -> Row:
        row: Row = {"index": place[0], "subindex": place[1]}
        if self._description is not None and self._description.has(*place):
            row["name"] = self._description.variable(*place).name
        return row

    def _value(self, transfer: Transfer) -> Row:
        """Return the bytes as a value of the data type; with an unknown type, bytes of an expedited transfer
        are an integer, and others have no value.
        """
        raw, kind, signed = bytes(transfer.joined.content), "", False
        if self._description is not None and transfer.place is not None and self._description.has(*transfer.place):
            data_type = DATA_TYPES.get(self._description.variable(*transfer.place).data_type)
            kind, signed = (data_type.kind, data_type.signed) if data_type else (kind, signed)
        if kind == "real" and len(raw) in (4, 8):
            number: float = struct.unpack("<f" if len(raw) == 4 else "<d", raw)[0]
            return {"value": number if math.isfinite(number) else str(number)}  # JSON knows no infinity
        if kind == "text":
            return {"value": raw.rstrip(b"\0").decode("latin-1")}
        if transfer.kind == "expedited" or (kind == "int" and len(raw) <= 8):
            return {"value": int.from_bytes(raw, "little", signed=signed and kind == "int")}
        return {}


def _is_known(transfer: Transfer | None) -> bool:
    """Tell whether the transfer is known for certain."""
    return transfer is not None and (transfer.both or isinstance(transfer.joined, SubBlocks))


def _is_segment(transfer: Transfer, data: bytes, form: Form | None) -> bool:
    """Tell whether a frame from the sender of a block transfer's data is a segment."""
    number, blocks = data[0] & 0x7F, transfer.joined
    if not number:
        return False
    if not isinstance(blocks, SubBlocks):  # the initiation waits for its response
        return form is None or not form.initiates
    if form in (forms.BLOCK_UPLOAD_END, forms.BLOCK_DOWNLOAD_END):
        return not (blocks.finished or (form.exact(data) and (blocks.number == 0 or blocks.all_sent)))
    if form is not None and form.initiates and not transfer.upload and form.exact(data):
        return not (blocks.ended or blocks.number >= number or number > blocks.most)  # else a new transfer starts
    return not blocks.ended


def _expedited(data: bytes) -> bytes:
    return data[4 : 8 - (data[0] >> 2 & 3)] if data[0] & 0x01 else data[4:]


def _size(transfer: Transfer) -> Row:
    return {} if transfer.joined.size is None else {"size": transfer.joined.size}
