"""Models of a world on their way to the cycle: what their parts do not use reaches no law."""

import math
import random

import numpy as np
import pytest

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.models import Models
from coulombus.host.cycle.parameter_changes import LiveParameters
from coulombus.host.laws.karnopp import karnopp
from coulombus.host.world.model_check import ModelRefused
from coulombus.host.world.model_parts import Model, Wall
from coulombus.host.world.protocol import Named
from coulombus.host.world.records import MODEL, OFFERS
from coulombus.rigs.rig import load_rig
from model_cycle import cycle_of
from world_fuzz import Fuzz

WORLD = ("world.rest=law",)


def models_of(rig="bench"):
    controllers = Controllers(load_rig(rig, WORLD), "hybrid")
    parameters = LiveParameters(controllers)
    return controllers, parameters, Models(controllers, parameters)


def in_use(controllers, number):
    """Let the cycle take a model; return its record."""
    world = controllers.axes["world"]
    world["taken"][0] = number
    return world["offered"][0, number % OFFERS]


@pytest.mark.parametrize("rig", ["bench", "plane"])
def test_parameters_that_are_no_part_of_a_model_are_cleared(rig):
    controllers, _, models = models_of(rig)
    record = np.zeros((), MODEL)
    record["life_ns"], record["parameters"] = 1_000_000, 0b110010
    record["parameter"][:6] = -math.inf, math.nan, 1e308, 5e-324, math.inf, -1.0
    model = in_use(controllers, models.write(record))
    assert model["parameters"] == 0
    assert not model["parameter"].any()


def test_parameters_that_are_a_part_are_completed_with_the_rigs():
    controllers, parameters, models = models_of()
    slots = models.slots[0]
    record = Model(wall=Wall(0.5, 2.0), parameters={"F_d_Nm": 1.25}).record(slots)
    model = in_use(controllers, models.write(record))
    values = {row["name"]: row["value"] for row in parameters.rows()[0]}
    assert {name: model["parameter"][slot] for name, slot in slots.items()} == {
        name: values[name] if name != "F_d_Nm" else 1.25 for name in slots
    }


def test_no_accepted_model_makes_a_law_return_what_is_no_number():
    controllers, parameters, models = models_of()
    slots = models.slots[0]
    named = [
        Named(0, slots[row["name"]], row["low"], row["high"], row["value"], row["name"])
        for row in parameters.rows()[0]
        if row["name"] in slots
    ]
    rng = random.Random(38)
    fuzz = Fuzz(rng, models.longest_life_ns, named)
    cycle = cycle_of(1, rest=0.5)
    for name in ("K_p", "F_s", "F_d", "velocity_band_counts"):
        cycle.law[name] = controllers.axes["law"][name][0]
    for sequence in range(1, 4001):
        message = rng.choice((fuzz.model, fuzz.garbled))(sequence)
        try:
            number = models.write(np.frombuffer(bytes(message), MODEL)[0])
        except ModelRefused:
            continue
        cycle.place(in_use(controllers, number))
        for _ in range(rng.randrange(1, 4)):
            torques = cycle.at(rng.gauss(0.0, 0.1), rng.choice((0.0, rng.gauss(0.0, 1.0))), rng.gauss(0.0, 1.0))
            psi_Nm = karnopp(cycle.motion, cycle.w.law, cycle.state)
            assert math.isfinite(psi_Nm), sequence
            assert all(map(math.isfinite, torques)), sequence
            cycle.state.psi_Nm = cycle.law_Nm = psi_Nm
            cycle.law_brake_Nm = cycle.state.brake_Nm
    assert models.accepted > 1000
