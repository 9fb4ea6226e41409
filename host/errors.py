"""Why the host refuses or stops.

`coulombus.system.errors` has the tree of all errors, and their exit statuses.
"""

from __future__ import annotations

from coulombus.system.errors import CoulombusError

__all__ = ["AnswerUntrusted", "DeviceMismatch", "HostError", "NodeMissing", "SafetyTrip", "SdoAborted"]


class HostError(CoulombusError):
    """Base of all reasons."""

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
