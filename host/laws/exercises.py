r"""Exercises of commissioning (`host.commission`): laws that drive motor or brake with a known signal.

The recordings of exercises identify the rig. Exercises have the signature of a law (`host.laws.laws`), so
they run in the same compiled cycle, with its limits and monitors, as any friction law. Their parameters
are ``law.user``, in the order in each docstring; rig files do not have them.
"""

from __future__ import annotations

from coulombus.host.laws.law import LawRecord, LawStateRecord, MotionRecord

__all__ = ["hold", "square", "stair", "sweep"]


def hold(motion: MotionRecord, law: LawRecord, state: LawStateRecord) -> float:
    """Hold the brake at ``user[0]`` [Nm], without motor torque."""
    state.brake_Nm = law.user[0]
    return 0.0


def sweep(motion: MotionRecord, law: LawRecord, state: LawStateRecord) -> float:
    r"""Turn the handle to and fro by the motor, by :math:`\pm` ``user[1]`` [rad] about its position, at the
    speeds ``user[4]``, ``user[5]``, ``user[6]`` [rad/s] in turn, each in both directions.

    .. math:: \tau = K e + I, \quad \dot I = K_i e, \quad e = v_r - v, \quad |\tau|, |I| \le \tau_{max}

    with ``user[0]`` the largest torque [Nm], ``user[2]`` K [Nm s/rad], ``user[3]`` K_i [Nm/rad].
    If the handle makes no progress for 0.5 s, because a hand or a stop holds it, the direction is reversed.
    The first 0.2 s are without torque, so that a recording shows the end of the sign check.
    """
    memory = state.user  # 0: direction, 1: integral, 2: reversals, 3: start angle, 4: time without progress, 5: time
    memory[5] += motion.dt_s
    if memory[5] < 0.2:
        return 0.0
    if memory[0] == 0.0:
        memory[0] = 1.0
        memory[3] = motion.x_rad
    k = int(memory[2]) // 2 % 3
    e = memory[0] * law.user[4 + k] - motion.v_rad_s
    memory[4] = memory[4] + motion.dt_s if memory[0] * motion.v_rad_s < 0.25 * law.user[4 + k] else 0.0
    if (motion.x_rad - memory[3]) * memory[0] >= law.user[1] or memory[4] > 0.5:
        memory[0] = -memory[0]
        memory[1] = 0.0
        memory[2] += 1.0
        memory[4] = 0.0
        return 0.0
    limit = law.user[0]
    memory[1] = min(max(memory[1] + law.user[3] * e * motion.dt_s, -limit), limit)
    torque: float = min(max(law.user[2] * e + memory[1], -limit), limit)
    return -torque


def stair(motion: MotionRecord, law: LawRecord, state: LawStateRecord) -> float:
    """Raise the brake from 0 to ``user[0]`` [Nm] in ``user[1]`` steps of ``user[2]`` [s] each, and lower it
    again; then it stays 0.
    """
    state.user[0] += motion.dt_s
    step = state.user[0] // law.user[2]
    if step > law.user[1]:
        step = max(2.0 * law.user[1] - step, 0.0)
    state.brake_Nm = law.user[0] * step / law.user[1]
    return 0.0


def square(motion: MotionRecord, law: LawRecord, state: LawStateRecord) -> float:
    """Alternate the motor between ``user[0]`` and its opposite [Nm], and the brake between ``user[2]`` [Nm]
    and off, ``user[1]`` [s] each.
    """
    state.user[0] += motion.dt_s
    first = state.user[0] // law.user[1] % 2.0 == 0.0
    state.brake_Nm = law.user[2] if first else 0.0
    torque: float = law.user[0]
    return -torque if first else torque
