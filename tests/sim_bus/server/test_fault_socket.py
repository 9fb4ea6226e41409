"""Faults that another program injects into a running bus: their effects, their ends, and what is refused."""

from __future__ import annotations

import json
import threading
from contextlib import contextmanager

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.lab.bus_log import LoggedNetwork
from coulombus.node.kinds import DRIVE402
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.can_bus.fault_confinement import MANUAL
from coulombus.sim_bus.faults.fault_file import faults_of
from coulombus.sim_bus.faults.fault_kinds import RESTART_MS
from coulombus.sim_bus.faults.injection import Injection
from coulombus.sim_bus.faults.live_faults import FaultRefused, LiveFaults, NodeUnknown
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.sim_bus.server import fault_socket
from coulombus.sim_bus.server.fault_socket import BusFaults, fault_buses, fault_sockets
from coulombus.sim_bus.server.rig_server import SimServer
from coulombus.sim_bus.server.socket_file import Peer
from coulombus.wire.address import BusUnavailable, parse_address
from places import EDS

MS = 1_000_000
BENCH = parse_address("coulombus:faults")


def a_node(heartbeat_ms=10):
    network = LoggedNetwork()
    device = network.add(EDS / "motor.eds", 5, DRIVE402)
    network.power_on()
    device[0x1017, 0] = heartbeat_ms
    network.wait_ns(50 * MS)
    return network, device, LiveFaults(network, network.log.mark)


def heartbeats(network):
    return len(network.log.said("heartbeat node 5"))


def test_a_heartbeat_stops_comes_back_and_both_are_marked():
    network, _, faults = a_node()
    assert heartbeats(network) > 3
    assert faults.inject("heartbeat-off", "5", None, {}) == "inject heartbeat_off on 5"
    network.wait_ns(MS)
    before = heartbeats(network)
    network.wait_ns(50 * MS)
    assert heartbeats(network) == before
    assert faults.state()["acting"][0] | {"since_s": 0} == {
        "fault": "heartbeat_off", "on": "5", "since_s": 0, "for_s": None,
    }  # fmt: skip
    assert faults.clear("", "") == ["clear heartbeat_off on 5"]
    network.wait_ns(50 * MS)
    assert heartbeats(network) > before + 3
    assert not faults.acts
    assert network.log.said("inject heartbeat_off")
    assert network.log.said("clear heartbeat_off")


def test_a_fault_ends_by_itself_and_the_table_is_free_again():
    network, device, faults = a_node()
    faults.inject("over_current", "5", 0.02, {})
    network.wait_ns(10 * MS)
    assert device[0x603F, 0] == 0x2310
    assert faults.acts
    network.wait_ns(20 * MS)
    assert not faults.acts
    assert faults.clear("", "") == []
    assert int(network.bus[0].fault_count) == 0
    assert int(network.nodes[0].in_faults) == 0


@pytest.mark.parametrize(
    ("fault", "values"), [("noise", {"rate": "0.01"}), ("stuck_dominant", {}), ("corrupt_crc", {}), ("drop", {})]
)
def test_the_wire_is_as_before_after_clear(fault, values):
    network, _, faults = a_node()
    ear = network.station({0x705})
    faults.inject(fault, "bus", None, values)
    network.wait_ns(100 * MS)
    faults.clear(fault, "bus")
    times = network.injection.results()[0]["times"]
    assert times > 0
    assert int(network.bus[0].fault_count) == 0
    network.wait_ns(300 * MS)  # bus-off may have to end
    errors = int(network.bus[0].errors)
    ear.take(0x705)
    network.wait_ns(100 * MS)
    assert len(ear.take(0x705)) == 10
    assert int(network.bus[0].errors) == errors
    assert network.injection.results()[0]["times"] == times


def test_a_cable_is_cut_at_a_node_and_mended():
    network, _, faults = a_node()
    network_ear = network.station({0x705})
    faults.inject("cut", "5", None, {})
    network.wait_ns(50 * MS)
    network_ear.take(0x705)
    network.wait_ns(50 * MS)
    assert not network_ear.take(0x705)
    with pytest.raises(FaultRefused, match="acts already"):
        faults.inject("cut", "5", None, {})
    faults.clear("", "")
    network.wait_ns(300 * MS)
    assert network_ear.take(0x705)


def test_a_node_boots_with_another_id_and_back():
    network, device, faults = a_node()
    faults.inject("other_node_id", "5", None, {"node_id": "9"})
    network.wait_ns(10 * MS)
    assert device.node_id == 9
    assert network.log.said("heartbeat boot-up node 9")
    faults.clear("", "5")
    network.wait_ns(10 * MS)
    assert device.node_id == 5


def test_an_axis_is_blocked_and_released():
    world = VirtualRig(load_rig("bench"), "hybrid")
    world.boot()
    faults = LiveFaults(world, None)
    faults.inject("blocked", "motor", None, {})
    world.wait_ns(MS)
    assert world.plant[0].obstacle_Nm > 1e5
    faults.clear("", "")
    assert world.plant[0].obstacle_Nm == 0.0


@pytest.mark.parametrize(
    ("fault", "where", "values", "error", "words"),
    [
        ("heartbeat", "5", {}, FaultRefused, "did you mean 'heartbeat_off'"),
        ("noise", "6", {}, NodeUnknown, "no node '6'.*it has 5"),
        ("blocked", "5", {}, FaultRefused, "cannot have the fault blocked: it has no mechanics; it has over_current"),
        ("power_off", "bus", {}, FaultRefused, "expected --on NODE"),
        ("stuck_dominant", "5", {}, FaultRefused, "expected --on bus"),
        ("noise", "bus", {"rate": "-1"}, FaultRefused, "noise: rate: expected a number above 0, not -1"),
        ("noise", "bus", {"rates": "1"}, FaultRefused, "rates: no such key"),
        ("noise", "bus", {"after": "enabled"}, FaultRefused, "leave it out"),
        ("noise", "bus", {"kind": "drop"}, FaultRefused, "kind is stated by the FAULT"),
        ("noise", "bus", {"duration_s": "1"}, FaultRefused, "duration_s is stated by --for"),
        ("noise", "bus", {"bus": "x"}, FaultRefused, "bus is stated by --bus"),
        ("reset", "5", {"node": "6"}, FaultRefused, "node is stated by --on; leave --set node out"),
        ("noise", "5", {"seen_by": "6"}, FaultRefused, "seen_by is stated by --on"),
        ("noise", "bus", {'rate = 1\n[[fault]]\nkind = "drop"\nmost': "1"}, FaultRefused, "is no key"),
    ],
)
def test_what_is_refused_changes_nothing(fault, where, values, error, words):
    network, _, faults = a_node()
    with pytest.raises(error, match=words):
        faults.inject(fault, where, None, values)
    assert not faults.acts
    assert heartbeats(network) > 0


def test_controllers_keep_their_settings_when_a_fault_is_injected():
    network, _, faults = a_node()
    network.bus[0].stations["restart_ns"][0] = MS
    faults.inject("over_current", "5", None, {})
    first = int(network.bus[0].stations["restart_ns"][0])
    network.bus[0].stations["restart_ns"][0] = MANUAL
    faults.inject("noise", "bus", None, {})
    assert first == RESTART_MS * MS
    assert int(network.bus[0].stations["restart_ns"][0]) == MANUAL


@pytest.mark.parametrize("fault", ["over_current", "other_node_id", "drift"])
def test_a_look_at_the_instant_of_its_end_does_not_keep_a_fault(fault):
    network, device, faults = a_node()
    network.at(network.t_ns + 20 * MS, lambda _: faults.state())  # before the fault's own event
    faults.inject(fault, "5", 0.02, {})
    network.wait_ns(40 * MS)
    assert not faults.acts
    assert (int(network.nodes[0].in_faults), device.node_id, int(network.nodes[0].clock_ppb)) == (0, 5, 0)


def test_a_fault_that_is_over_is_not_cleared_and_leaves_no_row():
    network, _, faults = a_node()
    faults.inject("drop", "5", 0.02, {})
    network.wait_ns(30 * MS)
    assert faults.clear("", "") == []
    assert network.log.said("fault drop 705h")
    faults.inject("noise", "bus", 0.02, {})
    network.wait_ns(30 * MS)
    assert not faults.acts
    assert int(network.bus[0].fault_count) == 0


@pytest.mark.parametrize(("fault", "where", "left"), [("noise", "", "drop"), ("", "bus", "noise")])
def test_clear_ends_the_faults_of_a_kind_or_a_place_only(fault, where, left):
    _, _, faults = a_node()
    faults.inject("noise", "5", None, {})
    faults.inject("drop", "bus", None, {})
    assert len(faults.clear(fault, where)) == 1
    assert [row["fault"] for row in faults.state()["acting"]] == [left]


def test_a_fault_of_frames_lasts_until_it_is_cleared():
    network, _, faults = a_node()
    assert faults.inject("drop", "bus", None, {}) == "inject drop on bus"
    network.wait_ns(100 * MS)
    assert network.injection.results()[0]["times"] >= 10
    assert faults.state()["acting"][0]["for_s"] is None


@pytest.mark.parametrize("clears", [False, True])
def test_a_files_fault_that_waits_for_the_drive_is_kept_until_it_is_cleared(clears):
    world = VirtualRig(load_rig("bench"), "hybrid")
    text = '[[fault]]\nkind = "over_current"\nnode = "motor"\nafter = "enabled"\nduration_s = 0.01\n'
    faults = LiveFaults(world, None)
    injection = Injection(world, faults_of(text, "faults.toml"), 0)
    world.boot()
    assert [row["fault"] for row in faults.state()["acting"]] == ["over_current"]
    assert len(faults.clear("", "") if clears else []) == clears
    injection.enabled(world.t_ns)
    world.wait_ns(5 * MS)
    assert bool(world.nodes[0].in_faults) is not clears
    world.wait_ns(10 * MS)
    assert int(world.nodes[0].in_faults) == 0


@contextmanager
def served(path, address=BENCH):
    server = SimServer(load_rig("bench"), address, record=path)
    ready = threading.Event()
    thread = threading.Thread(target=server.run, kwargs={"ready": ready.set})
    thread.start()
    ready.wait()
    try:
        with fault_sockets(server):
            yield
    finally:
        server.stop()
        thread.join()
        server.close()


@pytest.mark.real_time
@pytest.mark.patient
def test_the_verbs_break_and_mend_a_live_bus_whose_recording_has_the_markers(private_sockets, tmp_path):
    run = CliRunner().invoke
    with served(tmp_path / "bus.pcapng"):
        done = run(main, ["inject", "over-current", "--on", "1", "--json"])
        assert done.exit_code == 0, done.output
        acting = json.loads(done.stdout)["acting"]
        assert [(row["fault"], row["on"]) for row in acting] == [("over_current", "motor")]
        listed = run(main, ["inject", "--list"])
        assert "over_current on motor" in listed.stdout.split("acts now:")[1]
        assert run(main, ["inject", "power_off", "--on", "elbow"]).exit_code == 5
        assert run(main, ["inject", "powr_off", "--on", "motor"]).exit_code == 2
        assert run(main, ["inject", "noise", "--on", "bus", "--for", "20ms"]).exit_code == 0
        assert run(main, ["clear"]).exit_code == 0
        assert BusFaults(BENCH).state()["acting"] == []
        assert run(main, ["clear", "--bus", "coulombus:none"]).exit_code == 4
    texts = [text for _, text in read(tmp_path / "bus.pcapng").markers]
    assert "inject over_current on motor" in texts
    assert "clear over_current on motor" in texts
    assert "inject noise on bus for 0.02 s" in texts


@pytest.mark.real_time
@pytest.mark.patient
def test_a_bus_may_be_called_like_a_process_of_another(private_sockets, tmp_path):
    address = parse_address("coulombus:bench.7")
    with served(tmp_path / "bus.pcapng", address):
        assert fault_buses() == [address]
        assert [node["name"] for node in BusFaults(address).state()["nodes"]] == ["motor", "brake"]
        with pytest.raises(BusUnavailable, match=r"there is coulombus:bench\.7"):
            BusFaults(parse_address("coulombus:bench")).state()


@pytest.mark.real_time
@pytest.mark.patient
def test_another_user_is_refused(private_sockets, tmp_path, monkeypatch):
    monkeypatch.setattr(fault_socket, "peer", lambda connection: Peer(1, 12345, 0))
    with served(tmp_path / "bus.pcapng"), pytest.raises(BusUnavailable, match="takes no fault from user 12345"):
        BusFaults(BENCH).state()
