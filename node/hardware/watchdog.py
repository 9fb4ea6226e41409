"""Watchdog process: makes a node's outputs safe when the node cannot.

It is a child of the node's process, in its own session, and ignores the terminal's signals. The
node writes a byte to its stdin once per period. If no byte comes for `watchdog_s`, or stdin ends
because the node's process ended (by any means, including SIGKILL), the watchdog writes the safe
values. Its messages on stdout: ``r`` ready, ``!`` the node stalled and the safe values are
written. `Guard` is its client, in the node's process.

    python -m coulombus.node.hardware.watchdog WATCHDOG_S ORDERS     (JSON: [[path, text], ...])
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from collections.abc import Collection, Sequence
from contextlib import suppress

from coulombus.node.hardware.board import load_class
from coulombus.node.hardware.channels import HardwareError, SafeWrite, put
from coulombus.system.stop_signals import ignore

__all__ = ["READY", "TRIPPED", "Guard", "carry_out", "guard_outputs"]

READY, TRIPPED = b"r", b"!"
TRIES = 3
START_S, END_S = 20.0, 5.0


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


class Guard:
    """A watchdog process that can make the outputs safe.

    Parameters
    ----------
    watchdog_s : longest time between two calls of `feed`
    orders : writes that make the outputs safe
    claims : descriptors of the outputs' locks, which it keeps until its work is done

    Raises
    ------
    HardwareError
        the process did not start
    """

    def __init__(self, watchdog_s: float, orders: Sequence[SafeWrite], claims: Collection[int] = ()) -> None:
        self._watchdog_s = watchdog_s
        words = [sys.executable, "-m", "coulombus.node.hardware.watchdog", str(watchdog_s), json.dumps(orders)]
        self._process = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True, pass_fds=tuple(claims)
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self.pid = self._process.pid
        self._feed, self._answers = self._process.stdin.fileno(), self._process.stdout.fileno()
        ready, _, _ = select.select([self._answers], [], [], START_S)
        if not ready or os.read(self._answers, 1) != READY:
            self.close()
            raise HardwareError("the watchdog process did not start")
        os.set_blocking(self._feed, False)
        os.set_blocking(self._answers, False)

    def feed(self) -> None:
        """Report to the watchdog that the node is alive.

        Raises
        ------
        HardwareError
            the watchdog is gone, or it has made the outputs safe because the node stalled
        """
        try:
            os.write(self._feed, b".")
        except BlockingIOError:
            raise HardwareError("the watchdog process no longer reads") from None
        except OSError:
            raise HardwareError("the watchdog process is gone") from None
        with suppress(BlockingIOError):
            answer = os.read(self._answers, 64)
            if TRIPPED in answer:
                raise HardwareError(f"the node hung for {self._watchdog_s:g} s, and its watchdog acted")
            if not answer:
                raise HardwareError("the watchdog process is gone")

    def close(self) -> None:
        """Let the watchdog make the outputs safe a last time, and wait for its end."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(OSError):
            self._process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(END_S)
        self._process.stdout.close()


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
