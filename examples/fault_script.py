"""Plan a fault: the motor drive loses its power in mid-stroke.

Who notices, and what does the brake do?

python examples/fault_script.py
"""

from __future__ import annotations

from pathlib import Path

from coulombus import read, simulate
from coulombus.sim_bus.network.event_loop import MOTOR
from coulombus.sim_bus.network.virtual_rig import VirtualRig

MS = 1_000_000
AFTER_ENABLED_NS = 5_500 * MS  # the stroke has begun at 5 s, and the handle moves until 6 s


def main() -> None:
    off_ns = []

    def power_off(world: VirtualRig) -> None:
        off_ns.append(world.t_ns)
        world.power_off(MOTOR)

    def wait_for_display(world: VirtualRig) -> None:
        """When the schedule begins is not known beforehand: look every millisecond until it has."""
        if world.enabled_ns is None:
            world.at(world.t_ns + MS, wait_for_display)
        else:
            world.at(world.enabled_ns + AFTER_ENABLED_NS, power_off)

    path = Path("fault.pcapng")
    result = simulate(
        "bench", "hybrid", 13.0, record=path, script=lambda world: world.at(MS, wait_for_display), force=True
    )
    print(f"exit status {result.exit_status}: {result.trip}")

    recording = read(path)
    trip_s = next(time for time, text in recording.markers if text.startswith("trip"))
    print(f"tripped {1e3 * (trip_s - off_ns[0] * 1e-9):.1f} ms after the power-off")
    setpoint = recording["brake.setpoint_Nm"]
    after = setpoint.t_s > trip_s
    held = setpoint.t_s[after & (setpoint.values > 0)]
    print(f"the brake was told at most {setpoint.values[after].max():.1f} Nm, and 0 after {held[-1] - trip_s:.2f} s")


if __name__ == "__main__":
    main()
