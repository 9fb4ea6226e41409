"""The data plane's process (`host.realtime.process`) with the threads of `benchmarks.load` in it,
which begin when the loop does.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from typing import Any

from benchmarks.load import start_load
from coulombus.host.realtime import process
from coulombus.host.realtime.data_plane import DataPlane
from coulombus.host.realtime.shared_memory import PlaneStatus, SharedPlane


class LoadedPlane(DataPlane):
    """A `DataPlane` whose process has a busy and a garbage-making Python thread besides
    the loop.
    """

    MODULE = "benchmarks.loaded_plane"

    def wait_loaded(self) -> None:
        """Wait until both threads run."""
        assert self._process.stdout is not None
        self._process.stdout.readline()


def _load_later(settings: dict[str, Any]) -> None:
    shared = SharedPlane(settings["memory_fd"], settings["axes"])
    while (
        shared.plane["status"][0] != PlaneStatus.LISTENING
    ):  # what comes before would take minutes beside a busy thread
        time.sleep(0.02)
    start_load()
    os.write(1, b"loaded\n")


if __name__ == "__main__":
    settings = json.loads(sys.argv[1])
    threading.Thread(target=_load_later, args=(settings,), daemon=True).start()
    sys.exit(process.main(settings))
