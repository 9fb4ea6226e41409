"""What disturbs an interpreter: a busy Python thread, and one that makes garbage on a heap of a
million objects.

``python -m benchmarks.load`` does it in a process of its own, beside something that has no
interpreter.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
from collections import deque

HEAP_OBJECTS = 1_000_000
BLOCK_OBJECTS = 10_000


class Cell:
    """Two of these refer to each other, so that only the garbage collector frees them."""

    def __init__(self) -> None:
        self.other = self


def pairs(count: int) -> list[Cell]:
    cells = [Cell() for _ in range(count)]
    for i in range(0, count, 2):
        cells[i].other, cells[i + 1].other = cells[i + 1], cells[i]
    return cells


def busy() -> None:
    """Never let go of the interpreter but when it is taken away."""
    n = 0
    while True:
        n = (n * 1103515245 + 12345) & 0x7FFFFFFF


def garbage(full: threading.Event) -> None:
    """Keep a heap of a million objects, and exchange it for new ones block by block."""
    blocks = HEAP_OBJECTS // BLOCK_OBJECTS
    heap = deque((pairs(BLOCK_OBJECTS) for _ in range(blocks)), maxlen=blocks)
    full.set()
    while True:
        heap.append(pairs(BLOCK_OBJECTS))


def start_load() -> None:
    """Start both threads; return when the heap is there. They end with the process."""
    full = threading.Event()
    threading.Thread(target=garbage, args=(full,), daemon=True).start()
    full.wait()
    threading.Thread(target=busy, daemon=True).start()


if __name__ == "__main__":
    ctypes.CDLL(None).prctl(1, int(signal.SIGKILL), 0, 0, 0)  # PR_SET_PDEATHSIG
    start_load()
    print("loaded", flush=True)
    while os.getppid() != 1:
        time.sleep(1)
    sys.exit()
