"""The bus in real time: what it does for its clients, never how fast (but never faster than its bit
rate).
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import socket
import struct
import subprocess
import sys
import threading
import time

import canopen
import pytest

from coulombus.recording.pcapng_blocks import RecordingError
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.network.script import ScriptEntry, ScriptError, read_script
from coulombus.sim_bus.server.clients import SLOTS, SlotState
from coulombus.sim_bus.server.rig_server import SimServer
from coulombus.wire.address import BusAddress, BusUnavailable, parse_address, socket_path
from coulombus.wire.bits import frame_bits
from coulombus.wire.handshake import Answer, BusStatus, Flags, Hello, connect
from places import ROOT

pytestmark = [pytest.mark.real_time, pytest.mark.patient]

FRAME = struct.Struct("=IB3x8s")
EFF, RTR, ERR = 0x80000000, 0x40000000, 0x20000000
TIMEOUT_S = 60.0


opened, started = [], []


@pytest.fixture(autouse=True)
def private_directory(private_sockets):
    yield
    while opened:
        opened.pop().close()
    while started:  # none is left where the test failed before its end
        with started.pop() as process:
            process.kill()


@pytest.fixture(scope="module")
def rig():
    return load_rig("bench")


@contextlib.contextmanager
def served(rig, name="t", **options):
    server = SimServer(rig, BusAddress("coulombus", name), **options)
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield server
    finally:
        server.stop()
        thread.join()
        server.close()


def frame(can_id, data=b"", length=None):
    return FRAME.pack(can_id, len(data) if length is None else length, data.ljust(8, b"\0"))


class Client:
    """A client that collects frames, (id, data), besides the nodes' boot-ups and heartbeats."""

    def __init__(self, server, flags=0, filters=()):
        self.socket = connect(server.address, flags, filters)
        opened.append(self.socket)
        self.socket.settimeout(TIMEOUT_S)
        self.frames = []

    def send(self, *frames):
        self.socket.send(b"".join(frames))

    def get(self, count):
        """Return the next `count` frames."""
        while len(self.frames) < count:
            message = self.socket.recv(1 << 16)
            assert message, "the bus has closed"
            assert len(message) % 16 == 0
            for can_id, length, data in FRAME.iter_unpack(message):
                if can_id not in (0x701, 0x702):
                    self.frames.append((can_id, data[:length]))
        taken, self.frames = self.frames[:count], self.frames[count:]
        return taken

    def until(self, can_id):
        while (got := self.get(1)[0])[0] != can_id:
            pass
        return got[1]


def upload(client, node, index, subindex):
    client.send(frame(0x600 + node, struct.pack("<BHB4x", 0x40, index, subindex)))
    return client.until(0x580 + node)[4:]


def test_frames_go_to_all_but_their_sender(rig):
    with served(rig) as server:
        a, b, c = Client(server), Client(server), Client(server, Flags.OWN)
        a.send(frame(0x123, b"abc"), frame(0x18DAF110 | EFF, b"12345678"), frame(0x124 | RTR, length=4))
        sent = [(0x123, b"abc"), (0x18DAF110 | EFF, b"12345678"), (0x124 | RTR, bytes(4))]
        assert b.get(3) == c.get(3) == sent
        c.send(frame(0x125))
        assert a.get(1) == b.get(1) == c.get(1) == [(0x125, b"")]  # a had none of its own before


def test_filters_have_socketcans_meaning_and_may_be_changed(rig):
    with served(rig) as server:
        sender = Client(server)
        some = Client(server, filters=[(0x120, 0x7F8 | EFF)])
        inverted = Client(server, filters=[(0x120 | ERR, 0x7F8)])
        extended = Client(server, filters=[(0x128 | EFF, 0x1FFFFFFF | EFF)])
        three = [frame(0x121), frame(0x128), frame(0x128 | EFF)]
        sender.send(*three, frame(0x127))
        assert some.get(2) == [(0x121, b""), (0x127, b"")]
        assert inverted.get(2) == [(0x128, b""), (0x128 | EFF, b"")]
        assert extended.get(1) == [(0x128 | EFF, b"")]
        some.socket.send(Hello(Flags.OWN).pack())
        assert len(some.socket.recv(1 << 16)) % 16 == 8
        some.send(*three)
        assert [one[0] for one in some.get(3)] == [0x121, 0x128, 0x128 | EFF]


def test_a_listener_only_listens(rig):
    with served(rig) as server:
        listener, other = Client(server, Flags.LISTEN_ONLY), Client(server)
        listener.send(frame(0x100))
        other.send(frame(0x101))
        assert listener.get(1) == [(0x101, b"")]
        listener.send(frame(0x102))
        other.send(frame(0x103))
        assert listener.get(1) == [(0x103, b"")]
        other.socket.setblocking(False)
        with pytest.raises(BlockingIOError):
            other.socket.recv(16)
    assert server.result.malformed == 2


def test_one_senders_frames_keep_their_order_and_take_their_bits(rig):
    sent = [(0x400 - k % 7, bytes([k % 256]) * (k % 9)) for k in range(300)]
    bits = sum(frame_bits(can_id, data) for can_id, data in sent)
    with served(rig) as server:
        a, b = Client(server), Client(server)
        begin = time.monotonic()
        a.send(*(frame(*one) for one in sent))
        assert b.get(300) == sent
        assert time.monotonic() - begin >= (bits - 3) / rig.bus.bitrate_bit_s


def test_a_client_that_sends_faster_than_the_bus_is_told_and_loses_nothing(rig):
    with served(rig) as server:
        a, b = Client(server), Client(server)
        a.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        a.socket.setblocking(False)
        taken = 0
        with contextlib.suppress(BlockingIOError):
            while taken < 100_000:
                a.send(frame(0x100 + taken % 256, struct.pack("<Q", taken)))
                taken += 1
        assert taken < 100_000
        assert [struct.unpack("<Q", data)[0] for _, data in b.get(taken)] == list(range(taken))


def test_who_does_not_read_loses_frames_and_harms_nobody(rig):
    messages, each = 400, 1000
    with served(rig, unpaced=True) as server:
        deaf, sender, reader = Client(server), Client(server), Client(server)
        batch = b"".join(frame(0x300, struct.pack("<Q", k)) for k in range(each))

        def send():
            for _ in range(messages):
                sender.socket.send(batch)

        thread = threading.Thread(target=send)
        thread.start()
        counted = 0
        while counted < messages * each:
            counted += len([one for one in FRAME.iter_unpack(reader.socket.recv(1 << 16)) if one[0] == 0x300])
        thread.join()
        deaf.socket.setblocking(False)
        arrived = 0
        with contextlib.suppress(BlockingIOError):
            while True:
                arrived += len(deaf.socket.recv(1 << 16)) // 16
        deaf.socket.settimeout(TIMEOUT_S)
        assert greet_again(deaf).lost > 0
    assert arrived < messages * each
    (loser,) = server.result.losers
    assert loser["pid"] == os.getpid()
    assert loser["delivered"] == arrived
    assert server.result.lost == loser["lost"]
    assert messages * each <= loser["lost"] + arrived <= messages * each + 20  # and the nodes' own


def test_malformed_messages_are_dropped_and_counted(rig):
    with served(rig) as server:
        a, b = Client(server), Client(server)
        for message in (bytes(7), bytes(24), bytes(16 * 1025), frame(0x100, length=9), frame(ERR | 4, bytes(8))):
            a.socket.send(message)
        a.socket.settimeout(TIMEOUT_S)
        a.send(frame(0x101, b"\xff" * 8, length=2))
        assert b.get(1) == [(0x101, b"\xff\xff")]
    assert server.result.malformed == 5


def test_a_bad_greeting_is_refused(rig):
    with served(rig) as server:
        for message, status in ((frame(0x100), BusStatus.BAD_HELLO), (struct.pack("<IHHH14x", 0x53424C43, 2, 0, 0), 1)):
            with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stranger:
                stranger.settimeout(TIMEOUT_S)
                stranger.connect(str(socket_path("t")))
                stranger.send(message)
                assert struct.unpack_from("<IHH", stranger.recv(100))[2] == status
                assert stranger.recv(100) == b""
        assert upload(Client(server), 1, 0x1000, 0) == struct.pack("<I", 0x00020192)


def test_a_full_bus_says_so_and_a_place_that_is_left_is_free(rig):
    with served(rig) as server:
        clients = [Client(server) for _ in range(SLOTS)]
        assert len({greet_again(client).station for client in clients}) == SLOTS
        for _ in range(2):
            with pytest.raises(BusUnavailable, match="taken"):
                connect(server.address)
        clients[3].socket.close()
        deadline = time.monotonic() + TIMEOUT_S
        while True:
            try:
                clients[3] = Client(server)
                break
            except BusUnavailable:
                assert time.monotonic() < deadline
        clients[0].send(frame(0x100))
        assert clients[3].get(1) == [(0x100, b"")]


def greet_again(client):
    client.socket.send(Hello().pack())
    while (answer := Answer.unpack(client.socket.recv(1 << 16))) is None:
        pass
    return answer


def test_who_says_nothing_keeps_nobody_out(rig):
    """Connections that never greet take all places; who greets finds one."""
    with served(rig) as server:
        path = str(socket_path(server.address.name))
        mute = [socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(SLOTS + 3)]
        opened.extend(mute)
        for one in mute:
            one.connect(path)
        a, b = Client(server), Client(server)
        a.send(frame(0x123))
        assert b.get(1) == [(0x123, b"")]


def test_what_a_client_sent_before_it_left_is_carried(rig):
    with served(rig) as server:
        reader = Client(server)
        for k in range(20):
            with Client(server).socket as brief:
                reader.send(frame(0x200))  # so that it leaves something unread
                brief.send(b"".join(frame(0x100 + k, bytes([n])) for n in range(5)))
        seen = reader.get(100)
    assert sorted(seen) == sorted((0x100 + k, bytes([n])) for k in range(20) for n in range(5))


def test_sdo_nmt_and_pdos_of_the_nodes(rig):
    with served(rig) as server:
        a = Client(server)
        assert upload(a, 1, 0x1018, 1) == struct.pack(
            "<I", int(rig.one_axis().description("motor").variable(0x1018, 1).default)
        )
        assert upload(a, 2, 0x1000, 0) == struct.pack("<I", 0x000A0194)
        pdos = [pdo.layout.cob_id for pdo in rig.pdos() if pdo.layout.direction == "tpdo"]
        a.send(frame(0x000, bytes([1, 0])), frame(0x080))
        assert {can_id for can_id, _ in a.get(2)} <= set(pdos)


def test_canopen_over_python_can_attaches(rig):
    with served(rig) as server:
        network = canopen.Network()
        network.connect(interface="coulombus", channel=server.address.name)
        try:
            node = network.add_node(1, str(ROOT / "eds" / "motor.eds"))
            assert node.sdo[0x1000].raw == 0x00020192
            node.sdo[0x1017].raw = 20
            node.nmt.wait_for_heartbeat(TIMEOUT_S)
            assert node.nmt.state == "PRE-OPERATIONAL"
        finally:
            network.disconnect()


def test_a_script_switches_a_node_off_and_on_and_resets_one(rig):
    script = (
        ScriptEntry(1_050_000_000, "motor", "power_off"),
        ScriptEntry(1_100_000_000, "motor", "power_on"),
        ScriptEntry(1_000_000_000, "brake", "reset"),
    )
    with served(rig, script=script) as server:
        client = Client(server, filters=[(0x700, 0x780)])
        boots = []
        while boots[-2:] != [0x702, 0x701]:  # whether the first two were seen is left open
            message = client.socket.recv(1 << 16)
            boots += [can_id for can_id, _, data in FRAME.iter_unpack(message) if data[0] == 0]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[[at]]\nt_s = 1\nnode = 'motor'\naction = 'explode'", "action = 'explode'; expected \"power_off\" or"),
        ("[[at]]\nt_s = -1\nnode = 'motor'\naction = 'reset'", "entry 1 of .* t_s = -1; expected seconds"),
        ("[[at]]\nt_s = 1\nnode = 'drive'\naction = 'reset'", "node = 'drive'"),
        ("[[at]]\nt_s = 1", "expected the keys"),
        ("[at]\nt_s = 1", "expected nothing but"),
        ("at = 3", "expected nothing but"),
        ("[[when]]\nt_s = 1", "when; expected"),
        ("t_s = = 1", r"script.toml:1: t_s: '= 1' cannot be read"),
    ],
)
def test_a_wrong_script_is_refused_with_the_entry(tmp_path, text, reason):
    path = tmp_path / "script.toml"
    path.write_text(text)
    with pytest.raises(ScriptError, match=reason):
        read_script(path)


def test_a_script_as_read(tmp_path):
    path = tmp_path / "script.toml"
    path.write_text("[[at]]\nt_s = 1.5\nnode = 'brake'\naction = 'power_off'\nafter = 'enabled'\n")
    assert read_script(path) == (ScriptEntry(1_500_000_000, "brake", "power_off", "enabled"),)


def test_a_live_bus_is_refused_and_a_dead_ones_file_replaced(rig):
    path = socket_path("t")
    with served(rig):
        with pytest.raises(BusUnavailable, match="served already") as refused:
            SimServer(rig, BusAddress("coulombus", "t"))
        assert refused.value.exit_status == 4
        assert path.is_socket()
    assert not path.exists()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(str(path))
        dead.listen()
    assert path.is_socket()
    with served(rig) as server:
        Client(server)
    assert not path.exists()


def test_a_bus_that_is_refused_makes_no_recording_and_replaces_none(rig, tmp_path):
    mine, new = tmp_path / "mine.pcapng", tmp_path / "new.pcapng"
    mine.write_text("mine")
    with served(rig):
        for record in (mine, new):
            with pytest.raises(BusUnavailable):
                SimServer(rig, BusAddress("coulombus", "t"), record=record, force=True)
    assert mine.read_text() == "mine"
    assert not new.exists()
    with pytest.raises(RecordingError, match="exists"):
        SimServer(rig, BusAddress("coulombus", "t"), record=mine)
    assert not socket_path("t").exists()


def test_an_interface_that_is_not_there_is_said_with_the_way_to_get_it(rig):
    with pytest.raises(BusUnavailable, match="modprobe") as refused:
        SimServer(rig, parse_address("socketcan:nothere0"))
    assert refused.value.exit_status == 4


# the command


def start_command(*options, **popen):
    process = subprocess.Popen(
        [sys.executable, "-m", "coulombus", "emulate", "--bus", "coulombus:t", "--json", *options],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **popen,
    )
    started.append(process)
    assert process.stdout is not None
    return process, json.loads(process.stdout.readline())


@pytest.mark.thorough
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_the_command_ends_with_0_on_a_signal_that_was_ignored_at_its_start(number):
    process, ready = start_command(preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN))
    assert (ready["event"], ready["bus"], ready["bitrate_bit_s"]) == ("ready", "coulombus:t", 1_000_000)
    assert {right["name"] for right in ready["real_time"]} >= {"SCHED_FIFO", "locked memory", "timer slack"}
    process.send_signal(number)
    out, _ = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 0
    assert json.loads(out)["event"] == "end"
    assert not socket_path("t").exists()


def test_a_client_for_whom_no_memory_is_left_is_not_kept(rig, monkeypatch):
    def refused(client):
        raise MemoryError

    server = SimServer(rig, BusAddress("coulombus", "t"))
    monkeypatch.setattr("coulombus.sim_bus.server.admission.ask_for_stamps", refused)
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)) as client:
        client.settimeout(TIMEOUT_S)
        client.connect(str(socket_path("t")))
        with pytest.raises(MemoryError) as failure:
            server.run(TIMEOUT_S)
        assert client.recv(1) == b""  # though the failure still knows the socket
        assert failure.tb
    server.close()


def test_whatever_becomes_of_a_client_closing_leaves_nothing(rig, tmp_path, monkeypatch):
    server = SimServer(rig, BusAddress("coulombus", "t"), record=tmp_path / "r.pcapng")
    mine, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    server._admission.admit(0, mine, SlotState.GREETING)

    def refused(bus, station):
        raise MemoryError

    monkeypatch.setattr("coulombus.sim_bus.server.admission.detach", refused)
    before = len(os.listdir("/proc/self/fd"))
    with pytest.raises(MemoryError):
        server.close()
    other.close()
    assert not socket_path("t").exists()
    assert len(os.listdir("/proc/self/fd")) == before - 7  # two of the client, listener, two to wake, spare, recording
    assert len(read(tmp_path / "r.pcapng").frames) == 0


def test_the_command_ends_by_itself():
    process, _ = start_command("--seconds", "1", "--priority", "0")
    out, err = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 0, err
    assert json.loads(out)["seconds"] >= 1


def test_with_few_descriptors_it_sleeps_all_the_same_and_turns_clients_away():
    """ppoll refused 35 entries at once, every time, and a client that could not be accepted woke
    the loop for ever: 95 % at SCHED_FIFO.
    """
    few = 16
    process, _ = start_command(
        *("--priority", "0"), preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (few, few))
    )
    clients, refused = [], 0
    for _ in range(few):
        try:
            clients.append(connect(BusAddress("coulombus", "t")))
        except BusUnavailable:
            refused += 1
    assert clients
    assert refused
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=TIMEOUT_S)
    for client in clients:
        client.close()
    assert process.returncode == 0, err
    end = json.loads(out)
    assert end["clients"] == len(clients)
    assert end["wakeups"] < 1e4 * (1 + end["seconds"])


def test_a_second_one_is_refused(rig):
    with served(rig):
        second = subprocess.run(
            [sys.executable, "-m", "coulombus", "emulate", "--bus", "coulombus:t"],
            cwd=ROOT,
            capture_output=True,
            text=True,
        )
    assert second.returncode == 4
    assert "served already" in second.stderr


def test_killed_and_started_anew(rig):
    process, _ = start_command()
    client = connect(BusAddress("coulombus", "t"))
    opened.append(client)
    process.kill()
    process.communicate()
    client.settimeout(TIMEOUT_S)
    while client.recv(1 << 16):  # boot-ups, and then the end
        pass
    with served(rig) as server:
        assert upload(Client(server), 1, 0x1000, 0) == struct.pack("<I", 0x00020192)


def test_the_world_stands_still_while_nobody_can_run():
    process, _ = start_command()
    with connect(BusAddress("coulombus", "t")):  # answered: its loop runs
        time.sleep(0.05)
    try:
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.3)
    finally:
        process.send_signal(signal.SIGCONT)
    time.sleep(0.1)
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=TIMEOUT_S)
    end = json.loads(out)
    assert end["stalls"] >= 1
    assert 0.1 < end["stalled_s"] < end["seconds"]
