"""Who asks a host for other parameters: at its door, by the verb, with and without the arm key."""

from __future__ import annotations

import json
import socket
import threading

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.parameter_changes import LiveParameters
from coulombus.host.run.changes import LOCK_NS, LONGEST_NS, TRIES, WINDOW_NS, ArmKey, Changes, new_arm_key
from coulombus.host.run.control_socket import HostSocket, NotChanged, StopRequest, ask_change, control_path
from coulombus.rigs.rig import load_rig
from coulombus.wire.address import parse_address

pytestmark = pytest.mark.usefixtures("private_sockets")

BUS = parse_address("coulombus:x")


class Host:
    """A host's door in a thread of its own; its step takes each order at once, unless it is slow."""

    def __init__(self, arm_key="", rig="bench", slow=0, why_not=None):
        self.k = Controllers(load_rig(rig), "hybrid")
        self.applied, self.slow, self.why_not = [], slow, why_not
        self.changes = Changes(LiveParameters(self.k), arm_key, self._apply, lambda: self.why_not)
        self.asked, self.now_ns = 0, 0

    def _apply(self, change):
        self.applied.append(change.marker.partition(" [")[0])
        self.late = change

    def _take(self):
        live = self.k.axes["live"]
        live["wanted"][self.late.index] = live["taken"][self.late.index] = self.late.number

    def _change(self, text):
        self.asked += 1
        answer = self.changes.answer(text, self.now_ns)
        if "marker" in answer and not self.slow:
            self._take()
        if "again" in answer:
            self.slow -= 1
            if not self.slow:
                self._take()
        return json.dumps(answer).encode()

    def __enter__(self):
        self.door, self.over, self.stops = HostSocket(BUS), threading.Event(), 0
        self.door.change = self._change
        self.thread = threading.Thread(target=self._serve)
        self.thread.start()
        return self

    def _serve(self):
        while not self.over.is_set():
            self.stops += self.door.stop_wanted()

    def __exit__(self, *_):
        self.over.set()
        self.thread.join()
        self.door.close({"trip": None})


def call(words):
    return CliRunner().invoke(main, ["set", *words.split(), "--bus", str(BUS)])


def test_a_value_is_set_by_the_verb_and_told():
    with Host() as host:
        done = call("F_s=2.0 F_d=1.5 --over 200ms")
        assert (done.exit_code, done.output) == (0, "set F_s_Nm 3.5 -> 2 Nm, F_d_Nm 3 -> 1.5 Nm in 0.6 s\n")
        done = call("--undo --json")
    told = json.loads(done.stdout)
    assert [(one["name"], one["old"], one["new"]) for one in told["changes"]] == [
        ("F_s_Nm", 2.0, 3.5),
        ("F_d_Nm", 1.5, 3.0),
    ]
    assert (told["undo"], told["over_s"], len(host.applied)) == (True, 0.5, 2)


def test_without_a_value_the_parameters_are_listed():
    with Host(arm_key="123456") as host:
        done, told = call(""), json.loads(call("--json").stdout)
    assert done.exit_code == 0
    rows = [line.split() for line in done.output.splitlines()]
    assert rows[0] == ["parameter", "value", "from", "to", "unit"]
    assert rows[1] == ["K_p_Nm_rad", "10000", "above", "0", "1e+07", "Nm/rad"]
    assert rows[2][:3] == ["F_s_Nm", "3.5", "0"]
    assert "--key" in done.output
    assert told["arm_key"] is True
    assert told["parameters"][0][1]["high"] == float(rows[2][3])
    assert not host.applied


def test_the_axes_of_a_rig_are_told_apart():
    with Host(rig="two_axes") as host:
        listed = call("").output
        assert "left.F_s_Nm" in listed
        assert "right.F_s_Nm" in listed
        missing, right = call("F_d=1.0"), call("F_d=1.0 --axis right")
    assert missing.exit_code == 2
    assert "expected one of left, right" in missing.output
    assert right.exit_code == 0
    assert host.applied == ["set right.F_d_Nm 2.2 -> 1 Nm in 0.5 s"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("F_s=400", "limits.brake_torque_Nm ends there"),
        ("F_d=3.6", "expected F_d_Nm at most F_s_Nm"),
        ("F_x=1", "no parameter of this name"),
        ("F_s=2.0 --over 1ms", "expected 0.1 to 60 s"),
        ("F_s=2.0 --over soon", "as in 0.5s or 500ms"),
        ("F_s", "expected NAME=VALUE, as in F_s=2.0"),
        ("F_s=much", "expected NAME=VALUE, as in F_s=2.0"),
        ("F_s=1 F_s=2", "F_s is given twice"),
        ("F_s=1 --undo", "leave the values out"),
        ("--undo", "there is no change to undo"),
        ("F_s=2.0 --axis y", "the rig has no named axes"),
    ],
)
def test_what_is_refused_is_a_usage_error_with_the_reason(words, told):
    with Host() as host:
        done = call(words)
    assert done.exit_code == 2
    assert told in " ".join(done.output.split())
    assert not host.applied


def test_a_host_that_ends_changes_nothing():
    with Host(why_not="the host ends: it is in its safe state"), pytest.raises(NotChanged, match="in its safe state"):
        ask_change(BUS, {"values": {"F_s": 2.0}})


def test_where_a_hand_may_be_on_the_handle_a_change_needs_the_arm_key():
    with Host(arm_key="004711") as host:
        for words, told in (("", "needs the arm key"), (" --key 4711", "the arm key is wrong"), (" --key é", "wrong")):
            done = call("F_s=3.2" + words)
            assert done.exit_code == 2
            assert told in " ".join(done.output.split())
        assert not host.applied
        assert call("F_s=3.2 --key 004711").exit_code == 0
        assert call("--undo").exit_code == 2
        assert call("--undo --key 004711").exit_code == 0


def test_only_a_rig_that_moves_somebody_has_an_arm_key():
    assert new_arm_key(BUS) == ""
    assert len(new_arm_key(parse_address("socketcan:can0"))) == 6


def tries(key, count, now_ns):
    return [key.why_not(f"{k:06d}", now_ns) for k in range(count)]


def test_the_arm_key_has_a_limit_of_tries_and_then_the_right_one_is_refused_too():
    key = ArmKey("004711")
    told = tries(key, TRIES, 7)
    assert all("is wrong" in text for text in told)
    assert "none is taken for 60 s" in told[-1]
    assert "none" not in "".join(told[:-1])
    assert key.why_not("004711", 7 + LOCK_NS // 2) == (
        "too many wrong arm keys: none is taken for another 30 s, the right one neither"
    )
    assert "another 1 s" in key.why_not("", 6 + LOCK_NS)
    assert key.why_not("004711", 7 + LOCK_NS) is None


def test_a_lock_of_the_arm_key_is_twice_as_long_as_the_one_before_until_it_is_right():
    key, now_ns, locked = ArmKey("004711"), 0, []
    for _ in range(8):
        tries(key, TRIES, now_ns)
        locked.append(next(k for k in range(1, 400) if key.why_not("", now_ns + k * LOCK_NS).startswith("a hand")))
        now_ns += locked[-1] * LOCK_NS
    assert locked == [1, 2, 4, 8, 16, 32, 60, LONGEST_NS // LOCK_NS]
    assert key.why_not("004711", now_ns) is None
    assert "for 60 s" in tries(key, TRIES, now_ns)[-1]


def test_wrong_arm_keys_that_lie_long_apart_lock_nothing():
    key = ArmKey("004711")
    for k in range(20):
        assert "none is taken" not in key.why_not("1", k * (WINDOW_NS // (TRIES - 1) + 1))
    assert all(text.startswith("a hand") for text in [key.why_not("", 0)] * 20)  # no key given is no try
    tries(key, TRIES - 1, 20 * WINDOW_NS)
    assert key.why_not("004711", 20 * WINDOW_NS) is None  # and begins anew
    assert "none is taken" not in tries(key, TRIES - 1, 20 * WINDOW_NS)[-1]
    assert "none is taken" in tries(key, TRIES, 22 * WINDOW_NS)[-1]  # the old ones hold no lock up


def test_the_tries_of_all_who_come_to_the_socket_count_together():
    with Host(arm_key="004711") as host:
        for k in range(TRIES):
            assert "the arm key is wrong" in " ".join(call(f"F_s=3.2 --key {k}").output.split())
        host.now_ns = LOCK_NS - 1
        done = call("F_s=3.2 --key 004711")
        assert (done.exit_code, host.applied) == (2, [])
        assert "for another 1 s" in " ".join(done.output.split())
        host.now_ns = LOCK_NS
        assert call("F_s=3.2 --key 004711").exit_code == 0


def test_a_change_that_comes_before_the_last_was_taken_is_asked_again():
    with Host(slow=3) as host:
        assert call("F_s=3.2").exit_code == 0
        assert call("F_d=1.0").exit_code == 0
        assert host.asked == 5  # the second was put off three times
    assert host.applied[1] == "set F_d_Nm 3 -> 1 Nm in 0.8 s"


@pytest.mark.parametrize(
    "text",
    [
        "nonsense",
        "[]",
        "[" * 30000,
        '{"value": 1}',
        '{"values": 1}',
        '{"values": {"F_s": "2"}}',
        '{"values": {"F_s": true}}',
        '{"values": {"F_s": NaN}}',
        '{"values": {"F_s": 1e999}}',
        '{"values": {"F_s": 1' + "0" * 400 + "}}",
        '{"values": {"F_s": 2}, "over_s": null}',
        '{"values": {"F_s": 2}, "axis": 3}',
        '{"values": {"F_s": 2}, "key": null}',
        '{"undo": 1}',
        '{"undo": true, "values": {"F_s": 2}}',
    ],
)
def test_nonsense_is_refused_and_changes_nothing(text):
    host = Host()
    answer = host.changes.answer(text, 0)
    assert answer["error"].startswith("expected ")
    assert not host.applied


def test_refusals_do_not_hold_up_a_stop():
    """They are answered, and a stop that comes behind them is heard at the same look."""
    door = HostSocket(BUS)
    host = Host()
    door.change = lambda text: json.dumps(host.changes.answer(text, 0)).encode()
    askers = []
    for _ in range(7):
        one = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        one.connect(str(control_path(BUS)))
        one.send(b'set {"values": {"F_s": 400}}')
        askers.append(one)
    request = StopRequest(BUS)
    assert door.stop_wanted()
    door.close({"trip": None, "cycles": 1, "mode": "hybrid"})
    assert request.result()["cycles"] == 1
    for one in askers:
        assert b"ends there" in one.recv(1 << 16)
        one.close()
