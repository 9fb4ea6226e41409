"""Measurement of wake-up delays: ``python -m coulombus.host.doctor.sleeper SETTINGS``.

The loop sleeps like the data plane's. It runs in a separate process, because it requests real-time rights.
The process prints one JSON object.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

from coulombus.kernels.decorator import kernel
from coulombus.kernels.libc import EINTR, now_ns, sleep_until
from coulombus.kernels.records import Integers
from coulombus.system.realtime import ask_for_real_time, die_with_parent

__all__ = ["BINS", "main", "wake"]

BINS = 20_000
"""Number of bins of 1 us; longer delays are in the last bin."""
LEAD_NS = 2_000_000


@kernel
def wake(bins: Integers, start_ns: int, period_ns: int, cycles: int) -> int:
    """Sleep until `start_ns` and then for `cycles` periods; count each wake-up's delay in `bins`.

    Missed periods are skipped, as in the data plane. Return the largest delay [ns].
    """
    latest = 0
    end_ns = start_ns + cycles * period_ns
    t = start_ns
    while t < end_ns:
        if sleep_until(t) == EINTR:
            continue
        late = now_ns() - t
        latest = max(latest, late)
        bins[min(late // 1000, bins.shape[0] - 1)] += 1
        t += period_ns * (1 + late // period_ns)
    return latest


def main(settings: dict[str, Any]) -> int:
    """Measure, and print the counts; return the exit status of the process."""
    die_with_parent(settings["parent"])
    bins = np.zeros(BINS, np.int64)
    wake(bins, time.monotonic_ns(), 1_000_000, 2)  # compiles, and touches the memory
    bins[:] = 0
    rights = ask_for_real_time(settings["priority"], settings["cpu"])
    period_ns = int(settings["period_ns"])
    latest = wake(bins, time.monotonic_ns() + LEAD_NS, period_ns, max(1, round(settings["seconds"] * 1e9 / period_ns)))
    used = np.flatnonzero(bins)
    counts = {int(us): int(bins[us]) for us in used}
    print(json.dumps({"counts": counts, "latest_us": latest / 1000, "real_time": rights.as_dict()}))
    return 0


if __name__ == "__main__":
    sys.exit(main(json.loads(sys.argv[1])))
