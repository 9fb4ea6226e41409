"""Other people's programs on the real virtual bus, in real time: function, never speed."""

import threading
import time

import can
import canopen
import pytest

from coulombus.monitor.live import Live
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.server.rig_server import SimServer
from coulombus.wire.address import parse_address
from coulombus.wire.client import Client, pack_frame
from coulombus.wire.handshake import Flags, Hello

pytestmark = [pytest.mark.real_time, pytest.mark.patient]

BENCH = parse_address("coulombus:bench")


@pytest.fixture(autouse=True)
def server(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    server = SimServer(load_rig("bench"), BENCH)
    ready = threading.Event()
    thread = threading.Thread(target=server.run, args=(30.0,), kwargs={"ready": ready.set})
    thread.start()
    assert ready.wait(10)
    yield server
    server.stop()
    thread.join(10)
    server.close()
    assert not thread.is_alive()


def opened(**options):
    return can.Bus(interface="coulombus", channel="bench", **options)


def test_a_plain_canopen_network():
    rig = load_rig("bench")
    network = canopen.Network()
    network.connect(interface="coulombus", channel="bench")
    try:
        motor = network.add_node(rig.one_axis().motor.node_id, rig.one_axis().description("motor").path)
        motor.sdo.RESPONSE_TIMEOUT = 5
        assert motor.sdo[0x1000].raw == 0x00020192
        motor.sdo[0x1017].raw = 20
        network.nmt.state = "OPERATIONAL"
        for _ in range(50):
            if motor.nmt.wait_for_heartbeat(60) == "OPERATIONAL":
                break
        assert motor.nmt.state == "OPERATIONAL"
    finally:
        network.disconnect()


def test_own_frames_filters_and_other_clients():
    with (
        opened(receive_own_messages=True, can_filters=[{"can_id": 0x123, "can_mask": 0x7FF}]) as ours,
        opened() as other,
    ):
        assert ours.bitrate_bit_s == 1_000_000
        ours.send(can.Message(arbitration_id=0x122, data=b"a", is_extended_id=False))
        ours.send(can.Message(arbitration_id=0x123, data=b"b", is_extended_id=False))
        assert ours.recv(5).data == b"b"
        seen = []
        while len(seen) < 2:
            message = other.recv(5)
            assert message is not None
            seen += [bytes(message.data)] if message.arbitration_id in (0x122, 0x123) else []
        assert seen == [b"a", b"b"]
        ours.set_filters([{"can_id": 0x124, "can_mask": 0x7FF}])
        other.send(can.Message(arbitration_id=0x123, is_extended_id=False))
        other.send(can.Message(arbitration_id=0x124, is_extended_id=False))
        assert ours.recv(5).arbitration_id == 0x124


def test_what_a_listener_sends_is_on_no_bus():
    with Client(BENCH, Hello(Flags.LISTEN_ONLY)) as quiet, opened() as talker, opened() as other:
        quiet.send(pack_frame(0x155))
        talker.send(can.Message(arbitration_id=0x156, is_extended_id=False))
        seen = []
        while 0x156 not in seen:
            message = other.recv(5)
            assert message is not None
            seen.append(message.arbitration_id)
        assert 0x155 not in seen


def test_the_live_view_of_the_simulated_rig():
    live = Live(KnownBus(load_rig("bench")))
    with Client(BENCH) as client, opened() as host:
        sync = host.send_periodic(can.Message(arbitration_id=0x80, is_extended_id=False), 0.005)
        host.send(can.Message(arbitration_id=0, data=[1, 0], is_extended_id=False))
        deadline = time.monotonic() + 10
        while True:
            assert time.monotonic() < deadline
            client.wait(0.1)
            live.add_frames(client.receive())
            snapshot = live.snapshot(time.time_ns())
            if all(row.count > 2 for row in snapshot.pdos if "TPDO" in row.name):
                break
        sync.stop()
        client.ask()
        while client.unanswered:
            assert client.wait(5)
            client.receive()
    assert (client.lost, client.malformed) == (0, 0)
    values = {value.name: value.value for row in snapshot.pdos for value in row.values}
    assert values["brake.coil_temperature_degC"] == pytest.approx(22.0, abs=1.0)
    assert values["motor.position_rad"] == pytest.approx(0.0, abs=0.1)
    assert snapshot.nodes[0].power_state == "switch on disabled"
