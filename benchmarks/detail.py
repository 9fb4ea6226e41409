"""The virtual bus with a plant in detail, everything on, against the plain plant.

The two take turns, and CPU time of the thread is counted.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

from benchmarks.size import size
from coulombus.lab.set_up import set_up
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.network.virtual_rig import VirtualRig

__all__ = ["ALL", "detail"]

ROUNDS = size(9, 1)
SIMULATED_S = 2.0
ALL = (
    "plant.cable.stiffness_Nm_rad=2000.0", "plant.cable.damping_Nms_rad=0.05", "plant.cable.backlash_rad=5e-4",
    "plant.cable.motor_inertia_kg_m2=1e-3", "plant.handle.stiffness_Nm_rad=1500.0",
    "plant.handle.damping_Nms_rad=0.02", "plant.handle.inertia_kg_m2=4e-4", "plant.stribeck_Nm=0.03",
    "plant.friction.angle_share=0.1", "plant.friction.angle_periods=9", "plant.friction.share_1_K=-0.005",
    "plant.friction.drift_1_s=1e-4", "plant.fluid.viscous_Nms_rad=0.002", "plant.fluid.torque_1_K=0.002",
    "plant.fluid.viscous_1_K=0.01", "plant.fluid.fall_lag_s=0.01", "plant.fluid.shear_s_rad=0.1",
    "plant.iron.play_Nm=[0.05,0.1,0.2,0.4]", "plant.iron.weights=[0.1,0.1,0.1,0.1]", "plant.ripple.share=0.02",
    "plant.heat.capacity_J_K=100.0", "plant.heat.resistance_K_W=2.0", "plant.cogging_Nm=0.01",
    "plant.transducer_inertia_kg_m2=1e-4", "plant.transducer_lag_s=5e-4", "plant.transducer_bias_Nm=0.01",
    "plant.coil_step_A=0.001", "plant.encoder_eccentricity_rad=0.001", "operator.population=0.2",
)  # fmt: skip
BRISTLES = ("plant.friction.law=lugre", "plant.friction.sigma_0_Nm_rad=500.0", "plant.friction.sigma_1_Nms_rad=0.1")


def _displaying(*overrides: str) -> VirtualRig:
    world = VirtualRig(load_rig("bench", overrides), "hybrid")
    set_up(world)
    world.start_host()
    world.wait_ns(6_000_000_000)  # into the strokes
    return world


def detail(show: Callable[..., None]) -> None:
    """Print the figures with `show`."""
    worlds = {
        "the plain plant": _displaying(),
        "the plant in detail, everything on": _displaying(*ALL),
        "the same with bristles": _displaying(*ALL, *BRISTLES),
    }
    times: dict[str, list[float]] = {name: [] for name in worlds}
    for _ in range(ROUNDS):
        for name, world in worlds.items():
            begin = time.thread_time()
            world.wait_ns(round(SIMULATED_S * 1e9))
            times[name].append(time.thread_time() - begin)
    for name, row in times.items():
        show(
            f"virtual time with {name}",
            f"{SIMULATED_S / statistics.median(row):.0f} x",
            "at least 500 x",
            [SIMULATED_S / time_s for time_s in row],
        )
    plain, full, _ = (statistics.median(row) for row in times.values())
    show("a cycle with everything on, against the plain plant", f"{full / plain:.1f} x")
