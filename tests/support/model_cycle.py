"""The local model of an axis in a cycle of its own, beside a law of constant output."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from coulombus.host.laws.law import LawRecord, LawStateRecord, MotionRecord
from coulombus.host.world.local_model import add_model, follow_model
from coulombus.host.world.records import MODEL, OFFERS, LocalModelRecord
from coulombus.kernels.records import new_records
from plain_records import record_for_kernels

SLOT_NAMES = {"K_p_Nm_rad": 0, "F_s_Nm": 1, "F_d_Nm": 2}
MS = 1_000_000


def offer(w, record, number):
    """Let the next cycle take model `number`."""
    row = w.offered[number % OFFERS]
    for name, value in zip(MODEL.names, record.tolist(), strict=True):
        row[name] = value
    w.wanted = number


@dataclass
class Cycle:
    """The local model in a cycle, with a law of constant output."""

    w: Any
    motion: Any
    law: Any
    state: Any
    law_Nm: float = 0.0
    law_brake_Nm: float = 0.0
    compensation_Nm: float = 0.0
    number: int = 0

    def render(self, model, profile=0):
        """Let the next cycle take a model."""
        self.place(model.record(SLOT_NAMES, profile=profile))

    def place(self, record):
        """Let the next cycle take a record."""
        self.number += 1
        offer(self.w, record, self.number)

    def at(self, x_rad, v_rad_s=0.0, handle_Nm=0.0):
        """Run a cycle at a position; return the torques of motor (sign of psi) and brake."""
        m = self.motion
        m.x_rad, m.v_rad_s, m.v_counts, m.handle_Nm = x_rad, v_rad_s, 100.0 * v_rad_s, handle_Nm
        follow_model(self.w, self.motion, self.law, self.state)
        return add_model(self.w, self.motion, self.compensation_Nm, self.law_Nm, self.law_brake_Nm)


def cycle_of(mode, *, rest=1.0, motor_Nm=10.0, brake_Nm=20.0, rate_Nm=1e3, fall_Nm=1e3, **values):
    kinds = LocalModelRecord, MotionRecord, LawRecord, LawStateRecord
    w, motion, law, state = (record_for_kernels(new_records(kind)[0]) for kind in kinds)
    w.on, w.mode, w.rest, w.law_share, w.period_ns, w.ramp_step, w.K_p_ratio = 1, mode, rest, rest, MS, 0.25, 1.0
    w.motor_limit_Nm, w.brake_limit_Nm, w.motor_rate_Nm, w.brake_fall_Nm = motor_Nm, brake_Nm, rate_Nm, fall_Nm
    law.K_p, law.F_s, law.F_d, law.velocity_band_counts = 100.0, 3.0, 2.0, 2.0
    return Cycle(w, motion, law, state, **values)
