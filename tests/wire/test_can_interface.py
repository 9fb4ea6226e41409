import asyncio
import select
import socket
import struct
import threading
import time
from contextlib import contextmanager

import can
import canopen
import pytest
from can.bus import BusState

from coulombus.wire.address import BusUnavailable, bus_names, parse_address
from coulombus.wire.client import BusFull, BusGone, Client, pack_frame
from tiny_bus import tiny_bus

pytestmark = [pytest.mark.real_time, pytest.mark.usefixtures("private_sockets")]

BENCH = parse_address("coulombus:bench")


def opened(**options):
    return can.Bus(interface="coulombus", channel="bench", **options)


def test_found_by_its_entry_point(bus):
    with opened() as ours:
        assert type(ours).__module__ == "coulombus.wire.can_interface"
        assert str(ours) == "coulombus:bench"
        assert ours.bitrate_bit_s == 1_000_000
        assert ours.protocol is can.CanProtocol.CAN_20
    assert {"interface": "coulombus", "channel": "bench"} in can.detect_available_configs(["coulombus"])


@pytest.mark.parametrize(
    ("message", "can_id", "length", "data"),
    [
        (can.Message(arbitration_id=0x181, data=b"abc", is_extended_id=False), 0x181, 3, b"abc"),
        (can.Message(arbitration_id=0x80, is_extended_id=False), 0x80, 0, b""),
        (can.Message(arbitration_id=0x12345678, data=bytes(range(8))), 0x92345678, 8, bytes(range(8))),
        (can.Message(arbitration_id=0x601, is_remote_frame=True, dlc=8, is_extended_id=False), 0x40000601, 8, b""),
    ],
)
def test_a_frame_goes_to_the_others_as_it_is(bus, message, can_id, length, data):
    with opened() as ours, opened() as other:
        before = time.time()
        ours.send(message)
        frame = other.recv(2)
        assert bus.frames == [(can_id, length, data.ljust(8, b"\0"))]
        assert frame.equals(message, timestamp_delta=None, check_channel=False)
        assert frame.channel == "bench"
        assert before <= frame.timestamp <= time.time()
        assert ours.recv(0) is None


def test_own_frames_on_demand(bus):
    with opened(receive_own_messages=True) as ours:
        ours.send(can.Message(arbitration_id=5, is_extended_id=False))
        frame = ours.recv(2)
        assert (frame.arbitration_id, frame.is_rx) == (5, False)
        bus.deliver((6, b""))
        assert ours.recv(2).is_rx


def test_what_is_no_frame_of_the_bus_is_not_sent(bus):
    """Cut to eleven bits, 800h would be an NMT command."""
    wrong = (
        {"arbitration_id": 0x800, "is_extended_id": False},
        {"arbitration_id": 1 << 29},
        {"arbitration_id": -1},
        {"arbitration_id": 1, "is_error_frame": True},
    )
    with opened() as ours:
        for fields in wrong:
            with pytest.raises(can.CanOperationError, match=r"identifier|error frame"):
                ours.send(can.Message(check=False, **fields))
    assert bus.frames == []


def test_bus_off_is_told_by_the_state():
    """Station 17, which data[5] of its own error frames tells, goes off and comes back.

    Station 18 does not matter.
    """
    with tiny_bus() as bus, opened() as ours:
        states = []
        for classes, station in ((0x240, 18), (0x240, 17), (0x288, 17), (0x304, 17)):
            bus.deliver((0x20000000 | classes, bytes((0, 0, 0, 0, 0, station, 0, 0))))
            assert ours.recv(2).is_error_frame
            states.append(ours.state)
    assert states == [BusState.ACTIVE, BusState.ERROR, BusState.ERROR, BusState.ACTIVE]


def test_a_bus_that_does_not_tell_its_controllers(bus):
    with opened() as ours, pytest.raises(can.CanOperationError, match="does not report"):
        ours.details()


def test_a_message_of_many_frames_comes_frame_by_frame_and_the_descriptor_stays_readable(bus):
    with opened() as ours:
        bus.deliver(*[(0x180 + i, bytes([i])) for i in range(5)])
        for i in range(5):
            assert select.select([ours.fileno()], [], [], 2)[0]
            assert ours.recv(0).arbitration_id == 0x180 + i
        assert select.select([ours.fileno()], [], [], 0)[0] == []
        assert ours.recv(0) is None


def test_asyncio_gets_every_frame_of_a_message(bus):
    async def collect():
        reader = can.AsyncBufferedReader()
        with opened() as ours:
            notifier = can.Notifier(ours, [reader], loop=asyncio.get_running_loop())
            bus.deliver(*[(i, b"") for i in range(1, 8)])
            identifiers = [(await asyncio.wait_for(reader.get_message(), 2)).arbitration_id for _ in range(7)]
            notifier.stop()
        return identifiers

    assert asyncio.run(collect()) == list(range(1, 8))


def test_filters_are_the_buss(bus):
    with opened(can_filters=[{"can_id": 0x180, "can_mask": 0x780, "extended": False}]) as ours:
        assert bus.greetings[-1][1] == [(0x180, 0x80000780)]
        bus.deliver((0x181, b""), (0x80000181, b""), (0x201, b""), (0x182, b""))
        assert [ours.recv(2).arbitration_id for _ in range(2)] == [0x181, 0x182]
        assert ours.recv(0) is None


def test_filters_change_at_once_also_for_frames_under_way(bus):
    with opened() as ours:
        bus.deliver((0x181, b""), (0x201, b""))
        ours.set_filters([{"can_id": 0x201, "can_mask": 0x7FF}])
        assert ours.recv(2).arbitration_id == 0x201
        assert ours.recv(0.05) is None  # takes the answer
        bus.deliver((0x181, b""), (0x201, b"2"))
        assert ours.recv(2).data == b"2"
        ours.set_filters(None)
        assert ours.recv(0.05) is None
        bus.deliver((0x181, b""))
        assert ours.recv(2).arbitration_id == 0x181


def test_several_filters_of_both_lengths(bus):
    filters = [
        {"can_id": 0x181, "can_mask": 0x7FF, "extended": False},
        {"can_id": 0x12345600, "can_mask": 0x1FFFFF00, "extended": True},
        {"can_id": 0x701, "can_mask": 0x7FF},
    ]
    with opened() as ours:
        ours.set_filters(filters)
        assert ours.recv(0.05) is None  # takes the answer
        passing = [0x181, 0x923456FF, 0x701, 0x80000701]  # without "extended": frames of both lengths
        bus.deliver(*[(can_id, b"") for can_id in (0x80000181, 0x182, *passing, 0x92345700)])
        frames = [ours.recv(2) for _ in passing]
        assert [m.arbitration_id | m.is_extended_id << 31 for m in frames] == passing
        assert ours.recv(0) is None


def test_more_filters_than_a_bus_takes_are_applied_here(bus):
    with opened(can_filters=[{"can_id": i, "can_mask": 0x7FF} for i in range(600)]) as ours:
        assert bus.greetings[-1][1] == []
        bus.deliver((700, b""), (599, b""))
        assert ours.recv(2).arbitration_id == 599


def test_error_frames(bus):
    with opened() as ours, opened(ignore_rx_error_frames=True) as deaf:
        bus.deliver((0x20000004, bytes(8)), (0x80, b""))
        assert ours.recv(2).is_error_frame
        assert not deaf.recv(2).is_error_frame


def test_state_passive_listens_only(bus):
    with opened(listen_only=True) as ours, opened() as other:
        assert ours.state is BusState.PASSIVE
        with pytest.raises(can.CanOperationError, match="listen only"):
            ours.send(can.Message(arbitration_id=1))
        ours.state = BusState.ACTIVE
        assert ours.state is BusState.ACTIVE
        ours.send(can.Message(arbitration_id=1))
        assert other.recv(2).arbitration_id == 1
        with pytest.raises(ValueError, match="ACTIVE or PASSIVE"):
            ours.state = BusState.ERROR


def test_periodic_frames(bus):
    with opened() as ours, opened() as other:
        task = ours.send_periodic(can.Message(arbitration_id=0x77F, data=[5], is_extended_id=False), 0.01)
        assert [other.recv(2).arbitration_id for _ in range(3)] == [0x77F] * 3
        task.stop()


def test_a_periodic_frame_is_modified_and_stopped(bus):
    with opened() as ours, opened() as other:
        message = can.Message(arbitration_id=0x77F, data=[4], is_extended_id=False)
        task = ours.send_periodic(message, 0.005)
        assert other.recv(2).data == b"\4"
        message.data = bytes([5])
        task.modify_data(message)
        values = [other.recv(2).data[0] for _ in range(200)]
        assert values == sorted(values)
        assert values[-1] == 5
        task.stop()
        while other.recv(0.2) is not None:  # what was under way
            pass
        ours.stop_all_periodic_tasks()
        ours.flush_tx_buffer()


def test_several_threads_share_a_bus(bus):
    with can.ThreadSafeBus(interface="coulombus", channel="bench") as ours, opened() as other:

        def talk(first):
            for i in range(20):
                ours.send(can.Message(arbitration_id=first + i, is_extended_id=False))

        threads = [threading.Thread(target=talk, args=(100 * k,)) for k in range(1, 5)]
        for thread in threads:
            thread.start()
        identifiers = [other.recv(5).arbitration_id for _ in range(80)]
        for thread in threads:
            thread.join()
        assert sorted(identifiers) == [100 * k + i for k in range(1, 5) for i in range(20)]
        for k in range(1, 5):  # each thread's own in their order
            mine = [identifier for identifier in identifiers if identifier // 100 == k]
            assert mine == sorted(mine)


def test_after_shutdown_every_call_says_so(bus):
    ours = opened()
    ours.shutdown()
    for call in (
        lambda: ours.recv(0),
        lambda: ours.send(can.Message(arbitration_id=1)),
        lambda: setattr(ours, "state", BusState.PASSIVE),
        lambda: ours.set_filters([{"can_id": 1, "can_mask": 1}]),
        lambda: ours.send_periodic(can.Message(arbitration_id=1), 1.0),
    ):
        with pytest.raises(can.CanOperationError, match="was shut down here"):
            call()


def test_the_socket_of_a_dead_process_is_no_bus(bus, short_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(str(short_path / "coulombus" / "dead"))
    assert "dead" in bus_names()
    assert can.detect_available_configs(["coulombus"]) == [{"interface": "coulombus", "channel": "bench"}]
    with pytest.raises(can.CanInitializationError, match="start one in another terminal"):
        can.Bus(interface="coulombus", channel="dead")


def test_what_is_no_frame_is_dropped_and_counted(bus):
    with Client(BENCH) as client:
        bus.deliver_bytes(b"\1" * 7)
        bus.deliver_bytes(b"\1" * 24)  # a greeting by its length, but no answer
        bus.deliver_bytes(struct.pack("=IB3x8s", 1, 9, b"") + pack_frame(2, b"ok"))
        frames = []
        while not frames:
            assert client.wait(2)
            frames = client.receive()
        assert [(can_id, length) for _, can_id, length, _ in frames] == [(2, 2)]
        assert client.malformed == 3


def test_lost_frames_are_told_on_demand(bus):
    with Client(BENCH) as client:
        assert client.lost == 0
        bus.lost = 12
        client.ask()
        assert client.wait(2)
        assert client.receive() == []
        assert (client.lost, client.unanswered) == (12, 0)


def fill(client):
    for _ in range(1_000_000):
        client.send(bytes(16 * 64))


def send_twice(ours):
    for _ in range(2):
        ours.send(can.Message(arbitration_id=1), timeout=0.02)


def test_a_bus_that_does_not_read_is_full_and_nobody_hangs(bus):
    with opened() as ours, bus._lock:  # the bus's thread hangs
        with pytest.raises(BusFull, match="full"):
            fill(ours._client)
        with pytest.raises(can.CanOperationError, match="full"):
            send_twice(ours)  # the thread may take one message more before it waits for the lock


def test_a_bus_that_goes_is_told_not_waited_for():
    with tiny_bus():
        ours, client = opened(), Client(BENCH)
    with ours, client:
        with pytest.raises(can.CanOperationError, match="is gone"):
            ours.recv(2)
        assert ours.state is BusState.ERROR
        with pytest.raises(can.CanOperationError, match="is gone"):
            ours.recv(2)
        with pytest.raises(can.CanOperationError, match="is gone"):
            ours.send(can.Message(arbitration_id=1))
        with pytest.raises(BusGone, match="is gone"):
            client.receive()


def test_no_bus_and_no_name_say_what_to_do(bus):
    with pytest.raises(can.CanInitializationError, match="coulombus emulate --bus coulombus:other"):
        can.Bus(interface="coulombus", channel="other")
    with pytest.raises(can.CanInitializationError, match="virtual buses here: bench"):
        can.Bus(interface="coulombus", channel="")
    with pytest.raises(can.CanInitializationError, match="-i socketcan -c can0"):
        can.Bus(interface="coulombus", channel="socketcan:can0")
    with pytest.raises(can.CanInitializationError, match="classical"):
        opened(fd=True)
    with opened() as ours, pytest.raises(can.CanOperationError, match="at most 8"):
        ours.send(can.Message(arbitration_id=1, data=bytes(12), is_fd=True))


def test_shut_down_twice_and_descriptors_returned(bus):
    ours = opened()
    ours.shutdown()
    ours.shutdown()
    assert ours.fileno() == -1


@contextmanager
def beating(bus):
    """Send node 1's heartbeat again and again: canopen forgets what came before it waits."""
    ended = threading.Event()

    def beat():
        while not ended.wait(0.01):
            bus.deliver((0x701, b"\x05"))

    thread = threading.Thread(target=beat)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def test_a_plain_canopen_network(bus):
    network = canopen.Network()
    network.connect(interface="coulombus", channel="bench", bitrate=1_000_000)
    node = network.add_node(1, canopen.ObjectDictionary())
    with beating(bus):
        assert node.nmt.wait_for_heartbeat(20) == "OPERATIONAL"
    network.nmt.state = "PRE-OPERATIONAL"
    network.sync.transmit()
    deadline = time.monotonic() + 20
    while len(bus.frames) < 2 and time.monotonic() < deadline:
        time.sleep(0.001)
    network.disconnect()
    assert bus.frames == [(0, 2, b"\x80\0" + bytes(6)), (0x80, 0, bytes(8))]


def test_a_missing_interface_of_linux_is_told():
    with pytest.raises(BusUnavailable, match=r"socketcan:nocan0 cannot be opened: .*sudo") as caught:
        Client(parse_address("socketcan:nocan0"))
    assert caught.value.exit_status == 4
