r"""A model that keeps the handle swinging gets softer, compiled.

What a sampled model returns comes late, and what comes late gives energy (Colgate and Schenkel, J. Robotic
Systems 14(1), 1997). So a model acts on the place where the handle will be when the torque acts,
:math:`x + v \tau`: that takes back the energy of the delay :math:`\tau`. It is not enough if the stiffness
is too high for the period, the encoder and the hand. Then the handle swings, and the model feeds the swings.

A swing that ends within `CHATTER_NS` is fed if it is nearly as large as the one before, and if what is stiff
or damps gave energy by the motor during both, and more than law, profile and constant force (an energy account
at the hand's port, with the torque that acted; Hannaford and Ryu 2002, doi:10.1109/70.988969). A drive that
lags more than is believed hides this energy: `SUSTAINED` swings that are too fast for a hand, and fed by
nothing else, count, too. With each one the stiffness and the damping are multiplied by `SOFTENS`; a motor at
its limit is as stiff as this limit by the swing. So they end where the hand's own damping is enough. Off the
model they come back slowly.

    w : the `LocalModelRecord` of an axis        m : a `ModelRecord`
"""

from __future__ import annotations

from coulombus.host.world.records import OFFERS, LocalModelRecord, ModelParts, ModelRecord
from coulombus.kernels.decorator import kernel

__all__ = ["DRIVE_LAG_S", "come_back", "feeds_a_swing", "field_stiffness", "keep_stiffness", "soften"]

DRIVE_LAG_S = 1e-3
"""Lag of a drive's torque behind its set-point, of which no device tells anything."""
CHATTER_NS = 80_000_000
"""Longest swing of an oscillation."""
HAND_NS = 50_000_000
"""A hand's own swings are longer."""
SUSTAINED = 8
"""So many swings in a row that are shorter are no hand's."""
KEPT = 0.8
"""A swing that is smaller than this share of the one before dies by itself."""
SOFTENS = 0.8
MOST = 0.999
RECOVERY_S = 2.0
"""Time in which the stiffness grows e-fold while the model exerts nothing."""
WALL, SPRING, FIELD = int(ModelParts.WALL), int(ModelParts.SPRING), int(ModelParts.FIELD)


@kernel
def field_stiffness(m: ModelRecord) -> float:
    """Return the sum of a field's stiffness in the plane, 0 for a constant force."""
    stiffness = 0.0
    for k in range(4):
        stiffness += abs(m.plane_field_N_m[k])
    return stiffness


@kernel
def keep_stiffness(w: LocalModelRecord) -> None:
    """Take the newest model: one that is stiffer than the last is softened down to what was displayed."""
    m = w.offered[w.taken % OFFERS]
    stiffness = 0.0
    if m.parts & WALL:
        stiffness += m.wall_K_Nm_rad + m.plane_wall_K_N_m
    if m.parts & SPRING:
        stiffness += m.spring_K_Nm_rad + m.plane_spring_K_N_m
    if m.parts & FIELD:
        stiffness += abs(m.field_Nm_rad) + field_stiffness(m)
    if w.softened > 0.0:
        displayed = (1.0 - w.softened) * w.stiffness
        w.softened = min(max(1.0 - displayed / stiffness, 0.0), MOST) if displayed * stiffness > 0.0 else 0.0
    w.stiffness = stiffness


@kernel
def feeds_a_swing(w: LocalModelRecord, x_rad: float) -> bool:
    """Follow the handle's swings, once a cycle; return whether one ends in this cycle that the model has fed."""
    stiff_Nm = w.world_Nm - w.driven_Nm
    for k in range(2):
        part_Nm = stiff_Nm if k == 0 else w.pushed_Nm - stiff_Nm
        w.given_J[k] -= w.acting_Nm[k] * (x_rad - w.swing_x_rad)
        w.acting_Nm[k] += ((part_Nm if w.acts_at_once else w.before_Nm[k]) - w.acting_Nm[k]) * w.drive_step
        w.before_Nm[k] = part_Nm
    w.swing_x_rad = x_rad
    w.swing_ns += w.period_ns
    w.extreme_rad = min(w.extreme_rad, x_rad) if w.falls else max(w.extreme_rad, x_rad)
    if abs(w.extreme_rad - x_rad) <= w.swing_band_rad:
        return False
    size_rad = abs(w.extreme_rad - w.turned_rad)
    fast = w.swing_ns < CHATTER_NS
    stiff_J, rest_J = w.given_J[0] + w.given_before_J[0], w.given_J[1] + w.given_before_J[1]
    sustained = fast and size_rad > KEPT * w.swing_rad > 0.0
    w.swings = w.swings + 1 if sustained and w.swing_ns < HAND_NS else 0
    fed = sustained and (stiff_J > max(rest_J, 0.0) or (w.swings >= SUSTAINED and rest_J <= 0.0))
    w.swing_rad = size_rad if fast else 0.0
    w.turned_rad, w.extreme_rad, w.falls = w.extreme_rad, x_rad, 1 - w.falls
    for k in range(2):
        w.given_before_J[k], w.given_J[k] = w.given_J[k], 0.0
    w.swing_ns = 0
    w.demand_before, w.demand = w.demand, 0.0
    return fed


@kernel
def soften(w: LocalModelRecord) -> None:
    """Display a softer model: softer than the torque that the motor gave makes it, where that was at its limit."""
    w.softened = min(1.0 - (1.0 - w.softened) * SOFTENS / max(w.demand_before, 1.0), MOST)


@kernel
def come_back(w: LocalModelRecord, exerts: bool) -> None:
    """Let the stiffness grow again while the handle is off the model, and does not swing."""
    if not exerts and w.swing_ns >= CHATTER_NS:
        w.softened = max(1.0 - (1.0 - w.softened) * (1.0 + 1e-9 * w.period_ns / RECOVERY_S), 0.0)
