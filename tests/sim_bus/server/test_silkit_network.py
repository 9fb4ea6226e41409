"""The bus as the network simulator of SIL Kit: participants of this test's own, by ctypes and on loopback, against
`VirtualNetwork` with the same requests.
"""

from __future__ import annotations

import ctypes as ct
import random
import threading
from contextlib import contextmanager
from importlib.util import find_spec

import pytest

from coulombus.recording.extras import MissingExtra
from coulombus.sim_bus.can_bus.stations import attach, detach, restart
from coulombus.sim_bus.faults.fault_file import read_faults
from coulombus.sim_bus.faults.rows import install
from coulombus.sim_bus.network.network import TAP, VirtualNetwork
from coulombus.sim_bus.server import silkit_interface as c
from coulombus.sim_bus.server.silkit_interface import SilKit, SilKitError, SilKitFrame
from coulombus.sim_bus.server.silkit_network import SilKitNetwork
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, data_bytes
from node_bench import EDS

MS = 1_000_000
PATIENCE_S = 60.0
EXTENDED, REMOTE = SilKitFrame.EXTENDED, SilKitFrame.REMOTE
TRANSMITTED, CANCELED, QUEUE_FULL = 1, 2, 4
ACTIVE, PASSIVE, BUS_OFF = c.ErrorStateEvent.ACTIVE, c.ErrorStateEvent.PASSIVE, c.ErrorStateEvent.BUS_OFF


def needs_silkit(test):
    reason = "silkit-py is not installed: pip install -e '.[silkit]' (Python 3.12 or later)"
    skip = pytest.mark.skipif(find_spec("SilKit_py") is None, reason=reason)
    return skip(pytest.mark.real_time(pytest.mark.patient(test)))


class Required(ct.Structure):
    _fields_ = (("count", ct.c_size_t), ("names", ct.POINTER(ct.c_char_p)))


class Workflow(c.Head):
    KIND = 7, 3, 3
    _fields_ = (("required", ct.POINTER(Required)),)


def handler(event, action):
    return ct.CFUNCTYPE(None, ct.c_void_p, ct.c_void_p, ct.POINTER(event))(lambda _a, _b, e: action(e[0]))


class Participant:
    """One controller; `plan` has by step the calls that it makes: a frame to send, or a function's name
    and arguments."""

    def __init__(self, silkit, name, uri, plan, last_step=None):
        self.silkit, self.plan, self.last_step = silkit, plan, last_step
        self.frames, self.sent, self.states, self.error_states = [], [], [], []
        self.ended = threading.Event()
        self.participant = silkit.make("Participant_Create", configuration(silkit), name, uri)
        self.controller = silkit.make("CanController_Create", self.participant, b"can", b"CAN1")
        self.kept = []
        self.add("AddFrameHandler", c.FrameEvent, self.on_frame, ct.c_uint8(3))
        self.add("AddFrameTransmitHandler", c.TransmitEvent, self.on_sent, ct.c_int32(7))
        self.add("AddStateChangeHandler", c.StateEvent, lambda e: self.states.append((e.t_ns, e.state)))
        self.add("AddErrorStateChangeHandler", c.ErrorStateEvent, lambda e: self.error_states.append((e.t_ns, e.state)))
        life = self.life = silkit.make("LifecycleService_Create", self.participant, c.LifecycleConfiguration(10))
        clock = silkit.make("TimeSyncService_Create", life)
        self.kept += [c.STEP_HANDLER(self.on_step), c.HANDLER(lambda *_: self.ended.set())]
        silkit.call("TimeSyncService_SetSimulationStepHandler", clock, None, self.kept[-2], ct.c_uint64(MS))
        silkit.call("LifecycleService_SetShutdownHandler", life, None, self.kept[-1])
        silkit.call("LifecycleService_StartLifecycle", life)

    def add(self, name, event, action, *mask):
        self.kept.append(handler(event, action))
        number = ct.byref(ct.c_uint64())
        self.silkit.call(f"CanController_{name}", self.controller, None, self.kept[-1], *mask, number)

    def on_frame(self, event):
        frame = event.frame[0]
        data = ct.string_at(frame.data, frame.size) if frame.size else b""
        self.frames.append((event.t_ns, frame.can_id, frame.flags, frame.dlc, data))

    def on_sent(self, event):
        self.sent.append((event.t_ns, event.can_id, event.status, event.context))

    def on_step(self, _context, _service, now_ns, _duration):
        for call in self.plan.get(now_ns // MS, ()):
            if isinstance(call[0], str):
                self.silkit.call(f"CanController_{call[0]}", self.controller, *call[1:])
            else:
                can_id, flags, length, data, context = call
                buffer = ct.create_string_buffer(data, max(1, len(data)))
                frame = SilKitFrame(can_id, flags, length, 0, 0, 0, ct.addressof(buffer), len(data))
                self.silkit.call("CanController_SendFrame", self.controller, frame, ct.c_void_p(context))
        if now_ns // MS == self.last_step:
            self.silkit.call("LifecycleService_Stop", self.life, b"all steps are done")


def configuration(silkit):
    return silkit.make(
        "ParticipantConfiguration_FromString", b'{"Middleware": {"AcceptorUris": ["tcp://127.0.0.1:0"]}}'
    )


@contextmanager
def registry_on_loopback(silkit):
    uri = ct.c_char_p()
    registry = silkit.make("Vendor_Vector_SilKitRegistry_Create", configuration(silkit))
    try:
        listen = "Vendor_Vector_SilKitRegistry_StartListening"
        silkit.call(listen, registry, b"silkit://127.0.0.1:0", ct.byref(uri))
        yield uri
    finally:
        silkit.call("Vendor_Vector_SilKitRegistry_Destroy", registry)


def simulate(network, plan_a, plan_b, last_step):
    """Return participants A and B after a simulation on loopback, with the bus as a third participant."""
    silkit, made = SilKit(), []
    with registry_on_loopback(silkit) as uri:
        try:
            made.append(silkit.make("Participant_Create", configuration(silkit), b"Controller", uri))
            required = Required(3, (ct.c_char_p * 3)(b"A", b"B", b"Coulombus"))
            system = silkit.make("Experimental_SystemController_Create", made[0])
            set_workflow = "Experimental_SystemController_SetWorkflowConfiguration"
            silkit.call(set_workflow, system, Workflow(ct.pointer(required)))
            a, b = Participant(silkit, b"A", uri, plan_a, last_step), Participant(silkit, b"B", uri, plan_b)
            made += [a.participant, b.participant]
            SilKitNetwork(network, uri.value.decode()).run(PATIENCE_S)
            for participant in (a, b):
                assert participant.ended.wait(PATIENCE_S)
                silkit.call("LifecycleService_WaitForLifecycleToComplete", participant.life, ct.byref(ct.c_int16()))
        finally:
            for participant in made[::-1]:
                silkit.call("Participant_Destroy", participant)
    return a, b


def reference(prepare, **options):
    """Return frames as `Participant.frames`, and (ns, identifier, word) of the error frames, of a network that
    `prepare` gives its stations and requests.
    """
    frames, errors = [], []

    def keep(log):
        for t_ns, can_id, length, word, _ in log.tolist():
            if can_id & CAN_ERR_FLAG:
                errors.append((t_ns, can_id & 0xFFF, word))
                continue
            remote, extended = bool(can_id & CAN_RTR_FLAG), bool(can_id & CAN_EFF_FLAG)
            data = b"" if remote else data_bytes(word, length)
            frames.append((t_ns, can_id & 0x1FFFFFFF, extended * EXTENDED | remote * REMOTE, length, data))

    network = VirtualNetwork(on_frames=keep, **options)
    detach(network.bus[0], TAP)
    prepare(network)
    network.wait_ns(2_000 * MS)
    network.flush()
    return frames, errors


def request(station, call, t_ns):
    can_id, flags, length, data, _ = call
    full_id = can_id | (CAN_EFF_FLAG if flags & EXTENDED else 0) | (CAN_RTR_FLAG if flags & REMOTE else 0)
    station.send(full_id, data, at_ns=t_ns, length=length)


def random_requests(rng, parity, count):
    """Return by step up to eight frames of every kind, `count` in all; A's identifiers are even, B's odd."""
    plan, made = {0: [("Start",)]}, 0
    while made < count:
        calls = plan.setdefault(len(plan) if made else 0, [])
        for _ in range(min(rng.randrange(9), count - made)):
            made += 1
            extended, remote, length = rng.random() < 0.2, rng.random() < 0.1, rng.randrange(9)
            can_id = rng.randrange(0, 1 << (29 if extended else 11), 2) | parity
            data = b"" if remote else rng.randbytes(length)
            calls.append((can_id, extended * EXTENDED | remote * REMOTE, length, data, made))
    return plan


@pytest.mark.slow
@needs_silkit
def test_order_and_stamps_of_10000_frames_are_the_networks():
    rng = random.Random(4)
    plans = [random_requests(rng, parity, 5_000) for parity in (0, 1)]
    last_step = max(map(len, plans)) + 100

    def prepare(network):
        stations = [network.station(()), network.station(())]
        for k in range(last_step):
            for station, plan in zip(stations, plans, strict=True):
                for call in plan.get(k, ()):
                    if call != ("Start",):
                        network.at(k * MS, lambda n, s=station, c=call: request(s, c, n.t_ns))

    a, b = simulate(VirtualNetwork(1_000_000), *plans, last_step)
    frames, errors = reference(prepare, bitrate_bit_s=1_000_000)
    assert len(frames) == 10_000
    assert not errors
    assert a.frames == frames
    assert b.frames == frames
    for participant, parity in ((a, 0), (b, 1)):
        own = [(t_ns, can_id, TRANSMITTED) for t_ns, can_id, *_ in frames if can_id % 2 == parity]
        assert [row[:3] for row in participant.sent] == own
        assert sorted(context for *_, context in participant.sent) == list(range(1, 5_001))


FLIPS = """
[[fault]]
kind = "flip"
on = {can_id = 0x2A0, every = 1}
most = 0
bit = 40
"""


@needs_silkit
def test_missing_acknowledge_error_passive_bus_off_and_restart_are_the_networks(tmp_path):
    """A is alone until step 40: nobody acknowledges. From step 60 on its frames 2A0h have a wrong bit; at step 90 it
    starts again.
    """
    first, wrong, last = (0x100, 0, 2, b"\1\2", 1), (0x2A0, 0, 8, bytes(8), 2), (0x101, 0, 0, b"", 3)
    plan_a = {0: [("Start",), first], 60: [wrong] * 30, 80: [last], 90: [("Start",)], 95: [last]}
    (tmp_path / "flips.toml").write_text(FLIPS)

    def disturbed(network):
        install(network.bus[0], read_faults(tmp_path / "flips.toml"), 0, {}, {})
        return network

    def prepare(network):
        disturbed(network)
        a, b = network.station(()), network.station(())
        network.bus[0]["stations"]["restart_ns"] = -1
        detach(network.bus[0], b.number)
        for k, call in ((0, first), *[(60, wrong)] * 30, (95, last)):
            network.at(k * MS, lambda n, c=call: request(a, c, n.t_ns))
        network.at(40 * MS - 1, lambda n: attach(n.bus[0], b.number))
        network.at(90 * MS - 1, lambda n: restart(n.bus[0], a.number, 90 * MS))

    a, b = simulate(disturbed(VirtualNetwork(500_000)), plan_a, {40: [("Start",)]}, 150)
    frames, errors = reference(prepare, bitrate_bit_s=500_000)
    assert a.frames == b.frames == frames
    assert {row[1] for row in frames} == {0x100, 0x2A0, 0x101}
    states = [
        (t, PASSIVE if word >> 8 & 0x30 else BUS_OFF if i & 0x40 else ACTIVE) for t, i, word in errors if i & 0x44
    ]
    changes = [row for row, before in zip(states, [(0, ACTIVE), *states], strict=False) if row[1] != before[1]]
    assert [state for _, state in changes] == [PASSIVE, ACTIVE, PASSIVE, BUS_OFF, ACTIVE]
    assert a.error_states == [(0, ACTIVE), *changes]
    assert b.error_states == [(40 * MS, ACTIVE)]
    off_ns = changes[3][0]
    passed, given_up = [[row for row in a.sent if row[2] == status] for status in (TRANSMITTED, CANCELED)]
    assert [row[:2] for row in passed] == [row[:2] for row in frames]
    assert given_up == [(off_ns, 0x2A0, CANCELED, 2)] * (32 - len(passed)) + [(80 * MS, 0x101, CANCELED, 3)]


@needs_silkit
def test_a_device_of_the_bus_answers_and_a_controller_of_another_bit_rate_is_off():
    network = VirtualNetwork(500_000)
    network.add(EDS / "motor.eds", 5)
    network.power_on()
    upload = (0x605, 0, 8, bytes.fromhex("4018100100000000"), 1)
    fd, remote = (0x10, 1 << 12, 8, bytes(8), 2), (0x11, REMOTE, 3, b"", 3)
    plan_a = {
        1: [("SetBaudRate", 500_000, 0, 0), ("Start",)],
        2: [upload, fd, remote],
        10: [(0x20, 0, 0, b"", 5)] * 520,
    }
    plan_b = {1: [("SetBaudRate", 250_000, 0, 0), ("Start",)], 2: [(0x12, 0, 0, b"", 4)]}
    a, b = simulate(network, plan_a, plan_b, 20)
    assert [(can_id, flags, dlc) for _, can_id, flags, dlc, _ in a.frames[:4]] == [
        (0x705, 0, 1),
        (0x11, REMOTE, 3),
        (0x605, 0, 8),
        (0x585, 0, 8),
    ]
    assert a.frames[3][-1].startswith(bytes.fromhex("43181001"))
    assert [row[1:] for row in a.sent[:3]] == [(0x10, CANCELED, 2), (0x11, TRANSMITTED, 3), (0x605, TRANSMITTED, 1)]
    assert [row for row in a.sent if row[2] == QUEUE_FULL] == [(10 * MS, 0x20, QUEUE_FULL, 5)] * 8
    assert a.states == b.states == [(MS, c.StateEvent.STARTED)]
    assert b.frames == []
    assert b.sent == [(2 * MS, 0x12, CANCELED, 4)]


@needs_silkit
def test_without_the_others_and_without_a_registry_it_ends():
    with (
        registry_on_loopback(SilKit()) as uri,
        pytest.raises(SilKitError, match=r"no step of the simulation for 0.2 s"),
    ):
        SilKitNetwork(VirtualNetwork(), uri.value.decode()).run(0.2)
    with pytest.raises(SilKitError, match=r"silkit://127\.0\.0\.1:\d+: SilKit_Participant_Create returned"):
        SilKitNetwork(VirtualNetwork(), uri.value.decode()).run(PATIENCE_S)


def test_a_missing_or_foreign_library_and_a_bus_without_bit_times_are_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(c, "find_spec", lambda _: None)
    with pytest.raises(MissingExtra, match=r"pip install '\.\[silkit\]'"):
        SilKit()
    (tmp_path / "lib.so").write_bytes(b"no library")
    with pytest.raises(SilKitError, match=r"lib.so.*expected SIL Kit 4\.0\.55 or later"):
        SilKit(tmp_path / "lib.so")
    for network, step_ns in ((VirtualNetwork(0), 1), (VirtualNetwork(), 0), (VirtualNetwork([500_000, 500_000]), 1)):
        with pytest.raises(ValueError, match="expected step_ns of 1 or more"):
            SilKitNetwork(network, "silkit://127.0.0.1:1", step_ns=step_ns)
