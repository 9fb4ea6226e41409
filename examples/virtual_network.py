"""A CANopen network for one's own tests, in virtual time: two devices from an EDS, a master and a
monitor.

Nothing sleeps: a second passes as fast as it is computed, and the same program prints the same
times to the nanosecond.
"""

from __future__ import annotations

import sys
from pathlib import Path

from coulombus.sim_bus.network.network import Heard, VirtualNetwork

EDS = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent.parent / "eds" / "motor.eds"


def main() -> None:
    """Boot two nodes, read an object, start them and count the answers to SYNC."""
    network = VirtualNetwork(bitrate_bit_s=500_000)
    for node_id in (1, 2):
        network.add(EDS, node_id)
    master = network.station()  # hears every frame
    network.power_on()
    network.wait_ns(10_000_000)
    for boot in master.take():
        print(f"{boot.t_ns / 1e3:.1f} us: boot-up of node {boot.can_id & 0x7F}")

    master.send(0x602, bytes.fromhex("4000100000000000"))  # SDO upload of 1000h
    answer = master.wait_for(0x582, timeout_ns=50_000_000)
    assert answer is not None
    print(f"node 2 is of device type 0x{int.from_bytes(answer.data[4:], 'little'):08X}")

    counts = {0x181: 0, 0x182: 0}

    def count(frame: Heard) -> None:
        counts[frame.can_id] += 1

    network.station(counts, on_frame=count)  # hears only TPDO1 of both
    master.send(0x000, b"\x01\x00")  # NMT: start all
    for cycle in range(100):
        master.send(0x080, at_ns=network.t_ns + (cycle + 1) * 10_000_000)  # SYNC
    network.wait_ns(1_005_000_000)
    print(f"100 SYNCs, TPDO1 of node 1: {counts[0x181]}, of node 2: {counts[0x182]}")


if __name__ == "__main__":
    main()
