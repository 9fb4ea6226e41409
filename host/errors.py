"""Errors of the host.

`coulombus.system.errors` has the tree of all errors and their exit statuses.
"""

from __future__ import annotations

from coulombus.system.errors import CoulombusError

__all__ = ["AnswerUntrusted", "DeviceMismatch", "HostError", "NodeMissing", "SafetyTrip", "SdoAborted"]


class HostError(CoulombusError):
    """Base class of the host's errors."""

    exit_status = 1


class NodeMissing(HostError):
    """A node does not answer."""

    exit_status = 5


class SdoAborted(HostError):
    """A node aborted an SDO transfer."""

    exit_status = 6


class AnswerUntrusted(HostError):
    """An SDO response cannot be used: it is malformed, it is for another object, or two devices answer."""

    exit_status = 6


class DeviceMismatch(HostError):
    """A node's identity or configuration differs from the rig file.

    The text names each difference.
    """

    exit_status = 3


class SafetyTrip(HostError):
    """Arming was refused, or a trip led to the safe state."""

    exit_status = 7
