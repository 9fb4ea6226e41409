import io
import struct
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from coulombus.monitor import pdo_text
from coulombus.monitor.live import Live
from coulombus.monitor.screen import CHANGED, Screen, as_dict, as_lines
from coulombus.monitor.snapshot import HostLine
from coulombus.monitor.watch import ViewKeys, _Asker
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.rigs.rig import load_rig
from coulombus.wire.bits import worst_case_bits
from host_bench import VELOCITY

S = 1_000_000_000
T0 = 1_700_000_000 * S
FACTS = {"bus": "coulombus:bench", "bitrate_bit_s": 1_000_000, "lost": 0, "malformed": 0}


@pytest.fixture(scope="module")
def rig():
    return load_rig("bench", VELOCITY)


def frame(t_s, can_id, data=b""):
    return (T0 + round(t_s * S), can_id, len(data), data.ljust(8, b"\0"))


def tpdo1(t_s, statusword, position=0, torque=0):
    return frame(t_s, 0x181, struct.pack("<Hih", statusword, position, torque))


def texts(snapshot):
    return [event.text for event in snapshot.events]


def test_values_in_si_units_rates_and_ages(rig):
    live = Live(KnownBus(rig))
    live.snapshot(T0)
    for i in range(1000):
        live.add_frames([frame(i / 1000, 0x80), tpdo1(i / 1000, 0x0237, -819200, 100)])
    live.add_frames([frame(0.5, 0x202, struct.pack("<h", 1500))])
    snapshot = live.snapshot(T0 + S)
    rows = {row.name: row for row in snapshot.pdos}
    signals = as_dict(snapshot, FACTS, T0)["signals"]
    assert signals["motor.statusword"] == 0x0237
    assert signals["motor.position_rad"] == pytest.approx(-100 * 2 * 3.141592653589793 / 9.587)
    assert signals["motor.torque_Nm"] == pytest.approx(0.1 * 0.18 * 9.587)
    assert signals["motor.velocity_rad_s"] is None
    assert rows["motor.TPDO1"].rate_per_s == pytest.approx(1000)
    assert rows["motor.TPDO1"].age_s == pytest.approx(0.001)
    assert rows["brake.RPDO1"].age_s == pytest.approx(0.5)
    assert rows["motor.TPDO2"].age_s is None
    assert snapshot.sync_per_s == pytest.approx(1000)
    assert snapshot.frames == 2001


def test_rate_is_of_the_last_second(rig):
    live = Live(KnownBus(rig))
    for tenth in range(30):
        live.add_frames([frame(tenth / 10, 0x80)] * (100 if tenth < 10 else 10))
        snapshot = live.snapshot(T0 + tenth * S // 10)
    assert snapshot.sync_per_s == pytest.approx(100)


def test_states_of_the_drive_as_they_change(rig):
    live = Live(KnownBus(rig))
    live.add_frames([tpdo1(0, 0x0250), tpdo1(0.1, 0x0231), tpdo1(0.2, 0x0237), tpdo1(0.3, 0x0218)])
    snapshot = live.snapshot(T0 + S)
    assert texts(snapshot) == [
        "motor: switch on disabled -> ready to switch on",
        "motor: ready to switch on -> operation enabled",
        "motor: operation enabled -> fault",
    ]
    assert [event.grave for event in snapshot.events] == [False, False, True]
    assert snapshot.nodes[0].power_state == "fault"
    assert live.snapshot(T0 + S).events == ()


def test_heartbeats_boot_up_and_silence(rig):
    live = Live(KnownBus(rig))
    live.add_frames([frame(0, 0x701, b"\0"), frame(0.01, 0x701, b"\x7f"), frame(0.06, 0x701, b"\x05")])
    live.add_frames([frame(0.06, 0x77F, b"\x05")])
    snapshot = live.snapshot(T0 + S // 10)
    motor, brake, host = snapshot.nodes
    assert (motor.state, brake.state, host.state) == ("operational", None, "operational")
    assert motor.age_s == pytest.approx(0.04)
    assert texts(snapshot) == [
        "motor: boot-up", "motor: boot-up -> pre-operational", "motor: pre-operational -> operational",
    ]  # fmt: skip
    snapshot = live.snapshot(T0 + S)
    assert texts(snapshot) == ["motor: no heartbeat for 0.15 s", "host: no heartbeat for 0.15 s"]
    assert [node.silent for node in snapshot.nodes] == [True, False, True]
    assert texts(live.snapshot(T0 + 2 * S)) == []
    live.add_frames([frame(2.1, 0x701, b"\x7f")])
    assert texts(live.snapshot(T0 + int(2.1 * S))) == ["motor: heard again, pre-operational"]


def test_sync_that_stops_and_comes_back(rig):
    live = Live(KnownBus(rig))
    assert texts(live.snapshot(T0)) == []
    live.add_frames([frame(0, 0x80)])
    assert texts(live.snapshot(T0 + S)) == ["SYNC stopped"]
    assert texts(live.snapshot(T0 + 2 * S)) == []
    live.add_frames([frame(3, 0x80)])
    assert texts(live.snapshot(T0 + 3 * S)) == ["SYNC again"]


def test_an_emergency_of_another_length_is_told_with_its_code(rig):
    live = Live(KnownBus(rig))
    live.add_frames(
        [frame(0, 0x082, bytes.fromhex("102301000000")), frame(0, 0x081, b"\x10"), frame(0, 0x081, bytes(2))]
    )
    assert texts(live.snapshot(T0)) == [
        "brake: EMCY 0x2310: continuous over-current at the output (register 01h), 6 bytes, expected 8",
        "motor: EMCY without a code, 1 bytes, expected 8",
        "motor: EMCY error reset or no error, 2 bytes, expected 8",
    ]
    assert live.snapshot(T0).nodes[1].emergency.startswith("0x2310")


def test_emergencies_nmt_commands_sdo_aborts_and_error_frames(rig):
    live = Live(KnownBus(rig))
    live.add_frames([frame(0, 0x081, bytes.fromhex("5082110000000000")), frame(0, 0x082, bytes(8))])
    live.add_frames([frame(0, 0x000, b"\x01\x00"), frame(0, 0x000, b"\x80\x02")])
    live.add_frames([frame(0, 0x581, bytes.fromhex("8041600000000206"))])
    live.add_frames([(T0, 0x20000044, 8, bytes(8))] * 3)
    snapshot = live.snapshot(T0)
    assert texts(snapshot) == [
        "motor: EMCY 0x8250: RPDO time-out (register 11h)",
        "brake: EMCY error reset or no error (register 00h)",
        "NMT: start, to all",
        "NMT: enter pre-operational, to brake",
        "motor: SDO 6041h:00 aborted: 0x06020000: object does not exist in the object dictionary",
        "error frame: controller problem, bus off",
    ]
    assert snapshot.error_frames == 3
    assert (snapshot.nodes[0].emergency, snapshot.nodes[1].emergency) == ("0x8250: RPDO time-out", None)


def test_segments_of_a_block_transfer_are_no_aborts(rig):
    live = Live(KnownBus(rig))
    exchanged = (
        *((0x601, "a40020017f"), (0x581, "c60020010e"), (0x601, "a3"), (0x581, "0161626364656667")),
        *((0x581, "8280002001000000"), (0x601, "8000200104000405")),
    )
    live.add_frames([frame(0, can_id, bytes.fromhex(data).ljust(8, b"\0")) for can_id, data in exchanged])
    assert texts(live.snapshot(T0)) == ["motor: SDO block upload 2000h:01 aborted: 0x05040004: CRC error"]


def test_malformed_and_unknown_frames_are_counted_and_change_nothing(rig):
    live = Live(KnownBus(rig))
    live.add_frames(
        [tpdo1(0, 0x0237, 5), frame(0.1, 0x181, b"\1\2"), frame(0.1, 0x555), frame(0.1, 0x80000181, bytes(8))]
    )
    snapshot = live.snapshot(T0 + S)
    assert snapshot.pdos[1].malformed == 1
    assert snapshot.pdos[1].count == 1
    assert snapshot.unknown == 2


@given(st.lists(st.tuples(st.integers(0, 2**62), st.integers(0, 2**32 - 1), st.integers(0, 8), st.binary(min_size=8, max_size=8))))  # fmt: skip
def test_no_frame_raises(received):
    live = Live(KnownBus(load_rig("bench")))
    live.add_frames(received)
    live.add_frames([(t_ns, can_id & 0x7FF, length, data) for t_ns, can_id, length, data in received])
    snapshot = live.snapshot(T0)
    assert as_dict(snapshot, FACTS, T0)["frames"] == 2 * len(received)
    assert list(as_lines(snapshot, FACTS, T0))


def test_lines(rig):
    live = Live(KnownBus(rig))
    live.snapshot(T0)
    live.add_frames([tpdo1(0.9, 0x0237, -819200, 100), frame(0.9, 0x701, b"\x05")])
    lines = list(as_lines(live.snapshot(T0 + S), FACTS, T0))
    assert lines[1].split() == [
        "1.000", "motor.TPDO1", "1.0/s", "100", "ms",
        "statusword=0x0237", "position_rad=-65.53860", "rad", "torque_Nm=+0.17257", "Nm",
    ]  # fmt: skip
    assert lines[-1].endswith("lost 0  motor operational  brake -  host -")


def test_nodes_that_the_rig_does_not_have(rig):
    """With their state, how often they send, and what they tell; a PDO alone may be anybody's."""
    live = Live(KnownBus(rig))
    live.snapshot(T0)
    live.add_frames([frame(0.1, 0x705, b"\0"), frame(0.2, 0x085, bytes.fromhex("3081010000000000"))])
    live.add_frames(
        [frame(i / 10, 0x705, b"\5") for i in range(3, 10)] + [frame(0.95, 0x185, bytes(8)), frame(0.95, 0x186)]
    )
    snapshot = live.snapshot(T0 + S)
    five = snapshot.nodes[-1]
    assert (five.name, five.node_id, five.known, five.state, five.frames) == ("5", 5, False, "operational", 10)
    assert five.rate_per_s == pytest.approx(10)
    assert snapshot.unknown == 1
    assert texts(snapshot) == [
        "5: a node that the rig does not have; --rig says which rig it is",
        "5: boot-up",
        "5: EMCY 0x8130: life guard or heartbeat error (register 01h)",
        "5: boot-up -> operational",
    ]
    assert texts(live.snapshot(T0 + 60 * S)) == []  # how often its heartbeat comes is not known
    assert as_dict(snapshot, FACTS, T0)["nodes"]["5"]["known"] is False


def shown(snapshot, width, height, events=(), all_nodes=True):
    console = Console(width=width, height=height, color_system=None)
    with console.capture() as captured:
        console.print(Screen(snapshot, FACTS, events, T0, all_nodes), end="")
    return captured.get().splitlines()


def busy(rig):
    live = Live(KnownBus(rig))
    live.snapshot(T0)
    for i in range(999):
        live.add_frames([frame(i / 1000, 0x80), tpdo1(i / 1000, 0x0237, -819200, 100)])
        live.add_frames([frame(i / 1000, 0x182, struct.pack("<hhh", -1250, 640, 221))])
    for n in range(60):
        live.add_event(T0 + n * S // 100, f"event {n}" + " of many words" * (n == 58))
    return live.snapshot(T0 + S)


@pytest.mark.parametrize(("width", "height"), [(80, 24), (60, 20), (120, 40), (60, 40), (80, 14)])
def test_the_table_fits_into_the_terminal(rig, width, height):
    """No number is cut, and the newest events are there."""
    snapshot = busy(rig)
    lines = shown(snapshot, width, height, snapshot.events)
    assert len(lines) < height
    assert max(map(len, lines)) <= width
    assert "event 59" in lines[-1]
    assert any("event 57" in line for line in lines)
    whole = "\n".join(lines)
    for text in ("-65.53860", "999.0 /s", "operation enabled") if height > 14 else ("more lines",):
        assert text in whole
    if height >= 24:
        assert "+22.10000" in whole
    assert "\u2026" not in whole


def test_columns_go_by_their_importance(rig):
    titles = {}
    for width in (40, 60, 80, 120, 160):
        (line,) = (line for line in shown(busy(rig), width, 40) if "signal" in line)
        titles[width] = line.split()
    assert titles == {
        40: ["signal", "value"],
        60: ["PDO", "signal", "value", "rate"],
        80: ["PDO", "COB-ID", "signal", "value", "rate", "age"],
        120: ["PDO", "COB-ID", "signal", "value", "rate", "age", "period", "[ms]"],
        160: ["PDO", "COB-ID", "signal", "value", "rate", "age", "bytes", "period", "[ms]", "bits"],
    }


def test_without_a_rig_given_only_what_was_heard_is_shown(rig):
    live = Live(KnownBus(rig))
    live.snapshot(T0)
    assert "none of the rig's nodes was heard" in "".join(shown(live.snapshot(T0), 80, 24, all_nodes=False))
    live.add_frames([frame(0.1, 0x705, b"\5")])
    snapshot = live.snapshot(T0 + S)
    whole = "\n".join(shown(snapshot, 80, 24, all_nodes=False))
    assert "motor" not in whole
    assert "operational" in whole
    head, line = as_lines(snapshot, FACTS, T0, all_nodes=False)
    assert "5: a node that the rig does not have" in head
    assert line.endswith("lost 0  5 operational")
    assert "motor" in "\n".join(shown(snapshot, 80, 24))


def test_periods_load_and_bits_of_words(rig):
    live = Live(KnownBus(rig))
    live.snapshot(T0)
    for t_s in (0.0, 0.001, 0.0035, 0.0040):
        live.add_frames([tpdo1(t_s, 0x1237)])
    snapshot = live.snapshot(T0 + S // 100)
    (row,) = (row for row in snapshot.pdos if row.name == "motor.TPDO1")
    assert (row.least_s, row.most_s) == (pytest.approx(0.0005), pytest.approx(0.0025))
    assert as_dict(snapshot, FACTS, T0)["load"] == pytest.approx(4 * worst_case_bits(8) / 10_000)
    whole = "\n".join(shown(snapshot, 160, 40))
    assert "0.50-2.50" in whole
    assert "remote, mode 12" in whole
    assert "load 5 %" in whole
    (row,) = (row for row in live.snapshot(T0 + S).pdos if row.name == "motor.TPDO1")
    assert (row.least_s, row.most_s) == (None, None)  # none came since


def test_a_rig_that_does_not_match_the_bus_is_told_once(rig):
    live = Live(KnownBus(rig))
    for t_s in (0.1, 0.2):
        live.add_frames([frame(t_s, 0x181, b"\1\2"), frame(t_s, 0x381, bytes(8))])
    events = live.snapshot(T0 + S).events
    assert [event.text for event in events if event.grave] == [
        "181h has 2 bytes, the rig's has 8: another rig?",
        "motor: 381h comes, which the rig does not have",
    ]


def test_lss_in_words(rig):
    live = Live(KnownBus(rig))
    live.add_frames(
        [frame(0.1, 0x7E5, bytes.fromhex("1107000000000000")), frame(0.2, 0x7E4, bytes.fromhex("1101000000000000"))]
    )
    assert texts(live.snapshot(T0 + S)) == [
        "LSS: configure node id, node id 7",
        "LSS: configure node id, result node id out of range",
    ]


def screen_lines(live, width, **facts):
    console = Console(width=width, height=40, file=io.StringIO())
    screen = Screen(live.snapshot(T0 + S), FACTS | facts, (), T0)
    return list(screen.__rich_console__(console, console.options))


def test_bytes_that_changed_since_the_last_look_stand_out(rig):
    live = Live(KnownBus(rig))
    live.add_frames([tpdo1(0.1, 0x0237, 5)])
    live.snapshot(T0)
    live.add_frames([tpdo1(0.2, 0x0237, 6)])
    (line,) = (line for line in screen_lines(live, 80, raw=True) if "motor.TPDO1" in line.plain)
    (span,) = (span for span in line.spans if span.style == CHANGED)
    assert "3702060000000000" in line.plain
    assert line.plain[span.start : span.end] == "06"
    assert line.plain[span.start - 4 : span.start] == "3702"
    assert len(line.plain) <= 80
    (line,) = (line for line in screen_lines(live, 80, raw=True) if "motor.TPDO1" in line.plain)
    assert CHANGED not in [span.style for span in line.spans]  # no other since


def test_a_held_picture_says_so_and_the_host_is_told(rig):
    live = Live(KnownBus(rig))
    host = HostLine("host: mode hybrid")
    lines = [line.plain for line in screen_lines(live, 80, paused=True, frames=12, host=host)]
    assert any(line.startswith("PAUSED") and "12 frames" in line for line in lines)
    assert "host: mode hybrid" in lines
    assert not any("PAUSED" in line.plain for line in screen_lines(live, 80))
    for state, style in (("tripped", "red"), ("ended", "dim")):
        styles = {line.plain: str(line.style) for line in screen_lines(live, 80, host=HostLine("no host", state))}
        assert styles["no host"] == style


def test_bits_of_words_have_lines_of_their_own_where_no_column_is_wide_enough(rig):
    live = Live(KnownBus(rig))
    live.add_frames([tpdo1(0.1, 0x1237)])
    lines = [line.plain for line in screen_lines(live, 80, words=True)]
    assert "motor.statusword 0x1237: operation enabled; remote, mode 12" in lines
    assert not any("controlword" in line and ":" in line for line in lines)  # none came
    assert not any("mode 12" in line.plain for line in screen_lines(live, 80))


def test_the_keys_of_a_view():
    keys = ViewKeys()
    keys.struck(b"p")
    assert (keys.paused, keys.raw, keys.words, keys.ended) == (True, False, False, False)
    keys.struck(b" bwq")
    assert (keys.paused, keys.raw, keys.words, keys.ended) == (False, True, True, True)


def test_the_table_of_a_pdo_is_filled_with_what_came(rig):
    live = Live(KnownBus(rig))
    live.add_frames([tpdo1(0.9, 0x0237, -819200)])
    now = {row.can_id: row for row in live.snapshot(T0 + S).pdos}
    pdos = {pdo.layout.cob_id: pdo for pdo in rig.pdos()}
    lines = list(pdo_text.as_lines(pdos[0x181], now[0x181]))
    assert any("last 37 02 00 80 F3 FF 00 00, 100 ms ago" in line for line in lines)
    assert any("motor.position_rad" in line and line.endswith("-65.5386") for line in lines)
    assert any("motor.statusword" in line and line.endswith("567 (237h)") for line in lines)
    assert max(map(len, lines)) <= 80
    assert any("it did not come" in line for line in pdo_text.as_lines(pdos[0x201], now[0x201]))
    assert pdo_text.as_dict(pdos[0x181], now[0x181])["now"]["data"] == "37020080f3ff0000"
    assert "now" not in pdo_text.as_dict(pdos[0x181])


def test_whatever_the_host_answers_the_view_goes_on():
    question = threading.Event()

    def ask():
        if question.is_set():
            return
        question.set()
        raise KeyError("mode")

    with _Asker(ask) as asker:
        assert question.wait(20)
    assert asker.answer.text == "host: 'mode'"


@pytest.mark.parametrize("seed", range(4))
def test_a_block_is_as_its_frames_one_by_one(seed, monkeypatch):
    """Also the order of events of one stamp. Frames of the rig and of strangers, of right and wrong lengths, error frames, every state."""
    rng = np.random.default_rng(seed)
    ids = [
        0x80,
        0x181,
        0x182,
        0x201,
        0x202,
        0x701,
        0x702,
        0x77F,
        0x081,
        0x581,
        0x000,
        0x7E5,
        0x281,
        0x705,
        0x185,
        0x085,
    ]
    ids += [0x555, 0x80000181, 0x40000181, 0x20000044, 0x20000001]
    lengths = {0x80: 0, 0x181: 8, 0x182: 6, 0x201: 4, 0x202: 2, 0x701: 1, 0x702: 1, 0x77F: 1, 0x705: 1}
    by_frames, many = (Live(KnownBus(load_rig("bench"))) for _ in range(2))
    t_ns = T0
    for n in (0, 1, 3, 200, 40, 500):
        received = []
        for _ in range(n):
            t_ns += int(rng.integers(0, 3_000_000)) * int(rng.integers(2))
            can_id = int(rng.choice(ids))
            length = lengths.get(can_id, 8) if rng.random() < 0.95 else int(rng.integers(0, 9))
            data = bytearray(rng.bytes(length).ljust(8, b"\0"))
            if can_id == 0x181 and rng.random() < 0.9:
                data[0] = int(rng.choice([0x37, 0x31, 0x18]))
            received.append((t_ns, can_id, length, bytes(data)))
        many.add_frames(received)
        with monkeypatch.context() as alone:
            alone.setattr("coulombus.monitor.live.TOGETHER", 1)
            for single in received:
                by_frames.add_frames([single])
        assert by_frames.snapshot(t_ns) == many.snapshot(t_ns)
    assert min(by_frames.error_frames, by_frames.unknown) > 10
    assert any(row.malformed for row in by_frames.snapshot(t_ns).pdos)
