"""A bench for the host's compiled step alone: the test plays both devices, TPDO by TPDO."""

from __future__ import annotations

import copy
import math
from functools import cache

import numpy as np

from coulombus.eds.cia402 import COMMAND_OF_CONTROLWORD, NEXT_STATE, STATUSWORD, VOLTAGE_ENABLED, PowerState
from coulombus.eds.codec import pack
from coulombus.host.cycle import axes
from coulombus.host.cycle.controller import Controller
from coulombus.host.cycle.records import Image, Phase, Trip
from coulombus.host.cycle.transitions import allowed
from coulombus.kernels.decorator import Entry
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import new_queue, push
from plain_records import record_for_kernels, records_for_kernels

MS = 1_000_000
VELOCITY = ("role.velocity.object=606C", f"role.velocity.scale_rad_s={2 * math.pi / 8192}")
"""Overrides by which the drive tells its velocity, too: in a TPDO of its own."""

rig_of = cache(load_rig)
OWNER = np.zeros(0x800, np.int64)
"""Every identifier is the only axis's."""
_begin, _on_frame = Entry(axes.begin), Entry(axes.on_frame)
_finish = {}
"""Law -> the kernel for it. To ask for a law's type at each call takes longer than all else."""


@cache
def _armed(mode, overrides):
    bench = HostBench(mode, *overrides)
    bench.arm()
    bench.cycles(600)
    return bench


def armed(mode="hybrid", *overrides):
    """Return a bench of its own that was armed and has shown the law whole; the way there is gone
    once.
    """
    bench = _armed(mode, overrides).copy()
    assert bench.phase is Phase.RUN
    return bench


class HostBench:
    """Two devices whose answers a test can bend: position in counts, handle torque, statusword,
    missing TPDOs.
    """

    def __init__(self, mode="hybrid", *overrides, rig=None):
        self.rig = rig_of("bench", overrides) if rig is None else rig
        self.k = Controller(self.rig.one_axis(), mode)
        self.k.records = records_for_kernels(self.k.records)
        self.axis = self.k.records[0]
        self.c, self.h = self.axis.control, self.axis.host
        self.out = record_for_kernels(new_queue())
        self.t_ns = 0
        self.state = int(PowerState.SWITCH_ON_DISABLED)
        self.brake_state = int(PowerState.SWITCH_ON_DISABLED)  # of a brake that is a drive
        self.counts = 0.0
        self.handle_Nm = 0.0
        self.coil_A = 0.0
        self.torque_pm = 0
        self.supply = True
        self.status_bits = 0  # beside those of the state
        self.switch = 0  # the object that is the dead man's switch, where the rig has one
        self.silent = set()  # "motor", "brake" or a sensor's name
        self.heartbeats = True
        self.sent = {}
        ids = list(self.c.node_id[: self.c.nodes])
        tpdos = [self.k.tpdos[i] for i in range(self.c.tpdos)]
        owners = [self.k.axis.devices[ids.index(pdo.cob_id & 0x7F)] for pdo in tpdos]
        self.tpdos = [(owner, pdo, int(pdo.cob_id), int(pdo.length)) for owner, pdo in zip(owners, tpdos, strict=True)]
        self.k.start(0)

    def copy(self):
        """Return a bench of its own in the same state."""
        other = copy.copy(self)
        other.k = copy.copy(self.k)
        other.k.records, other.out, other.silent = copy.deepcopy((self.k.records, self.out, self.silent))
        other.axis = other.k.records[0]
        other.c, other.h = other.axis.control, other.axis.host
        return other

    def tpdo_values(self):
        """Raw values of the process image as the devices would send them."""
        values = self.h.image.copy()
        values[Image.STATUSWORD] = int(STATUSWORD[self.state]) | (VOLTAGE_ENABLED if self.supply else 0)
        values[Image.STATUSWORD] |= self.status_bits
        values[Image.DEADMAN] = self.switch
        values[Image.POSITION] = math.floor(self.counts)
        values[Image.TORQUE] = round(self.torque_pm)
        values[Image.HANDLE_TORQUE] = round(self.handle_Nm / self.c.handle_Nm_raw) if self.c.handle_Nm_raw else 0
        values[Image.COIL_CURRENT] = round(self.coil_A / self.c.coil_A_raw) if self.c.coil_A_raw else 0
        values[Image.BRAKE_STATUSWORD] = int(STATUSWORD[self.brake_state])
        return values

    def frame(self, can_id, length, word):
        return _on_frame(self.k.records, OWNER, self.t_ns, can_id, length, word)

    def finish(self):
        law = self.k.law_function
        if law not in _finish:
            _finish[law] = Entry(axes.finish)
        self.h.waiting = 1
        _finish[law](self.k.records, law, self.t_ns, axes.WINDOW_OVER, self.out, None)

    def cycle(self):
        """One cycle; afterwards `sent` has the image of what the host sent.

        A change of the phase is one of the table's.
        """
        before = self.phase
        self.out["count"] = 0
        self.t_ns = self.h.cycle * MS
        _begin(self.k.records, self.t_ns, self.out)
        self.t_ns += 500_000
        if self.heartbeats and self.h.cycle % 20 == 0:
            for node in self.c.node_id[: self.c.nodes]:
                self.frame(0x700 + node, 1, 5)
        values = self.tpdo_values()
        done = 0
        for owner, pdo, can_id, length in self.tpdos:
            if owner not in self.silent:
                done = self.frame(can_id, length, pack(pdo, values))
        if done != 1:
            self.t_ns += 200_000
        self.finish()
        assert allowed(before, self.phase, Trip(int(self.h.trip))), f"{before.name} -> {self.phase.name}"
        command = int(COMMAND_OF_CONTROLWORD[self.controlword & 0xF])
        self.state = int(NEXT_STATE[self.state, command])
        command = int(COMMAND_OF_CONTROLWORD[int(self.h.image[Image.BRAKE_CONTROLWORD]) & 0xF])
        self.brake_state = int(NEXT_STATE[self.brake_state, command])

    def cycles(self, n, until=None):
        for _ in range(n):
            if until is not None and until():
                return
            self.cycle()

    @property
    def controlword(self):
        return int(self.h.image[Image.CONTROLWORD])

    @property
    def motor_pm(self):
        """Target torque sent, per mille."""
        return int(self.h.image[Image.TARGET_TORQUE])

    @property
    def brake_Nm(self):
        """Brake set-point sent."""
        return float(self.h.image[Image.BRAKE_SETPOINT] * self.c.brake_Nm_raw)

    @property
    def phase(self):
        return self.k.phase

    def enter(self, phase, counts=0):
        """Stand in `phase`, without the way there: both devices talk, the handle stands at
        `counts`, the drive is enabled from ENABLE on.
        """
        h = self.h
        self.counts = float(counts)
        self.state = int(PowerState.SWITCHED_ON if phase <= Phase.ENABLE else PowerState.OPERATION_ENABLED)
        h.has_position, h.raw_position, h.counts, h.reference_counts = 1, counts, counts, counts
        h.cycle, h.sync_ns, h.phase, h.gain, h.sign_direction = 100, 100 * MS, int(phase), 1.0, 1
        h.heard_ns[0] = h.heard_ns[1] = 100 * MS
        h.enabled_ns = -1 if phase <= Phase.ENABLE else 50 * MS
        h.armed_ns = 60 * MS if phase >= Phase.RUN else -1
        state = self.k.state[0]
        state.stuck, state.x_stuck = 1, counts * self.c.rad_count
        return self

    def frames(self):
        """What the host sent in this cycle: (time, identifier, length, word)."""
        rows = (self.out.frames[k] for k in range(self.out.count))
        return [(int(f.t_ns), int(f.can_id), int(f.length), int(f.word)) for f in rows]

    def follow_sign_check(self, direction=1, hand=-1):
        """Be a handle on a light hand: move when the torque exceeds the friction, and let the hand
        resist.
        """
        torque = self.motor_pm * self.c.motor_Nm_raw
        excess = max(abs(torque) - 0.14, 0.0)
        angle = direction * excess / 5.0
        self.counts = angle / abs(self.c.rad_count)
        self.handle_Nm = hand * 5.0 * abs(angle)

    def arm(self, direction=1, hand=-1):
        """Cycle through the arming until RUN (or a refusal)."""
        for _ in range(3000):
            if self.phase >= Phase.RUN:
                return
            if self.phase in (Phase.SIGN, Phase.SETTLE):
                self.follow_sign_check(direction, hand)
            self.cycle()
        raise AssertionError(f"neither armed nor refused: {self.phase.name}")


__all__ = ["MS", "VELOCITY", "HostBench", "push"]
