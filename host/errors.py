"""Why the host refuses or stops, and the exit status that each reason has.

HostError
+-- NodeMissing        5   a node does not answer
+-- SdoAborted         6   a node refuses a value
+-- AnswerUntrusted    6   a node's answer is none, or a second device's (then 3)
+-- DeviceMismatch     3   a node is not what the rig file says
+-- SafetyTrip         7   arming was refused, or the safe state was entered
"""

from __future__ import annotations

__all__ = ["AnswerUntrusted", "DeviceMismatch", "HostError", "NodeMissing", "SafetyTrip", "SdoAborted"]


class HostError(Exception):
    """Base of all reasons; `exit_status` is the command line's."""

    exit_status = 1


class NodeMissing(HostError):
    """A node does not answer."""

    exit_status = 5


class SdoAborted(HostError):
    """A node aborted an SDO transfer."""

    exit_status = 6


class AnswerUntrusted(HostError):
    """An SDO answer says nothing of the object that was asked for: it is malformed, about another
    object, or two devices answer.
    """

    exit_status = 6


class DeviceMismatch(HostError):
    """A node's identity or configuration is not what the rig file says.

    The text names each difference.
    """

    exit_status = 3


class SafetyTrip(HostError):
    """Arming was refused, or a trip led to the safe state."""

    exit_status = 7
