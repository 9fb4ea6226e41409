"""Texts for incidents of SDO transfers."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from coulombus.explain.incident_kind import CABLE, IncidentKind

__all__ = ["SDO_KINDS"]

SDO_KINDS: Mapping[str, IncidentKind] = MappingProxyType(
    {
        "sdo_abort": IncidentKind(
            35, "A node refused an SDO transfer", "Object, value or state do not fit.",
            ("Read what the abort code says.", "Compare with the device's EDS file: index, type, limits.", "Try it in PRE-OPERATIONAL."),
            "What should have been set is not set.", "CiA 301, 7.2.4.3.17, table 22", "sdo",
        ),
        "sdo_refused_read": IncidentKind(
            5, "A node does not have an object", "It was asked for an object that it need not have.",
            ("Nothing, if the program goes on: optional objects are often asked for.", "Compare with its EDS file.",
             "Check that the EDS file is of this firmware."),
            "Usually harmless.", "CiA 301, 7.2.4.3.17, table 22", "sdo",
        ),
        "sdo_timeout": IncidentKind(
            41, "A node did not answer an SDO request", "It is busy, off, or the request was lost.",
            (CABLE, "Ask again with a longer time-out.", "Look for error frames at that time."),
            "The transfer did not happen.", "CiA 301, 7.2.4.3", "sdo",
        ),
        "sdo_late": IncidentKind(
            43, "An SDO answer came after its client had given up", "The time-out of the client is shorter than this answer takes.",
            ("Lengthen the time-out of the client.", "Compare with the other response times: coulombus explain FILE 1.",
             "Look what the node did then: starting, storing parameters, a full bus."),
            "The client takes the transfer for failed, though the node did it.", "CiA 301, 7.2.4.3", "sdo",
        ),
        "sdo_not_taken": IncidentKind(
            46, "An SDO client did not take an answer", "The answer is on the bus, and the client waited on: its program, filter or driver lost it.",
            ("Look at the client's program: which thread reads its answers?", "Look at its receive filter (580h + node id) and its queue.",
             "Read the same object with another tool: coulombus sdo."),
            "The node is well; the client takes it for dead.", "CiA 301, 7.2.4.3", "sdo",
        ),
        "sdo_repeated": IncidentKind(
            37, "An SDO client repeated a request before its answer", "The client is impatient: it asks again while the node still works.",
            ("Lengthen the time-out of the client.", "Let it wait, or abort before it asks again.", "Compare with the node's response times."),
            "The node gets the request twice: the second answer belongs to no request.", "CiA 301, 7.2.4.3", "sdo",
        ),
        "sdo_overlap": IncidentKind(
            38, "SDO requests overlap on one channel", "Two clients use the same channel, or one client does not wait for its answer.",
            ("Look for a second program or tool that reads this node.", "Give the second client a channel of its own (1201h).",
             "Let one program ask for all."),
            "A server has one transfer at a time: each client may take the other's answer for its own.", "CiA 301, 7.2.4.1", "sdo",
        ),
        "sdo_wrong_object": IncidentKind(
            45, "A node answered about another object", "Its firmware answers wrongly, or the answer belongs to an earlier request.",
            ("Ask for one object at a time, and compare the answers.", "Look for a second client on this channel.",
             "Update the firmware of the node."),
            "A client that does not compare takes the wrong value.", "CiA 301, 7.2.4.3", "sdo",
        ),
        "sdo_stray": IncidentKind(
            48, "A node sends SDO answers that nobody asked for", "Its firmware answers more often than it is asked, or two devices answer.",
            ("Look whether two devices have this node id.", "Ask with segments and with block transfer, and compare.",
             "Update the firmware of the node."),
            "A client may take such an answer for the next one.", "CiA 301, 7.2.4.3", "sdo",
        ),
        "sdo_data": IncidentKind(
            51, "The data of an SDO transfer are wrong", "Size or CRC do not match the bytes, and both sides accepted them.",
            ("Read the object back, and compare.", "Send it again, with CRC.", "Look whether the sender's program announces the right size."),
            "A program or parameter in the device is not what was sent.", "CiA 301, 7.2.4.3.3 and 7.2.4.3.16", "sdo",
        ),
        "sdo_client_abort": IncidentKind(
            6, "A client ended an SDO transfer", "The client did not want the transfer to go on.",
            ("Read what the abort code says.", "Look at what the client's program reports.", "Try it without block transfer."),
            "The transfer did not happen.", "CiA 301, 7.2.4.3.17", "sdo",
        ),
        "sdo_incomplete": IncidentKind(
            34, "An SDO transfer ended half way", "Client or node gave up without an abort.",
            ("Try it again.", "Try it without block transfer.", "Look for error frames at that time."),
            "The object may hold an old or a half value.", "CiA 301, 7.2.4.3.4 to 7.2.4.3.16", "sdo",
        ),
        "not_applied": IncidentKind(
            33, "A setting was confirmed and not applied", "The node took the write, and keeps another value.",
            ("Read it again.", "Write it in PRE-OPERATIONAL, PDO switched off (bit 31).", "Look in the manual which values it rounds or refuses."),
            "The node's setting differs from its master's.", "CiA 301, 7.5.2", "sdo",
        ),
    }
)  # fmt: skip
"""Each of these kinds by its name."""
