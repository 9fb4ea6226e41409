"""Python beside the compiled loop: what both make of one record, in what order, and when.

Virtual time plays the loop, and the test plays the thread: it does the job when it is told to.
"""

from __future__ import annotations

import contextlib
import os
import struct
from pathlib import Path

import numpy as np
import pytest

from coulombus.eds.cia301 import NmtCommand, NmtState
from coulombus.eds.own_devices import told_identity
from coulombus.eds.reader import read_eds
from coulombus.node.kinds import of_identity
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.network.kernel import Exit, run
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.server import beside as beside_module
from coulombus.sim_bus.server.beside import ASKED, Beside, Kind, ask_force, ask_service, exchange, has_room, is_beside
from coulombus.sim_bus.server.rig_server import PacedRig
from coulombus.wire.frame import data_bytes, data_word, push

MS = 1_000_000
EDS = Path(__file__).resolve().parent.parent.parent / "eds"


def rows_of(kinds):
    descriptions = [read_eds(EDS / f"{name}.eds") for name in kinds]
    return [(one, of_identity(told_identity(one))) for one in descriptions]


class Loop:
    """A network whose loop is virtual time; Python's part is done by `work` or by a thread."""

    def __init__(self, kinds=("motor",), before=lambda network: None):
        self.network = VirtualNetwork()
        for node_id, (description, profile) in enumerate(rows_of(kinds), 1):
            self.network.add(description, node_id, profile)
        self.tester = self.network.station(()).number
        self.network.power_on()
        self.network.wait_ns(10 * MS)
        before(self.network)
        self.start()

    def start(self):
        self.wake = os.eventfd(0, os.EFD_NONBLOCK)
        self.beside = Beside(self.network, self.wake, lambda: None, apart=True)
        self.world = self.network.arguments[0]
        self.seen = int(self.world.state.log_count)

    def close(self):
        self.beside.close()
        os.close(self.wake)

    def send(self, can_id, data, at_ns=None):
        t_ns = self.network.t_ns if at_ns is None else at_ns
        push(self.world.out, self.tester, t_ns, can_id, len(data), data_word(data))

    def sdo(self, text, node=1, at_ns=None):
        self.send(0x600 + node, bytes.fromhex(text).ljust(8, b"\0"), at_ns)

    def go(self, duration_ns):
        """Let the world go on; return the frames of the nodes, (id, data)."""
        self.world.state.until_ns = self.network.t_ns + duration_ns
        exchange(self.world, self.beside.jobs, False)
        while (why := Exit(run(*self.network.arguments, 1))) is not Exit.UNTIL:
            assert why is Exit.SERVICE
            if is_beside(self.world.state, self.world.log):
                assert has_room(self.beside.jobs)
                ask_service(self.world, self.beside.jobs)
            else:
                with self.in_the_loop():
                    self.network.answer(why)
            exchange(self.world, self.beside.jobs, False)
        new = self.world.log[self.seen : int(self.world.state.log_count)]
        self.seen += len(new)
        return [
            (int(f["can_id"]), data_bytes(int(f["word"]), int(f["length"]))) for f in new if f["source"] != self.tester
        ]

    @contextlib.contextmanager
    def in_the_loop(self):
        """As `Beside.in_the_loop`, with a thread that does what is waited for."""
        self.beside.start(None)
        try:
            with self.beside.in_the_loop():
                yield
        finally:
            self.beside.stop()

    @property
    def asked(self):
        return int(self.beside.jobs.job["state"][0]) == ASKED

    def work(self):
        """Do the job that was handed over."""
        assert self.asked
        self.beside._done(self.beside.jobs, self.beside._serve())

    def serve(self):
        """Do all that is asked, with no time in between; return the answers."""
        found = self.go(MS)
        while self.asked:
            self.work()
            found += self.go(MS)
        return [data for can_id, data in found if can_id == 0x581]


@pytest.fixture
def loop(request):
    made = []

    def make(*arguments, **options):
        made.append(Loop(*arguments, **options))
        return made[-1]

    yield make
    for one in made:
        one.close()


def operational(network):
    for row in range(len(network.devices)):
        network.nmt_command(row, NmtCommand.START)


def test_pdos_go_on_while_a_service_is_under_way(loop):
    one = loop(("motor", "mr_brake"), operational)
    one.sdo("2F 60 60 00 0A")
    assert (0x581, bytes.fromhex("6060600000000000")) not in one.go(MS)
    assert one.asked
    for _ in range(20):
        one.send(0x080, b"")
        found = [can_id for can_id, _ in one.go(MS)]
        assert {0x181, 0x182} <= set(found)
        assert 0x581 not in found
    one.work()
    assert (0x581, bytes.fromhex("6060600000000000")) in one.go(MS)
    node = one.world.nodes[0]
    assert node["values"][one.network.devices[0].slot(0x6060)] == 10


def test_requests_are_answered_in_their_order(loop):
    """The second is one that the core answers by itself, and does when nothing waits."""
    one = loop()
    one.sdo("40 00 10 00")
    assert [data[:4].hex() for can_id, data in one.go(MS) if can_id == 0x581] == ["43001000"]
    assert not one.asked
    one.sdo("2B 17 10 00 64 00")
    one.sdo("40 17 10 00")
    assert not [can_id for can_id, _ in one.go(MS) if can_id == 0x581]
    answers = one.serve()
    assert [data[:4].hex() for data in answers] == ["60171000", "4b171000"]
    assert struct.unpack_from("<H", answers[1], 4)[0] == 100
    assert one.world.nodes[0]["busy"] == 0


def test_what_the_loop_wrote_meanwhile_is_newer(loop):
    """An RPDO comes while an SDO writes the same object, and one that it does not write."""
    one = loop(before=operational)
    motor, node = one.network.devices[0], one.world.nodes[0]
    torque, mode = motor.slot(0x6071), motor.slot(0x6060)
    one.sdo("2B 71 60 00 64 00")
    one.go(MS)
    one.send(0x201, struct.pack("<Hh", 0x0006, 77))
    one.send(0x080, b"", one.network.t_ns + MS // 2)
    one.go(MS)
    assert node["values"][torque] == 77
    one.work()
    one.go(MS)
    assert node["values"][torque] == 77
    one.sdo("2F 60 60 00 04")
    one.serve()
    assert (node["values"][torque], node["values"][mode]) == (77, 4)


def test_an_object_of_the_communication_profile_acts_when_it_is_taken_back(loop):
    one = loop()
    one.sdo("2B 17 10 00 05 00")  # heartbeat: 5 ms
    one.go(20 * MS)
    one.work()
    assert [can_id for can_id, _ in one.go(51 * MS)].count(0x701) in (10, 11)


def test_nmt_start_is_done_beside_and_a_reset_after_what_was_asked_before(loop):
    one = loop()
    one.send(0x000, bytes((NmtCommand.START, 0)))
    one.go(MS)
    assert one.world.nodes[0]["nmt"] == NmtState.PRE_OPERATIONAL
    one.work()
    one.go(MS)
    assert one.world.nodes[0]["nmt"] == NmtState.OPERATIONAL
    one.sdo("2B 17 10 00 05 00")
    one.sdo("40 08 10 00")  # a name: a segmented upload
    one.send(0x000, bytes((NmtCommand.RESET_NODE, 1)), one.network.t_ns + MS)
    found = one.go(5 * MS)
    assert [data[:1] for can_id, data in found if can_id == 0x581] == [b"\x60", b"\x41"]
    assert (0x701, b"\0") in found
    assert one.world.nodes[0]["nmt"] == NmtState.PRE_OPERATIONAL
    assert one.world.nodes[0]["heartbeat_ns"] != 5 * MS
    assert one.serve() == []
    one.sdo("60")  # the transfer ended with the reset
    assert [data[:1] for data in one.serve()] == [b"\x80"]


def test_segments_of_an_upload(loop):
    one = loop()
    one.sdo("40 08 10 00")
    (head,) = one.serve()
    size, text, toggle = struct.unpack_from("<I", head, 4)[0], b"", 0
    while len(text) < size:
        one.sdo(f"{0x60 | toggle:02x}")
        (segment,) = one.serve()
        text += segment[1 : 8 - (segment[0] >> 1 & 7)]
        toggle ^= 0x10
    assert text.decode() == one.network.devices[0][0x1008, 0]


def test_a_block_upload_in_the_loop_s_order(loop):
    """What follows is handed over when its segments have gone."""
    one = loop()
    one.sdo("A0 08 10 00 7F 00")
    (head,) = one.serve()
    size = struct.unpack_from("<I", head, 4)[0]
    one.sdo("A3")
    one.go(MS // 2)
    one.work()
    assert exchange(one.world, one.beside.jobs, False)
    assert one.world.nodes[0]["outbox_count"] > 0
    one.sdo("40 18 10 01")
    found = [data for can_id, data in one.go(10 * MS) if can_id == 0x581]
    assert [data[0] & 0x7F for data in found[:-1]] + [found[-1][0] & 0x7F] == list(range(1, -(-size // 7) + 1))
    assert b"".join(data[1:] for data in found)[:size].decode() == one.network.devices[0][0x1008, 0]
    assert one.asked


def test_the_core_writes_nothing_that_is_not_copied(loop):
    """A course with PDOs, segments and emergencies: what only Python writes stays as it was."""
    one = loop(("motor", "mr_brake"), operational)
    before = one.beside.jobs.live.copy()
    runs = [range(*run_) for run_ in beside_module._RUNS]
    copied = np.zeros(before.shape[1], bool)
    for each in runs:
        copied[list(each)] = True
    first = beside_module._SEGMENTS
    copied[first : first + 127] = True
    for k in range(50):
        one.send(0x080, b"")
        one.send(0x201, struct.pack("<Hh", (6, 7, 15)[k % 3], k))
        one.send(0x202, b"\1")
        one.go(MS)
    one.go(200 * MS)
    changed = (one.beside.jobs.live != before).any(axis=0)
    assert changed.sum() > 20
    assert not (changed & ~copied).any()


def test_with_no_room_left_the_loop_waits(loop):
    one = loop()
    asked = 0
    while has_room(one.beside.jobs):
        one.sdo("2B 17 10 00 64 00")
        one.go(MS)
        asked += 1
    assert asked == beside_module.ROOM - beside_module.SPARE
    with one.in_the_loop():
        assert one.network.devices[0].record["heartbeat_ns"] == 100 * MS
    assert has_room(one.beside.jobs)
    assert [data[0] for can_id, data in one.go(100 * MS) if can_id == 0x581] == [0x60] * asked


def test_a_mistake_in_a_service_ends_the_loop(loop, monkeypatch):
    one = loop()
    stopped = []
    monkeypatch.setattr(one.beside, "_stop", lambda: stopped.append(True))
    monkeypatch.setattr(one.network, "serve", lambda *_: 1 // 0)
    one.sdo("2B 17 10 00 64 00")
    one.go(MS)
    with one.in_the_loop():
        pass
    assert stopped
    assert isinstance(one.beside.failure, ZeroDivisionError)


class Axis(Loop):
    def __init__(self):
        self.network = PacedRig(load_rig("bench"), "hybrid", 1, 1_000_000)
        self.network.power_on()
        self.start()


@pytest.mark.parametrize("kind", [Kind.ENABLED, Kind.FORCE, Kind.RESTED])
def test_a_block_of_force_is_a_function_of_time_whenever_it_comes(kind):
    one, other = Axis(), PacedRig(load_rig("bench"), "hybrid", 1, 1_000_000)
    try:
        one.world.axes["operator_start_ns"] = 0
        one.world.plant["t_ns"] = 2_000 * MS
        other.plant["t_ns"], other.axes["operator_start_ns"] = 2_000 * MS, -1 if kind is Kind.RESTED else 0
        one.world.state.t_ns = 2_000 * MS
        ask_force(one.world, one.beside.jobs, kind, 0)
        exchange(one.world, one.beside.jobs, False)
        one.work()
        one.world.plant["t_ns"] = 2_050 * MS
        assert exchange(one.world, one.beside.jobs, False)
        if kind is Kind.RESTED:
            other._left[0] = 0.0, 2.0
            assert one.world.axes["operator_start_ns"][0] == -1
        other._new_force_block(0)
        assert np.array_equal(one.world.f_h, other._f_h)
        assert np.ptp(one.world.f_h) > 0
        for name in ("force_step", "force_end_ns"):
            assert one.world.axes[name][0] == other.axes[name][0]
        assert not one.beside.jobs.asked.any()
    finally:
        one.close()
