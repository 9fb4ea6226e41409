"""LSS slave of a device (CiA 305): a master finds it by its identity and assigns a node id and a bit rate.

Both settings exist three times. A master configures the *pending* setting. It becomes the *active*
setting with the next reset communication (node id) or with activate bit timing (bit rate), so that
configuration never disturbs a running device. Store configuration makes it the *persistent*
setting, with which power-on and reset node begin.

The state machine runs in parallel to NMT, in all of its states. A device without a node id has no
NMT state yet: it sends no boot-up, stays in LSS waiting, and boots when it returns to waiting with
a valid node id.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from coulombus.eds.cia301 import CobId, NmtState
from coulombus.eds.cia305 import BIT_RATES, FASTSCAN_START, UNCONFIGURED, LssService, LssState
from coulombus.node import core
from coulombus.node.dictionary import Dictionary
from coulombus.node.record import NodeRecord
from coulombus.node.sdo_kernels import forget_segments
from coulombus.node.store import Store
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import Queue, data_bytes, data_word, push

__all__ = ["Lss"]

OK, OUT_OF_RANGE = 0, 1
NOT_STORED = 2
"""Error codes of the configuration services: range (11h, 13h); access to the storage (17h)."""

_TABLE_0 = 0
_SECTION = "lss"


class Lss:
    """The LSS slave of a device.

    Parameters
    ----------
    dictionary
        1018h is the identity: vendor, product, revision, serial number.
    record
        The device's, of `node.record.new_nodes`.
    node_id
        The persistent node id; `eds.cia305.UNCONFIGURED` for none.
    store
        Storage for store configuration; its content takes precedence over `node_id`.
    restart
        Performs NMT's reset communication; called when a device without a node id receives a node
        id.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        record: NodeRecord,
        node_id: int,
        store: Store,
        restart: Callable[[int, Queue], None],
    ) -> None:
        self._dictionary, self._record = dictionary, record
        self._memory, self._restart = store, restart
        self.state = LssState.WAITING
        self.node_id, self.rate = node_id, 0  # the rate: an index of `BIT_RATES`; no bus here changes its bit rate
        stored = store.section(_SECTION)
        if len(stored.get("node_id", b"")) == 1 and _valid(stored["node_id"][0]):
            self.node_id = stored["node_id"][0]
        if len(stored.get("bit_rate", b"")) == 1 and stored["bit_rate"][0] in BIT_RATES:
            self.rate = stored["bit_rate"][0]
        self.persistent_node_id = self.pending_node_id = self.node_id
        self.persistent_rate = self.pending_rate = self.rate
        self._heard: dict[int, int] = {}
        self._scanned = 0

    # life cycle

    def power_on(self) -> None:
        """Begin with the stored settings (power-on, reset node)."""
        self.pending_node_id = self.persistent_node_id
        self.rate = self.pending_rate = self.persistent_rate
        self._record["silent_ns"] = 0
        self.reset()

    def reset(self) -> None:
        """Activate the pending node id, and wait (every reset)."""
        self.node_id = self.pending_node_id
        self.state = LssState.WAITING
        self._heard.clear()
        self._scanned = 0

    def mute(self) -> None:
        """Let the device receive only LSS and send nothing else; a ramp to the safe output continues."""
        record = self._record
        record["nmt"] = NmtState.INITIALISING
        record["route"][:] = core.ROUTE_NONE
        record["rerouted"] = 1
        record["rtr_route"][:] = core.ROUTE_NONE
        record["route"][CobId.LSS_RX] = core.ROUTE_LSS
        record["heartbeat_ns"] = record["sync_producer_ns"] = record["consumer_state"] = 0
        record["emcy_id"] = -1

    # services

    def request(self, t_ns: int, length: int, word: int, out: Queue) -> None:
        """Serve a frame on 7E5h; drop and count a frame that is no service."""
        record = self._record
        if length != 8:
            record["dropped_length"] += 1
            return
        content = data_bytes(word, 8)
        service = _SERVICES.get(content[0])
        if service is None:
            record["dropped_unknown"] += 1
            return
        state, serve = service
        if state is not None and state is not self.state:
            return  # for slaves in the other state
        was_unconfigured = self.node_id == UNCONFIGURED
        try:
            answer = serve(self, content, t_ns)
        except ValueError:
            record["dropped_unknown"] += 1
            return
        if answer is not None:
            ready_ns = t_ns + int(record["processing_ns"])
            response = data_word(answer.ljust(8, b"\0"))
            push(out, self._record["station"], ready_ns, int(CobId.LSS_TX), 8, response)  # int: an enum is not compiled
        back_to_waiting = content[0] == LssService.SWITCH_STATE_GLOBAL and self.state is LssState.WAITING
        if back_to_waiting and was_unconfigured and self.pending_node_id != UNCONFIGURED:
            self._restart(t_ns, out)

    def _switch_global(self, data: bytes, t_ns: int) -> None:
        self.state = LssState(data[1])  # ValueError: no such state
        self._heard.clear()

    def _hear(self, data: bytes, t_ns: int) -> None:
        """Store a number of an address; a new address begins with its vendor id."""
        if data[0] in (LssService.SWITCH_VENDOR, LssService.IDENTIFY_VENDOR):
            self._heard.clear()
        self._heard[data[0]] = _number(data)

    def _switch_selective(self, data: bytes, t_ns: int) -> bytes | None:
        self._hear(data, t_ns)
        first = LssService.SWITCH_VENDOR
        identity = [self._heard.get(first + k) for k in range(4)]
        self._heard.clear()
        if identity != self.identity():
            return None
        self.state = LssState.CONFIGURATION
        return bytes((LssService.SWITCH_ANSWER,))

    def _identify(self, data: bytes, t_ns: int) -> bytes | None:
        self._hear(data, t_ns)
        heard, (vendor, product, revision, serial) = self._heard, self.identity()
        self._heard = {}
        if not all(code in heard for code in range(LssService.IDENTIFY_VENDOR, LssService.IDENTIFY_SERIAL_HIGH + 1)):
            return None
        alike = (vendor, product) == (heard[LssService.IDENTIFY_VENDOR], heard[LssService.IDENTIFY_PRODUCT])
        low, high = heard[LssService.IDENTIFY_REVISION_LOW], heard[LssService.IDENTIFY_REVISION_HIGH]
        first, last = heard[LssService.IDENTIFY_SERIAL_LOW], heard[LssService.IDENTIFY_SERIAL_HIGH]
        match = alike and low <= revision <= high and first <= serial <= last
        return bytes((LssService.IDENTIFY_ANSWER,)) if match else None

    def _identify_non_configured(self, data: bytes, t_ns: int) -> bytes | None:
        return bytes((LssService.NON_CONFIGURED_ANSWER,)) if self._unconfigured else None

    def _fastscan(self, data: bytes, t_ns: int) -> bytes | None:
        """Answer if the identity's number `sub` equals the master's, down to the bit `check`."""
        number, check, sub, following = _number(data), data[5], data[6], data[7]
        if (check > 31 and check != FASTSCAN_START) or sub > 3 or following > 3:
            raise ValueError("no such fastscan")
        if not self._unconfigured:
            return None
        if check == FASTSCAN_START:
            self._scanned = 0
        elif sub != self._scanned or (number ^ self.identity()[sub]) >> check:
            return None
        elif check == 0 and following < sub:  # all four numbers are found
            self.state, self._scanned = LssState.CONFIGURATION, 0
        else:
            self._scanned = following
        return bytes((LssService.IDENTIFY_ANSWER,))

    def _configure_node_id(self, data: bytes, t_ns: int) -> bytes:
        valid = _valid(data[1])
        if valid:
            self.pending_node_id = data[1]
        return bytes((data[0], OK if valid else OUT_OF_RANGE))

    def _configure_bit_timing(self, data: bytes, t_ns: int) -> bytes:
        valid = data[1] == _TABLE_0 and data[2] in BIT_RATES
        if valid:
            self.pending_rate = data[2]
        return bytes((data[0], OK if valid else OUT_OF_RANGE))

    def _activate_bit_timing(self, data: bytes, t_ns: int) -> None:
        """Be silent for twice the delay: once at the old bit rate, then at the new one; refused in OPERATIONAL."""
        record = self._record
        if record["nmt"] == NmtState.OPERATIONAL:
            raise ValueError("refused in OPERATIONAL")
        self.rate = self.pending_rate
        delay_ns = int.from_bytes(data[1:3], "little") * 1_000_000
        record["sdo_deadline_ns"][:] = NEVER_NS
        forget_segments(self._record, -1)
        end_ns = t_ns + 2 * delay_ns
        record["silent_ns"] = record["emcy_ready_ns"] = end_ns
        for name in ("heartbeat_next_ns", "sync_next_ns"):
            record[name] = max(int(record[name]), end_ns)

    def _store(self, data: bytes, t_ns: int) -> bytes:
        settings = {"node_id": bytes((self.pending_node_id,)), "bit_rate": bytes((self.pending_rate,))}
        try:
            self._memory.put({_SECTION: settings})
        except OSError:
            return bytes((data[0], NOT_STORED))
        self.persistent_node_id, self.persistent_rate = self.pending_node_id, self.pending_rate
        return bytes((data[0], OK))

    def _inquire_identity(self, data: bytes, t_ns: int) -> bytes:
        return data[:1] + self.identity()[data[0] - LssService.INQUIRE_VENDOR].to_bytes(4, "little")

    def _inquire_node_id(self, data: bytes, t_ns: int) -> bytes:
        return bytes((data[0], self.node_id))

    def identity(self) -> list[int]:
        """Return the four numbers of 1018h; 0 if the EDS has none."""
        return [self._dictionary.number(0x1018, k) & 0xFFFFFFFF for k in range(1, 5)]

    @property
    def _unconfigured(self) -> bool:
        return self.node_id == self.pending_node_id == UNCONFIGURED


def _valid(node_id: int) -> bool:
    return 1 <= node_id <= 127 or node_id == UNCONFIGURED


def _number(data: bytes) -> int:
    return int.from_bytes(data[1:5], "little")


_W, _C = LssState.WAITING, LssState.CONFIGURATION
_Serve = Callable[[Lss, bytes, int], bytes | None]
_SERVICES: Mapping[int, tuple[LssState | None, _Serve]] = {
    LssService.SWITCH_STATE_GLOBAL: (None, Lss._switch_global),
    **dict.fromkeys(range(LssService.SWITCH_VENDOR, LssService.SWITCH_SERIAL), (_W, Lss._hear)),
    LssService.SWITCH_SERIAL: (_W, Lss._switch_selective),
    LssService.CONFIGURE_NODE_ID: (_C, Lss._configure_node_id),
    LssService.CONFIGURE_BIT_TIMING: (_C, Lss._configure_bit_timing),
    LssService.ACTIVATE_BIT_TIMING: (_C, Lss._activate_bit_timing),
    LssService.STORE_CONFIGURATION: (_C, Lss._store),
    **dict.fromkeys(range(LssService.INQUIRE_VENDOR, LssService.INQUIRE_SERIAL + 1), (_C, Lss._inquire_identity)),
    LssService.INQUIRE_NODE_ID: (_C, Lss._inquire_node_id),
    **dict.fromkeys(range(LssService.IDENTIFY_VENDOR, LssService.IDENTIFY_SERIAL_HIGH), (None, Lss._hear)),
    LssService.IDENTIFY_SERIAL_HIGH: (None, Lss._identify),
    LssService.IDENTIFY_NON_CONFIGURED: (None, Lss._identify_non_configured),
    LssService.FASTSCAN: (_W, Lss._fastscan),
}
"""Command specifier -> state in which it is served (None: both), and the service."""
