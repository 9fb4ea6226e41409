"""How long the machine stood still: it may be shared with others, and then a test against the wall
clock that fails says nothing of this project.

One watcher for each CPU sleeps and wakes, above everything else where that is granted; a wake-up
far too late is a standstill. It is a program of its own, because nothing that a test does may hold
it up: ``python standstill.py CPU`` answers each byte on stdin by a line, the longest lateness since
the byte before in seconds.
"""

import os
import select
import subprocess
import sys
import time
from contextlib import suppress

PERIOD_S = 0.01
LIMIT_S = 0.025
"""Half of what the real-time tests' rig endures (`rigs.overrides.SHARED_MACHINE`): the watcher sees
a standstill from its next wake-up on.
"""


class Watchers:
    """All CPUs that this process may use, watched; to be closed."""

    def __init__(self):
        self._processes = [
            subprocess.Popen(
                [sys.executable, "-I", "-S", __file__, str(cpu)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
            )
            for cpu in sorted(os.sched_getaffinity(0))
        ]
        self.longest_s()

    def longest_s(self):
        """Return the longest standstill of any CPU since the last call [s]."""
        for process in self._processes:
            process.stdin.write(b"?")
            process.stdin.flush()
        return max(float(process.stdout.readline()) for process in self._processes)

    def close(self):
        for process in self._processes:
            process.communicate()


def watch(cpu):
    """Answer until stdin ends."""
    os.sched_setaffinity(0, {cpu})
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(99))
    longest, woken = 0.0, time.monotonic()
    while True:
        asked = select.select([0], [], [], PERIOD_S)[0]
        before, woken = woken, time.monotonic()
        longest = max(longest, woken - before - PERIOD_S)
        if asked:
            if not os.read(0, 1):
                return
            os.write(1, b"%f\n" % longest)
            longest = 0.0


if __name__ == "__main__":
    watch(int(sys.argv[1]))
