"""A CANopen device: its description, its dictionary and its services, on one row of the records that the core runs on.

The owner of the records calls `core.on_frame` with every frame and `core.on_time` at ``nodes[i].next_ns``; when
`on_frame` returns 1 it calls `Device.service` with the same arguments. Nothing here knows a socket, a thread or a clock.
"""

from __future__ import annotations

from collections.abc import Mapping

from eds.cia301 import Abort, NmtCommand, NmtState
from eds.pdo import layouts
from eds.reader import Description, Value
from node import behaviour, brake404, core, drive402
from node.access import Access
from node.communication import Communication
from node.dictionary import Dictionary
from node.records import FAR_FUTURE_NS, KIND_BRAKE, KIND_DRIVE, KIND_GENERIC
from node.sdo import SdoServer, abort_frame
from wire.frame import Records, data_bytes, data_word, push

__all__ = ["SDO_TIMEOUT_NS", "Device"]

SDO_TIMEOUT_NS = 1_000_000_000
"""A segmented transfer that stands still for so long is aborted (0504 0000h)."""

NMT_TARGET: Mapping[int, NmtState] = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
}
"""NMT command -> state that follows, from any state after the boot-up (CiA 301, figure 48); a reset boots again."""

NMT_RESET: Mapping[int, int] = {NmtCommand.RESET_NODE: 0x0000, NmtCommand.RESET_COMMUNICATION: 0x1000}
"""NMT command -> first index of the objects that take their defaults again (0x1000: to 0x1FFF)."""


class Device:
    """The device in row `i` of `nodes`, `rpdo`, `tpdo`.

    Parameters
    ----------
    description
        The EDS; its objects are the device's.
    node_id
        1 to 127.
    kind
        `node.records.KIND_DRIVE`, `KIND_BRAKE` or `KIND_GENERIC` (any EDS: objects, PDOs and services, no behaviour).
    nodes, rpdo, tpdo, i
        From `node.records.new_nodes`, and the row that becomes this device.

    Raises
    ------
    ValueError
        The node id or the kind is out of range.
    eds.reader.EdsError
        A default PDO map of the EDS cannot be read right.
    """

    def __init__(
        self,
        description: Description,
        node_id: int,
        kind: int,
        nodes: Records,
        rpdo: Records,
        tpdo: Records,
        i: int,
    ) -> None:
        if not 1 <= node_id <= 127:
            raise ValueError(f"node id {node_id}; expected 1 to 127")
        if kind not in (KIND_GENERIC, KIND_DRIVE, KIND_BRAKE):
            raise ValueError(f"kind {kind}; expected KIND_GENERIC, KIND_DRIVE or KIND_BRAKE of node.records")
        layouts(description, node_id)
        self.description, self.node_id, self.kind = description, node_id, kind
        self._records = (nodes, rpdo, tpdo, i)
        self._nodes, self._i = nodes, i
        self.record = nodes[i]
        self.record["node_id"], self.record["kind"] = node_id, kind
        self.record["sdo_deadline_ns"] = FAR_FUTURE_NS
        self.dictionary = Dictionary(description, node_id, kind, nodes["values"][i])
        self.communication = Communication(self.dictionary, nodes, rpdo, tpdo, i)
        self._access = Access(self.dictionary, self.communication, kind, self._changed)
        self._sdo = SdoServer(self._access)
        self._now = 0
        self._load(0x0000, 0)

    # values

    def __getitem__(self, key: tuple[int, int]) -> Value:
        """Return an object's present value, as a Python number, text or bytes."""
        core.refresh_inputs(self._nodes, self._i, self._now)
        self.communication.collect(key[0])
        return self.dictionary[key]

    def __setitem__(self, key: tuple[int, int], value: Value) -> None:
        """Set an object as the device itself does: no access right, no limit; the record follows."""
        self.dictionary[key] = value
        self._changed(*key)
        self.record["next_ns"] = min(int(self.record["next_ns"]), self._now)

    def slot(self, index: int, subindex: int = 0) -> int:
        """Return where a numeric object stands in the record's `values`."""
        return self.dictionary.slot(index, subindex)

    # life

    def power_on(self, t_ns: int, queue: Records, header: Records) -> None:
        """Switch the device on: defaults, boot-up, PRE-OPERATIONAL."""
        record = self.record
        record["powered"] = 1
        record["causes"] = record["latched"] = record["history_count"] = 0
        record["emcy_ready_ns"] = 0
        record["nmt"] = NmtState.INITIALISING
        self._load(0x0000, t_ns)
        if self.kind == KIND_BRAKE:
            brake404.start(record, t_ns)
        self._boot(t_ns, queue, header)

    def power_off(self) -> None:
        """Switch the device off: it is silent, and its outputs are 0."""
        record = self.record
        record["powered"] = 0
        record["nmt"] = NmtState.INITIALISING
        record["out_torque_pm"] = record["out_brake_Nm"] = 0.0
        record["rpdo_pending"] = record["setpoint_armed"] = record["ramping"] = 0
        record["sdo_deadline_ns"] = record["next_ns"] = FAR_FUTURE_NS
        self._sdo.drop()

    def _load(self, first: int, t_ns: int) -> None:
        """Give the objects their defaults, from index `first` on (0x1000: communication only)."""
        self._sdo.drop()
        self.record["sdo_deadline_ns"] = FAR_FUTURE_NS
        if first == 0x1000:
            self.dictionary.reset(0x1000, 0x1FFF)
        else:
            self.dictionary.reset(0x0000, 0xFFFF)
            self._start(t_ns)
        self.communication.refresh_all(t_ns)

    def _start(self, t_ns: int) -> None:
        """Start the kind's own part with the values that now stand in the dictionary."""
        record, number = self.record, self.dictionary.number
        if self.kind == KIND_DRIVE:
            record["supply_mV"] = number(0x6079, 0, 0)
            drive402.start(record, t_ns)
        elif self.kind == KIND_BRAKE:
            high = self.description.variable(0x7300, 1).high if (0x7300, 1) in self.dictionary else None
            record["setpoint_high"] = int(high) if high is not None else 32767
            self._scale()

    def _changed(self, index: int, subindex: int) -> None:
        """Bring the record up to an object that was written."""
        if 0x1000 <= index < 0x2000:
            self.communication.refresh(index, subindex, self._now)
        elif self.kind == KIND_BRAKE and index in (0x6126, 0x6127, 0x6132, 0x6302):
            self._scale()

    def _scale(self) -> None:
        """Bring the brake's scales up to 6126h, 6127h, 6132h and 6302h."""
        record, objects = self.record, self.dictionary
        record["ao_unit_Nm"] = 10.0 ** -objects.number(0x6302, 1)
        for k in range(3):
            unit = 10.0 ** objects.number(0x6132, k + 1)
            record["ai_gain"][k] = objects.real(0x6126, k + 1, 1.0) * unit
            record["ai_bias"][k] = objects.real(0x6127, k + 1, 0.0) * unit

    # services

    def service(self, t_ns: int, can_id: int, length: int, data: int, queue: Records, header: Records) -> None:
        """Serve the frame for which `core.on_frame` returned 1: an NMT command or an SDO request."""
        self._now = t_ns
        if can_id == 0x000:
            self.nmt_command(t_ns, data & 0xFF, queue, header)
        elif can_id == self.communication.sdo_rx:
            self._serve_sdo(t_ns, length, data, queue, header)

    def nmt_command(self, t_ns: int, command: int, queue: Records, header: Records) -> None:
        """Carry out an NMT command (its specifier); an unknown one is counted."""
        self._now = t_ns
        record = self.record
        if command in NMT_TARGET:
            self._set_nmt(t_ns, NMT_TARGET[command], behaviour.BY_COMMAND, queue, header)
        elif command in NMT_RESET:
            self._set_nmt(t_ns, NmtState.INITIALISING, behaviour.BY_RESET, queue, header)
            first = NMT_RESET[command]
            if first == 0x0000:
                record["causes"] = record["latched"] = record["history_count"] = 0
            self._load(first, t_ns)
            core.forget_connections(self._nodes, self._i, t_ns, queue, header)
            self._boot(t_ns, queue, header)
        else:
            record["dropped_unknown"] += 1

    def _serve_sdo(self, t_ns: int, length: int, data: int, queue: Records, header: Records) -> None:
        record = self.record
        if length != 8:
            record["dropped_length"] += 1
            return
        if t_ns > record["sdo_deadline_ns"] or record["sdo_deadline_ns"] == FAR_FUTURE_NS:
            self._sdo.drop()  # the transfer that stood still: the core has told the client so, or would have now
        core.refresh_inputs(self._nodes, self._i, t_ns)
        self._access.carries = 0
        response = self._sdo.request(data_bytes(data, 8))
        if response is not None:
            ready_ns = t_ns + int(record["processing_ns"])
            push(queue, header, self._i, ready_ns, self.communication.sdo_tx, 8, data_word(response))
        record["sdo_deadline_ns"] = FAR_FUTURE_NS
        if self._sdo.transfer is not None:
            record["sdo_deadline_ns"] = t_ns + SDO_TIMEOUT_NS
            record["sdo_abort_id"] = self.communication.sdo_tx
            record["sdo_abort_word"] = data_word(abort_frame(*self._sdo.transfer, Abort.TIMEOUT))
        core.written(*self._records, t_ns, self._access.carries, queue, header)

    def _boot(self, t_ns: int, queue: Records, header: Records) -> None:
        ready_ns = t_ns + int(self.record["processing_ns"])
        push(queue, header, self._i, ready_ns, 0x700 + self.node_id, 1, NmtState.INITIALISING)
        self._set_nmt(t_ns, NmtState.PRE_OPERATIONAL, behaviour.BY_COMMAND, queue, header)

    def _set_nmt(self, t_ns: int, state: int, why: int, queue: Records, header: Records) -> None:
        core.set_nmt(*self._records, t_ns, int(state), why, queue, header)
