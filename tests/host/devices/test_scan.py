"""Who is on a bus: ids, identities, states; silent nodes, double ids, answers that are none."""

from __future__ import annotations

import pytest

from coulombus.eds.cia301 import NmtState
from coulombus.eds.eds_folder import fitting, read_folder
from coulombus.host.devices import running_host
from coulombus.host.devices.running_host import check_alone
from coulombus.host.devices.scan import scan, trouble
from coulombus.host.errors import SafetyTrip
from coulombus.host.run.control_socket import HostSocket, host_runs
from coulombus.wire.address import parse_address
from devices_bench import DevicesLink, Server, eds

S = 1_000_000_000
NOBODY = parse_address("coulombus:nobody")


def expedited(value):
    """Answer each upload with a number."""

    def answer(request):
        if request[0] != 0x40:
            return []
        return [b"\x43" + request[1:4] + value.to_bytes(4, "little")]

    return answer


def test_each_node_tells_type_identity_name_and_state():
    link = DevicesLink()
    link.add(eds("motor", vendor=0x77, serial=0xFFFFFFFE), 1)
    link.add(eds("mr_brake"), 127)
    first, last = scan(link)
    assert (first.node_id, last.node_id) == (1, 127)
    assert first.numbers[0x1000, 0] == 0x00020192
    assert [first.numbers[0x1018, k] for k in range(1, 5)] == [0x77, 0x402, 0x10000, 0xFFFFFFFE]
    assert first.name.startswith("Coulombus motor drive")
    assert last.profile == 404
    assert first.state is NmtState.PRE_OPERATIONAL  # it has just booted
    assert link.t < 3 * S
    assert all(
        data[0] >> 5 in (2, 3, 4) for can_id, data in link.sent
    )  # uploads and their segments: nothing is written


def test_127_nodes_are_found_in_three_seconds():
    link = DevicesLink()
    for node_id in range(1, 128):
        Server(link, node_id, expedited(0x00020192))
    found = scan(link)
    assert [one.node_id for one in found] == list(range(1, 128))
    assert link.t < 3 * S


def test_a_node_that_only_has_a_heartbeat_is_found_by_listening():
    link = DevicesLink()
    link.put(0x709, b"\x04", after_ns=8 * S)
    assert scan(link) == ()
    link = DevicesLink()
    link.put(0x709, b"\x04", after_ns=8 * S)
    (one,) = scan(link, listen_s=10.0)
    assert (one.node_id, one.state, one.answers_sdo) == (9, NmtState.STOPPED, False)
    assert 10 * S <= link.t < 10.5 * S


@pytest.mark.parametrize(
    ("raw", "name"),
    [
        (b"Drive \xb0C \xfc\0junk\xff\xfe", "Drive \xb0C \xfc"),
        (b"Drive\0\0\0\0", "Drive"),
        (b"\0junk", ""),
        (b"\tA\x07 B", "A B"),
    ],
)
def test_a_name_ends_at_its_first_zero(raw, name):
    link, left = DevicesLink(), []

    def answer(request):
        if request[:4] == b"\x40\x08\x10\0":
            left[:] = [raw[k : k + 7] for k in range(0, len(raw), 7)]
            return [b"\x41" + request[1:4] + len(raw).to_bytes(4, "little")]
        if request[0] >> 5 == 3:
            part = left.pop(0)
            return [bytes((request[0] & 0x10 | 7 - len(part) << 1 | (not left),)) + part.ljust(7, b"\0")]
        return (
            [b"\x80" + request[1:4] + b"\0\0\2\6"]
            if request[2] == 0x10 and request[1] in (9, 10)
            else expedited(1)(request)
        )

    Server(link, 5, answer)
    (one,) = scan(link)
    assert one.name == name


def test_a_node_whose_answers_have_another_length_is_no_missing_one():
    link = DevicesLink()
    Server(link, 5, lambda request: [b"\x4b" + request[1:4] + b"\0\0"])
    (one,) = scan(link)
    assert one.remark == "node 5, SDO of 1000h:00: it answers with 6 bytes; an SDO message has 8 (CiA 301)"


@pytest.mark.parametrize("timeout_s", [0.1, 0.5, 2.0])
@pytest.mark.parametrize("share", [0.9, 1.5])
def test_a_node_has_as_long_as_the_time_out_says(timeout_s, share):
    link = DevicesLink()
    after_ns = round(share * timeout_s * S)
    Server(link, 127, lambda request: [(answer, after_ns) for answer in expedited(1)(request)])
    assert [one.node_id for one in scan(link, timeout_s=timeout_s)] == [127] * (share < 1)


def test_two_devices_of_one_id_are_noticed():
    link = DevicesLink()
    Server(link, 5, expedited(0x192))
    Server(link, 5, expedited(0x191))
    Server(link, 6, expedited(0x191))
    assert [(one.node_id, one.twice) for one in scan(link)] == [(5, True), (6, False)]


@pytest.mark.parametrize(
    "rest",
    [
        lambda request: [],
        lambda request: [b"\x80" + request[1:4] + b"\x00\x00\x02\x06"],
        lambda request: [b"\x41" + request[1:4] + b"\xff\xff\xff\xff"],
        lambda request: [b"\xff" * 8],
        lambda request: [b"\x43" + request[1:4]],
        lambda request: [(b"\x43" + request[1:4] + b"\1\0\0\0", 900_000_000)],
        lambda request: [b"\x00" * 8] if request[0] >> 5 == 3 else [b"\x40" + request[1:4] + bytes(4)],
    ],
    ids=["silent", "aborts", "endless length", "nonsense", "short", "late", "toggle"],
)
def test_a_node_whose_answers_are_none_holds_nobody_up(rest):
    link = DevicesLink()
    Server(link, 5, lambda request: expedited(0x192)(request) if request[1:3] == b"\x00\x10" else rest(request))
    link.add(eds("motor"), 1)
    motor, other = scan(link)
    assert motor.identity == (0x4C0, 0x402)
    assert other.numbers[0x1000, 0] == 0x192
    assert other.identity == (0, 0)
    assert link.t < 6 * S


def test_a_flood_of_other_frames_changes_nothing():
    link = DevicesLink()
    link.add(eds("motor"), 1)
    for k in range(5000):
        link.put(0x181 + k % 0x300, bytes(8), after_ns=100_000 * k)
    assert [one.identity for one in scan(link) if one.answers_sdo and one.numbers] == [(0x4C0, 0x402)]


@pytest.mark.parametrize(
    ("count", "classes", "anybody", "text"),
    [
        (0, 0, False, ""),
        (9, 0x20, False, "nothing acknowledges"),
        (9, 0x88, True, "wrong bit rate or a missing termination"),
        (9, 0x40, False, "bus-off"),
        (9, 0x02, True, "9 error frames"),
    ],
)
def test_error_frames_are_told_with_their_likely_cause(count, classes, anybody, text):
    told = trouble(count, classes, anybody)
    assert text in told
    assert bool(told) == bool(text)


AT_WORK = ((0x80, b"", "SYNC"), (0x601, bytes(8), "SDO"), (0x583, bytes(8), "SDO"), (0x77F, b"\5", "the heartbeat"))


@pytest.mark.parametrize(("can_id", "data", "text"), AT_WORK)
def test_a_host_at_work_is_noticed(private_sockets, can_id, data, text):
    link = DevicesLink()
    link.put(0x77F, b"\x7f")  # a device's
    link.put(can_id, data, after_ns=S // 4)
    with pytest.raises(SafetyTrip, match=f"a host is on bus coulombus:nobody: {text}"):
        check_alone(link, NOBODY)
    link.put(can_id, data, after_ns=S // 4)
    assert text in check_alone(link, NOBODY, beside=True)
    assert check_alone(link, NOBODY) == ""


def test_a_host_of_this_machine_is_noticed_before_it_sends(private_sockets):
    assert not host_runs(NOBODY)
    host = HostSocket(NOBODY)
    assert "control socket" in running_host.who_is_at_work(DevicesLink(), NOBODY)
    host.close()
    assert not host_runs(NOBODY)


def test_the_eds_file_is_that_of_the_identity_and_rather_of_the_revision(tmp_path):
    for name, identity in (("a", {"revision": 1}), ("b", {"revision": 2}), ("c", {"vendor": 9, "revision": 2})):
        (tmp_path / f"{name}.eds").write_text(eds("motor", **identity).text, encoding="utf-8")
    (tmp_path / "corrupt.eds").write_bytes(bytes(range(256)))
    (tmp_path / "notes.txt").write_text("no EDS file")
    files, refused = read_folder(tmp_path)
    assert len(files) == 3
    assert "corrupt.eds:1" in str(refused[0])
    for revision, name in ((2, "b.eds"), (1, "a.eds"), (7, "a.eds")):
        assert fitting(files, (0x4C0, 0x402), revision).path.endswith(name)
    assert fitting(files, (0, 0)) is None
    assert fitting(files, (0x4C0, 0x403)) is None
