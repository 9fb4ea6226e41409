"""`scan`, `lss`, `sdo` and `nmt` from the command line, on devices in virtual time: their output,
their JSON, their exit statuses, their refusals.
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from coulombus.cli import sdo_shell
from coulombus.cli.main import main
from coulombus.eds.reader import read_eds
from coulombus.host.run.control_socket import HostSocket
from coulombus.rigs.rig import load_rig
from coulombus.wire.address import BusUnavailable, parse_address
from desk import BUS, put_on_desk
from devices_bench import UNCONFIGURED, Server, eds
from lss_slave import LssSlave
from places import ROOT

LATER_NS = 500_000_000
"""When it has been listened for a host."""


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def desk(private_sockets, monkeypatch, tmp_path):
    link = put_on_desk(monkeypatch)
    link.add(eds("motor"), 1)
    link.add(eds("mr_brake"), 2)
    monkeypatch.chdir(tmp_path)
    return link


def call(*words, **options):
    result = CliRunner().invoke(main, [str(word) for word in words], **options)
    assert "Traceback" not in result.output
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def told(*words):
    result = call(*words, *BUS, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_scan_tells_the_agreed_keys(desk, tmp_path):
    (tmp_path / "eds").mkdir()
    (tmp_path / "eds" / "mine.eds").write_text(eds("motor").text)
    (tmp_path / "eds" / "corrupt.eds").write_bytes(bytes(range(256)))
    desk.add(eds("motor", vendor=0x77, serial=5), UNCONFIGURED)
    desk.put(0x701, b"\x7f", after_ns=LATER_NS)
    found = told("scan", "--eds", "eds")
    assert list(found["nodes"][0]) == [
        *("node_id", "state", "device_type", "vendor_id", "product_code", "revision", "serial", "name", "eds")
    ]
    motor, brake = found["nodes"]
    assert (motor["node_id"], motor["device_type"], motor["vendor_id"], motor["serial"]) == (1, 0x20192, 0x4C0, 1)
    assert motor["eds"] == "eds/mine.eds"
    assert motor["state"] == "PRE_OPERATIONAL"
    assert brake["eds"].endswith("mr_brake.eds")
    assert [one["serial"] for one in found["unconfigured"]] == [5]
    assert "corrupt.eds" in found["remarks"][0]


def test_scan_prints_a_table_of_80_columns(desk):
    desk.add(eds("motor", vendor=0x77, serial=5), UNCONFIGURED)
    desk.put(0x763, b"\x04", after_ns=LATER_NS)
    desk.put(0x701, b"\x7f", after_ns=LATER_NS)
    Server(desk, 5, lambda request: 2 * [b"\x43\x00\x10\x00\x92\x01\x02\x00"] if request[0] == 0x40 else [])
    result = call("scan", *BUS)
    assert result.exit_code == 0
    assert max(map(len, result.stdout.splitlines())) <= 80
    for text in ("pre-operational", "4C0h 402h 10000h 1h", "mr_brake.eds", "no node id", "coulombus lss --set-id N"):
        assert text in " ".join(result.stdout.split()), text
    assert "node 5 answers requests twice, or differently: two devices have this node id" in result.stderr
    assert "node 99 answers no SDO; its heartbeat says STOPPED" in result.stderr


def test_an_empty_bus_ends_with_a_missing_node(desk):
    desk.devices.clear()
    desk._rows.clear()
    result = call("scan", *BUS)
    assert result.exit_code == 5
    assert "no node on coulombus:desk answers: power, cable, termination, bit rate?" in result.stderr
    assert "--listen 10" in result.stderr
    assert json.loads(call("scan", *BUS, "--json").stdout)["nodes"] == []


def test_init_knows_our_own_devices_without_a_folder(desk, tmp_path):
    result = call("init", *BUS, "-o", "my.toml")
    assert result.exit_code == 0, result.output
    axis = load_rig(str(tmp_path / "my.toml")).one_axis()
    assert (axis.motor.eds, axis.motor.node_id, axis.brake.eds, axis.brake.node_id) == (
        "motor.eds",
        1,
        "mr_brake.eds",
        2,
    )


def test_init_names_what_to_do_for_a_device_without_a_file(desk, tmp_path):
    desk.add(eds("motor", vendor=0x77), 3)
    result = call("init", *BUS, "--drive-id", 3, "-o", "my.toml")
    assert result.exit_code == 3
    assert "it has no EDS file here; put its maker's file into a folder, give it with --eds-folder" in result.stderr
    assert not (tmp_path / "my.toml").exists()


def test_init_refuses_two_devices_of_one_id(desk, tmp_path):
    Server(desk, 5, lambda request: 2 * [b"\x43\x00\x10\x00\x92\x01\x02\x00"] if request[0] == 0x40 else [])
    result = call("init", *BUS, "-o", "my.toml")
    assert result.exit_code == 3
    assert "two devices have this node id; take one off the bus, and give the other another id" in result.stderr
    assert not (tmp_path / "my.toml").exists()


ABORT = b"\x80%b\0\0\x02\x06"
BUSY = b"\x43%b\x11\0\0\0"


def a_second_device(link, node_id, answer):
    """Let another device answer each upload 0.3 ms later."""
    Server(link, node_id, lambda request: [(answer % request[1:4], 300_000)] if request[0] == 0x40 else [])


@pytest.mark.parametrize("answer", [ABORT, BUSY], ids=["abort", "value"])
@pytest.mark.parametrize("words", [("dump", 1, "m.dcf"), ("get", 1, "1017h", "--eds", "m.eds")])
def test_what_two_devices_answer_is_neither_a_configuration_nor_an_identity(desk, tmp_path, words, answer):
    (tmp_path / "m.eds").write_text(eds("motor").text, encoding="utf-8")
    a_second_device(desk, 1, answer)
    result = call("sdo", *words, *BUS)
    assert result.exit_code == 3
    assert "two devices answer as node 1" in result.stderr
    assert not (tmp_path / "m.dcf").exists()


def endless(request):
    return [b"\x41" + request[1:4] + b"\xff\xff\xff\xff"] if request[0] == 0x40 else []


def test_an_answer_that_is_none_is_no_identity_of_zeros(desk, tmp_path):
    Server(desk, 5, lambda request: endless(request) if request[1:3] == b"\x18\x10" else expedited(request))
    for words in (("sdo", "get", 5, "1000h", "--eds", tmp_path), ("init", "-o", "my.toml")):
        result = call(*words, *BUS)
        assert result.exit_code == 6, words
        assert "upload of 1018h:01: it has 4294967295 bytes" in result.stderr
        assert "node 5 has 1018h" not in result.stderr
    assert "node 5: upload of 1018h:0" in call("scan", *BUS).stderr


def expedited(request):
    return [b"\x43" + request[1:4] + b"\x92\x01\x02\0"] if request[0] == 0x40 else []


def test_a_dump_with_an_answer_that_is_none_writes_no_file(desk, tmp_path):
    desk.tamper = lambda frame: (
        [type(frame)(frame.t_ns, frame.can_id, b"\x60" + frame.data[1:], 8)]
        if frame.can_id == 0x581 and frame.data[1:4] == b"\x17\x10\0"
        else [frame]
    )
    result = call("sdo", "dump", 1, "m.dcf", *BUS)
    assert result.exit_code == 6
    assert "1017h:00" in result.stderr
    assert not (tmp_path / "m.dcf").exists()


def test_init_on_a_bus_where_nobody_answers_says_who_tells_more(desk):
    desk.devices.clear()
    desk._rows.clear()
    result = call("init", *BUS)
    assert result.exit_code == 3
    assert "no node on coulombus:desk responds to SDO: coulombus scan --bus coulombus:desk" in result.stderr


def test_error_frames_are_told(desk):
    desk.error_frames, desk.error_classes = 12, 0x88
    assert "a wrong bit rate or a missing termination (120 ohm at both ends) is likely" in call("scan", *BUS).stderr


def test_bit_rates_are_for_socketcan(desk):
    assert call("scan", *BUS, "--bitrates").exit_code == 2


@pytest.mark.thorough
def test_lss_lists_and_numbers_devices(desk):
    for serial in (5, 6):
        desk.add(eds("motor", vendor=0x77, serial=serial), UNCONFIGURED)
    result = call("lss", *BUS)
    assert "00000077:00000402:00010000:00000005  no EDS file" in result.stdout
    assert "2 devices without a node id" in result.stdout
    for words, status, text in (
        (("--set-id", 9), 3, "--all"),
        (("--set-id", 1, "--all"), 3, "has the node id 1 already"),
        (("--set-id", 127, "--all"), 3, "the last one is 127"),
        (("--all",), 2, "--all goes with --set-id"),
        (("--set-id", 9, "--device", "1:2:3:4"), 5, "no device with LSS"),
        (("--set-id", 9, "--device", "1:2:3"), 2, "expected VENDOR:PRODUCT"),
        (("--bitrate", 500000), 2, "add --store"),
        (("--bitrate", 5, "--store"), 2, "expected a bit rate from 10k to 20M"),
        (("--bitrate", "600k", "--store"), 2, "expected one of 1000000"),
    ):
        refused = call("lss", *BUS, *words)
        assert refused.exit_code == status, refused.output
        assert text in " ".join(refused.output.replace("│", " ").split())
    done = told("lss", "--set-id", 9, "--all", "--store")
    assert [(one["node_id"], one["booted"], one["stored"]) for one in done["set"]] == [
        (9, True, True),
        (10, True, True),
    ]
    assert [device.node_id for device in desk.devices] == [1, 2, 9, 10]


@pytest.mark.parametrize("quirk", [{"store_ns": 1_200_000_000}, {"deaf_ns": 3_000_000}, {"answer_ns": 400_000_000}])
def test_lss_serves_slow_slaves(desk, quirk):
    slave = LssSlave(desk, (0x999, 2, 3, 4), **quirk)
    desk.others.append(lambda can_id, data: [(0x714, b"\0")] if data[:2] == b"\4\0" and slave.stored == 20 else [])
    done = told("lss", "--device", "999:2:3:4", "--set-id", 20, "--store")
    assert [(one["node_id"], one["stored"], one["booted"]) for one in done["set"]] == [(20, True, True)]


def test_lss_waits_as_long_as_it_is_told(desk):
    slave = LssSlave(desk, (0x999, 2, 3, 4), store_ns=1_200_000_000)
    result = call("lss", *BUS, "--device", "999:2:3:4", "--store", "--timeout", 1)
    assert result.exit_code == 5
    assert "the device answers LSS (store) late, 1 s are allowed: --timeout gives it longer" in result.stderr
    assert not slave.configures
    assert call("lss", *BUS, "--device", "999:2:3:4", "--store").exit_code == 0


def test_an_early_slave_is_listed(desk):
    LssSlave(desk, (0x999, 2, 3, 4), early=True)
    assert call("lss", *BUS).stdout.startswith("00000999:00000002:00000003:00000004  no EDS file\n1 device without")


def test_slow_and_odd_sdo_servers_are_told_as_that(desk, tmp_path):
    (tmp_path / "m.eds").write_text(eds("motor", vendor=0x77).text, encoding="utf-8")
    desk.add(eds("motor", vendor=0x77), 5)
    late = lambda request: [(b"\x60" + request[1:4] + bytes(4), 2_500_000_000)] if request[0] >> 5 == 1 else []  # noqa: E731
    Server(desk, 6, late)
    assert call("sdo", "store", 6, *BUS).exit_code == 0
    result = call("sdo", "store", 6, *BUS, "--timeout", 1)
    assert result.exit_code == 5
    assert "node 6 answers late: after 2.5 s (SDO of 1010h:01), and 1 s are allowed" in result.stderr
    desk.tamper = lambda frame: (
        [type(frame)(frame.t_ns, frame.can_id, b"\x43" + frame.data[1:6] + b"\xaa\xbb", 8)]
        if frame.data[:3] == b"\x4b\x17\x10"
        else [frame]
    )
    result = call("sdo", "get", 5, "1017h", "--eds", "m.eds", *BUS)
    assert (result.exit_code, result.stdout) == (0, "00 00 aa bb\n")
    assert "1017h:00 has 4 bytes in the device; UNSIGNED16 has 2" in result.stderr


@pytest.mark.parametrize("node_id", [0, 128, 254, 256])
def test_a_node_has_an_id_or_none_yet(node_id):
    result = call("node", ROOT / "eds" / "motor.eds", "--node-id", node_id, "--bus", "coulombus:none")
    assert result.exit_code == 2
    assert str(node_id) in result.output


def test_a_device_that_does_not_boot_ends_with_a_missing_node(desk):
    desk.add(eds("motor", vendor=0x77, serial=5), UNCONFIGURED)
    desk.tamper = lambda frame: [] if frame.can_id == 0x709 else [frame]
    result = call("lss", *BUS, "--set-id", 9)
    assert result.exit_code == 5
    assert "no boot-up within 5 s" in result.stdout


def test_an_id_that_is_stored_is_there_without_a_boot_up(desk):
    LssSlave(desk, (0x999, 2, 3, 4))
    result = call("lss", *BUS, "--device", "999:2:3:4", "--set-id", 9, "--store", "--timeout", 2)
    assert result.exit_code == 0
    assert "stored, no boot-up within 2 s: it has the id from its next power-on" in result.stdout


def test_get_and_set(desk):
    assert call("sdo", "get", 1, "1008h", *BUS).stdout == "Coulombus motor drive\n"
    reading = told("sdo", "get", 2, "7130h:03")
    assert {"raw", "value", "unit"} <= reading.keys()
    assert reading["unit"] == "degC"
    assert call("sdo", "set", 1, "Producer_heartbeat_time", "100", *BUS).stdout == "100 ms (0064h)\n"
    assert told("sdo", "get", 1, "1017h")["raw"] == 100
    assert told("sdo", "set", 1, "1017h", "250 ms")["value"] == 250
    rated = told("sdo", "get", 2, "7300h:01", "--rig", "bench")
    assert (rated["raw"], rated["unit"]) == (0, "Nm")
    assert call("sdo", "get", 3, "1000h", *BUS, "--rig", "bench").exit_code == 3


@pytest.mark.parametrize(("index", "signature"), [("1010h:01", "0x65766173"), ("1011h:01", "0x64616F6C")])
def test_a_command_is_not_read_back(desk, index, signature):
    """1010h and 1011h tell what they can do, never the signature that was written."""
    result = call("sdo", "set", 1, index, signature, *BUS)
    assert result.exit_code == 0
    assert result.stdout == "1 (00000001h)\n"
    assert "holds another value" not in result.stderr
    assert call("sdo", "set", 1, index, "5", *BUS).exit_code == 6


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (("get", 1, "Hartbeat"), 2, "did you mean"),
        (("get", 1, "5999h"), 6, "0x06020000: object does not exist"),
        (("get", 9, "1000h"), 5, "node 9 does not answer"),
        (("set", 1, "1017h", "70000"), 2, "expected 0 to 65535"),
        (("set", 1, "1000h", "1"), 2, "can only be read"),
        (("get", 1, "1000h", "--eds", "none.eds"), 3, "none.eds"),
        (("get", 1, "1000h", "--eds", "x", "--rig", "bench"), 2, "give one of them"),
        (("get", 200, "1000h"), 2, "200"),
    ],
)
def test_what_cannot_be_read_or_written_is_told(desk, words, status, text):
    result = call("sdo", *words, *BUS)
    assert result.exit_code == status, result.output
    assert text in " ".join(result.output.replace("│", " ").split())


def test_a_device_that_holds_another_value_fails_the_check(desk):
    Server(
        desk,
        5,
        lambda request: (
            [b"\x60" + request[1:4] + bytes(4)] if request[0] >> 5 == 1 else [b"\x4b" + request[1:4] + b"\7\0\0\0"]
        ),
    )
    result = call("sdo", "set", 5, "2000h", "5", "--type", "UNSIGNED16", *BUS)
    assert result.exit_code == 1
    assert "the device holds another value" in result.stderr


def test_a_long_object_goes_to_a_file(desk, tmp_path):
    result = call("sdo", "get", 1, "1021h", "-o", "device.eds", *BUS)
    assert result.exit_code == 0
    assert read_eds(tmp_path / "device.eds").has(0x6041)
    assert call("sdo", "get", 1, "1021h", "-o", "device.eds", *BUS).exit_code == 2


def test_dump_and_restore(desk):
    result = call("sdo", "dump", 1, "m.dcf", *BUS)
    assert "values are in m.dcf" in result.stdout
    assert "6040h:00" in result.stderr
    call("sdo", "set", 1, "1017h", "200", *BUS)
    asked = call("sdo", "restore", 1, "m.dcf", *BUS)
    assert asked.exit_code == 2
    assert "1017h:00  Producer heartbeat time  200     0" in asked.stdout
    assert told("sdo", "get", 1, "1017h")["raw"] == 200
    done = told("sdo", "restore", 1, "m.dcf", "--yes")
    assert (done["written"], done["failed"]) == (1, [])
    assert done["differences"][0] == {
        "index": 0x1017,
        "subindex": 0,
        "name": "Producer heartbeat time",
        "device": 200,
        "file": 0,
    }
    assert told("sdo", "get", 1, "1017h")["raw"] == 0
    other = call("sdo", "restore", 2, "m.dcf", "--yes", *BUS)
    assert other.exit_code == 3
    assert call("sdo", "dump", 1, "m.dcf", *BUS).exit_code == 2  # it exists


def test_a_bus_that_ends_in_the_middle_is_told(desk, tmp_path):
    call("sdo", "dump", 1, "m.dcf", *BUS)
    call("sdo", "set", 1, "1017h", "200", *BUS)
    for left in (0, 1, 5, 100, 150):
        desk.left = left
        result = call("sdo", "restore", 1, "m.dcf", "--yes", *BUS)
        assert result.exit_code == 4
        assert "is gone" in result.stderr
        for words in (("scan",), ("sdo", "dump", 1, "n.dcf")):
            desk.left = left
            assert call(*words, *BUS).exit_code == 4
        assert not (tmp_path / "n.dcf").exists()
    desk.left = 0
    assert call("lss", *BUS).exit_code == 4


@pytest.mark.parametrize("step", [0, 1, 5, 50, 155])
def test_ctrl_c_at_any_step_ends_with_130(desk, monkeypatch, step):
    call("sdo", "dump", 1, "m.dcf", *BUS)
    call("sdo", "set", 1, "1017h", "200", *BUS)
    original = desk.receive
    desk.add(eds("motor", vendor=0x77, serial=5), UNCONFIGURED)
    for words in (("sdo", "restore", 1, "m.dcf", "--yes"), ("scan",), ("lss",), ("sdo", "get", 1, "1021h", "-o", "x")):
        count = [0]

        def receive(until_ns, count=count):
            count[0] += 1
            if count[0] == step + 3:
                raise KeyboardInterrupt
            return original(until_ns)

        monkeypatch.setattr(desk, "receive", receive)
        assert call(*words, *BUS).exit_code == 130
        monkeypatch.setattr(desk, "receive", original)
        assert told("sdo", "get", 1, "1000h")["raw"] == 0x20192  # nothing is left open in the device


@pytest.mark.parametrize(("answer", "raw", "status"), [("n", 200, 1), ("y", 0, 0)])
def test_restore_asks_at_a_terminal(desk, monkeypatch, answer, raw, status):
    call("sdo", "dump", 1, "m.dcf", *BUS)
    call("sdo", "set", 1, "1017h", "200", *BUS)
    monkeypatch.setattr("coulombus.cli.sdo.sys", SimpleNamespace(stdin=Terminal()))
    result = call("sdo", "restore", 1, "m.dcf", *BUS, input=f"{answer}\n")
    assert result.exit_code == status, result.output
    assert "write 1 of" in result.stderr
    assert ("nothing was written" in result.stderr) == (answer == "n")
    assert told("sdo", "get", 1, "1017h")["raw"] == raw


def test_store_and_defaults(desk):
    call("sdo", "set", 1, "1017h", "200", *BUS)
    assert "has stored" in call("sdo", "store", 1, *BUS).stdout
    assert "coulombus nmt reset 1 --bus coulombus:desk" in call("sdo", "restore-defaults", 1, *BUS).stdout
    assert call("nmt", "reset", 1, *BUS).stdout == "node 1: booted\n"
    assert told("sdo", "get", 1, "1017h")["raw"] == 0


def test_nmt(desk):
    call("sdo", "set", 1, "1017h", "50", *BUS)
    assert call("nmt", "start", 1, *BUS).stdout == "node 1: operational\n"
    assert told("nmt", "stop", "1") == {"nodes": [{"node_id": 1, "state": "STOPPED", "followed": True}]}
    assert call("nmt", "start", 9, *BUS).exit_code == 5
    assert call("nmt", "start", "everybody", *BUS).exit_code == 2
    assert call("nmt", "reset", "all", *BUS).stdout == "node 1: booted\nnode 2: booted\n"


WRITING = (
    *(("sdo", "set", 1, "1017h", "5"), ("sdo", "restore", 1, "m.dcf", "--yes"), ("sdo", "store", 1)),
    *(("sdo", "restore-defaults", 1), ("nmt", "start", 1), ("lss", "--set-id", 5), ("scan",)),
)


@pytest.mark.parametrize("words", WRITING, ids=[" ".join(map(str, words[:2])) for words in WRITING])
def test_beside_a_host_nothing_is_written_unless_it_is_said(desk, words):
    call("sdo", "dump", 1, "m.dcf", *BUS)
    host = HostSocket(parse_address("coulombus:desk"))
    before = len(desk.sent)
    result = call(*words, *BUS)
    assert result.exit_code == 7
    assert "end it first (coulombus stop --bus coulombus:desk), or say --beside-host" in result.stderr
    assert len(desk.sent) == before
    assert "its display may be disturbed" in call(*words, *BUS, "--beside-host").stderr
    assert len(desk.sent) > before
    host.close()


def test_reading_beside_a_host_is_said(desk):
    host = HostSocket(parse_address("coulombus:desk"))
    result = call("sdo", "get", 1, "1000h", *BUS)
    assert result.exit_code == 0
    assert "its display may be disturbed" in result.stderr
    host.close()


def test_the_shell_takes_lines_from_a_pipe(desk):
    lines = "get 1008h\n\nset 1017h 100 ms\nls heartbeat_time\nnmt start\nstore\nhelp get\nquit\nget nothing\n"
    result = call("sdo", 1, *BUS, input=lines)
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[:2] == ["Coulombus motor drive", "100 ms (0064h)"]
    assert "1017h:00  rw     Producer_heartbeat_time" in result.stdout
    assert "node 1: operational" in result.stdout
    assert "stored" in result.stdout


@pytest.mark.parametrize(
    ("line", "status"),
    [("get", 2), ("set 1017h", 2), ("nonsense", 2), ("get nothing", 2), ("get 5999h", 6), ("nmt up", 2), ('get "a', 2)],
)
def test_a_line_that_fails_ends_a_pipe(desk, line, status):
    result = call("sdo", 1, *BUS, input=f"{line}\nget 1008h\n")
    assert result.exit_code == status, result.output
    assert "Coulombus" not in result.stdout


def test_at_a_terminal_the_shell_goes_on_and_completes_names(desk, monkeypatch, capsys):
    from coulombus.host.devices.device import KnownDevice, describe
    from coulombus.host.sdo.sdo_client import SdoClient

    monkeypatch.setattr("sys.stdin", Terminal())
    client = SdoClient(desk, 1)
    shell = sdo_shell.Shell(desk, KnownDevice(client, describe(client, None)), beside=False)
    for line in ("get nothing", "nonsense", "set 1017h 70000"):
        assert shell.onecmd(line) is False
    assert len(capsys.readouterr().err.splitlines()) == 3
    assert shell.complete_get("producer_h", "get producer_h", 4, 14) == ["Producer_heartbeat_time"]
    assert shell.complete_set("", "set 1017h ", 10, 10) == []
    assert shell.complete_nmt("re", "nmt re", 4, 6) == ["reset", "reset-communication"]
    assert "get" in shell.completenames("g")
    monkeypatch.setattr(desk, "receive", lambda until_ns: (_ for _ in ()).throw(KeyboardInterrupt))
    assert shell.onecmd("get 1008h") is False
    assert capsys.readouterr().err == "interrupted\n"
    desk.left = 0
    monkeypatch.setattr(desk, "receive", type(desk).receive.__get__(desk))
    with pytest.raises(BusUnavailable):
        shell.onecmd("get 1008h")
    assert shell.onecmd("quit") is True


@pytest.mark.real_time
@pytest.mark.patient
def test_live_devices_without_node_ids_get_them_and_are_found(private_sockets, tmp_path):
    """The same on a live bus: two devices of one maker whose answers come one behind the other."""
    files = []
    for serial in (7, 0xF0000008):
        files.append(tmp_path / f"{serial}.eds")
        files[-1].write_text(eds("motor", vendor=0x77, serial=serial).text)
    words = [
        *map(str, files),
        "--node-id",
        "255",
        "--node-id",
        "255",
        "--bus",
        "coulombus:desk",
        "--json",
        "--kind",
        "generic",
    ]
    process = subprocess.Popen(
        [sys.executable, "-m", "coulombus", "node", *words],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert [("waits on bus" in process.stderr.readline()) for _ in files] == [True, True]
        assert len(told("scan", "--eds", tmp_path)["unconfigured"]) == 2
        done = told("lss", "--set-id", 9, "--all", "--store")
        assert [(one["serial"], one["node_id"], one["booted"]) for one in done["set"]] == [
            (7, 9, True),
            (0xF0000008, 10, True),
        ]
        assert [json.loads(process.stdout.readline())["node_id"] for _ in files] == [9, 10]
        assert [one["node_id"] for one in told("scan")["nodes"]] == [9, 10]
        assert told("sdo", "get", 10, "1018h:04", "--eds", files[1])["raw"] == 0xF0000008
    finally:
        process.terminate()
        process.communicate(timeout=60)


@pytest.mark.parametrize("words", [("sdo", "get", "1", "1000h"), ("nmt", "preop", "1"), ("scan",)])
def test_the_one_virtual_bus_that_is_served_is_found(desk, monkeypatch, words):
    monkeypatch.setattr("coulombus.wire.address.live_bus_names", lambda: ["desk"])
    done = call(*words, "--json")
    assert done.exit_code == 0, done.output
    assert "coulombus: on the bus coulombus:desk" in done.stderr
    assert json.loads(done.stdout)


def test_of_several_buses_none_is_taken_and_all_are_named(desk, monkeypatch):
    monkeypatch.setattr("coulombus.wire.address.live_bus_names", lambda: ["a", "b"])
    done = call("nmt", "stop", "1")
    assert done.exit_code == 2
    assert "These are served: coulombus:a, coulombus:b. A CAN interface is --bus" in " ".join(done.stderr.split())
