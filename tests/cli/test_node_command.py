"""`coulombus node`: any EDS as a live node, alone on a bus of its own or on that of another."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import signal
import struct
import subprocess
import sys
import threading
import time

import canopen
import pytest
from click.testing import CliRunner

import eds_text
from coulombus.cli.node import Switches, node_command
from coulombus.eds.reader import EdsError, read_eds
from coulombus.node.brake404 import BRAKE404
from coulombus.node.drive402 import DRIVE402
from coulombus.node.kinds import GENERIC, PROFILES
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.server.live_nodes import LiveNodes, NodeError
from coulombus.sim_bus.server.server import BusServer
from coulombus.wire.address import BusAddress, socket_path
from coulombus.wire.handshake import Flags, connect
from places import CORPUS, ROOT, beside

pytestmark = [pytest.mark.real_time, pytest.mark.patient, pytest.mark.usefixtures("private_sockets")]

MOTOR, BRAKE = ROOT / "eds" / "motor.eds", ROOT / "eds" / "mr_brake.eds"
FRAME = struct.Struct("=IB3x8s")
TIMEOUT_S = 60.0


def command(*arguments):
    return [sys.executable, "-m", "coulombus", "node", *map(str, arguments)]


def start(*arguments):
    """Start the command and return it when its node is on the bus, with the line that says so."""
    process = subprocess.Popen(
        command(*arguments, "--json"), cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    return process, json.loads(process.stdout.readline())


def end(process, number=signal.SIGTERM):
    process.send_signal(number)
    out, err = process.communicate(timeout=TIMEOUT_S)
    return process.returncode, [json.loads(line) for line in out.splitlines()], err


def upload(bus, node_id, index, subindex=0):
    bus.send(FRAME.pack(0x600 + node_id, 8, struct.pack("<BHB4x", 0x40, index, subindex)))
    while True:
        for can_id, _, data in FRAME.iter_unpack(bus.recv(1 << 16)):
            if can_id == 0x580 + node_id:
                return data


def test_two_nodes_share_a_bus_and_canopen_talks_to_them():
    """The first command serves the bus, the second joins; a third with an id that is taken is told
    of.
    """
    first, ready = start(MOTOR, "--node-id", 5, "--bus", "coulombus:desk", "--bitrate", 500_000)
    try:
        assert ready["event"] == "ready"
        assert (ready["node_id"], ready["serves_bus"], ready["bitrate_bit_s"]) == (5, True, 500_000)
        second, ready = start(BRAKE, "--node-id", 6, "--bus", "coulombus:desk", "--bitrate", 250_000)
        assert (ready["node_id"], ready["serves_bus"], ready["bitrate_bit_s"]) == (6, False, 500_000)
        network = canopen.Network()
        network.connect(interface="coulombus", channel="desk")
        try:
            for node_id, path in ((5, MOTOR), (6, BRAKE)):
                node = network.add_node(canopen.RemoteNode(node_id, str(path)))
                node.sdo.RESPONSE_TIMEOUT = TIMEOUT_S
                node.sdo[0x1017].raw = 50
                assert node.sdo[0x1017].raw == 50
                node.nmt.state = "OPERATIONAL"
                node.nmt.wait_for_heartbeat(TIMEOUT_S)
                assert node.nmt.wait_for_heartbeat(TIMEOUT_S) in ("OPERATIONAL", "PRE-OPERATIONAL")
        finally:
            network.disconnect()
        third, _ = start(MOTOR, "--node-id", 5, "--bus", "coulombus:desk")
        status, lines, err = end(third, signal.SIGINT)
        assert status == 0
        assert "runs at" not in err  # no bit rate was asked for
        status, lines, err = end(second)
        assert (status, lines[-1]["event"]) == (0, "end")
        assert "bus coulombus:desk runs at 0.5 Mbit/s, as its server says, and not at 0.25 Mbit/s" in err
    finally:
        status, lines, err = end(first)
    assert status == 0
    assert [line["event"] for line in lines] == ["duplicate", "end"]
    assert "another node" in err
    assert "node id 5" in err


def test_a_node_lives_on_whoever_reads_that_it_is_there():
    """`coulombus node ... | head -1` ended it, with 0."""
    reading, writing = os.pipe()
    os.close(reading)
    words = command(MOTOR, "--node-id", 1, "--bus", "coulombus:mute", "--json")
    with subprocess.Popen(words, cwd=ROOT, stdout=writing, stderr=subprocess.DEVNULL) as process:
        os.close(writing)
        deadline = time.monotonic() + TIMEOUT_S
        while not socket_path("mute").exists():
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(1e-2)
        with contextlib.closing(connect(BusAddress("coulombus", "mute"))) as bus:
            bus.settimeout(TIMEOUT_S)
            for _ in range(3):  # the boot-up is told before the first request is answered
                assert upload(bus, 1, 0x1000)[4:] == struct.pack("<I", 0x00020192)
        process.send_signal(signal.SIGTERM)
        assert process.wait(TIMEOUT_S) == 0


def test_a_joined_node_ends_when_its_bus_goes():
    first, _ = start(MOTOR, "--node-id", 1, "--bus", "coulombus:desk")
    second, _ = start(BRAKE, "--node-id", 2, "--bus", "coulombus:desk")
    end(first)
    _, err = second.communicate(timeout=TIMEOUT_S)
    assert second.returncode == 4
    assert "bus coulombus:desk is gone" in err


def test_several_nodes_in_one_process_answer(tmp_path):
    nodes = LiveNodes(((MOTOR, 1), (BRAKE, 2)), as_json=True)
    server = BusServer(nodes.make_world, BusAddress("coulombus", "t"), 1_000_000, join=True)
    nodes.server = server
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        with connect(server.address, Flags(0), ()) as bus:
            bus.settimeout(TIMEOUT_S)
            for node_id, path in ((1, MOTOR), (2, BRAKE)):
                value = int.from_bytes(upload(bus, node_id, 0x1000)[4:], "little")
                assert value == read_eds(path).variable(0x1000, 0).default
    finally:
        server.stop()
        thread.join()
        server.close()


def test_our_own_files_have_their_behaviour_and_others_none(tmp_path):
    other = tmp_path / "other.eds"
    other.write_text(MOTOR.read_text().replace("0x000004C0", "0x000004C1"))

    def kinds(kind):
        nodes = LiveNodes(((MOTOR, 1), (BRAKE, 2), (other, 3)), kind)
        return [PROFILES[device.record["kind"]] for device in nodes.make_world(1_000_000, True).devices]

    assert kinds(None) == [DRIVE402, BRAKE404, GENERIC]
    assert kinds(GENERIC) == [GENERIC] * 3


def test_auto_serves_any_file_as_its_objects_allow_and_tells_what_it_opens(tmp_path, capsys):
    other = tmp_path / "other.eds"
    other.write_text(MOTOR.read_text().replace("0x000004C0", "0x000004C1"))
    bare = tmp_path / "bare.eds"
    bare.write_text(eds_text.HEAD)
    nodes = LiveNodes(((MOTOR, 1), (BRAKE, 2), (other, 3), (bare, 4)), "auto")
    devices = nodes.make_world(1_000_000, True).devices
    assert [PROFILES[device.record["kind"]] for device in devices] == [DRIVE402, BRAKE404, DRIVE402, GENERIC]
    assert [device.dictionary.number(0x6072) for device in devices[:3]] == [0, 0, 3000]
    assert [len(texts) for texts in nodes.opened] == [0, 0, 1, 0]
    assert "other.eds: 6072h is 0 in the file" in capsys.readouterr().err


def test_the_ready_line_tells_kind_and_what_was_opened(tmp_path):
    other = tmp_path / "other.eds"
    other.write_text(MOTOR.read_text().replace("0x000004C0", "0x000004C1"))
    process, ready = start(other, "--node-id", 5, "--bus", "coulombus:desk", "--kind", "auto")
    end(process)
    assert ready["kind"] == "drive"
    assert [text.partition(" is ")[0] for text in ready["opened"]] == [f"{other}: 6072h"]


def test_a_kind_whose_objects_a_file_lacks_is_refused():
    with pytest.raises(NodeError, match=r"mr_brake.eds: got no 6040h:00, 6041h:00, .*which kind drive acts on"):
        LiveNodes(((BRAKE, 1),), DRIVE402)


def test_a_kind_that_is_none_names_those_that_are():
    result = CliRunner().invoke(node_command, [str(MOTOR), "--bus", "coulombus:desk", "--kind", "pump"])
    assert result.exit_code == 2
    assert "got kind 'pump', expected generic, drive, brake, io" in result.output


def test_one_diagnosis_is_one(tmp_path, capsys):
    (tmp_path / "odd.eds").write_text(eds_text.HEAD + eds_text.variable(DefaultValue="007"))
    LiveNodes(((tmp_path / "odd.eds", 1),))
    assert "odd.eds: 1 diagnosis, read tolerantly" in capsys.readouterr().err


def test_mistakes_are_told(tmp_path):
    with pytest.raises(NodeError, match="an id of its own"):
        LiveNodes(((MOTOR, 1), (BRAKE, 1)))
    with pytest.raises(NodeError, match="one file keeps one node"):
        LiveNodes(((MOTOR, 1), (BRAKE, 2)), store=tmp_path / "s")
    for store in (tmp_path, tmp_path / "absent" / "s"):
        with pytest.raises(NodeError, match="an existing directory"):
            LiveNodes(((MOTOR, 1),), store=store)
    empty = tmp_path / "empty.eds"
    empty.write_text("[FileInfo]\nFileName=empty.eds\n")
    done = subprocess.run(
        command(empty, "--node-id", 1, "--bus", "coulombus:t"), cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 3
    assert f"{empty}:1:" in done.stderr


@beside(CORPUS)
@pytest.mark.parametrize("path", sorted(CORPUS.glob("**/*.eds")) if CORPUS.is_dir() else [], ids=lambda path: path.name)
def test_every_object_of_a_vendors_file_is_served(path):
    """Every SDO read is answered.

    What has another length than its type says would be an error of ours.
    """
    network = VirtualNetwork(20_000_000, capacity=1)
    device, refusal = None, ""
    try:
        device = network.add(path, 9)
    except EdsError as refused:
        refusal = str(refused)
    if device is None:  # with the file and the line, and why
        assert re.match(rf"{re.escape(str(path))}:\d+: ", refusal)
        return
    request, response = (  # one file has those of node 16, whatever the node's id is
        device.description.default(0x1200, sub, 9) if device.description.has(0x1200, sub) else base + 9
        for sub, base in ((1, 0x600), (2, 0x580))
    )
    tester = network.station({response})
    network.power_on()
    network.wait_ns(5_000_000)
    answered = 0
    variables = [v for entry in device.description.objects.values() for v in entry.variables.values()]
    for variable in variables:
        index, subindex = variable.index, variable.subindex
        tester.take()
        tester.send(request, struct.pack("<BHB4x", 0x40, index, subindex))
        answer = tester.wait_for(response, 5_000_000)
        assert answer is not None, f"{index:04X}h:{subindex:02X}"
        if answer.data[0] & 0xE3 == 0x43:
            size = 4 - (answer.data[0] >> 2 & 3)
            assert not variable.bits or size == (variable.bits + 7) // 8
        elif answer.data[0] == 0x41:
            tester.send(request, b"\x80" + answer.data[1:4] + bytes(4))
        else:
            assert answer.data[0] == 0x80
        answered += 1
    assert answered > 10


@pytest.mark.parametrize(
    ("text", "places"),
    [
        ("negative=-20000,home=0:500,positive=20000", (-20_000, 0, 500, 20_000)),
        ("home=-3", (-math.inf, -3, math.inf, math.inf)),
        ("positive=7", (-math.inf, math.inf, math.inf, 7)),
    ],
)
def test_switches_are_places_on_the_axis(text, places):
    assert Switches().convert(text, None, None) == places


@pytest.mark.parametrize("text", ["", "home", "limit=3", "negative=x", "home=5:4", "positive=1:2", "home=nan"])
def test_switches_that_are_no_places_are_refused(text):
    run = CliRunner().invoke(node_command, [str(MOTOR), "--bus", "coulombus:x", "--switches", text])
    assert run.exit_code == 2
    assert "is not negative=PLACE, home=FROM:TO or positive=PLACE, in counts" in run.output


def test_only_a_drive_has_switches():
    nodes = LiveNodes([(BRAKE, 2)])
    with pytest.raises(NodeError, match="no node is a drive; give --kind drive"):
        nodes.place_switches((-1.0, 0.0, 1.0, 2.0))
    nodes = LiveNodes([(BRAKE, 2), (MOTOR, 1)])
    nodes.place_switches((-1.0, 0.0, 1.0, 2.0))
    network = VirtualNetwork(capacity=2)
    assert [*nodes.add_to(network)[1].record["switch_counts"]] == [-1, 0, 1, 2]
