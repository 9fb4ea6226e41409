"""Tables of CiA 305 (layer setting services, LSS), for the device, the host and the tools.

The master sends requests to all slaves on 7E5h; slaves respond on 7E4h. Both have eight bytes, the
command specifier first. Multi-byte numbers are little endian; unused bytes are 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

__all__ = [
    *("BIT_RATES", "FASTSCAN_START", "LSS_RESULTS", "REQUESTS", "UNCONFIGURED", "LssService", "LssState"),
    "lss_result",
]

UNCONFIGURED = 255
"""Node id of an unconfigured device."""

FASTSCAN_START = 128
"""Bit check of the first fastscan request, which every device without a node id answers."""


class LssState(IntEnum):
    """States of an LSS slave, with the values of the service switch state global."""

    WAITING = 0
    CONFIGURATION = 1


class LssService(IntEnum):
    """Command specifiers."""

    SWITCH_STATE_GLOBAL = 0x04
    CONFIGURE_NODE_ID = 0x11
    CONFIGURE_BIT_TIMING = 0x13
    ACTIVATE_BIT_TIMING = 0x15
    STORE_CONFIGURATION = 0x17
    SWITCH_VENDOR = 0x40
    SWITCH_PRODUCT = 0x41
    SWITCH_REVISION = 0x42
    SWITCH_SERIAL = 0x43
    SWITCH_ANSWER = 0x44
    IDENTIFY_VENDOR = 0x46
    IDENTIFY_PRODUCT = 0x47
    IDENTIFY_REVISION_LOW = 0x48
    IDENTIFY_REVISION_HIGH = 0x49
    IDENTIFY_SERIAL_LOW = 0x4A
    IDENTIFY_SERIAL_HIGH = 0x4B
    IDENTIFY_NON_CONFIGURED = 0x4C
    IDENTIFY_ANSWER = 0x4F
    NON_CONFIGURED_ANSWER = 0x50
    FASTSCAN = 0x51
    INQUIRE_VENDOR = 0x5A
    INQUIRE_PRODUCT = 0x5B
    INQUIRE_REVISION = 0x5C
    INQUIRE_SERIAL = 0x5D
    INQUIRE_NODE_ID = 0x5E


REQUESTS = frozenset(LssService) - {
    LssService.SWITCH_ANSWER,
    LssService.IDENTIFY_ANSWER,
    LssService.NON_CONFIGURED_ANSWER,
}
"""Requests of a master."""

BIT_RATES: Mapping[int, int] = {
    0: 1_000_000,
    1: 800_000,
    2: 500_000,
    3: 250_000,
    4: 125_000,
    6: 50_000,
    7: 20_000,
    8: 10_000,
}
"""Bit rates [bit/s] by index of table 0; index 5 is reserved, and here so is 9 (automatic detection)."""

LSS_RESULTS: Mapping[LssService, Mapping[int, str]] = {
    LssService.CONFIGURE_NODE_ID: {1: "node id out of range"},
    LssService.CONFIGURE_BIT_TIMING: {1: "bit rate not supported"},
    LssService.STORE_CONFIGURATION: {1: "storing not supported", 2: "storage medium: access error"},
}
"""Services whose answer has a result, and the results' texts."""


def lss_result(service: LssService, error: int, specific: int) -> str:
    """Return the result of a service as text, "ok" for 0."""
    return "ok" if error == 0 else LSS_RESULTS[service].get(error, f"error {error}, specific {specific}")
