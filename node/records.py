"""The one record of a node, which its compiled core and its Python services share.

`new_nodes` makes the records of several nodes at once: the core addresses a node by its row, so that one kernel serves
a whole bus. Everything is int64 or float64; times are int64 nanoseconds; a time that never comes is `FAR_FUTURE_NS`.
"""

from __future__ import annotations

import numpy as np

from eds.codec import PDO
from wire.frame import Records

__all__ = [
    "FAR_FUTURE_NS",
    "KIND_BRAKE",
    "KIND_DRIVE",
    "KIND_GENERIC",
    "MAX_CONSUMERS",
    "MAX_HISTORY",
    "MAX_PDOS",
    "NODE",
    "SLOTS",
    "new_nodes",
]

SLOTS = 384
MAX_PDOS = 8  # of each direction
MAX_CONSUMERS = 8  # entries of 1016h that are watched
MAX_HISTORY = 8  # entries of 1003h
FAR_FUTURE_NS = 1 << 62

KIND_GENERIC, KIND_DRIVE, KIND_BRAKE = 0, 1, 2

_I, _F = np.int64, np.float64

NODE = np.dtype(
    [
        # who and when
        ("node_id", _I),
        ("kind", _I),  # 0 generic, 1 drive, 2 brake
        ("nmt", _I),  # NmtState
        ("powered", _I),
        ("next_ns", _I),  # when on_time wants to be called; FAR_FUTURE_NS: never
        ("processing_ns", _I),  # from a frame or an event to the answer that is ready to be sent
        # simulated inputs, in the device's own units (written by sim_bus). After a change of in_supply_ok or in_faults
        # set next_ns to the present: both are looked at on SYNC, on an RPDO and on time
        ("in_position_counts", _I),
        ("in_velocity_counts_s", _F),
        ("in_torque_pm", _F),  # per mille of rated
        ("in_supply_ok", _I),
        ("in_faults", _I),  # device faults that are present, bits of node.emcy's causes
        ("in_handle_Nm", _F),
        ("in_coil_A", _F),
        ("in_coil_degC", _F),
        # simulated outputs (read by sim_bus)
        ("out_torque_pm", _F),  # 0 unless Operation Enabled
        ("out_brake_Nm", _F),  # >= 0 always
        # counters
        ("dropped_length", _I),  # RPDOs or SYNCs of a wrong length, NMT or heartbeat frames too short
        ("dropped_unknown", _I),  # frames of this node that do not fit its state (a PDO while not OPERATIONAL ...)
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
        # NMT, heartbeats, error behaviour
        ("heartbeat_ns", _I),  # 1017h; 0: none
        ("heartbeat_next_ns", _I),
        ("error_behaviour", _I),  # 1029h:01: 0 to PRE-OPERATIONAL, 1 no change, 2 to STOPPED
        ("consumer_id", _I, (MAX_CONSUMERS,)),  # node that is watched
        ("consumer_ns", _I, (MAX_CONSUMERS,)),  # its time of 1016h; 0: none
        ("consumer_last_ns", _I, (MAX_CONSUMERS,)),
        ("consumer_state", _I, (MAX_CONSUMERS,)),  # 0 waits for the first heartbeat, 1 alive, 2 lost
        # PDOs
        ("rpdo_ns", _I, (MAX_PDOS,)),  # last reception
        ("rpdo_armed", _I, (MAX_PDOS,)),  # its deadline is watched
        ("rpdo_lost", _I, (MAX_PDOS,)),
        ("rpdo_pending", _I),  # bit k: RPDO k waits for the next SYNC
        ("rpdo_word", _I, (MAX_PDOS,)),
        ("rpdo_carries", _I, (MAX_PDOS,)),  # bit 0: a controlword, bit 1: a set-point
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
        ("latched", _I),  # told by an EMCY and not yet reset
        ("emcy_id", _I),  # -1: none
        ("emcy_inhibit_ns", _I),
        ("emcy_ready_ns", _I),
        ("history_count", _I),
        ("history", _I, (MAX_HISTORY,)),  # 1003h, newest first
        # SDO server: a transfer that stands still is aborted by the core
        ("sdo_deadline_ns", _I),
        ("sdo_abort_id", _I),
        ("sdo_abort_word", _I),
        # set-point of a drive or a brake
        ("setpoint_ns", _I),  # reception of the one that acts
        ("setpoint_armed", _I),  # its age is watched (since the first RPDO that carries one)
        ("setpoint_stale", _I),
        # drive (CiA 402)
        ("power_state", _I),
        ("torque_demand_pm", _F),
        ("demand_ns", _I),  # when torque_demand_pm was computed
        ("controlword", _I),  # the last one that was acted upon: for the edge of bit 7
        ("limited", _I),  # the set-point is above 6072h now
        ("supply_mV", _I),  # what 6079h shows while the supply is there
        # brake (CiA 404)
        ("setpoint_high", _I),  # high limit of 7300h:01 in the EDS, raw
        ("ao_unit_Nm", _F),  # 10 ** -6302h:01
        ("ai_gain", _F, (3,)),  # 6126h * 10 ** 6132h
        ("ai_bias", _F, (3,)),  # 6127h * 10 ** 6132h
        ("ramp_from_Nm", _F),
        ("ramp_start_ns", _I),
        ("ramping", _I),  # brake: 0 the set-point acts, 1 on the way to the fault value, 2 there; drive: 1 on a slope
        # tables
        ("values", _I, (SLOTS,)),  # raw values of the objects, REAL as bit patterns
        ("route", np.int8, (2048,)),  # node.core's route of each identifier
        ("rtr_route", np.int8, (2048,)),
    ],
    align=True,
)


def new_nodes(n: int) -> tuple[Records, Records, Records]:
    """Return the records of `n` nodes that are powered off, their RPDOs and their TPDOs (all not valid)."""
    nodes = np.zeros(n, NODE).view(np.recarray)
    nodes["next_ns"] = FAR_FUTURE_NS
    nodes["processing_ns"] = 20_000
    nodes["in_supply_ok"] = 1
    rpdo = np.zeros((n, MAX_PDOS), PDO).view(np.recarray)
    tpdo = np.zeros((n, MAX_PDOS), PDO).view(np.recarray)
    rpdo["cob_id"] = tpdo["cob_id"] = -1
    return nodes, rpdo, tpdo
