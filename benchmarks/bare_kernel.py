"""The bare co-simulation of the bench rig: its plant, its host's cycle and its codec, without a bus.

Once per cycle the host begins, the plant advances in its own steps, each TPDO is packed and given to
the host at once, the host finishes, and each RPDO is unpacked for the plant. There are no nodes, no
bus, no heartbeats of nodes and no events: a simulation that exchanges the same PDOs by function calls.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

from coulombus.eds.codec import pack, unpack
from coulombus.host.cycle import step
from coulombus.host.cycle.records import Image
from coulombus.kernels.decorator import kernel
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.wire.frame import new_queue

__all__ = ["bare_cycles"]

POSITION, TARGET, TORQUE, BRAKE = map(int, (Image.POSITION, Image.TARGET_TORQUE, Image.TORQUE, Image.BRAKE_SETPOINT))


@kernel
def _cycles(axis, plants, course, law_function, out, image, forces, count):
    c, h, plant = axis.control, axis.host, plants[0]
    f_h, truth, per_knot = forces
    steps, t_ns = c.period_ns // plant.step_ns, h.sync_ns
    zero = image[POSITION] - round(plant.x / c.rad_count)
    for _ in range(count):
        t_ns += c.period_ns
        step.begin(axis, t_ns, out)
        out.count = 0
        course(plants, 0, f_h, per_knot, 0, steps, truth, -1)
        image[POSITION], image[TORQUE] = zero + round(plant.x / c.rad_count), image[TARGET]
        for k in range(c.tpdos):
            pdo = axis.tpdos[k]
            step.on_frame(axis, t_ns, pdo.cob_id, pdo.length, pack(pdo, image))
        step.finish(axis, law_function, t_ns, out)
        for k in range(c.rpdos):
            unpack(axis.rpdos[k], out.frames[k].word, image)
        out.count = 0
        plant.motor_pm, plant.brake_Nm = image[TARGET], h.brake_Nm


def bare_cycles(world: VirtualRig) -> Callable[[int], None]:
    """Return a function that computes so many cycles with copies of the records of `world`, which displays."""
    full, _, law_function, course, _ = world.arguments
    axes, plants, out = world.controllers.axes.copy(), full.plant.copy(), new_queue()
    axes["control"]["heartbeat_timeout_ns"] = 0  # no node sends one
    image = np.array(axes[0]["host"]["image"])
    forces = full.f_h.copy(), full.truth.copy(), int(full.axes[0]["steps_per_knot"])

    def run(count: int) -> None:
        _cycles(axes[0], plants, course, law_function, out, image, forces, count)
        if axes[0]["host"]["trip"]:
            sys.exit(f"benchmarks: the bare co-simulation tripped: {int(axes[0]['host']['trip'])}")

    return run
