"""Messages to a display at random: bytes, records with wrong bytes, and models with values in and out of range."""

import math
import time

from coulombus.host.world.model_check import RANGES
from coulombus.host.world.model_parts import Model, TorqueProfile
from coulombus.host.world.protocol import Greeting
from coulombus.host.world.records import MODEL, MOST_SAMPLES, PARAMETERS, ModelParts, offset_of

AFTER_SEQUENCE = offset_of(MODEL, "t_ns")
NO_NUMBERS = (math.nan, math.inf, -math.inf, -0.0, 1e308, 5e-324)


def number(rng, low, high):
    """Return a number from low to high of any magnitude; one of 50 is out of range or not finite."""
    if rng.random() < 0.02:
        return rng.choice((*NO_NUMBERS, 2 * high, 2 * low - 1.0))
    end = high if low == 0.0 or rng.random() < 0.5 else low
    return end * 10.0 ** rng.uniform(-9.0, 0.0)


class Fuzz:
    """Messages of a program that was welcomed with `named`, at random."""

    def __init__(self, rng, longest_life_ns, named):
        self._rng, self._longest_life_ns = rng, longest_life_ns
        self._bounds = {entry.slot: (entry.low, entry.high) for entry in named if entry.slot >= 0}

    def model(self, sequence):
        """Return a record whose fields have the right type; most are in range."""
        rng = self._rng
        profile = TorqueProfile([rng.uniform(-5.0, 5.0) for _ in range(rng.randrange(1, MOST_SAMPLES + 1))])
        record = Model(profile=profile).record({}, profile=rng.getrandbits(32))
        record["sequence"] = sequence
        record["t_ns"] = rng.choice((0, time.monotonic_ns(), rng.getrandbits(63))) if rng.random() < 0.1 else 0
        record["life_ns"] = rng.randrange(1, self._longest_life_ns) if rng.random() < 0.98 else -1
        record["axis"] = rng.choice((-1, 1, 1 << 40)) if rng.random() < 0.02 else 0
        record["parts"] = rng.randrange(ModelParts.PLANE if rng.random() < 0.9 else 2 * sum(ModelParts))
        record["wall_side"] = rng.choice((1, -1, 1, -1, 1, -1, 0, 7))
        for name, (low, high) in RANGES.items():
            record[name] = number(rng, low, high) if rng.random() < 0.8 else 0.0
        if rng.random() < 0.02:
            record["samples"] = rng.getrandbits(62)
        record["sample_ns"] = rng.randrange(1, 20_000_000) if rng.random() < 0.98 else -1
        slots = [slot for slot in self._bounds if rng.random() < 0.3]
        record["parameters"] = (
            sum(1 << slot for slot in slots) if rng.random() < 0.95 else rng.getrandbits(PARAMETERS + 4)
        )
        for slot in slots:
            low, high = self._bounds[slot]
            record["parameter"][slot] = rng.uniform(low, high) if rng.random() < 0.9 else number(rng, low, high)
        return bytearray(record.tobytes())

    def garbled(self, sequence):
        """Return a model record with random bytes behind its sequence number."""
        return self._other_bytes(self.model(sequence), AFTER_SEQUENCE)

    def rubbish(self, sequence):
        """Return the bytes of a connection: random, or a greeting with a garbled record that may be cut."""
        rng = self._rng
        if rng.random() < 0.2:
            return rng.randbytes(rng.randrange(1, 2 * MODEL.itemsize))
        data = bytearray(Greeting(flags=0).record()) + self._other_bytes(self.model(sequence), 0)
        if rng.random() < 0.3:
            del data[rng.randrange(1, len(data)) :]
        return data if rng.random() < 0.8 else self._other_bytes(data, 0)

    def _other_bytes(self, data, first):
        for _ in range(self._rng.randrange(1, 9)):
            data[self._rng.randrange(first, len(data))] = self._rng.randrange(256)
        return data
