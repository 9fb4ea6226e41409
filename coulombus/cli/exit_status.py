"""The exit statuses of all verbs: their single definition.

An exception that ends a verb has its status as `exit_status`.

A closed reader of stdout (``| head``) does not change the status: a verb with a verdict still ends
with it, and one that only prints (`decode`, `watch`, `dbc`) ends with 0. `emulate` and `node`
continue until they are stopped.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

__all__ = ["FAULT", "STATUSES"]

FAULT = 70
"""Internal error: EX_SOFTWARE of sysexits.h.

It differs from all statuses on a rig or a file.
"""

STATUSES: Mapping[int, str] = MappingProxyType(
    {
        0: "ok",
        1: "a check failed",
        2: "usage: a wrong option or argument, a recording that cannot be read, a file that cannot be written, no memory left",
        3: "configuration: any file missing; rig, EDS, law, motion, fault or script file wrong; a device that differs from its files",
        4: "bus unavailable, or a system other than Linux where Linux is needed",
        5: "a node is missing",
        6: "a node aborted an SDO transfer, or its response is invalid",
        7: "safety: arming refused, or a trip led to the safe state (for example, a recording that cannot be continued)",
        8: "deadlines or frames lost beyond the limit",
        FAULT: "internal error, with a traceback: please report it",
        129: "the terminal was closed (SIGHUP); `emulate`, `node`, `watch` and `bridge` end with 0 by any of these signals once they run",
        130: "interrupted by Ctrl-C (SIGINT)",
        131: "interrupted by Ctrl-Backslash (SIGQUIT)",
        143: "terminated (SIGTERM)",
    }
)
"""Status -> meaning."""
