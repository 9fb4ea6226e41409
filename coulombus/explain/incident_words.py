"""Texts for the kinds of clues: title, cause, checks, significance, reference.

`rank` decides which clue names an incident: the most specific one.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from coulombus.explain.incident_kind import CABLE, MANUAL, ONE_ID, TERMINATION, IncidentKind
from coulombus.explain.sdo_words import SDO_KINDS

__all__ = ["KINDS", "OF_AXES", "WHO"]


WHO: Mapping[str, str] = MappingProxyType(
    dict.fromkeys(("bus_silent", "bus_off", "no_ack", "error_passive", "error_frames", "repeated"), "wire")
    | dict.fromkeys(
        (
            "sync_lost",
            "sync_gap",
            "sync_jitter",
            "time_lost",
            "host_lost",
            "rpdo_missing",
            "rpdo_late",
            "host_trip",
            "limit_active",
        ),
        "host",
    )
    | dict.fromkeys(
        (
            "second_master",
            "ordered_away",
            "sdo_abort",
            "sdo_refused_read",
            "sdo_not_taken",
            "sdo_repeated",
            "sdo_overlap",
            "sdo_client_abort",
        ),
        "client",
    )
    | dict.fromkeys(
        (
            "bus_load",
            "starved",
            "two_sync",
            "duplicate_node",
            "same_cob_id",
            "pdo_length",
            "mode_refused",
            "no_pdo",
            "runs_on",
        ),
        "configuration",
    )
    | dict.fromkeys(("overrun", "node_missing", "following_error"), "unknown")
)
"""Culprit by kind: wire, host, client of an SDO server, configuration, or unknown; for all other kinds the node."""

OF_AXES = frozenset(
    {
        *("drive_fault", "quick_stop", "left_enabled", "not_following", "error_code"),
        *("setpoint_ignored", "runs_on", "following_error", "limit_active", "torque_when_off", "mode_refused"),
    }
)
"""Kinds about an axis of a drive."""

KINDS: Mapping[str, IncidentKind] = MappingProxyType(
    {
        "bus_silent": IncidentKind(
            95, "The whole bus was silent", "Nothing could be sent: the wire was held, shorted or cut, or all lost supply.",
            ("Look for a plug that was touched, or a loose terminator.", TERMINATION,
             "Unplug the nodes one by one until the bus stays free: the last one holds it dominant."),
            "No node hears any other; each watches its own time-outs.", "ISO 11898-1, 10.9; docs/bus.md", "bus",
        ),
        "bus_off": IncidentKind(
            90, "A CAN controller went bus-off", "Its transmissions failed again and again: wiring, bit rate or termination.",
            ("Check that all nodes have the same bit rate.", TERMINATION,
             "Watch its counters: ip -details -statistics link show can0."),
            "A bus-off node neither sends nor receives until it is restarted.", "ISO 11898-1, 12.1.4; docs/bus.md", "bus",
        ),
        "no_ack": IncidentKind(
            60, "Frames were not acknowledged", "The sender was alone: the cable is open, or the others are off.",
            ("Check that the other nodes have power.", "Look for an open plug between sender and the others.", TERMINATION),
            "An unacknowledged frame is repeated until a node acknowledges it.", "ISO 11898-1, 10.11", "bus",
        ),
        "error_passive": IncidentKind(
            55, "A controller became error passive", "Many of its frames were destroyed.",
            (CABLE, TERMINATION, "Compare the bit timing (sample point) of all nodes."),
            "An error-passive node can no longer stop others from taking a bad frame; bus-off is next.",
            "ISO 11898-1, 12.1.4", "bus",
        ),
        "error_frames": IncidentKind(
            58, "Many frames were destroyed", "Disturbance on the wire, a wrong bit timing, or two senders of one identifier.",
            ("Check whether a motor cable runs next to the CAN cable.", TERMINATION,
             "Compare the bit timing (sample point) of all nodes."),
            "Each destroyed frame is sent again: frames come late, and load grows.", "ISO 11898-1, 10.11; docs/bus.md", "bus",
        ),
        "overrun": IncidentKind(
            30, "The recorder lost frames", "A receive buffer overflowed: the log has gaps.",
            ("Record with fewer other programs running.", "Enlarge the interface's queue (txqueuelen, rcvbuf).",
             "Use an adapter with a larger buffer."),
            "What is missing in this log may have been on the bus.", "linux/can/error.h", "bus",
        ),
        "babble": IncidentKind(
            85, "An identifier floods the bus", "A node sends one frame again and again.",
            ("Find its sender: unplug nodes one by one.", "Check inhibit time (1800h:03) and event timer of that PDO.",
             "Update the firmware of the sender."),
            "Frames of lower priority wait, and come too late or never.", "CiA 301, 7.2.2.2 (inhibit time)", "bus",
        ),
        "bus_load": IncidentKind(
            84, "The bus was full", "More frames than the bit rate carries.",
            ("Compare which identifiers come most often: coulombus hz.", "Lengthen event timers and SYNC period, or map fewer PDOs.",
             "Raise the bit rate of all nodes."),
            "Frames of low priority come late or never: heartbeats first.", "CiA 301, 7.2.2; docs/planner.md", "bus",
        ),
        "sync_lost": IncidentKind(
            80, "SYNC stopped", "The SYNC producer, usually the host, stopped or was cut off.",
            ("Check whether the host's program still runs, and what it said last.", "Check the host's cable and interface.",
             "Read 1005h bit 30 of each node: exactly one node may produce SYNC."),
            "Synchronous PDOs stop with SYNC: no measurement comes, and no set-point acts.", "CiA 301, 7.2.5", "bus",
        ),
        "host_lost": IncidentKind(
            82, "The host fell silent", "The host's program or PC stopped, or its cable was cut.",
            ("Check whether the host's program still runs, and what it said last.", "Check the host's cable and interface.",
             "coulombus doctor: was its process held up or ended?"),
            "The nodes get no commands: the monitors of each node decide.", "CiA 301, 7.2.8.3.2.2; docs/runbook.md", "bus",
        ),
        "sync_gap": IncidentKind(
            40, "SYNC came late", "The host did not keep its cycle, or SYNC waited for other frames.",
            ("Look at what else ran on the host then.", "coulombus doctor: real-time rights, kernel, CPU.",
             "Give the host's thread a real-time priority."),
            "A cycle without SYNC is a cycle without measurement.", "CiA 301, 7.2.5", "bus",
        ),
        "sync_jitter": IncidentKind(
            41, "SYNC jitters", "Its producer does not keep its cycle: its program waits for other work.",
            ("Look at what else runs on the SYNC producer.", "coulombus doctor: real-time rights, kernel, CPU.",
             "Let an interface with its own clock send SYNC."),
            "Nodes sample and act at uneven times: what is derived from differences is wrong.", "CiA 301, 7.2.5", "bus",
        ),
        "two_sync": IncidentKind(
            86, "Two nodes produce SYNC", "Two masters, or a node whose 1005h bit 30 is set.",
            ("Check whether a second program or tool runs.", "Read 1005h of every node: bit 30 makes it a producer.",
             "Unplug the other master."),
            "Nodes sample and act twice per cycle, at wrong times.", "CiA 301, 7.5.2.6 (1005h)", "bus",
        ),
        "second_master": IncidentKind(
            91, "Two masters send set-points", "A second program sends the same RPDOs.",
            ("Look for a second program or tool on this bus.", "Stop one of the two masters.",
             "coulombus watch: see which values alternate."),
            "The drive follows whichever set-point came last.", "CiA 301, 7.2.2; docs/runbook.md",
        ),
        "duplicate_node": IncidentKind(
            92, "Two devices have one node id", "A replaced or added device still has the node id of another.",
            (ONE_ID, "Check the id switches of both devices.", "Give one of them another id: coulombus lss."),
            "Both answer, both obey: neither can be trusted.", "CiA 301, 7.2.4; CiA 305",
        ),
        "same_cob_id": IncidentKind(
            64, "Two nodes send PDOs with one COB-ID", "The configuration of one node was copied to the other.",
            ("Give each PDO a COB-ID of its own (1800h:01): 180h + node id is usual.",
             "Compare the COB-IDs of all nodes: coulombus pdo --node N --bus B.", "Look whether two EDS or DCF files have one node id."),
            "Their frames collide, and a receiver takes one for the other.", "CiA 301, 7.5.2.37",
        ),
        "node_missing": IncidentKind(
            74, "A node never answered", "It is off, not connected, or has another node id or bit rate.",
            (CABLE, "Check its node id and bit rate (switches, or coulombus scan).", TERMINATION),
            "What it should do is not done.", "CiA 301, 7.2.4",
        ),
        "restarted": IncidentKind(
            72, "A node restarted by itself", "Its supply dipped, or its watchdog reset it.",
            ("Measure its supply while the motor accelerates.", "Check its plug and its fuse.",
             "Ask the maker whether its watchdog keeps a log; update its firmware."),
            "It has forgotten its configuration, and is PRE-OPERATIONAL.", "CiA 301, 7.3.2.2.1",
        ),
        "node_lost": IncidentKind(
            70, "A node fell silent", "It lost its supply or its connection, or its firmware hangs.",
            (CABLE, "Measure its supply voltage at the plug.", "Switch it off and on; if it comes back, look for its error log."),
            "It gets no commands: its own monitors decide.", "CiA 301, 7.2.8.3.2.2",
        ),
        "left_operational": IncidentKind(
            62, "A node left OPERATIONAL unordered", "An error made it stop its PDOs (1029h), or its firmware did.",
            ("Look at its EMCY around this time.", "Read 1003h (error history) and 1001h.", "Read 1029h: it decides what an error leads to."),
            "It sends and takes no PDOs any more.", "CiA 301, 7.3.2.2 and 7.5.2.32 (1029h)",
        ),
        "ordered_away": IncidentKind(
            83, "A node was ordered out of OPERATIONAL at work", "An NMT command took it out while set-points were sent to it.",
            ("Find the sender of the command: a second master, a tool, a person.", "coulombus decode: the NMT row at this time.",
             "Start the node again, and look whether the command comes again."),
            "It sends and takes no PDOs any more, and its master works on.", "CiA 301, 7.3.2.2.2 (NMT)",
        ),
        "starved": IncidentKind(
            39, "Frames of a node do not get through", "Identifiers with a higher priority fill the bus.",
            ("See which identifier goes before it: coulombus hz.", "Give that PDO an inhibit time (1800h:03).",
             "Give the starved frame a lower identifier."),
            "Its consumers assume that its sender has failed.", "ISO 11898-1, 10.8 (arbitration)",
        ),
        "not_hearing": IncidentKind(
            73, "A node sends and does not hear", "Its receiver, its filters or its program do not take what is sent to it.",
            ("Switch it off and on: does it obey then?", "Look whether its receive queue or its firmware is stuck (maker's log).",
             "Compare its bit timing (sample point) with the other nodes."),
            "It cannot be stopped over the bus: no command reaches it.", "CiA 301, 7.3.2.2",
        ),
        "time_lost": IncidentKind(
            31, "TIME stopped", "Its producer, usually the host, does not send the time any more.",
            ("Check whether the host's program still runs.", "Read 1012h of each node: bit 30 makes it the producer.",
             "Look whether what needs the time (logs, time stamps) goes on without it."),
            "Clocks of the nodes drift apart.", "CiA 301, 7.2.6", "bus",
        ),
        "lss_refused": IncidentKind(
            32, "A device refused an LSS service", "Its value is out of range, or the device cannot store it.",
            ("Read the error code.", "Give a node id from 1 to 127 and a bit rate of CiA 301.", "Ask the maker which LSS services the device has."),
            "The device keeps its old node id or bit rate.", "CiA 305", "bus",
        ),
        "no_pdo": IncidentKind(
            52, "No PDO comes", "The nodes are OPERATIONAL beside SYNC, and no PDO is switched on.",
            ("Read 1800h:01 and 1400h:01 of the node: bit 31 switches a PDO off.", "Read 1A00h:00: a map without objects sends nothing.",
             "Read 1800h:02: 254 and 255 send only on a change."),
            "There are no measurements and no set-points.", "CiA 301, 7.5.2.37", "node",
        ),
        "runs_on": IncidentKind(
            96, "A drive runs on without its host", "No watch of the drive ends its motion when the host falls silent.",
            ("Stop it by its emergency stop, not over the bus.",
             "Write 1016h (heartbeat of the host), 6007h (abort connection) and 1029h (error behaviour) at bring-up.",
             "Give its RPDO an event timer (1400h:05)."),
            "Nobody commands it, and it moves: a hand may be on it.", "CiA 301, 7.5.2.19; CiA 402-2, 6007h",
        ),
        "setpoint_ignored": IncidentKind(
            48, "A drive ignores its set-points", "In a cyclic mode it clears statusword bit 12: it does not follow.",
            ("Read its EMCY and 603Fh.", "Compare the period of the set-points with 60C2h.", "Look for a limit switch or a halt input."),
            "The host commands, and the axis does as it likes.", "CiA 402-2, statusword bit 12",
        ),
        "service_length": IncidentKind(
            22, "A frame's length does not fit its service", "The sender does not keep to CiA 301, or the frame is of another protocol.",
            ("Look which program or device sends it.", "Compare with the clause of the service.",
             "Look whether another protocol shares this bus."),
            "Receivers ignore it, or read bytes that are not there.", "CiA 301, 7.2",
        ),
        "guard_toggle": IncidentKind(
            21, "The toggle bit of node guarding did not alternate", "An answer was lost, came twice, or the node restarted.",
            ("Look for a boot-up of the node just before.", "Look for a second guarding master.", TERMINATION),
            "The master takes it for a lost node.", "CiA 301, 7.2.8.3.2.1",
        ),
        "error_history": IncidentKind(
            7, "A node remembers an error", "The node's own diagnosis of an earlier error (1003h).",
            ("Look whether that error came in this log, too.", MANUAL, "Write 0 to 1003h:00 once it is understood: that clears the history."),
            "An error that came once may come again.", "CiA 301, 7.5.2.4 (1003h)",
        ),
        "event_timer": IncidentKind(
            26, "A PDO does not keep its event timer", "Its sender is busy, or the bus is full.",
            ("Read 1800h:05 of the node again.", "Look at the bus load at that time.",
             "Check that its inhibit time is shorter than the event timer."),
            "Consumers with an event timer assume that this PDO is lost.", "CiA 301, 7.5.2.37 (1800h:05)",
        ),
        "inhibit_time": IncidentKind(
            24, "A PDO does not keep its inhibit time", "The device ignores 1800h:03, or took it in another unit.",
            ("Read 1800h:03 of the node again: its unit is 100 us.", "Write it with the PDO switched off (1800h:01, bit 31).",
             "Update the firmware of the device."),
            "It takes more of the bus than was planned.", "CiA 301, 7.5.2.37 (1800h:03)",
        ),
        "following_error": IncidentKind(
            49, "A drive does not follow its set-point", "The load is too large, something blocks, or the set-points are too fast.",
            ("Turn the axis by hand, supply off: does it move freely?", "Compare the set-point's speed with the limits of the drive.",
             "Read 6065h and 6066h: window and time-out."),
            "The drive stops, or goes to FAULT with 8611h.", "CiA 402-2, statusword bit 13",
        ),
        "limit_active": IncidentKind(
            17, "A drive worked at an internal limit", "A set-point was beyond torque, speed or position limits.",
            ("Compare the set-point with 6072h (torque) and 607Dh (position).", "Check the limits of current and temperature.",
             "Ask less of the drive, or raise the limit."),
            "The drive does less than it is commanded.", "CiA 402-2, statusword bit 11",
        ),
        "torque_when_off": IncidentKind(
            43, "A drive shows torque without being enabled", "The current sensor has an offset, or the motor is driven from outside.",
            ("Look whether the axis turns.", "Compare 6077h with the drive at rest.", "Let the drive calibrate its current sensors."),
            "What is measured is wrong, or the power stage is not off.", "CiA 402-2, 6077h",
        ),
        "not_started": IncidentKind(
            51, "A node did not start", "It refused the NMT start, or did not get it.",
            ("Read its error history (1003h).", "Send the start to it alone: coulombus nmt start.",
             "Check its configuration: some devices refuse to start without it."),
            "Without OPERATIONAL there are no PDOs.", "CiA 301, 7.2.8.2.1",
        ),
        "drive_fault": IncidentKind(
            54, "A drive went to FAULT", "The drive switched its power stage off by itself.",
            ("Read the error code 603Fh and its EMCY.", "Check supply, motor plug and temperature.",
             "Reset it with bit 7 of the controlword, once the cause is gone."),
            "The motor has no torque.", "CiA 402-2, state machine, transition 13",
        ),
        "emcy": IncidentKind(
            53, "A node reported an error", "The node's own diagnosis.",
            (MANUAL, "Read 1001h and 1003h of the node.", "Look at what was commanded just before."),
            "A node reports an error that it cannot correct itself.", "CiA 301, 7.2.7 and 7.5.2.4 (1003h)",
        ),
        "error_code": IncidentKind(
            52, "A drive shows an error code", "The drive's own diagnosis (603Fh).",
            (MANUAL, "Read 1003h for what came before.", "Check supply, load and temperature."),
            "The code names what the drive saw.", "CiA 402-2, 603Fh",
        ),
        "reset_failed": IncidentKind(
            15, "A fault reset had no effect", "The cause of the fault was still there.",
            ("Remove the cause first.", "Read 603Fh after the reset.", "Set bit 7 of the controlword from 0 to 1: its edge resets."),
            "The drive stays in FAULT.", "CiA 402-2, transition 15",
        ),
        "quick_stop": IncidentKind(
            46, "A drive did a quick stop by itself", "A limit switch, an input, or a lost set-point.",
            ("Look at the limit switches and inputs (60FDh).", "Read 605Ah, and the drive's EMCY.", "Check that set-points came until then."),
            "The drive brakes and then has no torque.", "CiA 402-2, transition 11",
        ),
        "left_enabled": IncidentKind(
            47, "A drive left Operation Enabled by itself", "It lost supply, an enable input, or its set-points.",
            ("Check the enable input and the emergency stop.", "Check the supply of the power stage.", "Read 603Fh and 1003h."),
            "The motor has no torque, though the host commands it.", "CiA 402-2, state machine",
        ),
        "not_following": IncidentKind(
            44, "A drive does not follow its controlword", "Something that it needs is missing: supply, enable input, set-points.",
            ("Check that the power stage has its supply (statusword bit 4).", "Check enable input, safe torque off and limit switches.",
             "Send the controlword again from 0006h on, and watch which step stops."),
            "It never reaches Operation Enabled: there is no torque.", "CiA 402-2, state machine, transitions 2 to 4",
        ),
        "mode_refused": IncidentKind(
            45, "A drive does not take the mode", "It does not have this mode, or not in this state.",
            ("Read 6502h: the modes that it has.", "Write 6060h while the drive is not enabled.", "Look the mode's conditions up in its manual."),
            "Set-points of another mode have no effect.", "CiA 402-2, 6060h and 6061h",
        ),
        "heartbeat_lost": IncidentKind(
            42, "A node's heartbeat stopped", "Its other frames come: 1017h was changed, or the node is overloaded.",
            ("Read 1017h of the node.", "Look for a write to 1017h just before.", "Check the load of the node and of the bus."),
            "Its heartbeat consumers assume that it has failed.", "CiA 301, 7.2.8.3.2.2",
        ),
        "heartbeat_late": IncidentKind(
            20, "Heartbeats came late", "The node or the bus was busy.",
            ("Compare with the bus load at that time.", "Look for long SDO transfers to that node.",
             "Lengthen 1016h of its consumers, or shorten 1017h."),
            "The next one later is taken for a lost node.", "CiA 301, 7.5.2.19 (1016h)",
        ),
        "tpdo_missing": IncidentKind(
            38, "PDOs of a node were missing", "It did not send after SYNC: SYNC was lost to it, or it is overloaded.",
            ("Read its transmission type (1800h:02).", "Look for error frames at that time.", "Compare its cycle with the period of SYNC."),
            "The host works with an old measurement.", "CiA 301, 7.2.2.2 (transmission types)",
        ),
        "tpdo_late": IncidentKind(
            28, "PDOs of a node came late", "The node or the bus was busy.",
            ("Look at the bus load at that time.", "Check the node's inhibit time (1800h:03).", "Give the PDO a lower identifier."),
            "The host may take a measurement of the cycle before.", "CiA 301, 7.2.2",
        ),
        "rpdo_missing": IncidentKind(
            56, "Set-points stopped", "The host did not send this RPDO.",
            ("Check whether the host's program still runs.", "Look at what it said last.", "coulombus doctor: was its thread held up?"),
            "The node acts on an old set-point until its own watch ends that.", "CiA 301, 7.2.2; 1400h:05",
        ),
        "rpdo_late": IncidentKind(
            27, "Set-points came late", "The host did not keep its cycle.",
            ("Look at what else ran on the host.", "coulombus doctor: real-time rights, kernel, CPU.", "Shorten bus.tpdo_window_s."),
            "A set-point behind the next SYNC acts a cycle later.", "CiA 301, 7.2.2",
        ),
        "pdo_stopped": IncidentKind(
            36, "A periodic PDO stopped", "Its sender stopped it, or its event timer was changed.",
            ("Check the node's NMT state.", "Read its event timer (1800h:05).", "Look for a write to its parameters."),
            "Its consumers work with old values.", "CiA 301, 7.5.2.37",
        ),
        "pdo_length": IncidentKind(
            55, "A PDO's length does not fit its map", "The node's PDO map differs from its master's.",
            ("Read 1600h or 1A00h of the node.", "Write the map again after each restart of the node.",
             "Check that the EDS file is of this firmware."),
            "Values are read from wrong bytes, or not at all.", "CiA 301, 7.2.2.5 (EMCY 8210h)",
        ),
        "repeated": IncidentKind(
            10, "A frame came twice", "Its last bit was disturbed (CAN then delivers it twice), or a gateway repeats it.",
            ("Count how often: now and then is usual.", TERMINATION, "Look for a bridge or gateway that forms a loop."),
            "A toggling command would act twice.", "ISO 11898-1, 10.11 (last bit of end of frame)",
        ),
        **SDO_KINDS,
        "host_trip": IncidentKind(
            25, "The host stopped the machine", "The host's own watch: any failed check leads to the safe state.",
            ("Read the trip's text.", "Look the trip up in docs/runbook.md.", "coulombus plot: the signals before it."),
            "The machine is in its safe state until it is started again.", "docs/safety.md, docs/runbook.md", "host",
        ),
    }
)  # fmt: skip
"""Each kind by its name, as in ``explain --json``."""
