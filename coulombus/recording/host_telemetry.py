"""Internal values of the host, as frames of a second interface of the recording.

After each cycle the host reports values of each axis that no PDO carries: its phase, the active
limits, and the law's output and state. The frames were never on the bus. In the file they have a
separate interface, `HOST_INTERFACE`, with extended identifiers that no bus of a rig uses::

    1FC00000h + 16 * axis     byte 0        1      2      3      4      5      6         7
                              phase  trip   limits        gain          stuck  position_age
                         + 1  law_Nm (real32)             law_brake_Nm (real32)
                         + 2  velocity_rad_s (real32)     x_stuck_rad (real32)
                         + 3  and further: two values (real32) each of the law's state;
                              for an odd number the last frame has one value, and 4 bytes
                         + 11 world_Nm (real32)           world_brake_Nm (real32)
                         + 12 world_share   law_share     world_model
                              (1 count: 0.0001)           (number of the model in use)

The last two are there if the rig file has [world]. The names of the law's state are attached (`NAME`): a JSON list of strings. The recording is thus
self-contained, and `read` has the values as signals: ``host.phase``, ``host.law_Nm``.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from enum import IntEnum
from typing import NamedTuple

from coulombus.eds.pdo import Entry, PdoLayout
from coulombus.recording.pcapng_blocks import HOST_INTERFACE, SOURCE_INSIDE
from coulombus.rigs.field_help import UNITS, unit_of
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo, Signal
from coulombus.wire.can_flags import CAN_EFF_FLAG

__all__ = [
    "FIRST",
    "HOST_INTERFACE",
    "MOST_FRAMES",
    "NAME",
    "NODE",
    "OF_WORLD",
    "PER_AXIS",
    "PHASE_RUN",
    "SOURCE_INSIDE",
    "Limit",
    "inside_attachment",
    "inside_pdos",
    "of_axis",
]

NAME = "host.inside"
"""The attachment with the names of the law's state."""
NODE = "host"
"""Prefix of the signals' names, after the axis."""
FIRST = CAN_EFF_FLAG | 0x1FC00000
"""Identifier of the first axis' first frame."""
PER_AXIS = 16
"""Identifiers of each axis."""
OF_WORLD = 3 + 8
"""First frame of the world (`host.world`), after the law's: a law has at most 16 state numbers."""
MOST_FRAMES = OF_WORLD + 2
"""Maximum frames of an axis per cycle."""
GAIN = 1e-4
"""Value of one count of the gain."""
PHASE_RUN = 5
"""``host.phase`` while the law is displayed (`host.cycle.records.Phase.RUN`)."""


class Limit(IntEnum):
    """Active limits of a cycle: bits of ``host.limits``."""

    TORQUE_CLIPPED = 1  # the motor's torque exceeded its limit
    TORQUE_SLOWED = 2  # ... was held back by its rate, or near the speed limit
    BY_DRIVE = 4  # the drive reported an internal limit
    SETPOINT_CLIPPED = 8  # the brake's set-point exceeded its limit
    SETPOINT_NEGATIVE = 16
    COMPENSATION_WITHHELD = 32  # the observer let the motor give less than its compensation
    TPDO_MISSED = 64  # a cyclic TPDO was missing
    DEADMAN_OPEN = 128
    WORLD_CLIPPED = 256  # a limit changed what the world asked for


class _Field(NamedTuple):
    name: str
    bits: int
    unit: str = ""
    scale: float = 1.0
    real: bool = False


def _real(name: str) -> _Field:
    return _Field(name, 32, unit_of(name), real=True)


HEAD: tuple[tuple[_Field, ...], ...] = (
    (
        _Field("phase", 8),
        _Field("trip", 8),
        _Field("limits", 16),
        _Field("gain", 16, "", GAIN),
        _Field("stuck", 8),
        _Field("position_age", 8),
    ),
    (_real("law_Nm"), _real("law_brake_Nm")),
    (_real("velocity_rad_s"), _real("x_stuck_rad")),
)
WORLD: tuple[tuple[_Field, ...], ...] = (
    (_real("world_Nm"), _real("world_brake_Nm")),
    (_Field("world_share", 16, "", GAIN), _Field("law_share", 16, "", GAIN), _Field("world_model", 32)),
)


def inside_attachment(law_state: Sequence[tuple[str, int]]) -> dict[str, bytes]:
    """Return the attachment for a law's state: number of values and their names."""
    names = [name if size == 1 else _numbered(name, k + 1) for name, size in law_state for k in range(size)]
    return {NAME: json.dumps(names).encode()}


def _numbered(name: str, k: int) -> str:
    """Return ``F_2_Nm`` of ``F_Nm``: the unit stays at the name's end."""
    suffix = next((unit for unit in UNITS if name.endswith(unit)), "")
    return f"{name.removesuffix(suffix)}_{k}{suffix}"


def inside_pdos(rig: Rig, attached: bytes | None) -> tuple[RigPdo, ...]:
    """Return the PDOs of the host's frames for `rig`, by the attachment; empty without it."""
    if attached is None:
        return ()
    try:
        names = json.loads(attached)
        law_fields = [_real(f"law.{name}") for name in names if isinstance(name, str)][: 2 * (OF_WORLD - len(HEAD))]
    except (ValueError, TypeError):
        return ()
    pairs = tuple(tuple(law_fields[k : k + 2]) for k in range(0, len(law_fields), 2))
    return tuple(
        _pdo(rig, axis.prefix, FIRST + PER_AXIS * number, k, fields)
        for number, axis in enumerate(rig.axes)
        for k, fields in (*enumerate(HEAD + pairs), *(enumerate(WORLD, OF_WORLD) if axis.world is not None else ()))
    )


def _pdo(rig: Rig, prefix: str, first: int, number: int, fields: tuple[_Field, ...]) -> RigPdo:
    layout = PdoLayout(
        number=number + 1,
        direction="tpdo",
        cob_id=first + number,
        transmission=1,
        inhibit_ns=0,
        event_ns=0,
        sync_start=0,
        rtr_allowed=False,
        entries=tuple(
            Entry(0, k, field.bits, False, "real" if field.real else "int", field.name)
            for k, field in enumerate(fields)
        ),
    )
    signals = tuple(
        Signal(f"{prefix}{NODE}.{field.name}", 0, k, field.scale, 0.0, field.unit) for k, field in enumerate(fields)
    )
    return RigPdo(f"{prefix}{NODE}", rig.host.node_id, layout, signals)


def of_axis(pdos: Sequence[RigPdo], axis: str) -> tuple[RigPdo, ...]:
    """Return the PDOs of an axis, with plain names."""
    before = f"{axis}."
    return tuple(
        replace(
            pdo,
            node=pdo.node.removeprefix(before),
            signals=tuple(replace(signal, name=signal.name.removeprefix(before)) for signal in pdo.signals),
        )
        for pdo in pdos
        if pdo.node.startswith(before)
    )
