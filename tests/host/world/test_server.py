"""Programs at a display: the server, the client, and what comes between them."""

import asyncio
import math
import os
import random
import socket
import time

import numpy as np
import pytest

from coulombus.host.world import hand as hand_module
from coulombus.host.world.hand import Hand, NoWorld, connect, world_path
from coulombus.host.world.model_check import ModelRefused, why_not
from coulombus.host.world.model_parts import Model, Spring, TorqueProfile, Wall
from coulombus.host.world.protocol import (
    SIZES,
    VERSION,
    Greeting,
    Kind,
    read_named,
    read_refusal,
    read_welcome,
    records_in,
)
from coulombus.host.world.records import MODEL, STATE
from coulombus.host.world.server import CLIENTS, MOST_BACKLOG
from coulombus.wire.address import parse_address
from world_bench import BUS, LIFE_NS, PATIENCE_S, Bench

pytestmark = pytest.mark.usefixtures("private_sockets")


class Raw:
    """A program that writes bytes of its own."""

    def __init__(self, greeting=None):
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.socket.connect(str(world_path(BUS)))  # without a timeout it waits while too many do
        self.socket.settimeout(PATIENCE_S)
        self.data = bytearray()
        if greeting is not None:
            self.socket.sendall(greeting.record())

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def record(self):
        """Return the next record; None: the server has disconnected."""
        while True:
            records = records_in(self.data, 1)
            if records:
                return records[0]
            try:
                data = self.socket.recv(1 << 16)
            except ConnectionResetError:
                return None
            if not data:
                return None
            self.data += data

    def refusal(self):
        """Return the next refusal's reason."""
        while (entry := self.record()) is not None:
            if entry[0] == Kind.REFUSED:
                return read_refusal(entry[1]).reason
        return None


def wall(number, **values):
    record = Model(wall=Wall(0.0, 2.0)).record({})
    record["sequence"] = number
    for name, value in values.items():
        record[name] = value
    return record.tobytes()


def test_a_program_is_told_the_parameters_and_then_each_state():
    with Bench() as bench, Raw(Greeting()) as program:
        kinds = [program.record() for _ in range(3)]
        assert read_welcome(kinds[0][1]) == bench.display.welcome()
        assert [read_named(record) for _, record in kinds[1:]] == list(bench.display.parameters())
        bench.cycle(3)
        for sequence in (1, 2, 3):
            kind, record = program.record()
            state = np.frombuffer(record, STATE)[0]
            assert (kind, state["sequence"], state["x_rad"], state["lost"]) == (Kind.STATE, sequence, sequence / 2, 0)


def test_a_program_that_wants_no_states_gets_none():
    with Bench() as bench, Raw(Greeting(flags=0)) as program:
        for _ in range(3):
            program.record()
        bench.cycle(3)
        program.socket.sendall(wall(0))
        assert program.refusal() == "sequence is 0: expected more than 0"


def test_a_model_reaches_the_display():
    with Bench() as bench, Raw(Greeting()) as program:
        program.socket.sendall(wall(5, t_ns=0) + wall(6, t_ns=time.monotonic_ns()))
        bench.until(lambda: len(bench.display.models) == 2)
        first, second = bench.display.models
        assert (first["sequence"], first["wall_K_Nm_rad"], first["life_ns"]) == (5, 2.0, 100_000_000)
        assert second["life_ns"] < 100_000_000  # less the time on its way
        assert bench.server.controlled


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"wall_K_Nm_rad": math.nan}, "wall_K_Nm_rad is nan"),
        ({"wall_x_rad": math.inf}, "wall_x_rad is inf"),
        ({"life_ns": 2 * LIFE_NS}, "longest_life_s"),
        ({"t_ns": 1}, "late: it was sent"),
        ({"t_ns": 1 << 62}, "expected CLOCK_MONOTONIC"),
        ({"sequence": -1}, "sequence is -1"),
    ],
)
def test_a_model_that_is_not_plausible_is_refused_with_its_reason(values, reason):
    with Bench() as bench, Raw(Greeting()) as program:
        program.socket.sendall(wall(1, **values))
        assert reason in program.refusal()
        assert bench.display.models == []
        program.socket.sendall(wall(2))
        bench.until(lambda: bench.display.models)


def test_one_program_has_control_until_it_leaves():
    with Bench() as bench:
        with Raw(Greeting()) as first, Raw(Greeting()) as second:
            first.socket.sendall(wall(1))
            bench.until(lambda: bench.server.controlled)
            second.socket.sendall(wall(1))
            assert second.refusal() == "another program has control"
            first.socket.close()
            bench.until(lambda: not bench.server.controlled)
            second.socket.sendall(wall(2))
            bench.until(lambda: len(bench.display.models) == 2)
        bench.until(lambda: not bench.server.controlled)


def test_a_profile_of_another_program_is_another_profile():
    click = Model(profile=TorqueProfile((1.0,))).record({}, profile=1)
    click["sequence"] = 1
    with Bench() as bench:
        for count in (1, 2):
            with Raw(Greeting()) as program:
                program.socket.sendall(click.tobytes())
                bench.until(lambda count=count: len(bench.display.models) == count)
            bench.until(lambda: not bench.server.controlled)
        assert len({int(model["profile"]) for model in bench.display.models}) == 2


def test_on_a_real_rig_a_model_needs_the_key_and_a_reader_none():
    with Bench(key="123456") as bench, Raw(Greeting(key="123457")) as wrong, Raw(Greeting(key="123456")) as right:
        wrong.socket.sendall(wall(1))
        assert wrong.refusal() == "the arm key is wrong"
        bench.cycle()
        assert wrong.record()[0] == Kind.STATE
        right.socket.sendall(wall(1))
        bench.until(lambda: bench.display.models)


@pytest.mark.parametrize(
    "data",
    [
        b"\0" * 64,
        b"GET / HTTP/1.1\r\n\r\n" * 8,
        wall(1),
        Greeting(magic=b"COULWRLX").record(),
        Greeting(version=VERSION + 1).record(),
        Greeting().record() + b"\xff" * 8,
        Greeting().record() + Greeting().record(),
    ],
)
def test_a_program_of_another_protocol_is_disconnected_with_the_reason(data):
    with Bench(), Raw() as program:
        program.socket.sendall(data)
        assert program.refusal()
        assert program.record() is None


def test_a_slow_reader_is_told_what_it_lost_and_slows_nobody():
    with Bench() as bench, Raw(Greeting()) as slow, Raw(Greeting()) as quick:
        for program in (slow, quick):
            assert [program.record()[0] for _ in range(3)] == [Kind.WELCOME, Kind.PARAMETER, Kind.PARAMETER]
        count = 3 * MOST_BACKLOG // SIZES[Kind.STATE]
        for _ in range(count):
            bench.cycle()
            assert np.frombuffer(quick.record()[1], STATE)["lost"] == 0
        seen = []
        while not seen or seen[-1][0] < bench.sequence:
            if len(seen) == 1000:  # there is room again
                bench.cycle()
            state = np.frombuffer(slow.record()[1], STATE)[0]
            seen.append((int(state["sequence"]), int(state["lost"])))
        numbers = [sequence for sequence, _ in seen]
        assert numbers == sorted(set(numbers))
        assert seen[0] == (1, 0)
        sequence, lost = seen[-1]
        assert lost == sequence - len(seen) > 0


def test_states_that_the_queue_dropped_count_as_lost_of_everybody():
    with Bench() as bench, Raw(Greeting()) as program:
        for _ in range(3):
            program.record()
        bench.cycle()
        bench.cycle(skipped=4)
        states = [np.frombuffer(program.record()[1], STATE)[0] for _ in range(2)]
        assert [(int(state["sequence"]), int(state["lost"])) for state in states] == [(1, 0), (6, 4)]


def test_more_programs_than_there_is_room_for_are_sent_away():
    programs = []
    with Bench():
        for _ in range(CLIENTS):
            programs.append(Raw(Greeting()))
            assert programs[-1].record()[0] == Kind.WELCOME
        with Raw() as surplus:
            assert "programs are connected" in surplus.refusal()
        for program in programs:
            program.socket.close()


def test_rubbish_of_every_kind_neither_ends_the_server_nor_reaches_the_display():
    rng = random.Random(7)
    valid = wall(1)
    with Bench() as bench:
        for round_number in range(150):
            with Raw(Greeting()) as program:
                for sequence in range(1, 20):
                    data = bytearray(wall(sequence) if round_number % 3 else rng.randbytes(len(valid)))
                    if round_number % 3 == 1:
                        data[rng.randrange(8, len(data))] = rng.randrange(256)
                    elif round_number % 3 == 2:
                        data = data[: rng.randrange(len(data))]
                    try:
                        program.socket.sendall(data)
                    except OSError:
                        break
        with Raw(Greeting()) as last:
            assert last.record()[0] == Kind.WELCOME
        for model in bench.display.models:
            assert why_not(model, 1, LIFE_NS) is None


def test_the_data_planes_end_and_the_servers_end_are_the_programs_end():
    bench = Bench()
    with Raw(Greeting()) as program:
        for _ in range(3):
            program.record()
        bench.sender.close()
        program.socket.sendall(wall(1))
        bench.until(lambda: bench.display.models)  # the server lives on
        bench.server.close()
        bench.server.close()
        assert program.record() is None
        assert not world_path(BUS).exists()
    bench.states.close()


# the client


def read_on(hand, *parts, **values):
    """Render, and read states until something is raised."""
    hand.render(*parts, **values)
    while True:
        _ = hand.state


def test_the_hand_reads_the_newest_state_or_each():
    with Bench() as bench, connect("coulombus:x") as hand:
        assert (hand.welcome.period_ns, hand.parameters[0].name) == (1_000_000, "F_s_Nm")
        bench.cycle(3)
        assert [hand.next().sequence for _ in range(3)] == [1, 2, 3]
        bench.cycle(5)
        while hand.state.sequence < 8:
            os.sched_yield()
        bench.cycle(2)
        assert hand.next().sequence == 9
        bench.server.close()
        assert [state.sequence for state in hand] == [10]
        with pytest.raises(NoWorld, match="ended"):
            _ = hand.state


def test_the_hand_reads_in_coroutines():
    async def read(hand):
        return [state.sequence async for state in hand]

    with Bench() as bench, connect("x") as hand:
        bench.cycle(4)
        assert asyncio.run(hand.anext()).sequence == 1
        bench.until(lambda: hand.state.sequence == 4)
        bench.cycle(2)
        bench.server.close()
        assert asyncio.run(read(hand)) in ([5, 6], [5], [])  # what was on its way when the server ended


def test_what_the_hand_says_reaches_the_display():
    with Bench() as bench, connect("coulombus:x") as hand:
        assert hand.render(Wall(0.25, 2.0), law=0.5) == 1
        assert hand.set(F_s_Nm=1.5) == 2
        assert hand.render(Spring(0.0, 1.0)) == 3
        assert hand.render(Model(life_s=0.05)) == 4
        bench.until(lambda: len(bench.display.models) == 4)
        rows = [
            (m["parts"], m["law"], m["wall_K_Nm_rad"], m["parameter"][1], m["life_ns"] > 50_000_000)
            for m in bench.display.models
        ]
        assert rows == [
            (1, 0.5, 2.0, 0.0, True),
            (17, 0.5, 2.0, 1.5, True),
            (18, 0.5, 0.0, 1.5, True),
            (0, 1.0, 0.0, 0.0, False),
        ]


def test_a_profile_is_played_again_only_as_another_object():
    click = TorqueProfile((1.0, -1.0))
    with Bench() as bench, connect("coulombus:x") as hand:
        for part in (click, click, TorqueProfile((1.0, -1.0))):
            hand.render(part)
        bench.until(lambda: len(bench.display.models) == 3)
        first, again, other = (int(model["profile"]) for model in bench.display.models)
        assert (first == again, first == other) == (True, False)


def test_the_model_is_renewed_while_the_program_reads_and_not_longer():
    with Bench() as bench, connect("coulombus:x") as hand:
        hand.render(Wall(0.0, 2.0), life_s=0.01)
        bench.cycle()
        deadline = time.monotonic() + PATIENCE_S
        while len(bench.display.models) < 5 and time.monotonic() < deadline:
            _ = hand.state
        renewed = bench.display.models
        numbers = [int(model["sequence"]) for model in renewed]
        assert numbers == sorted(set(numbers))
        assert {float(model["wall_K_Nm_rad"]) for model in renewed} == {2.0}


def test_a_refusal_is_raised_and_the_model_is_not_sent_again():
    with Bench() as bench, connect("coulombus:x") as hand:
        bench.cycle()
        with pytest.raises(ModelRefused, match="model 1: life_ns is"):
            read_on(hand, Wall(0.0, 2.0), life_s=3.0)
        for _ in range(100):
            _ = hand.state
        assert bench.display.models == []


def test_a_model_that_comes_at_a_bad_moment_is_counted_and_sent_again():
    with Bench() as bench, connect("coulombus:x") as hand:
        bench.display.busy = "the display does not run yet"
        hand.render(Wall(0.0, 2.0), life_s=0.01)
        bench.cycle()
        while not hand.missed:
            _ = hand.state
        bench.display.busy = None
        while not bench.display.models:
            _ = hand.state


def test_without_a_host_the_reason_is_told():
    with pytest.raises(NoWorld, match="run --world"):
        connect("coulombus:x")


def test_a_host_that_refuses_the_connection_is_told_with_its_reason():
    with Bench():
        raw = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        raw.connect(str(world_path(BUS)))
        raw.sendall(Greeting(version=9).record())
        with pytest.raises(NoWorld, match="version 9"):
            Hand(raw, PATIENCE_S)
        raw.close()


def full_listener():
    """Return a socket at the world's path whose queue of programs is full, and those programs."""
    path = world_path(parse_address("coulombus:full"))
    path.parent.mkdir(parents=True, exist_ok=True)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.bind(str(path))
    listener.listen(0)
    waiting = []
    while True:
        program = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        program.setblocking(False)
        waiting.append(program)
        try:
            program.connect(str(path))
        except BlockingIOError:
            return listener, waiting


def test_a_program_waits_while_too_many_wait_before_it(monkeypatch):
    listener, waiting = full_listener()
    accepted = []
    monkeypatch.setattr(hand_module.time, "sleep", lambda pause_s: accepted.append(listener.accept()[0]))
    with pytest.raises(NoWorld) as error:  # it was let in, and got no answer
        connect("coulombus:full", timeout_s=0.2)
    assert len(accepted) == 1
    assert "too many programs" not in str(error.value)
    monkeypatch.setattr(hand_module.time, "sleep", lambda pause_s: None)
    with pytest.raises(NoWorld, match="full: it lets nobody in: it hangs, or too many programs wait"):
        connect("coulombus:full", timeout_s=0.01)
    for one in (listener, *waiting, *accepted):
        one.close()


def test_the_records_have_the_documented_sizes():
    assert {kind.name: SIZES[kind] for kind in Kind} == {
        "HELLO": 64,
        "MODEL": 776,
        "WELCOME": 64,
        "PARAMETER": 88,
        "STATE": 224,
        "REFUSED": 256,
    }
    assert MODEL.itemsize == 776
