"""Client of the watchdog process (`node.hardware.watchdog`), in the node's process."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from collections.abc import Collection, Sequence
from contextlib import suppress

from coulombus.node.hardware.channels import HardwareError, SafeWrite
from coulombus.node.hardware.watchdog import READY, TRIPPED

__all__ = ["Guard"]

START_S, END_S = 20.0, 5.0


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
