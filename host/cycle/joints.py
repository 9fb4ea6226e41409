"""The cycle's end for the joints of one arm: their commands are computed together.

The cycle waits for the TPDOs of all joints. Each joint is measured and watched as an axis is
(`host.cycle.step`). Then the law in the plane is evaluated once, its force is split, and each joint runs its
phase with its share.

- A trip of one joint makes all joints safe in the same cycle.
- The joints arm one after the other: a joint is moved by its sign check only while the joints before it
  are still, and the law begins when all joints are in phase RUN.
- The tip is watched from the first cycle: its workspace, and the Jacobian's condition.
- In the safe state the brakes fall together, in the proportion of the hand's torques, so that a loaded hand
  is let go along its force.

    axes : the `AxisRecord` of each joint; the first holds the `PlaneHostRecord`
    c : the CONTROL record of a joint        h : its HOST record
"""

from __future__ import annotations

import math

from coulombus.host.cycle import step
from coulombus.host.cycle.hand_over import bear, hands_over, ramp_gain
from coulombus.host.cycle.phases import advance
from coulombus.host.cycle.records import AxisRecords, Phase, Trip
from coulombus.host.plane.brake_split import expect_brakes, observe, release
from coulombus.host.plane.plane_host_record import PlaneHostRecord
from coulombus.host.plane.plane_step import PlaneFunctions, evaluate, in_workspace, measure_plane, share_out
from coulombus.host.plane.tip_model import (
    add_tip_model,
    end_tip_model,
    follow_tip_model,
    resist_at_rest,
    unpaid,
)
from coulombus.host.world.softening import feeds_a_swing, soften
from coulombus.kernels.decorator import kernel
from coulombus.rigs.kinematics.mechanisms import JOINTS
from coulombus.wire.frame import Queue

__all__ = ["finish_joints"]


@kernel
def finish_joints(axes: AxisRecords, arm: PlaneFunctions, t_ns: int, window_over: int, out: Queue) -> int:
    """Finish the cycle of all joints if their TPDOs are complete, or the window is over.

    Return the number of joints that still wait.
    """
    waiting, incomplete = 0, 0
    for k in range(JOINTS):
        c, h = axes[k].control, axes[k].host
        waiting += h.waiting
        incomplete += 1 if h.waiting and h.arrived & c.awaited != c.awaited else 0
    if waiting == 0 or (incomplete > 0 and not window_over):
        return incomplete
    for k in range(JOINTS):
        axes[k].host.doubt = step.observe(axes[k], t_ns)
    measured = _measure(axes, arm)
    _doubt_tip(axes, measured)
    end_tip_model(axes[0].world)
    if _displays(axes):
        _display(axes, arm)
    else:
        release(axes[0].plane.split)
    _share(axes)
    if axes[0].world.on:
        _share_model(axes)
    _share_doubt(axes)
    _hold_back(axes)
    for k in range(JOINTS):
        torque_Nm = advance(axes[k], None, axes[k].host.doubt, t_ns)
        axes[k].host.torque_Nm = step.limit_torque(axes[k].control, axes[k].host, torque_Nm)
    if axes[0].world.on:
        _count_limits(axes)
    _start_together(axes, t_ns)
    _release_together(axes)
    for k in range(JOINTS):
        step.close_and_send(axes[k], t_ns, out)
    return 0


@kernel
def _measure(axes: AxisRecords, arm: PlaneFunctions) -> bool:
    """Give the joints' measurements, last commands and parameters to the plane; return whether the pose is known."""
    plane = axes[0].plane
    has_pose = True
    for i in range(JOINTS):
        axis = axes[i]
        plane.counts[i], plane.hand_Nm[i] = axis.host.counts, axis.host.handle_Nm
        plane.split.brake_Nm[i], plane.split.motor_Nm[i] = axis.host.brake_Nm, axis.host.torque_Nm
        plane.control.compensation_Nm[i] = axis.control.compensation_Nm
        has_pose = has_pose and axis.host.has_position != 0
    for k in range(plane.law.user.shape[0]):
        plane.law.user[k] = axes[0].law.user[k]
    measure_plane(arm.mechanism, plane)
    if axes[0].world.on:
        axes[0].host.unpaid_J = unpaid(axes[0].world, plane)
        for i in range(JOINTS):
            if feeds_a_swing(axes[i].world, axes[i].host.counts * axes[i].control.rad_count):
                soften(axes[0].world)
    observe(plane.control, plane.split, plane.v_rad_s)
    expect_brakes(plane.control, plane.split)
    return has_pose


@kernel
def _doubt_tip(axes: AxisRecords, measured: bool) -> None:
    """Doubt a tip outside of its workspace, and a pose that is too near to singular."""
    plane, first = axes[0].plane, axes[0].host
    if not measured or first.doubt != Trip.NONE:
        return
    if not plane.condition >= plane.least_condition:
        first.doubt = Trip.SINGULAR
    elif not in_workspace(plane):
        first.doubt = Trip.WORKSPACE


@kernel
def _displays(axes: AxisRecords) -> bool:
    """Return whether all joints are in phase RUN and none doubts; ramp the law's gain."""
    for k in range(JOINTS):
        c, h = axes[k].control, axes[k].host
        if h.phase != Phase.RUN or h.doubt != Trip.NONE or (h.stop != 0 and not hands_over(c, h)):
            return False
    gain = 1.0
    for k in range(JOINTS):
        ramp_gain(axes[k].control, axes[k].host)
        gain = min(gain, axes[k].host.gain)
    axes[0].plane.gain = gain
    return True


@kernel
def _display(axes: AxisRecords, arm: PlaneFunctions) -> None:
    """Evaluate the law, add the world's model; a force that is not finite is a doubt."""
    plane, first, world = axes[0].plane, axes[0].host, axes[0].world
    if plane.display_cycles == 0:
        _forget(plane)
    plane.display_cycles += 1
    if world.on:
        follow_tip_model(world, plane, axes[0].law)
    if evaluate(arm.law, plane):
        if world.on:
            add_tip_model(world, plane)
        share_out(plane)
        if world.on:
            resist_at_rest(world, plane)
        return
    first.doubt = Trip.LAW
    first.law_Nm, first.law_part = plane.state.psi_N[0], 0
    if math.isfinite(first.law_Nm):
        first.law_Nm = plane.state.psi_N[1]
    if math.isfinite(first.law_Nm):
        first.law_Nm, first.law_part = plane.state.hold_N, 1
    if math.isfinite(first.law_Nm):
        first.law_Nm, first.law_part = plane.state.motor_N[0] + plane.state.motor_N[1], 2
    release(plane.split)


@kernel
def _forget(plane: PlaneHostRecord) -> None:
    """Begin the law at rest, with no force and no work."""
    state = plane.state
    plane.split.taken_J = 0.0
    state.stuck = 0
    state.hold_N = 0.0
    for i in range(2):
        state.psi_N[i] = state.motor_N[i] = plane.split.motor_J[i] = 0.0
    for k in range(state.user.shape[0]):
        state.user[k] = 0.0


@kernel
def _share(axes: AxisRecords) -> None:
    """Give each joint its share of the law's force, with the signs of `LawStateRecord`."""
    plane = axes[0].plane
    for i in range(JOINTS):
        axis = axes[i]
        state, motion = axis.state, axis.motion
        state.stuck = plane.state.stuck
        state.psi_Nm = plane.pose.jacobian[0, i] * plane.psi_N[0] + plane.pose.jacobian[1, i] * plane.psi_N[1]
        state.brake_Nm, state.motor_Nm = plane.split.brake_Nm[i], -plane.split.motor_Nm[i]
        axis.host.pushed_Nm = -plane.split.push_Nm[i]
        axis.host.clipped |= plane.split.clipped[i]
        motion.x_rad, motion.v_rad_s = axis.host.counts * axis.control.rad_count, plane.v_rad_s[i]
        motion.handle_Nm = axis.host.handle_Nm
    for k in range(plane.state.user.shape[0]):
        axes[0].state.user[k] = plane.state.user[k]


@kernel
def _share_model(axes: AxisRecords) -> None:
    """Give each joint its share of the model's force, with the sign of psi, and the model's state."""
    plane, first = axes[0].plane, axes[0].world
    for i in range(JOINTS):
        a, b = plane.pose.jacobian[0, i], plane.pose.jacobian[1, i]
        h, w = axes[i].host, axes[i].world
        w.world_Nm = h.world_Nm = a * first.push_N[0] + b * first.push_N[1]
        w.driven_Nm = a * first.driven_N[0] + b * first.driven_N[1]
        h.world_elastic_Nm = a * first.elastic_N[0] + b * first.elastic_N[1]
        resisting_Nm = abs(a * first.psi_N[0] + b * first.psi_N[1] - w.world_Nm)
        w.world_brake_Nm = min(resisting_Nm, plane.split.brake_Nm[i])
        w.share, w.law_share, w.taken = first.share, first.law_share, first.taken


@kernel
def _count_limits(axes: AxisRecords) -> None:
    """While the model exerts a force, count a cycle in which a limit acts as the model's, and not against the law."""
    first, limited = axes[0].world, 0
    if first.psi_N[0] != 0.0 or first.psi_N[1] != 0.0:
        for k in range(JOINTS):
            limited |= axes[k].host.clipped
            axes[k].host.clipped = 0
    if limited != 0 and first.clipped == axes[1].world.clipped:  # not counted yet in this cycle
        first.clipped += 1
    for k in range(1, JOINTS):
        axes[k].world.clipped = first.clipped


@kernel
def _share_doubt(axes: AxisRecords) -> None:
    """Let a joint's doubt make the others safe, too."""
    for k in range(JOINTS):
        if axes[k].host.doubt != Trip.NONE:
            for other in range(JOINTS):
                if axes[other].host.doubt == Trip.NONE:
                    axes[other].host.doubt = Trip.OTHER_AXIS
            return


@kernel
def _hold_back(axes: AxisRecords) -> None:
    """Let a joint wait in STILL for the joints before it, and in SETTLE for all."""
    ready = True
    for k in range(JOINTS):
        h = axes[k].host
        h.held = 0 if ready or h.phase > Phase.STILL else 1
        ready = ready and (h.phase == Phase.RUN or (h.phase == Phase.SETTLE and h.ready != 0))
    for k in range(JOINTS):
        if axes[k].host.phase == Phase.SETTLE:
            axes[k].host.held = 0 if ready else 1


@kernel
def _start_together(axes: AxisRecords, t_ns: int) -> None:
    """Let the display start, for all joints, when the last drive is in Operation Enabled."""
    enabled = True
    for k in range(JOINTS):
        if axes[k].host.phase >= Phase.SAFE:
            return
        enabled = enabled and axes[k].host.phase > Phase.ENABLE
    for k in range(JOINTS):
        h = axes[k].host
        if not enabled:
            h.enabled_ns = -1
        elif h.enabled_ns < 0:
            h.enabled_ns = t_ns


@kernel
def _release_together(axes: AxisRecords) -> None:
    """Let the brakes fall together in the safe state: each keeps the largest share that a joint keeps of its start."""
    share = 0.0
    for k in range(JOINTS):
        if axes[k].host.phase != Phase.SAFE:
            return
    if axes[0].host.safe_from_Nm < 0.0:
        _align_brakes(axes)
    for k in range(JOINTS):
        h = axes[k].host
        if h.safe_from_Nm > 0.0:
            share = max(share, h.level_Nm / h.safe_from_Nm)
    for k in range(JOINTS):
        h = axes[k].host
        h.level_Nm = min(share, 1.0) * h.safe_from_Nm
        h.brake_Nm = bear(axes[k].control, h)


@kernel
def _align_brakes(axes: AxisRecords) -> None:
    """Begin the release: brakes that hold more than the hand's torques fall to a common multiple of these.

    Then both brakes let go at the same instant. No brake rises, and none falls below the hand's torque. Without a
    believed transducer the brakes begin where they are.
    """
    multiple, believed = math.inf, True
    for k in range(JOINTS):
        c, h = axes[k].control, axes[k].host
        believed = believed and c.still_handle_Nm < math.inf and h.missed_in_a_row == 0 and h.trip != Trip.HANDLE_TORQUE
        if h.handle_Nm != 0.0:
            multiple = min(multiple, h.level_Nm / abs(h.handle_Nm))
    for k in range(JOINTS):
        h = axes[k].host
        h.safe_from_Nm = h.level_Nm
        if believed and 1.0 <= multiple < math.inf:
            h.safe_from_Nm = min(multiple * abs(h.handle_Nm), h.level_Nm)
