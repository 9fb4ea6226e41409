"""The one record of a node, which its compiled core and its Python services share.

`new_nodes` makes the records of several nodes at once; a kernel takes one of them, by reference. A
node's PDOs nest in its record. Everything is int64 or float64; times are int64 nanoseconds; a time
that never comes is `node.constants.FAR_FUTURE_NS`. What a kind of device keeps stands in its profile
(`node.kinds`), and in every record.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coulombus.eds.codec import PDO
from coulombus.node.constants import (
    BLOCK_SEGMENTS,
    EMCY_WAITING,
    FAR_FUTURE_NS,
    MAX_CONSUMERS,
    MAX_HISTORY,
    MAX_PDOS,
    MAX_SDO_SERVERS,
    OUTBOX,
    SLOTS,
)
from coulombus.node.kinds import PROFILES
from coulombus.wire.clock import CLOCK_FIELDS
from coulombus.wire.frame import Records

__all__ = ["LOOP_WORDS", "NODE", "new_nodes"]

_I = np.int64

NODE = np.dtype(
    [
        # who and when
        ("station", _I),  # number of its station on the bus: its row
        ("node_id", _I),
        ("kind", _I),  # number of its profile in node.kinds; 0: generic
        ("nmt", _I),  # NmtState
        ("powered", _I),
        ("next_ns", _I),  # when on_time wants to be called; FAR_FUTURE_NS: never
        *CLOCK_FIELDS,
        ("processing_ns", _I),  # from a frame or an event to the answer that is ready to be sent
        # simulated inputs that every kind has (written by sim_bus). After a change of one of them
        # set next_ns to the
        # present: both are looked at on SYNC, on an RPDO and on time
        ("in_supply_ok", _I),
        ("in_faults", _I),  # device faults that are present, bits of node.emcy's causes
        # counters
        ("dropped_length", _I),  # RPDOs or SYNCs of a wrong length, NMT or heartbeat frames too short
        ("dropped_unknown", _I),  # frames of this node that do not fit its state (a PDO while not OPERATIONAL ...)
        ("dropped_window", _I),  # synchronous RPDOs that came after the window of 1007h
        ("excess_length", _I),  # RPDOs longer than mapped, of which the first bytes were used
        ("negative_setpoints", _I),
        ("clipped_setpoints", _I),  # above the EDS' high limit (brake), above 6072h (drive)
        ("emcy_count", _I),
        # SYNC
        ("sync_ns", _I),  # the last one
        ("sync_armed", _I),  # one was seen since OPERATIONAL
        ("sync_overflow", _I),  # 1019h
        ("sync_id", _I),  # COB-ID of 1005h
        ("sync_producer_ns", _I),  # period of 1006h when 1005h's bit 30 is set, else 0
        ("sync_next_ns", _I),
        ("sync_counter", _I),
        ("sync_window_ns", _I),  # 1007h; 0: none
        # NMT, heartbeats, error behaviour
        ("heartbeat_ns", _I),  # 1017h; 0: none
        ("heartbeat_next_ns", _I),
        ("error_behaviour", _I),  # 1029h:01, communication: 0 to PRE-OPERATIONAL, 1 no change, 2 to STOPPED
        ("device_error_behaviour", _I),  # 1029h:02, a fault of the device itself
        ("consumers_used", _I),  # 1 + the last entry of 1016h that watches
        ("consumer_id", _I, (MAX_CONSUMERS,)),  # node that is watched
        ("consumer_ns", _I, (MAX_CONSUMERS,)),  # its time of 1016h; 0: none
        ("consumer_last_ns", _I, (MAX_CONSUMERS,)),
        ("consumer_state", _I, (MAX_CONSUMERS,)),  # 0 waits for the first heartbeat, 1 alive, 2 lost
        # node guarding
        ("guard_on", _I),  # 1: remote frames on 700h + id are answered (1017h is 0)
        ("guard_toggle", _I),
        ("guard_life_ns", _I),  # 100Ch x 100Dh; 0: not watched
        ("guard_last_ns", _I),
        ("guard_state", _I),  # 0 waits for the first remote frame, 1 alive, 2 lost
        # TIME
        ("time_id", _I),  # COB-ID of 1012h
        ("time_set_ns", _I),  # when the time of day was told; -1: never
        ("time_word", _I),  # what was told: bits 0-27 ms after midnight, bits 32-47 days since 1984-01-01
        # PDOs
        ("rpdo", PDO, (MAX_PDOS,)),
        ("tpdo", PDO, (MAX_PDOS,)),
        ("rpdo_ns", _I, (MAX_PDOS,)),  # last reception
        ("rpdo_armed", _I, (MAX_PDOS,)),  # its deadline is watched
        ("rpdo_lost", _I, (MAX_PDOS,)),
        ("rpdo_pending", _I),  # how many RPDOs wait for the next SYNC
        ("rpdo_waits", _I, (MAX_PDOS,)),  # this one does
        ("rpdo_word", _I, (MAX_PDOS,)),
        ("rpdo_carries", _I, (MAX_PDOS,)),  # bits `acts` of the objects that it maps (node.profile)
        ("rpdo_next", _I, (MAX_PDOS,)),  # next RPDO with the same COB-ID, or -1
        ("rpdo_used", _I),  # 1 + the last valid RPDO
        ("tpdo_used", _I),  # 1 + the last valid TPDO
        ("tpdo_events", _I),  # how many valid TPDOs are sent on events (transmission type 254, 255)
        ("tpdo_count", _I, (MAX_PDOS,)),  # SYNCs since the last transmission; -1: waits for the SYNC start value
        ("tpdo_ns", _I, (MAX_PDOS,)),  # last transmission
        ("tpdo_word", _I, (MAX_PDOS,)),  # what was sent last; sampled at SYNC for transmission type 252
        ("tpdo_due", _I, (MAX_PDOS,)),  # an event waits for the end of the inhibit time
        ("tpdo_mask", _I, (MAX_PDOS,)),  # bits whose change is an event
        # EMCY
        ("causes", _I),  # present now
        ("detected", _I),  # device faults that the device found itself, as in_faults
        ("held", _I),  # causes that stay latched until the reset of the kind
        ("latched", _I),  # told by an EMCY and not yet reset
        ("emcy_id", _I),  # -1: none
        ("emcy_inhibit_ns", _I),
        ("emcy_ready_ns", _I),  # the next one goes out then at the earliest
        ("emcy_waiting", _I),
        ("emcy_word", _I, (EMCY_WAITING,)),
        ("history_count", _I),
        ("history", _I, (MAX_HISTORY,)),  # 1003h, newest first
        ("silent_ns", _I),  # until then it hears and sends nothing (LSS: activate bit timing)
        # SDO server: a transfer that stands still is aborted by the core
        ("sdo_used", _I),  # 1 + the last valid channel
        ("sdo_deadline_ns", _I, (MAX_SDO_SERVERS,)),
        ("sdo_abort_id", _I, (MAX_SDO_SERVERS,)),
        ("sdo_abort_word", _I, (MAX_SDO_SERVERS,)),
        # segments of block downloads that the core collects; Python opens and closes a channel's
        # row
        ("segments_open", _I),  # how many rows are open
        ("segments_id", _I, (MAX_SDO_SERVERS,)),  # identifier of the requests; 0: closed
        ("segments_next", _I, (MAX_SDO_SERVERS,)),  # number of the segment that comes next
        ("segments_last", _I, (MAX_SDO_SERVERS,)),  # number of the block's last segment
        ("segments_count", _I, (MAX_SDO_SERVERS,)),  # collected and not yet taken by Python
        ("segments_word", _I, (MAX_SDO_SERVERS, BLOCK_SEGMENTS)),
        # what the core uploads by itself, sorted by key
        ("sdo_rx_id", _I),  # of the first server; -1: none
        ("sdo_tx_id", _I),
        ("fast_count", _I),
        ("fast_key", _I, (SLOTS,)),  # index x 256 + sub-index
        ("fast_slot", _I, (SLOTS,)),
        ("fast_size", _I, (SLOTS,)),  # bytes, 1 to 4
        # segments of block uploads, a ring
        ("outbox_first", _I),
        ("outbox_count", _I),
        ("outbox_next_ns", _I),
        ("outbox_channel", _I, (OUTBOX,)),
        ("outbox_id", _I, (OUTBOX,)),
        ("outbox_word", _I, (OUTBOX,)),
        # set-point of a kind that has one
        ("setpoint_ns", _I),  # reception of the one that acts
        ("setpoint_armed", _I),  # its age is watched (since the first RPDO that carries one)
        ("setpoint_stale", _I),
        ("ramping", _I),  # brake: 0 the set-point acts, 1 on the way to the fault value, 2 there; drive: 1 on a slope
        *(field for profile in PROFILES for field in profile.fields),
        # tables
        ("values", _I, (SLOTS,)),  # raw values of the objects, REAL as bit patterns
        ("rerouted", _I),  # 1: `route` was written; the reader that indexes it (sim_bus.network.agenda) clears it
        ("route", np.int16, (2048,)),  # node.core's route of each identifier
        ("rtr_route", np.int16, (2048,)),
    ],
    align=True,
)


SERVICES_ONLY = (
    *("rpdo", "tpdo", "fast_key", "fast_slot", "fast_size"),
    *("outbox_channel", "outbox_id", "outbox_word", "route", "rtr_route"),
)
"""Fields, the most of a record, that only the Python services write; the core reads them."""


def _loop_words() -> npt.NDArray[np.int64]:
    """Return the other fields as runs of words: first and last + 1 of each."""
    spans = [(offset, offset + field.itemsize) for field, offset in _fields(SERVICES_ONLY)]
    edges = [0, *(edge // 8 for span in sorted(spans) for edge in span), NODE.itemsize // 8]
    return np.array([run for run in zip(edges[::2], edges[1::2], strict=True) if run[0] < run[1]], np.int64)


def _fields(names: tuple[str, ...]) -> list[tuple[np.dtype[np.void], int]]:
    """Return type and offset of fields of `NODE`."""
    assert NODE.fields is not None
    return [NODE.fields[name][:2] for name in names]


LOOP_WORDS = _loop_words()
"""Words of a record that the core may write, by which its Python services have to be brought up to
date: runs, first and last + 1.
"""


def new_nodes(n: int) -> Records:
    """Return the records of `n` nodes that are powered off; none of their PDOs is valid."""
    nodes = np.zeros(n, NODE).view(np.recarray)
    nodes["next_ns"] = FAR_FUTURE_NS
    nodes["processing_ns"] = 20_000
    nodes["in_supply_ok"] = 1
    nodes["sdo_deadline_ns"] = FAR_FUTURE_NS
    nodes["time_set_ns"] = -1
    nodes["outbox_next_ns"] = FAR_FUTURE_NS
    nodes["station"] = np.arange(n)
    nodes["rpdo"]["cob_id"] = nodes["tpdo"]["cob_id"] = -1
    return nodes
