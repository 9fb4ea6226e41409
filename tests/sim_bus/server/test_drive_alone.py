"""A drive without a rig in `coulombus node`: its load, the defaults that its file lacks, and why it stands still."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass

import pytest
from click.testing import CliRunner

import eds_text
from coulombus.cli.node import node_command
from coulombus.node.drive402 import DRIVE402
from coulombus.node.io401 import IO401, IO404
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.rig.shaft_load import Load
from coulombus.sim_bus.server.live_nodes import LiveNodes, NodeError
from places import ROOT

MOTOR, BRAKE = ROOT / "eds" / "motor.eds", ROOT / "eds" / "mr_brake.eds"


def without_default(tmp_path, *indices):
    """Return a file of another maker's drive whose objects have no default."""
    text = MOTOR.read_text().replace("0x000004C0", "0x000004C1")
    for index in indices:
        head, section, rest = text.partition(f"[{index:04X}]\n")
        body, end, rest = rest.partition("\n\n")
        lines = [line for line in body.splitlines() if not line.startswith("DefaultValue")]
        text = head + section + "\n".join(lines) + end + rest
    path = tmp_path / "bare-drive.eds"
    path.write_text(text)
    return path


@pytest.mark.parametrize("kind", ["auto", DRIVE402])
def test_a_drive_whose_file_lacks_defaults_is_a_servo_that_may_turn(tmp_path, capsys, kind):
    path = without_default(tmp_path, 0x1000, 0x6072, 0x6079)
    nodes = LiveNodes(((path, 5),), kind)
    (device,) = nodes.make_world(1_000_000, True).devices
    assert device.dictionary.number(0x1000) == 0x00020192
    assert device.dictionary.number(0x6072) == 1000
    assert device.record["supply_mV"] == 48_000
    assert "without a default in the file, served with the drive's own: 1000h as 131474, 6072h as 1000" in (
        capsys.readouterr().err
    )
    assert len(nodes.opened[0]) == 1


def test_a_drive_alone_has_switches_where_a_homing_finds_them():
    network = LiveNodes(((MOTOR, 1),)).make_world(1_000_000, True)
    turn = network.plant[0].counts_rad * 2 * math.pi
    low, home_from, home_to, high = network.devices[0].record["switch_counts"] / turn
    assert (low, home_from, home_to, high) == pytest.approx((-1, 0.25, 0.5, 20))


def test_a_generic_device_keeps_what_its_file_says(tmp_path):
    nodes = LiveNodes(((without_default(tmp_path, 0x1000, 0x6072), 5),))
    (device,) = nodes.make_world(1_000_000, True).devices
    assert [device.dictionary.number(index) for index in (0x1000, 0x6072)] == [0, 0]
    assert nodes.opened == [()]


def test_a_module_without_inputs_and_outputs_is_refused_and_one_without_inputs_says_so(tmp_path, capsys):
    bare = tmp_path / "bare.eds"
    bare.write_text(eds_text.HEAD)
    with pytest.raises(
        NodeError, match=r"got no 6000h, 6200h, 6401h, 6411h, which kind io acts on; take --kind generic"
    ):
        LiveNodes(((bare, 1),), IO401)
    capsys.readouterr()
    LiveNodes(((BRAKE, 1),), IO404)
    assert capsys.readouterr().err == ""
    outputs = tmp_path / "outputs.eds"
    outputs.write_text(BRAKE.read_text().replace("7130", "5130"))
    LiveNodes(((outputs, 1),), IO404)
    assert "kind io404 finds no input in the file (7130h, 9130h)" in capsys.readouterr().err


def test_a_load_is_for_drives():
    nodes = LiveNodes(((MOTOR, 1), (BRAKE, 2)), load=Load(inertia_kg_m2=5e-3))
    network = nodes.make_world(1_000_000, True)
    assert list(network.axis_of) == [0, -1]
    assert network.plant[0].inertia == 5e-3
    with pytest.raises(NodeError, match="got kind brake; take --kind drive, or no load"):
        LiveNodes(((BRAKE, 2),), load=Load(friction_Nm=0.1))


def test_a_drive_says_once_why_it_does_not_move(capsys):
    nodes = LiveNodes(((MOTOR, 1),), as_json=True)
    server = StoppedServer(nodes.make_world(1_000_000, True))
    nodes.begin(server)
    network = server.world
    network.power_on()
    network.wait_ns(300_000_000)
    record = network.devices[0].record
    assert "does not move" not in capsys.readouterr().err  # nobody commands it
    node = network.canopen().add_node(1, str(MOTOR))
    node.nmt.state = "OPERATIONAL"
    network.wait_ns(1_000_000)
    node.sdo[0x6060].raw = 3
    for word in (6, 7, 15):
        node.sdo[0x6040].raw = word
    node.sdo[0x60FF].raw = 20_000
    network.wait_ns(2_000_000_000)
    said = capsys.readouterr()
    assert said.err.count("does not move") == 1
    assert "node 1 (" in said.err
    assert "6072h limits the torque to 0" in said.err
    (line,) = map(json.loads, said.out.splitlines())
    assert (line["event"], line["node_id"], line["reason"]) == ("standstill", 1, "torque_limit")
    assert node.sdo[0x6041].raw & 0x0800
    node.sdo[0x6072].raw = 1000
    network.wait_ns(1_000_000_000)
    assert record["in_velocity_counts_s"] == pytest.approx(20_000, rel=0.02)
    assert capsys.readouterr().err == ""


@dataclass
class StoppedServer:
    """A server whose present is its world's."""

    world: VirtualNetwork

    def now_ns(self):
        return self.world.t_ns


def test_the_options_of_the_load_reach_the_nodes(monkeypatch):
    loads = []
    monkeypatch.setattr(
        "coulombus.sim_bus.server.live_nodes.run_nodes",
        lambda nodes, *_: loads.append((nodes.load, nodes.kind)),
    )
    words = [str(MOTOR), "--node-id", "1", "--bus", "coulombus:desk", "--inertia", "1e-3", "--friction", "0"]
    result = CliRunner().invoke(node_command, [*words, "--damping", "0.002", "--rated-torque", "2"])
    assert result.exit_code == 0, result.output
    assert loads == [(Load(1e-3, 0.0, 0.002, 2.0), "auto")]


def test_a_drive_alone_is_homed_here_and_at_its_limit_switch_and_goes_to_a_position():
    servo = ROOT / "eds" / "servo.eds"
    network = LiveNodes(((servo, 5),)).make_world(1_000_000, True)
    network.power_on()
    network.wait_ns(10_000_000)
    node = network.canopen().add_node(5, str(servo))
    node.nmt.state = "OPERATIONAL"
    node.sdo[0x6060].raw = 6
    for method, seconds, turns in ((35, 0.1, 0), (17, 5, -1)):
        node.sdo[0x6098].raw = method
        for word in (6, 7, 15, 31):
            node.sdo[0x6040].raw = word
        network.wait_ns(round(seconds * 1e9))
        assert node.sdo[0x6041].raw & 0x3400 == 0x1400
        record = network.devices[0].record
        assert record["zero_counts"] == pytest.approx(turns * record["index_counts"], abs=2)
        node.sdo[0x6040].raw = 15
    node.sdo[0x6060].raw = 1
    node.sdo[0x6081].raw, node.sdo[0x6083].raw, node.sdo[0x6084].raw = 40_000, 200_000, 200_000
    node.sdo[0x607A].raw = -12_000
    node.sdo[0x6040].raw = 31
    network.wait_ns(round((12_000 / 40_000 + 40_000 / 200_000) * 1e9) + 20_000_000)
    assert node.sdo[0x6041].raw & 0x3400 == 0x1400
    assert node.sdo[0x6064].raw == pytest.approx(-12_000, abs=10)
