"""Watchdog process: makes a node's outputs safe when the node cannot.

It is a child of the node's process, in its own session, and ignores the terminal's signals. The
node writes a byte to its stdin once per period. If no byte comes for `watchdog_s`, or stdin ends
because the node's process ended (by any means, including SIGKILL), the watchdog writes the safe
values. Its messages on stdout: ``r`` ready, ``!`` the node stalled and the safe values are
written.

    python -m coulombus.node.hardware.watchdog WATCHDOG_S ORDERS     (JSON: [[path, text], ...])
"""

from __future__ import annotations

import json
import os
import select
import sys
from collections.abc import Sequence
from contextlib import suppress

from coulombus.node.hardware.board import load_class
from coulombus.node.hardware.channels import HardwareError, put
from coulombus.system.stop_signals import ignore

__all__ = ["READY", "TRIPPED", "carry_out", "guard_outputs"]

READY, TRIPPED = b"r", b"!"
TRIES = 3


def carry_out(orders: Sequence[Sequence[str]]) -> list[str]:
    """Make every output safe, and retry each failed write; return the remaining failures."""
    failed = []
    for path, text in orders:
        for left in reversed(range(TRIES)):
            try:
                if text.startswith("{"):
                    load_class(path)().write(json.loads(text))
                else:
                    put(path, text)
                break
            except Exception as error:  # a Python class may raise anything; continue with the next output
                if left == 0:
                    mistake = str(error) if isinstance(error, HardwareError) else f"{path}: {error!r}"
                    failed.append(mistake)
    return failed


def guard_outputs(watchdog_s: float, orders: Sequence[Sequence[str]], feed: int, answers: int) -> list[str]:
    """Wait for bytes on `feed` until it ends; return the outputs that could not be made safe then.

    The first byte starts the watchdog.
    """
    os.write(answers, READY)
    timeout_s: float | None = None
    while True:
        ready, _, _ = select.select([feed], [], [], timeout_s)
        if ready:
            if not os.read(feed, 4096):
                return carry_out(orders)
            timeout_s = watchdog_s
        else:
            carry_out(orders)
            timeout_s = None  # until the next feed
            with suppress(OSError):
                os.write(answers, TRIPPED)


def _main() -> None:
    ignore()
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(90))
    failed = guard_outputs(float(sys.argv[1]), json.loads(sys.argv[2]), 0, 1)
    for text in failed:
        with suppress(OSError):
            os.write(2, f"coulombus: the output is not safe: {text}\n".encode())
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    _main()
