"""A set-up that is taken over from an earlier run: the same bytes as without."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import pytest

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.setup.bringup import bring_up
from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.lab import set_up as module
from coulombus.lab.set_up import clear_cache, ready_world, return_world, set_up
from coulombus.lab.simulate import simulate
from coulombus.rigs.rig import Rig, load_rig
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from places import ROOT

EXAMPLES = ROOT / "examples"
DISPLAY_NS = 700_000_000

cached_set_up = partial(set_up, cached=True)

pytestmark = pytest.mark.skipif(JIT_DISABLED, reason="the plants' way through the set-up is a compiled function")


@pytest.fixture(autouse=True)
def nothing_kept() -> Iterator[None]:
    clear_cache()
    yield
    clear_cache()


@pytest.fixture
def set_ups(monkeypatch: pytest.MonkeyPatch) -> list[VirtualRig]:
    """The worlds that were brought up over SDO."""
    done: list[VirtualRig] = []

    def counted(controllers: Controllers, world: VirtualRig) -> tuple[str, ...]:
        done.append(world)
        return bring_up(controllers, world)

    monkeypatch.setattr(module, "bring_up", counted)
    return done


def course(rig: Rig, mode: str, seed: int, begin: Callable[[VirtualRig], tuple[str, ...]]) -> dict[str, Any]:
    """Return everything that a run leaves behind: each frame from power-on on, and each record."""
    world = VirtualRig(rig, mode, seed=seed)
    return displayed(world, lambda: begin(world))


def displayed(world: VirtualRig, begin: Callable[[], tuple[str, ...]]) -> dict[str, Any]:
    frames = []
    world.on_frames = lambda batch: frames.append(batch.copy())
    losses = begin()
    began_ns = world.t_ns
    world.start_host()
    world.wait_ns(DISPLAY_NS)
    world.flush()
    parts = world.arguments[0]
    left = {name: getattr(parts, name).tobytes() for name in ("nodes", "plant", "axes", "bus", "deadlines", "wants")}
    objects = [device.state() for device in world.devices]
    return {
        "frames": np.concatenate(frames).tobytes(),
        "host": world.controllers.axes.tobytes(),
        **left,
        "objects": objects,
        "losses": losses,
        "began": began_ns,
        "exits": world.exits,
    }


OTHERS = (
    ("bench", "hybrid", ()),
    ("bench", "active", ("plant.coulomb_Nm=0.08", "operator.inertia_kg_m2=0.01")),
    ("bench", "passive", ("plant.transducer_noise_Nm=0.02", "operator.tremor_Nm=0.05", "plant.step_s=1e-4")),
    ("two_axes", "hybrid", ()),
    ("elastic", "hybrid", ("plant.cable.stiffness_Nm_rad=300.0",)),
    ("bench", "active", ("plant.cable.motor_inertia_kg_m2=2e-4", "plant.cable.stiffness_Nm_rad=300.0")),
)


@pytest.mark.parametrize(("name", "mode", "changed"), OTHERS)
def test_a_run_that_takes_a_set_up_over_has_the_same_bytes(
    name: str, mode: str, changed: tuple[str, ...], set_ups: list[VirtualRig]
) -> None:
    first = load_rig(EXAMPLES / "elastic.toml" if name == "elastic" else name)
    cached_set_up(VirtualRig(first, mode, seed=3))
    other = first.variant(*changed)
    alone, taken = course(other, mode, 11, set_up), course(other, mode, 11, cached_set_up)
    assert len(set_ups) == 2
    assert {key for key in alone if alone[key] != taken[key]} == set()


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "mode", "changed"), OTHERS)
@pytest.mark.parametrize("tripped", [False, True])
def test_a_world_that_begins_again_has_the_same_bytes(
    name: str, mode: str, changed: tuple[str, ...], *, tripped: bool
) -> None:
    first = load_rig(EXAMPLES / "elastic.toml" if name == "elastic" else name)
    world = VirtualRig(first, mode, seed=3)
    losses = cached_set_up(world)
    world.start_host()
    world.wait_ns(DISPLAY_NS)
    if tripped:
        world.inject(0, "over_current", present=True)
        world.wait_ns(50_000_000)
        assert world.controllers.trip is not None
        world.inject(0, "over_current", present=False)
    return_world(world)
    other = first.variant(*changed)
    ready = ready_world(other, mode, 11)
    assert ready == (world, losses)
    assert ready_world(other, mode, 11) is None  # it is somebody's
    alone, again = course(other, mode, 11, set_up), displayed(world, lambda: losses)
    assert {key for key in alone if alone[key] != again[key]} == set()


def test_a_world_of_other_devices_or_of_a_law_that_may_be_edited_is_nobodys() -> None:
    rig = load_rig("bench")
    for one in (rig, rig.with_law(f"{EXAMPLES / 'own_law.py'}:stribeck")):
        world = VirtualRig(one, "hybrid")
        cached_set_up(world)
        return_world(world)
    assert ready_world(one, "hybrid", 0) is None
    assert ready_world(rig, "active", 0) is None
    assert ready_world(rig.variant("mechanics.friction_Nm=0.15"), "hybrid", 0) is None
    assert ready_world(rig.variant("plant.temperature_degC=31.0"), "hybrid", 0) is None  # and the world is gone
    assert ready_world(rig, "hybrid", 0) is None


def test_threads_that_simulate_side_by_side_do_not_share_a_world() -> None:
    rig = load_rig("bench")
    alone = [simulate(rig, "hybrid", 0.3, seed=seed, measured=True).as_dict() for seed in range(6)]
    with ThreadPoolExecutor(3) as pool:
        beside = list(pool.map(lambda seed: simulate(rig, "hybrid", 0.3, seed=seed, measured=True).as_dict(), range(6)))
    assert beside == alone


def test_a_world_whose_host_believes_something_else_is_not_kept() -> None:
    rig = load_rig("bench")
    world = VirtualRig(rig, "hybrid", believed=rig.variant("mechanics.friction_Nm=0.15"))
    cached_set_up(world)
    return_world(world)
    assert ready_world(rig, "hybrid", 0) is None


@pytest.mark.parametrize(
    "changed",
    [
        "mechanics.friction_Nm=0.15",  # the drive's limit follows from it
        "brake.setpoint_fault_s=0.02",  # is written to the brake
        "plant.temperature_degC=31.0",  # the driver measures it, and may trip by it
    ],
)
def test_a_set_up_is_not_taken_over_where_it_may_differ(changed: str, set_ups: list[VirtualRig]) -> None:
    rig = load_rig("bench")
    cached_set_up(VirtualRig(rig, "hybrid"))
    cached_set_up(VirtualRig(rig.variant(changed), "hybrid"))
    assert len(set_ups) == 2


def test_a_set_up_of_another_mode_is_not_taken_over(set_ups: list[VirtualRig]) -> None:
    rig = load_rig("bench")
    for mode in ("hybrid", "active", "hybrid", "active"):
        cached_set_up(VirtualRig(rig, mode))
    assert len(set_ups) == 2


def test_a_world_with_a_script_is_set_up_by_itself(set_ups: list[VirtualRig]) -> None:
    rig = load_rig("bench")
    cached_set_up(VirtualRig(rig, "hybrid"))
    world, called = VirtualRig(rig, "hybrid"), []
    world.at(1_000_000, lambda one: called.append(one.t_ns))
    cached_set_up(world)
    assert len(set_ups) == 2
    assert called == [1_000_000]


def test_a_run_for_its_figures_is_the_same_with_and_without(set_ups: list[VirtualRig]) -> None:
    rig = load_rig("bench").variant("plant.coulomb_Nm=0.06")
    own = simulate(rig, "hybrid", 0.4, seed=4, measured=True).as_dict()
    taken = simulate(rig, "hybrid", 0.4, seed=4, measured=True).as_dict()
    assert len(set_ups) == 1
    assert taken == own


@pytest.mark.parametrize("warms", [(), ("plant.coil_thermal_K_W=50.0", "plant.coil_thermal_s=2.0")])
def test_a_run_that_shows_its_progress_is_the_same(warms: tuple[str, ...]) -> None:
    rig = load_rig("bench").variant(*warms)
    shown: list[float] = []
    told = simulate(rig, "hybrid", 3.0, measured=True, progress=shown.append).as_dict()
    assert len(shown) > 10
    assert simulate(rig, "hybrid", 3.0, measured=True).as_dict() == told
