"""A CANopen device of one's own: a lamp that is switched and a thermometer that is read.

The EDS beside this file says what the device has, the call-backs what it does. Try it with

    python examples/own_device.py coulombus:bench
    coulombus conformance --bus coulombus:bench --node 5 --eds examples/own_device.eds
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from coulombus import Device

device = Device(Path(__file__).with_suffix(".eds"), node_id=5)


@device.written("Lamp")  # by an SDO or a PDO; "6200:01" names the same object
def switch(value: int) -> None:
    """Switch the lamp, as a real one would be here."""
    print("the lamp is", "on" if value & 1 else "off", flush=True)


@device.sync
def measure() -> None:
    """Measure the temperature after each SYNC; the next TPDO has it, in hundredths of a degree."""
    device["6401:01"] = 2000 + int(time.monotonic() * 10) % 100


if __name__ == "__main__":
    device.serve(sys.argv[1] if len(sys.argv) > 1 else "coulombus:bench")
