"""A server for worlds with a display that is none, and the data plane's end of its states."""

from __future__ import annotations

import os
import socket
import time

import numpy as np

from coulombus.host.world.hand import world_path
from coulombus.host.world.model_check import ModelRefused, why_not
from coulombus.host.world.protocol import Named, Welcome
from coulombus.host.world.records import STATE
from coulombus.host.world.server import WorldServer
from coulombus.wire.address import parse_address

BUS = parse_address("coulombus:x")
LIFE_NS = 1_000_000_000
PATIENCE_S = 30.0


class FakeDisplay:
    """A display without a rig: keeps the models, refuses what `why_not` refuses."""

    def __init__(self, key=""):
        self.models, self.right, self.busy = [], key, None

    def welcome(self):
        return Welcome(1, 1, len(self.parameters()), 1_000_000, 1, LIFE_NS, 7)

    def parameters(self):
        return (Named(0, 1, 0.0, 4.5, 3.5, "F_s_Nm"), Named(0, -1, 1.5, 1.5, 1.5, "motor_limit_Nm"))

    def why_not(self, key, now_ns):
        return None if key in (None, self.right) else "the arm key is wrong"

    def render(self, model):
        if self.busy is not None:
            raise ModelRefused(self.busy, again=True)
        reason = why_not(model, 1, LIFE_NS)
        if reason is not None:
            raise ModelRefused(reason)
        self.models.append(model.copy())


class Bench:
    """A server with a fake display, and the data plane's end of the states."""

    def __init__(self, key=""):
        self.states, sender = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.sender, self.display = sender, FakeDisplay(key)
        self.server = WorldServer(world_path(BUS), self.states, self.display)
        self.sequence = 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.server.close()
        self.states.close()
        self.sender.close()

    def cycle(self, count=1, skipped=0, v_rad_s=0.0):
        """Let the data plane finish cycles."""
        for _ in range(count):
            self.sequence += 1 + skipped
            record = np.zeros(1, STATE)
            record["sequence"], record["x_rad"], record["phase"] = self.sequence, 0.5 * self.sequence, 5
            record["v_rad_s"] = v_rad_s
            self.sender.send(record.tobytes())

    def until(self, condition):
        """Wait for the server's thread."""
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline
            os.sched_yield()
