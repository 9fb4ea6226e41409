"""A small CANopen machine on the simulated bus, for logs whose truth is known: drives under a master
that is no host of ours, and what goes wrong.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from benchmarks.explain_devices import DEVICES
from coulombus.eds.cia301 import NmtCommand
from coulombus.eds.eds_folder import EdsFiles
from coulombus.kernels.records import Records
from coulombus.node.drive402 import DRIVE402
from coulombus.node.emcy import DEVICE_FAULTS, FIRST_DEVICE_CAUSE
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.wire.clock import own_ns

MS = 1_000_000
MASTER = 0x7F
HEARTBEAT_MS = 40
ENABLE = (0x06, 0x07, 0x0F)
BEGIN_MS, CLEAR = 260, 0x80
"""When a fault begins, after the machine is at work."""
MID_TRAFFIC_MS = 1000
"""Traffic before it in a log that begins when the machine is at work already."""


@dataclass
class Machine:
    """A bus with drives and a master, which is built, brought up and run.

    Everything random comes of `dice`: node ids, period, jitter, how much the master configures.
    """

    dice: random.Random
    batches: list[Records] = field(default_factory=list)
    begin_ns: int = 0  # of the log

    def __post_init__(self) -> None:
        dice = self.dice
        self.period_ns = dice.choice((1, 2, 3, 4, 5, 10, 20)) * MS
        largest = {1: 2, 2: 4, 3: 6}.get(self.period_ns // MS, 8)  # the drive sends a second TPDO, too
        self.ids = sorted(dice.sample(range(1, 60), dice.randint(1, largest)))
        self.jitter_ns = dice.choice((0, 20_000, 80_000))
        self.maps_by_sdo = dice.random() < 0.7
        self.kind = dice.choices(DEVICES, (6, 1, 2, 2))[0]
        self.drives = self.kind.profile is DRIVE402
        self.watches = dice.random() < 0.6  # nodes watch the master and their set-points
        self.network = VirtualNetwork(1_000_000, capacity=len(self.ids) + 1, on_frames=self._keep)
        kind = self.kind
        self.devices = {number: self.network.add(kind.description, number, kind.profile) for number in self.ids}
        self.master = self.network.station(())
        self.client = self.network.station({0x580 + number for number in range(1, 128)})
        self.syncing = self.beating = True
        self.commanded = set(self.ids)
        self.words = dict.fromkeys(self.ids, 0)
        self.extra: list[Callable[[int], None]] = []
        self.next_beat = 0
        self.cycle = 0
        self.due_ns = 0

    def _keep(self, frames: Records) -> None:
        self.batches.append(np.array(frames))

    @property
    def frames(self) -> Records:
        """All frames so far, as an analyser would record them that was connected at `begin_ns`."""
        self.network.flush()
        frames = np.concatenate(self.batches)
        return frames[frames["t_ns"] >= self.begin_ns]

    # the master

    def ask(self, number: int, request: bytes, wait_ms: float = 20) -> bytes | None:
        """Send an SDO request; return the answer, None where none comes. Cycles go on meanwhile."""
        self.client.take()
        self.master.send(0x600 + number, request)
        if not self.due_ns:
            heard = self.client.wait_for(0x580 + number, round(wait_ms * MS))
            return None if heard is None else heard.data
        until = self.network.t_ns + round(wait_ms * MS)
        while self.network.t_ns < until:
            self.run(self.period_ns / MS)
            answers = self.client.take(0x580 + number)
            if answers:
                return answers[0].data
        return None

    def write(self, number: int, index: int, subindex: int, value: int, size: int) -> bytes | None:
        """Write an object."""
        command = 0x23 | (4 - size) << 2
        return self.ask(number, bytes((command, index & 0xFF, index >> 8, subindex)) + value.to_bytes(4, "little"))

    def read(self, number: int, index: int, subindex: int) -> bytes | None:
        """Read an object of at most four bytes."""
        return self.ask(number, bytes((0x40, index & 0xFF, index >> 8, subindex, 0, 0, 0, 0)))

    def send_nmt(self, command: NmtCommand, number: int = 0) -> None:
        """Send an NMT command."""
        self.master.send(0x000, bytes((command, number)))
        if self.due_ns:
            self.run(self.period_ns / MS)
        else:
            self.network.wait_ns(MS)

    def bring_up(self) -> None:
        """Switch on, configure, start, enable."""
        self.network.power_on()
        self.network.wait_ns(30 * MS)
        self.send_nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        for number in self.ids:
            self.configure(number)
        self.send_nmt(NmtCommand.START)
        self.due_ns = self.network.t_ns + 2 * MS
        self.next_beat = self.network.t_ns
        for word in ENABLE:
            self.words = dict.fromkeys(self.ids, word)
            self.run(30)
        self.run(BEGIN_MS - 90)

    @property
    def files(self) -> EdsFiles:
        """The EDS files that a reader of the log has: none where the log itself shows the maps."""
        shown = self.maps_by_sdo and not self.begin_ns
        return EdsFiles({} if shown else dict.fromkeys(self.ids, self.kind.description))

    def begin_log(self) -> None:
        """Connect the analyser now, in mid-traffic: it hears no boot-up, no SDO transfer and no NMT command."""
        self.begin_ns = self.network.t_ns
        self.run(MID_TRAFFIC_MS)

    def configure(self, number: int) -> None:
        """Write a node's settings, and read some of them back."""
        self.read(number, 0x1000, 0)
        self.read(number, 0x1018, 1)
        self.read(number, 0x1018, 2)
        if self.maps_by_sdo:
            for communication, mapping, base, words in (
                (0x1400, 0x1600, 0x200, self.kind.rpdo),
                (0x1800, 0x1A00, 0x180, self.kind.tpdo),
            ):
                self.write(number, communication, 1, 1 << 31 | base + number, 4)
                self.write(number, mapping, 0, 0, 1)
                for subindex, word in enumerate(words, 1):
                    self.write(number, mapping, subindex, word, 4)
                self.write(number, mapping, 0, len(words), 1)
                self.write(number, communication, 2, 1, 1)
                self.write(number, communication, 1, base + number, 4)
            self.read(number, 0x1A00, 0)
        if self.watches:
            self.write(number, 0x1016, 1, MASTER << 16 | 4 * HEARTBEAT_MS, 4)
            self.write(number, 0x1400, 5, max(5 * self.period_ns // MS, 50), 2)
        self.write(number, 0x1017, 0, HEARTBEAT_MS, 2)

    def run(self, ms: float) -> None:
        """Let cycles pass: SYNC, set-points half a period later, the master's heartbeat."""
        until = self.network.t_ns + round(ms * MS)
        while self.due_ns < until:
            at = self.due_ns + round(self.dice.uniform(0, self.jitter_ns))
            if self.syncing:
                self.master.send(0x080, at_ns=at)
            for action in self.extra:
                action(at)
            half = at + self.period_ns // 2
            for number in self.ids:
                if number in self.commanded:
                    data = self.words[number].to_bytes(2, "little") + (self.cycle % 5).to_bytes(2, "little")
                    self.master.send(0x200 + number, data, at_ns=half)
            if self.beating and at >= self.next_beat:
                self.master.send(0x700 + MASTER, b"\x05", at_ns=half)
                self.next_beat = at + HEARTBEAT_MS * MS
            self.cycle += 1
            self.due_ns += self.period_ns
            self.network.run_until(self.due_ns)

    def stop(self) -> None:
        """End as it should: controlword 6, then 0, then PRE-OPERATIONAL; SYNC ends last."""
        for word in (0x06, 0x00):
            self.words = dict.fromkeys(self.ids, word)
            self.run(30)
        self.send_nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        self.run(20)

    # what is done to a node

    def row(self, number: int) -> int:
        """Return a node's row in the network."""
        return self.ids.index(number)

    def inject(self, number: int, fault: str, present: bool) -> None:
        """Let a device fault come or go."""
        record = self.network.nodes[self.row(number)]
        bit = 1 << DEVICE_FAULTS[fault] - FIRST_DEVICE_CAUSE
        record["in_faults"] = record["in_faults"] | bit if present else record["in_faults"] & ~bit
        record["next_ns"] = own_ns(record, self.network.t_ns)
