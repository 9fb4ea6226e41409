"""Random bit errors with a rate and a seed, in a frame or on an idle wire: the time of the next one."""

from __future__ import annotations

import math

from coulombus.kernels.decorator import kernel
from coulombus.sim_bus.can_bus.records import NOBODY, NS, BusRecord
from coulombus.wire.clock import NEVER_NS

__all__ = ["disturber", "next_noise", "noisy_bit", "renew", "seeded"]

MODULUS, MULTIPLIER = 2_147_483_647, 48_271
MOST_BITS = 1e12


def seeded(seed: int) -> int:
    """Return the generator's state for a seed."""
    return (seed * 2_654_435_761 + 0x5DEECE66) % (MODULUS - 1) + 1


@kernel
def renew(bus: BusRecord, t_ns: int) -> None:
    """Combine the noises active at `t_ns`: together they disturb a bit with the probability
    1 - (1 - r1)(1 - r2)...
    """
    rate = 0.0
    bus.noise.until_ns = NEVER_NS
    for row in range(bus.fault_count):
        f = bus.faults[row]
        if f.active:
            rate += f.rate * (1.0 - rate)
            bus.noise.until_ns = min(bus.noise.until_ns, f.until_ns)
    bus.noise.rate = rate
    next_noise(bus, t_ns)


@kernel
def disturber(bus: BusRecord) -> int:
    """Return the row of the noise that disturbs this bit, drawn by the rates of the active noises."""
    last = count = 0
    rates = 0.0
    for row in range(bus.fault_count):
        if bus.faults[row].active:
            last = row
            count += 1
            rates += bus.faults[row].rate
    if count > 1:
        bus.noise.state = bus.noise.state * MULTIPLIER % MODULUS
        left = bus.noise.state / MODULUS * rates
        for row in range(last):
            if bus.faults[row].active:
                left -= bus.faults[row].rate
                if left < 0.0:
                    return row
    return last


@kernel
def next_noise(bus: BusRecord, t_ns: int) -> None:
    """Draw `next_ns`, the begin of the next disturbed bit: the number of undisturbed bits from `t_ns`
    on has a geometric distribution with the rate as its probability.

    The generator is Park's and Miller's minimal standard (doi:10.1145/63039.63042) with the
    multiplier 48271: all of it in int64.
    """
    if bus.noise.rate <= 0.0:
        bus.noise.next_ns = NEVER_NS
        return
    bus.noise.state = bus.noise.state * MULTIPLIER % MODULUS
    bits = 0.0
    if bus.noise.rate < 1.0:
        bits = min(math.log(bus.noise.state / MODULUS) / math.log1p(-bus.noise.rate), MOST_BITS)
    bus.noise.next_ns = t_ns + int(bits) * NS // bus.bit_rate
    if bus.noise.next_ns >= bus.noise.until_ns:
        bus.noise.next_ns = NEVER_NS


@kernel
def noisy_bit(bus: BusRecord, end_ns: int) -> int:
    """Return the station that noise hits in the bit that ends at `end_ns`, mostly `NOBODY`.

    Draw the next such bit.
    """
    if bus.noise.next_ns >= end_ns:
        return NOBODY
    bus.noise.hits += 1
    fault = bus.faults[disturber(bus)]
    fault.hits += 1
    next_noise(bus, end_ns)
    return int(fault.station)
