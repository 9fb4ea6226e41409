"""Record of a node, shared by its compiled core and its Python services, and its capacities.

`new_nodes` creates the records of several nodes at once; a kernel takes one of them, by reference.
The record contains the node's PDOs. Everything is int64 or float64; times are int64 nanoseconds; a
time that never comes is `NEVER_NS`. The fields of each kind of device are
declared in its profile (`node.kinds`), and are in every record.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
import numpy.typing as npt

from coulombus.eds.codec import PdoRecord
from coulombus.eds.sdo_frames import BLOCK_SEGMENTS
from coulombus.kernels.records import (
    FloatField,
    IntegerField,
    Record,
    RecordArray,
    dtype_of,
    new_records,
)
from coulombus.wire.clock import NEVER_NS, Clock

__all__ = [
    "EMCY_WAITING",
    "INPUTS",
    "LOOP_WORDS",
    "MAX_CONSUMERS",
    "MAX_HISTORY",
    "MAX_PDOS",
    "MAX_SDO_SERVERS",
    "NODE",
    "OUTBOX",
    "OUTPUTS",
    "PORTS",
    "SDO_TIMEOUT_NS",
    "SLOTS",
    "SPARE_SLOTS",
    "BrakeFields",
    "DriveFields",
    "InputOutputFields",
    "NodeRecord",
    "new_nodes",
]

SLOTS = 1024
PORTS, INPUTS, OUTPUTS = 8, 16, 8  # largest number of digital ports per direction, analogue inputs, outputs
SPARE_SLOTS = 256  # for objects that a PDO maps later, in addition to the EDS's
MAX_PDOS = 128  # per direction: those of two axes of a drive
MAX_CONSUMERS = 127  # checked entries of 1016h
MAX_SDO_SERVERS = 128  # 1200h to 127Fh
OUTBOX = 1024  # pending segments of block uploads
MAX_HISTORY = 8  # entries of 1003h
EMCY_WAITING = 8  # EMCY messages pending until the end of the inhibit time
SDO_TIMEOUT_NS = 1_000_000_000
"""An SDO transfer without progress for this time is aborted (0504 0000h)."""


class DriveFields(Record):
    """Fields of a CiA 402 drive in the record."""

    # simulated inputs, in the drive's own units
    in_position_counts: int  # position of the encoder
    in_velocity_counts_s: float  # velocity of the encoder
    in_torque_pm: float  # torque, per mille of rated
    # simulated output
    out_torque_pm: float  # 0 unless Operation Enabled
    # state
    power_state: int  # a `PowerState`
    torque_demand_pm: float  # torque after slope and limits, per mille of the rated torque
    demand_ns: int  # time at which torque_demand_pm was computed
    controlword: int  # last controlword that acted: for the edge of bit 7
    limited: int  # 1: the set-point is above 6072h now
    mode: int  # active mode: 6061h; 0 for an unsupported mode
    slowing: int  # active ramp of node.motion402 to torque 0, or 0
    slowing_to: int  # power state after the ramp
    slowing_ns: int  # time at which the ramp began
    speed_demand: float  # speed demand, counts/s
    speed_kp: float  # proportional gain, per mille per count/s
    speed_ki: float  # integral gain, per mille per count
    integral_pm: float  # integral of the velocity controller
    off_target_ns: int  # last time at which the speed was outside its window 606Dh
    moving_ns: int  # last time at which the speed was above its threshold 606Fh
    abort_by_option: int  # 1: 6007h determines the reaction to a lost host, as in CiA 402; 0: always a fault
    vendor_mode: int  # vendor-specific mode, whose set-point acts at once; 0: none
    vendor_pm: float  # per mille of rated torque per count of its set-point
    vendor_slot: int  # slot of its set-point
    supply_mV: int  # value of 6079h while the supply is present
    modes: int  # offered modes, as in 6502h
    servo: int  # address of the function of node.servo402; 0: the drive is no servo drive
    # axis (node.axis402)
    load_counts_s2: float  # acceleration of the axis by one per mille of torque, counts/s^2; 0: unknown
    unit_counts_s: float  # counts/s in one unit of 606Ch (60A9h)
    zero_counts: int  # position of the axis at which 6064h is 0
    index_counts: float  # counts of one turn of the motor, from one index pulse to the next
    switch_counts: Annotated[FloatField, 4]  # places: negative limit, home from and to, positive limit
    probe_function: int  # 60B8h that acts
    probe_counts: float  # position at the last look at the probes
    # position profile (node.trapezoid) and position control (node.position402)
    profile_ns: int  # start of the profile
    profile_end_ns: int  # its end
    profile_from: float  # position at its start
    profile_from_speed: float  # speed at its start, counts/s
    profile_to: float  # position at its end
    profile_to_speed: float  # speed at its end, counts/s
    stretch_s: Annotated[FloatField, 4]  # duration of each stretch
    stretch_a: Annotated[FloatField, 4]  # its acceleration, counts/s^2
    position_demand: float  # demand now, counts
    profile_speed: float  # its speed, counts/s
    profile_acceleration: float  # its acceleration, counts/s^2
    position_kp: float  # gain of the position controller, 1/s
    feed_forward_pm: float  # torque added to the velocity controller
    following_ns: int  # last time at which the following error was within 6065h
    following_lost: int  # 1: it has been larger for longer than 6066h
    stalled_s: float  # duration of the torque limit at standstill, s
    period_ns: int  # time between cyclic set-points, 60C2h; 0: as measured
    cyclic_ns: int  # reception of the last cyclic set-point; -1: none
    # profile position: the active set-point, and the one that waits
    target_counts: float  # active target
    target_speed: float  # profile speed of the active set-point, counts/s
    target_limited: int  # 1: 607Dh limits the active target
    acknowledged: int  # bit 12 of the statusword
    halted: int  # 1: halt acts
    waiting: int  # 1: a set-point waits
    waiting_counts: float  # its target
    waiting_speed: float  # its profile speed, counts/s
    waiting_up: float  # its acceleration, counts/s^2
    waiting_down: float  # its deceleration, counts/s^2
    waiting_limited: int  # 1: 607Dh limits its target
    # homing (node.homing402)
    homing: int  # a `homing402` stage
    homing_ns: int  # start of the homing
    homing_direction: float  # of the present search, 1 or -1
    homing_inputs: int  # switches at the last look
    homing_counts: float  # position of the axis at the last look
    home_counts: float  # place of the home position


class BrakeFields(Record):
    """Fields of the brake, a CiA 404 controller, in the record."""

    # simulated inputs
    in_handle_Nm: float  # torque of the torque transducer
    in_coil_A: float  # coil current
    in_coil_degC: float  # coil temperature
    # simulated outputs
    out_brake_Nm: float  # brake torque, always >= 0
    out_reverse_A: float  # current of the demagnetisation pulse, only while out_brake_Nm is 0
    # output block and input blocks
    setpoint_high: int  # high limit of 7300h:01 in the EDS, raw
    ao_gain_Nm: float  # torque = 7300h:01 * gain + bias (6302h, 7320h to 7323h)
    ao_bias_Nm: float  # bias of this line
    ao_full_Nm: float  # full scale, the largest output
    ao_FV_Nm: float  # value of 7330h:01 per Nm
    ai_gain: Annotated[FloatField, 3]  # 6126h * 10 ** 6132h
    ai_bias: Annotated[FloatField, 3]  # (6127h + 6124h) * 10 ** 6132h
    ai_low: Annotated[FloatField, 3]  # lower limit 7148h; above ai_high for a disabled channel
    ai_high: Annotated[FloatField, 3]  # upper limit 7149h
    # coil
    coil_A_Nm: float  # coil current per Nm, from the rig; 0: no coil is known
    max_A: float  # current limit, 2010h
    short_A: float  # current above the command that means a short circuit
    least_A: float  # command above which too little current means an open circuit
    open_ns: int  # duration until that is an open circuit
    open_since_ns: int  # time since which a command has no current; -1: it has
    warm_degC: float  # warning temperature, 2011h
    hot_degC: float  # temperature from which the coil is off
    cooled_degC: float  # temperature below which the over-temperature is over
    share_left: float  # share of max_A at hot_degC
    derated: int  # 1: a warm coil has less torque
    limit_Nm: float  # torque limit by max_A and the board now
    board_Nm: float  # largest torque of the hardware (an I/O file); 0: no limit
    demag_A: float  # current of the demagnetisation pulse, 2012h
    demag_ns: int  # duration of the pulse
    demag_delay_ns: int  # delay after the output reached 0
    pulse_due: int  # 1: the output was above 0 since the last pulse
    pulse_ns: int  # start of the pulse
    # ramp to the fault value
    ramp_to_Nm: float  # end value of the ramp
    ramp_from_Nm: float  # start value of the ramp
    ramp_start_ns: int  # start time of the ramp


class InputOutputFields(Record):
    """Fields of a CiA 401 input and output module in the record."""

    in_digital: Annotated[IntegerField, PORTS]  # bits of each port
    in_analogue: Annotated[IntegerField, INPUTS]  # raw, as in 6401h
    out_digital: Annotated[IntegerField, PORTS]  # bits of each port
    out_analogue: Annotated[IntegerField, OUTPUTS]  # raw, as in 6411h
    board_low: Annotated[IntegerField, OUTPUTS]  # lower limit of the hardware, raw; equal to board_high: no limit
    board_high: Annotated[IntegerField, OUTPUTS]  # upper limit of the hardware, raw
    analogue_most: int  # largest count of an analogue channel
    failed: int  # bits of the outputs, as in `carries`, that wait for a new value after a failure


class NodeRecord(Clock, DriveFields, BrakeFields, InputOutputFields):
    """State of one device."""

    # identity and time
    station: int  # number of its station on the bus, which is its row
    node_id: int  # 1 to 127
    kind: int  # number of its profile in node.kinds; 0: generic
    nmt: int  # NmtState
    powered: int  # 1: the device is switched on
    next_ns: int  # time of the next call of on_time; NEVER_NS: never
    processing_ns: int  # time from a frame or an event until the answer is ready
    # simulated inputs of every kind (written by sim_bus). After a change of an input set next_ns to the
    # present: both inputs are read on SYNC, on an RPDO and on time
    in_supply_ok: int  # 1: the supply is present
    in_faults: int  # present device faults, bits of node.emcy's causes
    # counters
    dropped_length: int  # RPDOs or SYNCs of a wrong length, too short NMT or heartbeat frames
    dropped_unknown: int  # frames for this node that do not fit its state (a PDO while not OPERATIONAL ...)
    dropped_window: int  # synchronous RPDOs that came after the window of 1007h
    excess_length: int  # RPDOs longer than mapped; their first bytes were used
    negative_setpoints: int  # negative set-points of the brake, which act as 0
    clipped_setpoints: int  # set-points above the EDS's high limit (brake), above 6072h (drive)
    emcy_count: int  # EMCYs sent
    # SYNC
    sync_ns: int  # time of the last SYNC
    sync_armed: int  # 1: a SYNC came since OPERATIONAL
    sync_overflow: int  # counter overflow value, 1019h
    sync_id: int  # COB-ID of 1005h
    sync_producer_ns: int  # period of 1006h if bit 30 of 1005h is set, else 0
    sync_next_ns: int  # time of the next SYNC to produce
    sync_counter: int  # counter of the next SYNC (1019h)
    sync_window_ns: int  # window, 1007h; 0: none
    # NMT, heartbeats, error behaviour
    heartbeat_ns: int  # producer time, 1017h; 0: none
    heartbeat_next_ns: int  # time of the next heartbeat
    error_behaviour: int  # 1029h:01, communication: 0 to PRE-OPERATIONAL, 1 no change, 2 to STOPPED
    device_error_behaviour: int  # 1029h:02, device fault
    consumers_used: int  # 1 + the last used entry of 1016h
    consumer_id: Annotated[IntegerField, MAX_CONSUMERS]  # monitored node
    consumer_ns: Annotated[IntegerField, MAX_CONSUMERS]  # time of 1016h; 0: none
    consumer_last_ns: Annotated[IntegerField, MAX_CONSUMERS]  # last heartbeat
    consumer_state: Annotated[IntegerField, MAX_CONSUMERS]  # 0 waiting for the first heartbeat, 1 alive, 2 lost
    # node guarding
    guard_on: int  # 1: remote frames on 700h + id are answered (1017h is 0)
    guard_toggle: int  # toggle bit of the next answer
    guard_life_ns: int  # life time, 100Ch x 100Dh; 0: not checked
    guard_last_ns: int  # last remote frame
    guard_state: int  # 0 waiting for the first remote frame, 1 alive, 2 lost
    # TIME
    time_id: int  # COB-ID of 1012h
    time_set_ns: int  # time of the last TIME message; -1: none
    time_word: int  # its content: bits 0-27 ms after midnight, bits 32-47 days since 1984-01-01
    # PDOs
    rpdo: Annotated[RecordArray[PdoRecord], MAX_PDOS]  # received PDOs
    tpdo: Annotated[RecordArray[PdoRecord], MAX_PDOS]  # sent PDOs
    rpdo_ns: Annotated[IntegerField, MAX_PDOS]  # last reception
    rpdo_armed: Annotated[IntegerField, MAX_PDOS]  # 1: its deadline is checked
    rpdo_lost: Annotated[IntegerField, MAX_PDOS]  # 1: its deadline has passed, which was reported
    rpdo_pending: int  # number of RPDOs that wait for the next SYNC
    rpdo_waits: Annotated[IntegerField, MAX_PDOS]  # 1: this RPDO waits for the next SYNC
    rpdo_word: Annotated[IntegerField, MAX_PDOS]  # last data received
    rpdo_carries: Annotated[IntegerField, MAX_PDOS]  # bits `acts` of the objects that it maps (node.profile)
    rpdo_next: Annotated[IntegerField, MAX_PDOS]  # next RPDO with the same COB-ID, or -1
    rpdo_used: int  # 1 + the last valid RPDO
    tpdo_used: int  # 1 + the last valid TPDO
    tpdo_events: int  # number of valid TPDOs that are sent on events (transmission type 254, 255)
    tpdo_count: Annotated[
        IntegerField, MAX_PDOS
    ]  # SYNCs since the last transmission; -1: waiting for the SYNC start value
    tpdo_ns: Annotated[IntegerField, MAX_PDOS]  # last transmission
    tpdo_word: Annotated[IntegerField, MAX_PDOS]  # last data sent; sampled at SYNC for transmission type 252
    tpdo_due: Annotated[IntegerField, MAX_PDOS]  # an event waits for the end of the inhibit time
    tpdo_mask: Annotated[IntegerField, MAX_PDOS]  # bits whose change is an event
    # EMCY
    causes: int  # present causes
    detected: int  # device faults detected by the device itself, as in in_faults
    held: int  # causes that stay latched until the kind's reset
    latched: int  # causes reported by an EMCY and not yet reset
    emcy_id: int  # -1: none
    emcy_inhibit_ns: int  # 1015h, least time between two EMCYs
    emcy_ready_ns: int  # earliest time of the next EMCY
    emcy_waiting: int  # number of queued EMCYs
    emcy_word: Annotated[IntegerField, EMCY_WAITING]  # queued EMCYs
    history_count: int  # entries of 1003h
    history: Annotated[IntegerField, MAX_HISTORY]  # 1003h, newest first
    silent_ns: int  # end of silence: until then it neither receives nor sends (LSS: activate bit timing)
    # SDO server: the core aborts a transfer without progress
    sdo_used: int  # 1 + the last valid channel
    sdo_deadline_ns: Annotated[IntegerField, MAX_SDO_SERVERS]  # deadline of each channel; NEVER_NS: no transfer
    sdo_abort_id: Annotated[IntegerField, MAX_SDO_SERVERS]  # identifier of the abort sent at the deadline
    sdo_abort_word: Annotated[IntegerField, MAX_SDO_SERVERS]  # data of the abort
    # segments of block downloads that the core collects; Python opens and closes a channel's row
    segments_open: int  # number of open rows
    segments_id: Annotated[IntegerField, MAX_SDO_SERVERS]  # identifier of the requests; 0: closed
    segments_next: Annotated[IntegerField, MAX_SDO_SERVERS]  # number of the next segment
    segments_last: Annotated[IntegerField, MAX_SDO_SERVERS]  # number of the block's last segment
    segments_count: Annotated[IntegerField, MAX_SDO_SERVERS]  # segments collected and not yet taken by Python
    segments_word: Annotated[IntegerField, (MAX_SDO_SERVERS, BLOCK_SEGMENTS)]  # collected data
    # objects that the core uploads by itself, sorted by key
    sdo_rx_id: int  # request identifier of the first server; -1: none
    sdo_tx_id: int  # its response identifier
    fast_count: int  # rows of the table
    fast_key: Annotated[IntegerField, SLOTS]  # index x 256 + sub-index
    fast_slot: Annotated[IntegerField, SLOTS]  # slot of the value
    fast_size: Annotated[IntegerField, SLOTS]  # bytes, 1 to 4
    # segments of block uploads, a ring
    outbox_first: int  # index of the first segment
    outbox_count: int  # number of queued segments
    outbox_next_ns: int  # time of the next transmission
    outbox_channel: Annotated[IntegerField, OUTBOX]  # channel of each segment
    outbox_id: Annotated[IntegerField, OUTBOX]  # identifier of each segment
    outbox_word: Annotated[IntegerField, OUTBOX]  # data of each segment
    # set-point, for kinds that have one
    setpoint_ns: int  # reception of the active set-point
    setpoint_armed: int  # 1: its age is checked (since the first RPDO that carries a set-point)
    setpoint_stale: int  # 1: the set-point is too old, which was reported
    ramping: int  # brake: 0 the set-point acts, 1 ramp to the fault value, 2 ramp ended; drive: 1 on a slope
    # tables
    values: Annotated[IntegerField, SLOTS]  # raw values of the objects, REAL as bit patterns
    rerouted: int  # 1: `route` was written; its reader with an index (sim_bus.network.deadline_tree) clears this
    route: Annotated[IntegerField, 2048, np.int16]  # route of each identifier, see node.core
    rtr_route: Annotated[IntegerField, 2048, np.int16]  # route of remote frames


NODE = dtype_of(NodeRecord)


SERVICES_ONLY = (
    *("rpdo", "tpdo", "fast_key", "fast_slot", "fast_size"),
    *("outbox_channel", "outbox_id", "outbox_word", "route", "rtr_route"),
)
"""Fields, most of a record, that only the Python services write; the core reads them."""


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
"""Words of a record that the core may write and that its Python services must follow: runs, first and last
+ 1.
"""


def new_nodes(n: int) -> RecordArray[NodeRecord]:
    """Return the records of `n` nodes that are powered off; their PDOs are not valid."""
    nodes: RecordArray[NodeRecord] = new_records(NodeRecord, n)
    nodes["next_ns"] = NEVER_NS
    nodes["processing_ns"] = 20_000
    nodes["in_supply_ok"] = 1
    nodes["sdo_deadline_ns"] = NEVER_NS
    nodes["time_set_ns"] = -1
    nodes["outbox_next_ns"] = NEVER_NS
    nodes["station"] = np.arange(n)
    nodes["unit_counts_s"] = 1.0
    nodes["switch_counts"] = -np.inf, np.inf, np.inf, np.inf
    nodes["rpdo"]["cob_id"] = nodes["tpdo"]["cob_id"] = -1
    return nodes
