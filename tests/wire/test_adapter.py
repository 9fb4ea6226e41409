"""A bus behind an adapter of python-can, as the readers and services of every other bus take it."""

from __future__ import annotations

import threading

import can
import pytest

from coulombus.wire import adapter
from coulombus.wire.adapter import AdapterClient, AdapterClock, open_bus, passes
from coulombus.wire.address import BusUnavailable, parse_address
from coulombus.wire.bus_link import BusLink
from coulombus.wire.client import BusFull, BusGone, Echo, pack_frame
from coulombus.wire.frame_batches import block_reader
from coulombus.wire.handshake import Flags, Hello
from far_ends import ADAPTERS, far_end

pytestmark = [pytest.mark.real_time, pytest.mark.patient]

PATIENCE_S = 20.0
EFF, RTR, ERR = 0x80000000, 0x40000000, 0x20000000
NOW_NS = 1_700_000_000_000_000_000


def opened(text, *hello):
    return open_bus(parse_address(text, ("can",)), Hello(*hello))


def taken(client, count):
    """Return the next frames (identifier, length, data)."""
    frames = []
    while len(frames) < count:
        assert client.wait(PATIENCE_S)
        frames += [frame[1:] for frame in client.receive()]
    assert len(frames) == count
    return frames


def base(can_id, data=b""):
    return can.Message(arbitration_id=can_id, is_extended_id=False, data=data)


@pytest.fixture
def virtual():
    with far_end("virtual") as (text, far):
        yield text, far


@pytest.mark.parametrize("interface", ADAPTERS)
def test_each_frame_comes_as_it_is_and_goes_as_it_is(interface):
    messages = [
        *(base(0x100 + n, bytes(range(n))) for n in range(9)),
        can.Message(arbitration_id=0x12345678, data=b"\xff\x00"),
        can.Message(arbitration_id=0x5, data=b"five"),  # extended, with a small number
    ]
    frames = [
        (message.arbitration_id | EFF * message.is_extended_id, message.dlc, bytes(message.data).ljust(8, b"\0"))
        for message in messages
    ]
    with far_end(interface) as (text, far), opened(text) as client:
        for message in messages:
            far.send(message)
        assert taken(client, len(frames)) == frames
        for can_id, length, data in frames:
            client.send(pack_frame(can_id, data[:length]))
        for message in messages:
            assert far.recv(PATIENCE_S).equals(
                message, timestamp_delta=None, check_channel=False, check_direction=False
            )
        assert (client.lost, client.malformed) == (0, 0)


@pytest.mark.parametrize("interface", ["virtual", "slcan"])
def test_a_remote_frame_goes_both_ways(interface):
    with far_end(interface) as (text, far), opened(text) as client:
        far.send(can.Message(arbitration_id=0x701, is_extended_id=False, is_remote_frame=True, dlc=1))
        assert taken(client, 1) == [(0x701 | RTR, 1, bytes(8))]
        client.send(pack_frame(0x702 | RTR, length=8))
        message = far.recv(PATIENCE_S)
        assert (message.arbitration_id, message.is_remote_frame, message.dlc) == (0x702, True, 8)


def test_the_options_of_the_address_are_the_drivers():
    with far_end("slcan") as (text, _), opened(text) as client:
        assert client.bitrate_bit_s == 500_000
        assert str(client.address).startswith("can:slcan:/dev/")


def test_what_the_address_leaves_open_stands_in_python_cans_configuration(monkeypatch, virtual):
    text, far = virtual
    channel = text.rpartition(":")[2]
    monkeypatch.setenv("CAN_CONFIG", f'{{"channel": "{channel}"}}')
    with opened("can:virtual") as client:
        far.send(base(0x123))
        assert taken(client, 1) == [(0x123, 0, bytes(8))]


def test_filters_have_the_meaning_of_socketcans():
    """Against the rule of can(7): bit 31 is of the mask like another one, bit 29 of the identifier inverts."""
    for can_id in (0x80, 0x80 | EFF, 0x581, 0x5FF, 0x601 | RTR, 0x601):
        assert passes(can_id, Hello())
        assert passes(can_id, Hello(filters=((0x581, 0x780),))) == (can_id & 0x780 == 0x580)
        assert passes(can_id, Hello(filters=((0x80, 0x7FF | EFF),))) == (can_id == 0x80)
        assert passes(can_id, Hello(filters=((0x80 | ERR, 0x7FF),))) == (can_id & 0x7FF != 0x80)
        assert passes(can_id, Hello(filters=((0x601 | RTR, 0x7FF | RTR), (1, 0x7FF)))) == (can_id == 0x601 | RTR)


def test_filters_change_while_the_bus_is_open(virtual):
    text, far = virtual
    with BusLink(parse_address(text, ("can",)), ((0x581, 0x7FF),)) as link:
        for can_id in (0x181, 0x581):
            far.send(base(can_id))
        assert link.receive(link.now_ns() + 20 * 10**9).can_id == 0x581
        link.set_filters(((0x181, 0x7FF),))
        for can_id in (0x581, 0x181):
            far.send(base(can_id))
        assert link.receive(link.now_ns() + 20 * 10**9).can_id == 0x181


def test_own_frames_come_back_on_demand_and_are_marked(virtual):
    text, far = virtual
    with opened(text, Flags.OWN) as hearing, opened(text) as deaf:
        hearing.send(pack_frame(0x181, b"own"))
        assert far.recv(PATIENCE_S).arbitration_id == 0x181
        assert hearing.wait(PATIENCE_S)
        (frame,) = hearing.receive()
        assert isinstance(frame, Echo)
        deaf.send(pack_frame(0x182))
        far.send(base(0x183))
        assert [can_id for can_id, _, _ in taken(deaf, 2)] == [0x181, 0x183]
        assert [type(frame) for frame in wait_for(hearing, 2)] == [tuple, tuple]


def wait_for(client, count):
    frames = []
    while len(frames) < count:
        assert client.wait(PATIENCE_S)
        frames += client.receive()
    return frames


class Driver:
    """Stands in for python-can's bus: what it receives, and how it fails."""

    def __init__(self, *messages, end=None, refusal=None):
        self.messages, self.end, self.refusal, self.lost = list(messages), end, refusal, 0
        self.shut = threading.Event()

    def recv(self, timeout):
        if self.messages:
            return self.messages.pop(0)
        if self.end is not None:
            raise self.end
        self.shut.wait(0.001)
        return None

    def send(self, message, timeout):
        if self.refusal is not None:
            raise self.refusal

    def shutdown(self):
        self.shut.set()
        if self.end is not None:
            raise self.end


def driven(monkeypatch, driver, *hello, interface="pcan"):
    monkeypatch.setattr(adapter, "_opened", lambda address, own: driver)
    return opened(f"can:{interface}:x", *hello)


def error(can_id=0, data=b""):
    return can.Message(arbitration_id=can_id, is_error_frame=True, data=data, dlc=len(data), check=False)


def test_error_frames_come_on_demand_and_have_linuxs_classes_or_none(monkeypatch):
    messages = (error(0x204, b"\0\x08\0\0\0\0\x60\0"), base(0x181))
    with driven(monkeypatch, Driver(*messages)) as client:
        assert taken(client, 1) == [(0x181, 0, bytes(8))]
    with driven(monkeypatch, Driver(*messages), Flags.ERRORS, interface="gs_usb") as client:
        assert taken(client, 2)[0] == (ERR | 0x204, 8, b"\0\x08\0\0\0\0\x60\0")
    with driven(monkeypatch, Driver(*messages), Flags.ERRORS) as client:  # pcan has codes of its own there
        assert taken(client, 2)[0] == (ERR | 0x80, 8, bytes(8))


def test_lost_frames_are_counted_wherever_they_were_lost(monkeypatch):
    monkeypatch.setattr(adapter, "ROOM", 3)
    driver = Driver(*(base(n) for n in range(5)), error(0x4, b"\0\x01"), end=OSError("unplugged"))
    driver.lost = 10
    with driven(monkeypatch, driver, interface="socketcan") as client:
        client._thread.join(PATIENCE_S)
        assert [frame[1] for frame in client.receive()] == [0, 1, 2]
        assert client.lost == 2 + 1 + 10


def test_what_is_no_classical_frame_is_counted(monkeypatch):
    messages = (can.Message(arbitration_id=1, is_fd=True, data=bytes(12)), can.Message(arbitration_id=2, is_fd=True))
    with driven(monkeypatch, Driver(*messages, base(3))) as client:
        assert taken(client, 1) == [(3, 0, bytes(8))]
        assert client.malformed == 2


@pytest.mark.parametrize("end", [OSError(5, "Input/output error"), can.CanOperationError("unplugged"), ValueError()])
def test_an_unplugged_adapter_ends_the_bus_after_its_last_frame(monkeypatch, end):
    client = driven(monkeypatch, Driver(base(0x181), end=end))
    assert taken(client, 1)[0][0] == 0x181
    for _ in range(2):
        assert client.wait(PATIENCE_S)
        with pytest.raises(BusGone, match=r"bus can:pcan:x is gone: (Input/output error|unplugged|ValueError)"):
            client.receive()
    client.close()
    client.close()


def test_a_frame_that_the_driver_does_not_take_may_be_sent_again(monkeypatch):
    with driven(monkeypatch, Driver(refusal=can.CanOperationError("queue"))) as client, pytest.raises(BusFull):
        client.send(pack_frame(1))
    client = driven(monkeypatch, Driver(refusal=can.CanOperationError("queue"), end=OSError("unplugged")))
    client._thread.join(PATIENCE_S)
    with pytest.raises(BusGone, match="unplugged"):
        client.send(pack_frame(1))
    client.close()


def test_a_view_reads_it_in_blocks(virtual):
    text, far = virtual
    with opened(text) as client:
        reader, rows = block_reader(client), []
        for n in range(3):
            far.send(base(0x181 + n, bytes((n, 0xFF))))
        while len(rows) < 3:
            assert client.wait(PATIENCE_S)
            block = reader.receive()
            rows += zip(block.can_ids.tolist(), block.lengths.tolist(), block.words.tolist(), strict=True)
        assert rows == [(0x181 + n, 2, 0xFF00 | n) for n in range(3)]
        assert len(reader.receive()) == 0


# stamps


def test_a_clock_of_1970_is_taken_as_it_is():
    clock = AdapterClock()
    for later_s in (0, 1, 100):
        stamp_s, now_ns = (NOW_NS / 1e9 + later_s, NOW_NS + later_s * 10**9 + 5_000_000)
        assert abs(clock.ns(stamp_s, now_ns) - round(stamp_s * 1e9)) == 0
    assert "by python-can" in clock.meaning


def test_a_clock_with_a_zero_of_its_own_is_set_at_its_first_frame():
    clock = AdapterClock()
    assert clock.ns(12.5, NOW_NS) == NOW_NS
    assert clock.ns(12.75, NOW_NS + 270_000_000) == NOW_NS + 250_000_000  # not the time of its arrival
    assert clock.ns(20.5, NOW_NS + 30 * 10**9) == NOW_NS + 8 * 10**9  # it has waited for this reader
    assert clock.ns(0.25, NOW_NS + 90 * 10**9) == NOW_NS + 90 * 10**9  # the adapter was switched on again
    assert clock.meaning.startswith("the adapter's clock, set to this PC's")


def test_a_clock_that_is_ahead_is_set_back():
    clock = AdapterClock()
    assert clock.ns(NOW_NS / 1e9 + 3, NOW_NS) == NOW_NS


def test_without_a_clock_a_frame_has_the_time_of_its_reception():
    clock = AdapterClock()
    assert clock.ns(0.0, NOW_NS) == NOW_NS
    assert "this PC's clock at reception" in clock.meaning


# what cannot be opened


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("can:pcam:x", "python-can has no interface 'pcam'; did you mean can:pcan:x?"),
        ("can:zzzzzz:x", "has no interface 'zzzzzz'; It has"),
        ("can:slcan:/dev/no-such-port", "could not open port /dev/no-such-port"),
        ("can:slcan", "give the channel, can:slcan:CHANNEL"),
        ("can:coulombus:nobody", "start one in another terminal with `coulombus emulate"),
        ("can:socketcand:x", "or the option: --bus-option KEY=VALUE"),
    ],
)
@pytest.mark.usefixtures("private_sockets")
def test_what_cannot_be_opened_says_what_to_do(text, said):
    with pytest.raises(BusUnavailable) as error:
        opened(text)
    assert said in str(error.value)
    assert error.value.exit_status == 4


@pytest.mark.parametrize(
    ("raised", "said"),
    [
        (can.CanInterfaceNotImplementedError("no module named usb"), "pip install 'python-can[gs-usb]', or its driver"),
        (ImportError("libpcanbasic.so"), "libpcanbasic.so; install what python-can's interface gs_usb needs"),
        (OSError(13, "Permission denied"), "may you open it"),
        (RuntimeError("Two\nlines."), "Two lines; is the channel right"),
        (KeyError(), "KeyError; is the channel right"),
    ],
)
def test_each_error_of_a_driver_is_one_sentence(monkeypatch, raised, said):
    def refuse(**_):
        raise raised

    monkeypatch.setattr(can, "Bus", refuse)
    with pytest.raises(BusUnavailable, match=r"^bus can:gs_usb:0 cannot be opened: [^\n]+$") as error:
        AdapterClient(parse_address("can:gs_usb:0", ("can",)))
    assert said in str(error.value)
