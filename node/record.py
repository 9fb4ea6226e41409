"""The one record of a node, which its compiled core and its Python services share.

`new_nodes` makes the records of several nodes at once; a kernel takes one of them, by reference. A
node's PDOs nest in its record. Everything is int64 or float64; times are int64 nanoseconds; a time
that never comes is `node.constants.FAR_FUTURE_NS`. What a kind of device keeps stands in its profile
(`node.kinds`), and in every record.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
import numpy.typing as npt

from coulombus.eds.codec import PdoRecord
from coulombus.kernels.records import (
    FloatField,
    IntegerField,
    Record,
    RecordArray,
    dtype_of,
    new_records,
)
from coulombus.node.constants import (
    BLOCK_SEGMENTS,
    EMCY_WAITING,
    FAR_FUTURE_NS,
    INPUTS,
    MAX_CONSUMERS,
    MAX_HISTORY,
    MAX_PDOS,
    MAX_SDO_SERVERS,
    OUTBOX,
    OUTPUTS,
    PORTS,
    SLOTS,
)
from coulombus.wire.clock import Clock

__all__ = ["LOOP_WORDS", "NODE", "BrakeFields", "DriveFields", "InputOutputFields", "NodeRecord", "new_nodes"]


class DriveFields(Record):
    """What a drive of CiA 402 keeps in its record."""

    # simulated inputs, in the drive's own units
    in_position_counts: int  # of the encoder
    in_velocity_counts_s: float  # its speed
    in_torque_pm: float  # per mille of rated
    # simulated output
    out_torque_pm: float  # 0 unless Operation Enabled
    # its state
    power_state: int  # a `PowerState`
    torque_demand_pm: float  # behind slope and limits, per mille of the rated torque
    demand_ns: int  # when torque_demand_pm was computed
    controlword: int  # the last one that was acted upon: for the edge of bit 7
    limited: int  # the set-point is above 6072h now
    mode: int  # the mode that acts: 6061h; 0 for one that is not there
    slowing: int  # node.motion402's ramp on the way to torque 0, or 0
    slowing_to: int  # the power state that follows it
    slowing_ns: int  # when it began
    guarded: int  # 607Dh or 6080h may limit
    speed_max_counts_s: float  # 6080h
    speed_demand: float  # counts/s
    speed_kp: float  # per mille per count/s
    speed_ki: float  # per mille per count
    integral_pm: float  # of the velocity controller
    off_target_ns: int  # when the speed was last outside its window 606Dh ...
    moving_ns: int  # ... and last above its threshold 606Fh
    abort_by_option: int  # 1: 6007h decides what a lost host does, as CiA 402 says; 0: it is a fault always
    vendor_mode: int  # a mode of the maker's own, whose set-point acts at once; 0: none
    vendor_pm: float  # per mille of rated torque for one count of its set-point
    vendor_slot: int  # where that stands
    supply_mV: int  # what 6079h shows while the supply is there


class BrakeFields(Record):
    """What the brake, a controller of CiA 404, keeps in its record."""

    # simulated inputs
    in_handle_Nm: float  # of the torque transducer
    in_coil_A: float  # of the coil
    in_coil_degC: float  # of the coil
    # simulated outputs
    out_brake_Nm: float  # >= 0 always
    out_reverse_A: float  # current of the demagnetisation pulse, only while out_brake_Nm is 0
    # output block and input blocks
    setpoint_high: int  # high limit of 7300h:01 in the EDS, raw
    ao_gain_Nm: float  # torque = 7300h:01 * gain + bias (6302h, 7320h to 7323h)
    ao_bias_Nm: float  # ... and what is added
    ao_full_Nm: float  # full scale, no output is above it
    ao_FV_Nm: float  # 7330h:01 for one Nm
    ai_gain: Annotated[FloatField, 3]  # 6126h * 10 ** 6132h
    ai_bias: Annotated[FloatField, 3]  # (6127h + 6124h) * 10 ** 6132h
    ai_low: Annotated[FloatField, 3]  # 7148h and 7149h; the other way round for a channel that is off
    ai_high: Annotated[FloatField, 3]  # ... and above it an input is out of range
    # coil
    coil_A_Nm: float  # what the coil draws for one Nm, told by the rig; 0: no coil is known
    max_A: float  # 2010h
    short_A: float  # more current than commanded, a short circuit
    least_A: float  # less current at a command is an open circuit
    open_ns: int  # for so long
    open_since_ns: int  # command without current since then; -1: no
    warm_degC: float  # 2011h
    hot_degC: float  # from here on the coil is off
    cooled_degC: float  # below it the over-temperature is over
    share_left: float  # of max_A, at hot_degC
    derated: int  # 1: a warm coil gives less
    limit_Nm: float  # what max_A and the board allow now
    board_Nm: float  # most that the hardware may put out (an I/O file); 0: it sets no limit
    demag_A: float  # 2012h
    demag_ns: int  # how long the pulse lasts
    demag_delay_ns: int  # after the output came to 0
    pulse_due: int  # 1: the output was above 0 since the last pulse
    pulse_ns: int  # when the pulse begins
    # ramp to the fault value
    ramp_to_Nm: float  # where it ends
    ramp_from_Nm: float  # where it began
    ramp_start_ns: int  # when it began


class InputOutputFields(Record):
    """What an input and output module of CiA 401 keeps in its record."""

    in_digital: Annotated[IntegerField, PORTS]  # of each port, its bits
    in_analogue: Annotated[IntegerField, INPUTS]  # raw, as 6401h
    out_digital: Annotated[IntegerField, PORTS]  # of each port, its bits
    out_analogue: Annotated[IntegerField, OUTPUTS]  # raw, as 6411h
    board_low: Annotated[IntegerField, OUTPUTS]  # what the hardware may put out, raw; both alike: it sets no limit
    board_high: Annotated[IntegerField, OUTPUTS]  # ... at most
    analogue_most: int  # largest count of an analogue channel
    failed: int  # bits of the outputs, as in `carries`, that wait for a new value


class NodeRecord(Clock, DriveFields, BrakeFields, InputOutputFields):
    """One device."""

    # who and when
    station: int  # number of its station on the bus: its row
    node_id: int  # 1 to 127
    kind: int  # number of its profile in node.kinds; 0: generic
    nmt: int  # NmtState
    powered: int  # 1: it is switched on
    next_ns: int  # when on_time wants to be called; FAR_FUTURE_NS: never
    processing_ns: int  # from a frame or an event to the answer that is ready to be sent
    # simulated inputs that every kind has (written by sim_bus). After a change of one of them
    # set next_ns to the
    # present: both are looked at on SYNC, on an RPDO and on time
    in_supply_ok: int  # 1: its supply is there
    in_faults: int  # device faults that are present, bits of node.emcy's causes
    # counters
    dropped_length: int  # RPDOs or SYNCs of a wrong length, NMT or heartbeat frames too short
    dropped_unknown: int  # frames of this node that do not fit its state (a PDO while not OPERATIONAL ...)
    dropped_window: int  # synchronous RPDOs that came after the window of 1007h
    excess_length: int  # RPDOs longer than mapped, of which the first bytes were used
    negative_setpoints: int  # of the brake, taken as 0
    clipped_setpoints: int  # above the EDS' high limit (brake), above 6072h (drive)
    emcy_count: int  # EMCYs that it has sent
    # SYNC
    sync_ns: int  # the last one
    sync_armed: int  # one was seen since OPERATIONAL
    sync_overflow: int  # 1019h
    sync_id: int  # COB-ID of 1005h
    sync_producer_ns: int  # period of 1006h when 1005h's bit 30 is set, else 0
    sync_next_ns: int  # when the next one is due
    sync_counter: int  # of the next one (1019h)
    sync_window_ns: int  # 1007h; 0: none
    # NMT, heartbeats, error behaviour
    heartbeat_ns: int  # 1017h; 0: none
    heartbeat_next_ns: int  # when the next one is due
    error_behaviour: int  # 1029h:01, communication: 0 to PRE-OPERATIONAL, 1 no change, 2 to STOPPED
    device_error_behaviour: int  # 1029h:02, a fault of the device itself
    consumers_used: int  # 1 + the last entry of 1016h that watches
    consumer_id: Annotated[IntegerField, MAX_CONSUMERS]  # node that is watched
    consumer_ns: Annotated[IntegerField, MAX_CONSUMERS]  # its time of 1016h; 0: none
    consumer_last_ns: Annotated[IntegerField, MAX_CONSUMERS]  # its last heartbeat
    consumer_state: Annotated[IntegerField, MAX_CONSUMERS]  # 0 waits for the first heartbeat, 1 alive, 2 lost
    # node guarding
    guard_on: int  # 1: remote frames on 700h + id are answered (1017h is 0)
    guard_toggle: int  # the next answer's toggle bit
    guard_life_ns: int  # 100Ch x 100Dh; 0: not watched
    guard_last_ns: int  # the last remote frame
    guard_state: int  # 0 waits for the first remote frame, 1 alive, 2 lost
    # TIME
    time_id: int  # COB-ID of 1012h
    time_set_ns: int  # when the time of day was told; -1: never
    time_word: int  # what was told: bits 0-27 ms after midnight, bits 32-47 days since 1984-01-01
    # PDOs
    rpdo: Annotated[RecordArray[PdoRecord], MAX_PDOS]  # what it receives
    tpdo: Annotated[RecordArray[PdoRecord], MAX_PDOS]  # what it sends
    rpdo_ns: Annotated[IntegerField, MAX_PDOS]  # last reception
    rpdo_armed: Annotated[IntegerField, MAX_PDOS]  # its deadline is watched
    rpdo_lost: Annotated[IntegerField, MAX_PDOS]  # 1: its deadline is over, which was told
    rpdo_pending: int  # how many RPDOs wait for the next SYNC
    rpdo_waits: Annotated[IntegerField, MAX_PDOS]  # this one does
    rpdo_word: Annotated[IntegerField, MAX_PDOS]  # what came last
    rpdo_carries: Annotated[IntegerField, MAX_PDOS]  # bits `acts` of the objects that it maps (node.profile)
    rpdo_next: Annotated[IntegerField, MAX_PDOS]  # next RPDO with the same COB-ID, or -1
    rpdo_used: int  # 1 + the last valid RPDO
    tpdo_used: int  # 1 + the last valid TPDO
    tpdo_events: int  # how many valid TPDOs are sent on events (transmission type 254, 255)
    tpdo_count: Annotated[
        IntegerField, MAX_PDOS
    ]  # SYNCs since the last transmission; -1: waits for the SYNC start value
    tpdo_ns: Annotated[IntegerField, MAX_PDOS]  # last transmission
    tpdo_word: Annotated[IntegerField, MAX_PDOS]  # what was sent last; sampled at SYNC for transmission type 252
    tpdo_due: Annotated[IntegerField, MAX_PDOS]  # an event waits for the end of the inhibit time
    tpdo_mask: Annotated[IntegerField, MAX_PDOS]  # bits whose change is an event
    # EMCY
    causes: int  # present now
    detected: int  # device faults that the device found itself, as in_faults
    held: int  # causes that stay latched until the reset of the kind
    latched: int  # told by an EMCY and not yet reset
    emcy_id: int  # -1: none
    emcy_inhibit_ns: int  # 1015h; between two EMCYs at least
    emcy_ready_ns: int  # the next one goes out then at the earliest
    emcy_waiting: int  # how many wait
    emcy_word: Annotated[IntegerField, EMCY_WAITING]  # those that wait
    history_count: int  # entries of 1003h
    history: Annotated[IntegerField, MAX_HISTORY]  # 1003h, newest first
    silent_ns: int  # until then it hears and sends nothing (LSS: activate bit timing)
    # SDO server: a transfer that stands still is aborted by the core
    sdo_used: int  # 1 + the last valid channel
    sdo_deadline_ns: Annotated[IntegerField, MAX_SDO_SERVERS]  # of each channel; FAR_FUTURE_NS: no transfer
    sdo_abort_id: Annotated[IntegerField, MAX_SDO_SERVERS]  # identifier of the abort that is sent then
    sdo_abort_word: Annotated[IntegerField, MAX_SDO_SERVERS]  # ... and its data
    # segments of block downloads that the core collects; Python opens and closes a channel's
    # row
    segments_open: int  # how many rows are open
    segments_id: Annotated[IntegerField, MAX_SDO_SERVERS]  # identifier of the requests; 0: closed
    segments_next: Annotated[IntegerField, MAX_SDO_SERVERS]  # number of the segment that comes next
    segments_last: Annotated[IntegerField, MAX_SDO_SERVERS]  # number of the block's last segment
    segments_count: Annotated[IntegerField, MAX_SDO_SERVERS]  # collected and not yet taken by Python
    segments_word: Annotated[IntegerField, (MAX_SDO_SERVERS, BLOCK_SEGMENTS)]  # what was collected
    # what the core uploads by itself, sorted by key
    sdo_rx_id: int  # of the first server; -1: none
    sdo_tx_id: int  # ... and of its answers
    fast_count: int  # rows of the table
    fast_key: Annotated[IntegerField, SLOTS]  # index x 256 + sub-index
    fast_slot: Annotated[IntegerField, SLOTS]  # where the value stands
    fast_size: Annotated[IntegerField, SLOTS]  # bytes, 1 to 4
    # segments of block uploads, a ring
    outbox_first: int  # the ring's first segment
    outbox_count: int  # how many wait
    outbox_next_ns: int  # when the next one goes out
    outbox_channel: Annotated[IntegerField, OUTBOX]  # of each, its channel
    outbox_id: Annotated[IntegerField, OUTBOX]  # ... identifier
    outbox_word: Annotated[IntegerField, OUTBOX]  # ... and data
    # set-point of a kind that has one
    setpoint_ns: int  # reception of the one that acts
    setpoint_armed: int  # its age is watched (since the first RPDO that carries one)
    setpoint_stale: int  # 1: it is older than it may be, which was told
    ramping: int  # brake: 0 the set-point acts, 1 on the way to the fault value, 2 there; drive: 1 on a slope
    # tables
    values: Annotated[IntegerField, SLOTS]  # raw values of the objects, REAL as bit patterns
    rerouted: int  # 1: `route` was written; the reader that indexes it (sim_bus.network.agenda) clears it
    route: Annotated[IntegerField, 2048, np.int16]  # node.core's route of each identifier
    rtr_route: Annotated[IntegerField, 2048, np.int16]  # the same of remote frames


NODE = dtype_of(NodeRecord)


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


def new_nodes(n: int) -> RecordArray[NodeRecord]:
    """Return the records of `n` nodes that are powered off; none of their PDOs is valid."""
    nodes: RecordArray[NodeRecord] = new_records(NodeRecord, n)
    nodes["next_ns"] = FAR_FUTURE_NS
    nodes["processing_ns"] = 20_000
    nodes["in_supply_ok"] = 1
    nodes["sdo_deadline_ns"] = FAR_FUTURE_NS
    nodes["time_set_ns"] = -1
    nodes["outbox_next_ns"] = FAR_FUTURE_NS
    nodes["station"] = np.arange(n)
    nodes["rpdo"]["cob_id"] = nodes["tpdo"]["cob_id"] = -1
    return nodes
