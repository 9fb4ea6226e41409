"""A CANopen device: its description, its dictionary and its services, on the core's record.

The owner of the records calls `core.on_frame` with every frame and `core.on_time` at
``record.next_ns``; when `on_frame` returns 1 it calls `Device.service` with the same arguments.
This module uses no socket, thread or clock.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import numpy as np

from coulombus.eds.cia301 import CobId, NmtCommand, NmtState
from coulombus.eds.cia305 import UNCONFIGURED
from coulombus.eds.nmt import ALLOWED, Service
from coulombus.eds.reader import Description, Value
from coulombus.node import core, guarding
from coulombus.node.communication_objects import PRODUCER, SDO_SERVERS, Communication
from coulombus.node.dictionary import Dictionary, DictionaryState
from coulombus.node.kinds import number
from coulombus.node.lss import Lss
from coulombus.node.profile import BY_COMMAND, BY_RESET, Profile
from coulombus.node.record import SDO_TIMEOUT_NS, NodeRecord
from coulombus.node.sdo_service import Access, SdoService
from coulombus.node.store import Store, StoredParameters
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import Queue, push

__all__ = ["SDO_TIMEOUT_NS", "Device", "DeviceState"]

TIME_EPOCH = datetime(1984, 1, 1)
TIME_BYTES = 6
"""Length of the TIME message (CiA 301, section 7.2.6): milliseconds after midnight and days since 1984-01-01.

```
bit  47            32 31  28 27                    0
    +----------------+------+-----------------------+
    | days           |  0   | ms after midnight     |
    +----------------+------+-----------------------+
```
"""

_MS_MASK, _DAYS_MASK = 0xFFFFFFF, 0xFFFF


def time_word(time: datetime) -> int:
    """Return the data of the TIME message for `time`, as a little-endian word; ValueError outside 1984 to
    2163.
    """
    passed = time - TIME_EPOCH
    if not 0 <= passed.days <= _DAYS_MASK:
        raise ValueError(f"{time} is outside what TIME can tell: 1984-01-01 to 2163-06-06")
    return passed.seconds * 1000 + passed.microseconds // 1000 | passed.days << 32


def time_of_day(word: int, elapsed_ns: int = 0) -> datetime:
    """Return the time of a TIME message, `elapsed_ns` after its reception."""
    return TIME_EPOCH + timedelta(
        days=word >> 32 & _DAYS_MASK, milliseconds=word & _MS_MASK, microseconds=elapsed_ns // 1000
    )


MOST_MADE = 16
"""Number of descriptions whose initial device state is cached for further devices."""
STAYS_PRE_OPERATIONAL = 0x04
"""Bit of 1F80h (CiA 302-2): the device does not start by itself. Without 1F80h it does not either."""

_RESET: Mapping[int, int] = {NmtCommand.RESET_NODE: 0x0000, NmtCommand.RESET_COMMUNICATION: 0x1000}
"""NMT command -> first index of the objects that return to their defaults (0x1000: to 0x1FFF)."""


class DeviceState(NamedTuple):
    """State of a device besides its record, while no transfer is open."""

    objects: DictionaryState
    boots: int
    now: int


class Device:
    """A device and its record.

    Parameters
    ----------
    description
        The EDS; its objects are the device's.
    node_id
        1 to 127, or `eds.cia305.UNCONFIGURED`: the device waits until an LSS master assigns one.
    profile
        Behaviour behind the objects: one of `node.kinds.PROFILES`, or a profile fitted to the file;
        `node.kinds.GENERIC`: none.
    record
        The record, from `node.record.new_nodes`, that becomes this device.
    store
        Storage of 1010h and LSS; by default the device's own memory, which resets and power cycles
        do not clear.

    Raises
    ------
    ValueError
        The node id is out of range, or no kernel knows the profile.
    """

    def __init__(
        self,
        description: Description,
        node_id: int,
        profile: Profile,
        record: NodeRecord,
        store: Store | None = None,
    ) -> None:
        if not 1 <= node_id <= 127 and node_id != UNCONFIGURED:
            raise ValueError(f"node id {node_id}; expected 1 to 127, or {UNCONFIGURED} for none")
        new = store is None and not record["node_id"]
        self.description, self.node_id, self.profile = description, node_id, profile
        self.record = record
        self.record["node_id"], self.record["kind"], self.record["held"] = node_id, number(profile), profile.held
        self.dictionary = Dictionary(description, node_id, profile.objects, record["values"])
        self.communication = Communication(self.dictionary, record, profile)
        self.store = Store() if store is None else store
        self.parameters = StoredParameters(self.dictionary, self.store, profile.acts)
        access = Access(self.dictionary, self.communication, self.parameters, profile, self._downloaded)
        self._sdo = SdoService(access, self.communication, record)
        self.lss = Lss(self.dictionary, record, node_id, self.store, self._reset_communication)
        self._now = 0
        self.boots = 0
        """Number of boot-ups: after power-on, and after each reset."""
        self.on_download: Callable[[int, int], None] | None = None
        """Called after an SDO client has written an object (index, sub-index)."""
        cache: dict[Any, tuple[Mapping[str, Any], DeviceState]] = description.derived.setdefault(Device, {})
        key = profile.name, profile.objects, profile.behaviour, profile.started, node_id, int(record["station"])
        if new and key in cache:  # the same device again
            fields, state = cache[key]
            for name, value in fields.items():
                record[name] = value
            self.adopt(state)
            self._sdo.refresh()
            return
        before = record.copy()
        self._tabulate()
        self._load(0x0000, 0)
        if new and len(cache) < MOST_MADE:
            changed = (name for name in record.dtype.names or () if not np.array_equal(before[name], record[name]))
            cache[key] = {name: np.copy(record[name]) for name in changed}, self.state()

    @property
    def unreadable(self) -> tuple[str, ...]:
        """Why PDOs of the EDS are unreadable, each with file:line; such a PDO is not valid at start, everything
        else is served.
        """
        return tuple(self.dictionary.unreadable.values())

    # values

    def __getitem__(self, key: tuple[int, int]) -> Value:
        """Return an object's present value, as a Python number, text or bytes."""
        core.refresh_inputs(self.record, self._now)
        self.communication.collect(key[0])
        return self.dictionary[key]

    def __setitem__(self, key: tuple[int, int], value: Value) -> None:
        """Set an object as the device itself does: without checks of access right and limit.

        The record follows.
        """
        self.dictionary[key] = value
        self._changed(*key)
        self.record["next_ns"] = min(int(self.record["next_ns"]), self._now)

    def slot(self, index: int, subindex: int = 0) -> int:
        """Return the index of a numeric object in the record's `values`."""
        return self.dictionary.slot(index, subindex)

    def time_of_day(self, t_ns: int) -> datetime | None:
        """Return the time of the last TIME message, advanced to `t_ns`; None before the first."""
        set_ns = int(self.record["time_set_ns"])
        return None if set_ns < 0 else time_of_day(int(self.record["time_word"]), t_ns - set_ns)

    def state(self) -> DeviceState:
        """Return the state besides the record."""
        return DeviceState(self.dictionary.state(), self.boots, self._now)

    def adopt(self, state: DeviceState) -> None:
        """Continue from the state of a device of the same file and node id, whose record this device now has."""
        self.boots, self._now = state.boots, state.now
        self.dictionary.adopt(state.objects)

    # life cycle

    def power_on(self, t_ns: int, out: Queue) -> None:
        """Switch the device on: defaults, boot-up, PRE-OPERATIONAL."""
        record = self.record
        record["powered"] = 1
        record["causes"] = record["latched"] = record["history_count"] = 0
        record["emcy_ready_ns"] = record["emcy_waiting"] = 0
        record["nmt"] = NmtState.INITIALISING
        self.lss.power_on()
        self._load(0x0000, t_ns)
        self.profile.powered_on(record, t_ns)
        self._boot(t_ns, out)

    def power_off(self) -> None:
        """Switch the device off: it is silent, and its outputs are 0."""
        record = self.record
        record["powered"] = 0
        record["nmt"] = NmtState.INITIALISING
        for field in self.profile.outputs:
            record[field] = 0
        record["rpdo_pending"] = record["setpoint_armed"] = record["ramping"] = 0
        record["next_ns"] = NEVER_NS
        self._sdo.drop()

    def _load(self, first: int, t_ns: int) -> None:
        """Set the objects to their stored values, or their defaults, from index `first` on (0x1000:
        communication only).
        """
        self._sdo.drop()
        self.lss.reset()
        self.node_id = self.dictionary.node_id = self.record["node_id"] = self.lss.node_id
        last = 0x1FFF if first == 0x1000 else 0xFFFF
        self.dictionary.reset(first, last)
        self.parameters.load(first, last)
        if first == 0x0000:
            self.profile.started(self.record, self.dictionary, t_ns)
        self.communication.refresh_all(t_ns)
        self._sdo.refresh()

    def _changed(self, index: int, subindex: int) -> None:
        """Update the record after an object was written."""
        if self.node_id == UNCONFIGURED and index < 0x2000:
            return  # the boot-up updates everything
        if 0x1000 <= index < 0x2000:
            self.communication.refresh(index, subindex, self._now)
            if index in SDO_SERVERS:
                self._sdo.refresh()
        else:
            self.profile.changed(self.record, self.dictionary, index, subindex)

    def _downloaded(self, index: int, subindex: int) -> None:
        self._changed(index, subindex)
        if self.on_download is not None:
            self.on_download(index, subindex)

    # services

    def service(self, t_ns: int, can_id: int, length: int, word: int, out: Queue) -> None:
        """Serve the frame for which `core.on_frame` returned 1: an NMT command, an SDO or an LSS request."""
        self._now = t_ns
        if can_id == CobId.NMT:
            if word & 0xFF in _RESET:
                self.nmt_command(t_ns, word & 0xFF, out)
            else:
                self._sdo.drop()  # the core has done the rest of STOPPED
        elif can_id == CobId.LSS_RX:
            self.lss.request(t_ns, length, word, out)
        elif self._sdo.serves(can_id):
            self._sdo.serve(t_ns, can_id, length, word, out)

    def nmt_command(self, t_ns: int, command: int, out: Queue) -> None:
        """Execute an NMT command (its specifier); count an unknown command."""
        self._now = t_ns
        record = self.record
        if command not in _RESET:
            if core.nmt_command(record, t_ns, command & 0xFF, out):
                self._sdo.drop()  # SDO ends with it
        else:
            self._set_nmt(t_ns, NmtState.INITIALISING, BY_RESET, out)
            first = _RESET[command]
            if first == 0x0000:
                self.lss.power_on()
                record["causes"] = record["latched"] = record["history_count"] = 0
            self._load(first, t_ns)
            core.forget_connections(self.record, t_ns, out)
            self._boot(t_ns, out)

    def _reset_communication(self, t_ns: int, out: Queue) -> None:
        self.nmt_command(t_ns, NmtCommand.RESET_COMMUNICATION, out)

    def _tabulate(self) -> None:
        """Give the core the table of objects that it may upload by itself."""
        table = np.array(self.dictionary.expedited(), np.int64).reshape(-1, 3)
        self.record["fast_count"] = len(table)
        for name, column in zip(("fast_key", "fast_slot", "fast_size"), table.T, strict=True):
            self.record[name][: len(table)] = column

    def produce_time(self, t_ns: int, time: datetime, out: Queue) -> bool:
        """Send TIME if bit 30 of 1012h is set and NMT allows it; tell whether it was sent."""
        if not self.dictionary.number(0x1012) & PRODUCER or not (self.record["powered"] and self.record["time_id"]):
            return False
        if not ALLOWED[self.record["nmt"]] & Service.TIME:
            return False
        push(out, self.record["station"], t_ns, int(self.record["time_id"]), TIME_BYTES, time_word(time))
        return True

    def _boot(self, t_ns: int, out: Queue) -> None:
        if self.node_id == UNCONFIGURED:
            self.lss.mute()
            return
        self.boots += 1
        ready_ns = t_ns + int(self.record["processing_ns"])
        push(out, self.record["station"], ready_ns, CobId.HEARTBEAT + self.node_id, 1, int(NmtState.INITIALISING))
        guarding.restart(self.record)
        self._set_nmt(t_ns, NmtState.PRE_OPERATIONAL, BY_COMMAND, out)
        if not self.dictionary.number(0x1F80, 0, STAYS_PRE_OPERATIONAL) & STAYS_PRE_OPERATIONAL:
            first = int(out["count"])
            self._set_nmt(t_ns, NmtState.OPERATIONAL, BY_COMMAND, out)
            sent = out.frames["t_ns"][first : int(out["count"])]
            sent[:] = np.maximum(sent, ready_ns + 1)  # a PDO comes after the boot-up, whatever its identifier
        if self.record["in_faults"]:
            self.record["next_ns"] = t_ns + 1  # errors that outlive the reset are reported after the boot-up

    def _set_nmt(self, t_ns: int, state: int, why: int, out: Queue) -> None:
        core.set_nmt(self.record, t_ns, int(state), why, out)
