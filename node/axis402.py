"""Compiled view of a drive's axis: zero of the position, switches, index, digital inputs, touch probes.

The axis counts from its power-on. Homing moves the *zero*: 6064h = position of the axis - zero,
within the range 607Bh or as an INTEGER32, both with overflow. The switches have places on the axis:

    negative limit switch   active at and below its place     bit 0 of 60FDh
    positive limit switch   active at and above its place     bit 1
    home switch             active between its two places     bit 2

The index is at every multiple of the counts in one turn of the motor. The touch probes 1 and 2
(60B8h to 60BDh) latch the position at the edges of the home switch, or at the index: the position
of the edge itself, not that of the next computation.

In the kernels: `n` the node's record (`node.record`), `probe` 0 or 1.
"""

from __future__ import annotations

import math

from coulombus.kernels.decorator import kernel
from coulombus.node import slots402
from coulombus.node.record import NodeRecord

__all__ = [
    "HOME",
    "NEGATIVE",
    "POSITIVE",
    "axis_position",
    "digital_inputs",
    "inputs",
    "look_at_probes",
    "new_probe_function",
    "next_index",
    "user_position",
]

NEGATIVE, POSITIVE, HOME = 1, 2, 4
"""Bits of 60FDh."""
_LOW, _HOME_FROM, _HOME_TO, _HIGH = 0, 1, 2, 3
_ENABLE, _CONTINUOUS, _SOURCE, _BY_INDEX, _RISING, _FALLING = 1, 2, 12, 4, 16, 32
_ENABLED, _RISEN, _FALLEN = 1, 2, 4
_SHORTEST_WAY, _NEGATIVE_WAY, _POSITIVE_WAY = 0xC0, 0x40, 0x80


@kernel
def user_position(n: NodeRecord, position: float) -> int:
    """Return a position of the axis as 6064h shows it."""
    counts = math.floor(position + 0.5) - n.zero_counts
    low, high = n.values[slots402.RANGE_LOW], n.values[slots402.RANGE_HIGH]
    if low < high:
        return int(low + (counts - low) % (high - low + 1))
    return ((counts + 0x80000000) & 0xFFFFFFFF) - 0x80000000


@kernel
def axis_position(n: NodeRecord, target: int, start: float) -> float:
    """Return the position of the axis for a user position, in the turn of the counter of `start`; within
    607Bh in the direction of 60F2h.
    """
    way = float(target - user_position(n, start))
    low, high = n.values[slots402.RANGE_LOW], n.values[slots402.RANGE_HIGH]
    start = math.floor(start + 0.5)
    if low >= high:
        return start + way
    span = float(high - low + 1)
    way = (way + user_position(n, start) - low) % span - (user_position(n, start) - low)
    option = n.values[slots402.POSITION_OPTION] & _SHORTEST_WAY
    if (option == _NEGATIVE_WAY and way > 0.0) or (option == _SHORTEST_WAY and way > span / 2):
        way -= span
    elif (option == _POSITIVE_WAY and way < 0.0) or (option == _SHORTEST_WAY and way <= -span / 2):
        way += span
    return start + way


@kernel
def inputs(n: NodeRecord, position: float) -> int:
    """Return the switches that are active at a position: bits of 60FDh."""
    bits = NEGATIVE if position <= n.switch_counts[_LOW] else 0
    if position >= n.switch_counts[_HIGH]:
        bits |= POSITIVE
    if n.switch_counts[_HOME_FROM] <= position <= n.switch_counts[_HOME_TO]:
        bits |= HOME
    return bits


@kernel
def digital_inputs(n: NodeRecord, position: float) -> int:
    """Return 60FDh at a position: the bits of the placed switches; the other bits are as they were."""
    places = n.switch_counts
    placed = NEGATIVE if places[_LOW] > -math.inf else 0
    if places[_HIGH] < math.inf:
        placed |= POSITIVE
    if places[_HOME_FROM] < math.inf:
        placed |= HOME
    present: int = n.values[slots402.DIGITAL_INPUTS]
    return present & ~placed | inputs(n, position)


@kernel
def next_index(n: NodeRecord, position: float, direction: float) -> float:
    """Return the position of the first index beyond a position."""
    turns = position / n.index_counts
    return n.index_counts * (math.floor(turns) + 1.0 if direction > 0.0 else math.ceil(turns) - 1.0)


@kernel
def new_probe_function(n: NodeRecord) -> None:
    """Begin with a new 60B8h: what it disables is no longer stored."""
    values = n.values
    status = 0
    for probe in range(2):
        function = values[slots402.PROBE_FUNCTION] >> 8 * probe & 0xFF
        before = n.probe_function >> 8 * probe & 0xFF
        if function & _ENABLE:
            stored = values[slots402.PROBE_STATUS] >> 8 * probe & 0xFF if before & _ENABLE else 0
            if not function & _RISING:
                stored &= ~_RISEN
            if not function & _FALLING:
                stored &= ~_FALLEN
            status |= (stored | _ENABLED) << 8 * probe
    n.probe_function = values[slots402.PROBE_FUNCTION]
    n.probe_counts = float(n.in_position_counts)
    values[slots402.PROBE_STATUS] = status


@kernel
def look_at_probes(n: NodeRecord) -> None:
    """Latch the positions of the edges that the axis has passed."""
    before, now = n.probe_counts, float(n.in_position_counts)
    n.probe_counts = now
    if n.probe_function & (_ENABLE | _ENABLE << 8) == 0 or before == now:
        return
    direction = 1.0 if now > before else -1.0
    index = next_index(n, before, direction)
    if (now - index) * direction >= 0.0:
        _edge(n, True, True, index)
    entry = n.switch_counts[_HOME_FROM if direction > 0.0 else _HOME_TO]
    leave = n.switch_counts[_HOME_TO if direction > 0.0 else _HOME_FROM]
    if (entry - before) * direction > 0.0 and (now - entry) * direction >= 0.0:
        _edge(n, False, True, entry)
    if (leave - before) * direction >= 0.0 and (now - leave) * direction > 0.0:
        _edge(n, False, False, leave)


@kernel
def _edge(n: NodeRecord, index: bool, rising: bool, position: float) -> None:
    for probe in range(2):
        function = n.probe_function >> 8 * probe & 0xFF
        stored = (_RISEN if rising else _FALLEN) << 8 * probe
        latches = function & _ENABLE and function & (_RISING if rising else _FALLING)
        if not latches or (function & _SOURCE == _BY_INDEX) != index:
            continue
        if n.values[slots402.PROBE_STATUS] & stored and not function & _CONTINUOUS:
            continue
        n.values[slots402.PROBE_STATUS] |= stored
        slot = slots402.PROBE_RISING if rising else slots402.PROBE_FALLING
        n.values[slot + 2 * probe] = user_position(n, position)
