"""A clock that runs fast or slow: all timers of its node, and nobody else's.

In int64, without a jump.
"""

from __future__ import annotations

from fractions import Fraction
from math import ceil, floor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.lab.simulate import simulate
from coulombus.node.record import new_nodes
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.faults.fault_file import FaultError, read_faults
from coulombus.sim_bus.faults.injection import Injection
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.server.rig_server import PacedRig
from coulombus.wire.clock import bus_ns, own_ns, set_clock
from node_bench import EDS

MS, S = 1_000_000, 1_000_000_000


@settings(max_examples=80)
@given(st.integers(0, 10**14), st.integers(0, 10**14), st.integers(-(10**8), 10**8), st.integers(-(10**8), 10**8))
def test_own_time_and_back(begin, later, first, second):
    """Against fractions.

    Two clocks one after the other, so that the second begins where the first has come to.
    """
    node = new_nodes(1)[0]
    assert (own_ns(node, begin), bus_ns(node, begin)) == (begin, begin)
    set_clock(node, begin, first)
    own = begin + floor(Fraction(later * (10**9 + first), 10**9))
    assert own_ns(node, begin + later) == own
    assert bus_ns(node, own) == begin + ceil(Fraction((own - begin) * 10**9, 10**9 + first))
    set_clock(node, begin + later, second)
    assert own_ns(node, begin + later) == own
    assert own_ns(node, bus_ns(node, own + later)) >= own + later > own_ns(node, bus_ns(node, own + later) - 1)


@pytest.mark.parametrize("ppm", [-20_000, 0, 300, 50_000])
def test_heartbeats_of_a_node_whose_clock_drifts(ppm):
    network = VirtualNetwork(0)
    drifts, other = network.add(EDS / "motor.eds", 1), network.add(EDS / "motor.eds", 2)
    heard = network.station({0x701, 0x702})
    network.power_on()
    set_clock(network.nodes[0], network.t_ns, ppm * 1000)
    for device in (drifts, other):
        device[0x1017, 0] = 10
    network.wait_ns(10 * S)
    for can_id, own_ppm in ((0x701, ppm), (0x702, 0)):
        beats = [f.t_ns for f in heard.heard if f.can_id == can_id and f.data != b"\0"]
        period = 10 * MS / (1 + own_ppm * 1e-6)
        assert len(beats) == pytest.approx(10 * S / period, abs=1)
        assert max(abs(t - beats[0] - k * period) for k, t in enumerate(beats)) <= 1


def test_the_syncs_of_a_node_whose_clock_drifts_for_a_time():
    """1006h is 10 ms of its own clock: slow by 2 % from 1 s to 2 s of the bus.

    Each SYNC's time by hand, and the TPDOs that it asks for with it.
    """
    network = VirtualNetwork(0)
    producer = network.add(EDS / "motor.eds", 1)
    heard = network.station({0x080})
    network.power_on()
    begin = network.t_ns
    network.at(begin + S, lambda network: set_clock(network.nodes[0], network.t_ns, -20_000_000))
    network.at(begin + 2 * S, lambda network: set_clock(network.nodes[0], network.t_ns, 0))
    producer[0x1006, 0] = 10_000
    producer[0x1005, 0] = 0x4000_0080
    network.wait_ns(3 * S)
    times = [f.t_ns for f in heard.heard]
    own = [
        t - min(max(t - begin - S, 0), S) // 50 for t in times
    ]  # what its clock showed: a fiftieth less, while it was slow
    assert len(times) in (297, 298, 299)
    assert max(abs(t - own[0] - k * 10 * MS) for k, t in enumerate(own)) <= 1


def test_a_watchdog_that_drifts():
    """A consumer with a clock 10 % fast loses a heartbeat 10 % sooner."""
    lost = {}
    for ppm in (0, 100_000):
        network = VirtualNetwork(0)
        device = network.add(EDS / "motor.eds", 1)
        tester = network.station({0x81})
        network.power_on()
        set_clock(network.nodes[0], network.t_ns, ppm * 1000)
        device[0x1016, 1] = 7 << 16 | 100
        network.wait_ns(MS)
        begin = network.t_ns
        tester.send(0x707, b"\5")
        network.wait_ns(300 * MS)
        (frame,) = tester.take()
        lost[ppm] = frame.t_ns - begin
    assert lost[0] == pytest.approx(100 * MS, abs=0.1 * MS)
    assert lost[100_000] == pytest.approx(100 * MS / 1.1, abs=0.1 * MS)


def test_the_host_and_a_node_of_a_rig(tmp_path):
    """The SYNCs of a host that runs 1000 ppm fast come sooner.

    That is within what the rig allows, and so is a node's drift.
    """
    file = tmp_path / "drift.toml"
    file.write_text(
        '[[fault]]\nkind = "drift"\nnode = "host"\nppm = 1000\n'
        '[[fault]]\nkind = "drift"\nnode = "brake"\nppm = -2000\nafter = "enabled"\nat_s = 0.5\nduration_s = 0.5\n'
    )
    result = simulate("bench", "hybrid", 2.0, faults=file, record=tmp_path / "r.pcapng")
    assert result.trip is None
    assert [fault["times"] for fault in result.faults] == [1, 1]
    frames = read(tmp_path / "r.pcapng").frames
    syncs = frames["t_ns"][frames["can_id"] == 0x80]
    assert np.median(np.diff(syncs)) == pytest.approx(MS / 1.001, abs=2)


def test_the_host_of_another_process_has_its_own_clock(tmp_path):
    file = tmp_path / "drift.toml"
    file.write_text('[[fault]]\nkind = "drift"\nnode = "host"\nppm = 1000\n')
    with pytest.raises(FaultError, match=r"drift.toml:3: .*another process"):
        Injection(PacedRig(load_rig("bench"), "hybrid", 0, 1_000_000), read_faults(file), 0)
