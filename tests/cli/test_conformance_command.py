"""`coulombus conformance`: its files, its JSON, its exit statuses, its refusals; a real socket
where that matters.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import canopen
import pytest
from click.testing import CliRunner

from conformance_bench import EDS, KIND_OF, VirtualLink, description, new_unit, run_cases
from coulombus.cli.main import main
from coulombus.conformance.catalogue import catalogue
from coulombus.conformance.report import as_dict, summary, verdict, write_junit, write_report
from coulombus.conformance.runner import ConformanceRefused, DeviceSilent, WrongDevice, check_before, run, select
from coulombus.conformance.tester.registry import FUNCTIONS
from coulombus.conformance.tester.unit import Timing, Unit
from coulombus.eds.reader import read_eds
from coulombus.wire import bus_link as link_module
from coulombus.wire.address import BusUnavailable, parse_address
from coulombus.wire.bus_link import RTR, BusFrame, BusLink
from tiny_bus import tiny_bus


class DeafLink(VirtualLink):
    def tamper(self, frame):
        return []


class DyingLink(VirtualLink):
    """A node that falls silent with its third SDO response."""

    left = 3

    def tamper(self, frame):
        self.left -= frame.can_id == 0x581
        return [frame] if self.left > 0 else []


class BabblingLink(VirtualLink):
    """A node that answers every SDO request with what makes no sense."""

    def tamper(self, frame):
        if frame.can_id != 0x581:
            return [frame]
        noise = bytes((frame.data[0] ^ 0x65, 0xFF, 0x12, 7, 1, 2, 3, 4))
        return [BusFrame(frame.t_ns, 0x581, noise, 8), BusFrame(frame.t_ns, 0x581, b"\x41", 1)]


def invoke(*arguments):
    return CliRunner().invoke(main, ["conformance", *arguments])


@pytest.fixture
def private_directory(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


def mixed_report():
    """A pass, a failure and one that does not apply."""
    unit = new_unit("mr_brake")
    unit.description = description("motor")  # 1000h is another
    return run(unit, select(["2.1", "2.5", "P.1", "P.9"]))


def test_json_has_the_agreed_keys():
    report = as_dict(mixed_report())
    assert report.keys() == {"passed", "failed", "not_applicable", "errors", "complete", "remarks", "causes", "cases"}
    assert (report["errors"], report["complete"]) == (0, True)
    results = {one["id"]: one["result"] for one in report["cases"]}
    assert results["2.1"] == "fail"
    assert results["2.5"] == "pass"
    for key, result in (("passed", "pass"), ("failed", "fail"), ("not_applicable", "not_applicable")):
        assert report[key] == list(results.values()).count(result)
    keys = {"id", "name", "result", "reason"}
    assert all(one.keys() - keys == ({"frames"} if one["result"] == "fail" else set()) for one in report["cases"])
    failed = report["cases"][0]
    assert "000A0194h" in failed["reason"]
    assert failed["frames"][-1].endswith("581  [8]  43 00 10 00 94 01 0A 00")
    json.dumps(report)


def test_the_reports_name_each_case(tmp_path):
    report = mixed_report()
    write_junit(report, tmp_path / "r.xml")
    suite = ElementTree.parse(tmp_path / "r.xml").getroot()[0]
    assert [test.get("name").split()[0] for test in suite] == ["2.1", "2.5", "P.1", "P.9"]
    assert suite.get("failures") == str(len(suite.findall("testcase/failure")))
    assert "581  [8]  43 00 10 00" in suite[0][0].text
    for ending in ("md", "html"):
        path = tmp_path / f"r.{ending}"
        write_report(report, path)
        text = path.read_text()
        assert summary(report) in text
        assert "581  [8]  43 00 10 00" in text
        assert "P.9" in text


def test_a_report_for_people_has_the_verdict_on_top_and_the_failures_first(tmp_path):
    unit = new_unit("mr_brake")
    unit.description = description("motor")  # 1000h is another
    report = run(unit, select(["2.1", "2.5", "P.1"]))
    results = [outcome.result for outcome in report.outcomes]
    assert results.index("pass") < len(results) - 1 - results[::-1].index("fail")  # mixed in the catalogue's order
    for ending, row in (("md", r"^\| ([\dP.]+) \|"), ("html", r'<tr class="\w+"><td>([\dP.]+)<')):
        write_report(report, tmp_path / f"r.{ending}")
        text = (tmp_path / f"r.{ending}").read_text()
        kinds = {outcome.case.id: outcome.result for outcome in report.outcomes}
        listed = [kinds[case] for case in re.findall(row, text, re.M)]
        assert listed == sorted(results, key=("fail", "error", "pass", "not_applicable").index)
        assert text.index("FAILED: ") < text.index("cause 1")
    assert f"FAILED: {results.count('fail')} case" in text


def test_a_run_without_failures_is_passed():
    report = run(new_unit("mr_brake"), select(["2.1", "2.5"]))
    assert verdict(report) == ("pass", "PASSED: 2 cases")
    assert verdict(replace(report, ended_by=KeyboardInterrupt()))[0] == "error"


def test_selected_cases_run_in_the_catalogues_order():
    assert [case.id for case in select(["7.101", "2.10", "2.1"])] == ["2.1", "2.10", "7.101"]
    assert len(select([])) == len(catalogue())
    with pytest.raises(ValueError, match=r"2\.99"):
        select(["2.99"])


def test_the_seed_chooses_the_objects():
    def chosen(seed):
        unit = new_unit("motor")
        unit.random.seed(seed)
        return run_cases(unit, "2.2").outcomes[0].reason

    assert chosen(1) == chosen(1) != chosen(2)


@pytest.mark.thorough
def test_a_run_leaves_the_device_as_it_was():
    unit = new_unit("motor")
    before = {key: unit.link.device[key] for key in _numbers(unit)}
    run_cases(unit)
    assert {key: unit.link.device[key] for key in before} == before
    assert unit.link.device.record["nmt"] == 127
    assert unit.link.device.record["out_torque_pm"] == 0


def _numbers(unit):
    return [(v.index, v.subindex) for v in unit.variables() if v.access == "rw"]


def test_nobody_there():
    with pytest.raises(DeviceSilent, match="node 1"):
        check_before(new_unit("motor", DeafLink))


def test_a_device_at_work_is_left_alone():
    unit = new_unit("motor")
    unit.link.send(0x000, b"\x01\x01")
    with pytest.raises(ConformanceRefused, match="OPERATIONAL"):
        check_before(unit)
    check_before(unit, force=True)
    enabled = new_unit("motor")
    for word in (6, 7, 15):
        enabled.put(0x6040, 0, bytes((word, 0)))
    with pytest.raises(ConformanceRefused, match="Operation Enabled"):
        check_before(enabled)


def test_the_eds_of_another_device_is_refused():
    unit = new_unit("motor")
    unit.description = description("mr_brake")
    with pytest.raises(WrongDevice, match=r"profile.*1000h:00 is 00020192h.*mr_brake\.eds"):
        check_before(unit)
    check_before(unit, force=True)
    assert WrongDevice.exit_status == 3


@pytest.mark.parametrize(("subindex", "name"), [(1, "vendor"), (2, "product")])
def test_a_device_of_the_same_profile_but_another_make_is_refused(tmp_path, subindex, name):
    unit = new_unit("motor")
    text = Path(unit.description.path).read_text()
    own = text.partition(f"[1018sub{subindex}]")[2].partition("DefaultValue=")[2].split()[0]
    head, mark, rest = text.partition(f"[1018sub{subindex}]")
    other = tmp_path / "other.eds"
    other.write_text(head + mark + rest.replace(f"DefaultValue={own}", "DefaultValue=0x12345678", 1))
    unit.description = read_eds(other)
    with pytest.raises(WrongDevice, match=rf"another {name} .*1018h:0{subindex} is .*, and 12345678h in"):
        check_before(unit)


def test_a_report_that_cannot_be_written_does_not_take_the_result_away(private_directory, monkeypatch, tmp_path):
    report = mixed_report()
    monkeypatch.setattr("coulombus.conformance.runner.check_before", lambda unit, force: None)
    monkeypatch.setattr("coulombus.conformance.runner.run", lambda unit, cases, progress: report)
    with tiny_bus("t"):
        eds = str(EDS / "motor.eds")
        monkeypatch.setattr("coulombus.conformance.report.write_report", _no_room)
        arguments = ("--bus", "coulombus:t", "--node", "1", "--eds", eds, "--report", str(tmp_path / "x.md"))
        result, told = invoke(*arguments), invoke(*arguments, "--json")
    assert result.exit_code == 2
    assert "No space left" in result.output
    assert summary(report)[:20] in result.output
    assert json.loads(told.stdout) == as_dict(report)  # and nothing behind it
    assert told.exit_code == 2


def _no_room(report, path):
    raise OSError(28, "No space left on device", str(path))


def test_ctrl_c_before_the_run_is_an_interruption_too(monkeypatch):
    def interrupted(path):
        raise KeyboardInterrupt

    monkeypatch.setattr("coulombus.eds.reader.read_eds", interrupted)
    result = invoke("--bus", "coulombus:t", "--node", "1", "--eds", "a.eds")
    assert result.exit_code == 130
    assert "interrupted" in result.output


def test_a_device_that_dies_fails_the_rest_at_once():
    unit = new_unit("motor", DyingLink)
    report = run(unit, select([]))
    assert len(report.outcomes) == len(catalogue())
    assert report.outcomes[-1].result == "fail"
    assert "does not answer any more" in report.outcomes[-1].reason
    assert unit.link.t < 200_000_000_000


def test_an_interrupted_run_leaves_the_drive_disabled():
    unit = new_unit("motor")

    def interrupt(number, case):
        if number:
            unit.put(0x6040, 0, b"\x06\0")
            unit.sdo.download(0x1010, 1, b"save")
            unit.stored = True
            raise KeyboardInterrupt

    report = run(unit, select(["2.1", "2.3"]), interrupt)
    assert isinstance(report.ended_by, KeyboardInterrupt)
    assert [one.case.id for one in report.outcomes] == ["2.1"]
    assert unit.number(0x6041) & 0x6F == 0x40


class VanishingLink(VirtualLink):
    """A bus that goes away with the tenth frame that is sent on it."""

    left = 10

    def send(self, can_id, data=b"", length=None):
        self.left -= 1
        if self.left <= 0:
            raise BusUnavailable("bus coulombus:t is gone")
        super().send(can_id, data, length)


def test_a_bus_that_goes_away_ends_the_run():
    """Even where the run has something to set right at its end: the exit status is that of
    the bus.
    """
    unit = new_unit("motor", VanishingLink)
    unit.stored = True
    report = run(unit, select([]))
    assert isinstance(report.ended_by, BusUnavailable)
    assert report.ended_by.exit_status == 4
    assert len(report.outcomes) < 5


def _broken(unit):
    unit.read(0x1000)
    return unit.no_such_thing


def test_what_the_tester_cannot_do_is_an_error_and_no_failure_of_the_device(monkeypatch, tmp_path):
    monkeypatch.setitem(FUNCTIONS, "2.3", _broken)
    report = run(new_unit("motor"), select(["2.1", "2.3", "2.5"]))
    assert [one.result for one in report.outcomes] == ["pass", "error", "pass"]
    assert "the tester itself failed" in report.outcomes[1].reason
    assert "AttributeError" in report.outcomes[1].reason
    assert "test_conformance_command.py" in report.outcomes[1].reason
    as_json = as_dict(report)
    assert (as_json["passed"], as_json["failed"], as_json["errors"]) == (2, 0, 1)
    assert as_json["cases"][1]["frames"][-1].endswith("581  [8]  43 00 10 00 92 01 02 00")
    assert "1 ended by an error of the tester" in summary(report)
    write_junit(report, tmp_path / "r.xml")
    suite = ElementTree.parse(tmp_path / "r.xml").getroot()[0]
    assert (suite.get("failures"), suite.get("errors")) == ("0", "1")
    assert "AttributeError" in suite[1].find("error").get("message")
    for ending in ("md", "html"):
        write_report(report, tmp_path / f"r.{ending}")
        assert (tmp_path / f"r.{ending}").read_text().count("AttributeError") >= 2


def test_an_error_while_a_case_is_undone_is_one_of_the_tester(monkeypatch):
    unit = new_unit("motor")
    monkeypatch.setattr(unit, "restore", lambda: {}["nothing"])
    assert run(unit, select(["2.1"])).outcomes[0].result == "error"


class NodeLink(VirtualLink):
    """A node in virtual time in the place of a bus."""

    def __init__(self, address):
        super().__init__(description("motor"), 1, KIND_OF["motor"])

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        """There is nothing to close."""


@pytest.fixture
def node_link(monkeypatch):
    monkeypatch.setattr("coulombus.wire.bus_link.BusLink", NodeLink)
    return ("--bus", "coulombus:t", "--node", "1", "--eds", str(EDS / "motor.eds"))


@pytest.mark.parametrize(("broken", "status"), [((), 0), (("2.3",), 1)])
def test_an_error_of_the_tester_has_the_exit_status_of_a_failure(node_link, monkeypatch, broken, status):
    for number in broken:
        monkeypatch.setitem(FUNCTIONS, number, _broken)
    result = invoke(*node_link, "--case", "2.1", "--case", "2.3")
    assert result.exit_code == status, result.output
    assert ("ERROR of the tester" in result.output) == bool(broken)


@pytest.mark.parametrize(
    ("why", "status"), [(KeyboardInterrupt(), 130), (SystemExit(143), 143), (BusUnavailable("the bus is gone"), 4)]
)
def test_a_run_that_is_ended_writes_what_it_has(node_link, monkeypatch, tmp_path, why, status):
    def ended(unit):
        raise why

    monkeypatch.setitem(FUNCTIONS, "2.5", ended)
    files = {name: tmp_path / name for name in ("r.xml", "r.md")}
    cases = ("--case", "2.1", "--case", "2.3", "--case", "2.5", "--case", "2.6")
    result = invoke(*node_link, *cases, "--json", "--junit", str(files["r.xml"]), "--report", str(files["r.md"]))
    assert result.exit_code == status, result.output
    told = json.loads(result.stdout)
    assert told["complete"] is False
    assert [one["id"] for one in told["cases"]] == ["2.1", "2.3"]
    assert [test.get("name").split()[0] for test in ElementTree.parse(files["r.xml"]).getroot()[0]] == ["2.1", "2.3"]
    assert "the run was ended before its last case" in files["r.md"].read_text()


def test_nonsense_fails_and_does_not_stop_the_run():
    unit = new_unit("motor", BabblingLink)
    report = run(unit, select(["1.0", "2.1", "2.16", "2.23", "3.6", "7.6", "8.5", "L.1", "P.4"]))
    assert report.outcomes[0].result == "pass"
    assert all(one.result == "fail" for one in report.outcomes[1:])


def test_frames_over_a_socket(private_directory):
    with (
        tiny_bus("t") as bus,
        BusLink(parse_address("coulombus:t")) as link,
        BusLink(parse_address("coulombus:t")) as other,
    ):
        link.send(0x123, b"abc")
        link.send(0x701 | RTR, length=1)
        for _ in range(2):  # so the bus has taken them
            assert other.receive(other.now_ns() + 10_000_000_000) is not None
        bus.deliver((0x181, b"1234"), (0x20000004, bytes(8)), (0x702 | RTR, b""))
        first, second = (link.receive(link.now_ns() + 10_000_000_000) for _ in range(2))
        assert (first.can_id, first.data, first.sent) == (0x181, b"1234", False)
        assert second.can_id == 0x702 | RTR
        assert second.data == b""
        assert link.receive(link.now_ns()) is None
        assert [(can_id, length) for can_id, length, _ in bus.frames] == [(0x123, 3), (0x701 | RTR, 1)]


def test_a_full_queue_ends_in_an_error(private_directory, monkeypatch):
    monkeypatch.setattr(link_module, "_PATIENCE_S", 0.0)

    def full(message):
        raise link_module.BusFull(parse_address("coulombus:t"))

    with tiny_bus("t"), BusLink(parse_address("coulombus:t")) as link:
        monkeypatch.setattr(link._client, "send", full)
        with pytest.raises(BusUnavailable, match="takes no frame"):
            link.send(0x123)


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (["--bus", "coulombus:none", "--node", "1", "--eds", str(EDS / "motor.eds")], 4, "no bus"),
        (["--bus", "nonsense", "--node", "1", "--eds", str(EDS / "motor.eds")], 2, "KIND:NAME"),
        (["--bus", "coulombus:none", "--node", "1", "--eds", "absent.eds"], 3, "absent.eds"),
        (["--bus", "coulombus:none", "--node", "0", "--eds", str(EDS / "motor.eds")], 2, "--node"),
        (["--bus", "coulombus:none", "--node", "1", "--eds", "absent.eds", "--case", "11.9"], 2, "11.9"),
        (["--bus", "coulombus:none", "--node", "1", "--eds", "absent.eds", "--timeout", "0"], 2, "--timeout"),
        (["--bus", "coulombus:none", "--node", "1", "--eds", "a.eds", "--junit", "absent/a.xml"], 2, "absent"),
    ],
)
def test_a_mistake_has_its_exit_status(private_directory, arguments, status, text):
    result = invoke(*arguments)
    assert result.exit_code == status, result.output
    assert text in result.output


def test_a_silent_bus_has_exit_status_5(private_directory):
    with tiny_bus("t"):
        eds = str(EDS / "motor.eds")
        result = invoke("--bus", "coulombus:t", "--node", "9", "--eds", eds, "--timeout", "0.01", "--json")
    assert result.exit_code == 5
    assert "no node answers as node 9" in result.output


class LocalNodeLink:
    """canopen's LocalNode without a thread: it answers within the call that hands it a frame."""

    def __init__(self, name, node_id):
        self.t = 0
        self.sent = []
        self.network = canopen.Network()
        self.network.send_message = self._send
        self.node = canopen.LocalNode(node_id, str(EDS / f"{name}.eds"))
        self.network.add_node(self.node)

    def _send(self, can_id, data, remote=False):
        self.sent.append(BusFrame(self.t, can_id, bytes(data), len(data)))

    def now_ns(self):
        return self.t

    def send(self, can_id, data=b"", length=None):
        self.t += 100_000
        if not can_id & RTR:
            self.network.notify(can_id, bytearray(data), self.t / 1e9)

    def receive(self, until_ns):
        if self.sent:
            return self.sent.pop(0)
        self.t = max(self.t, until_ns)
        return None


def test_a_localnode_gets_its_share():
    """What docs/conformance.md says of it, as far as it needs no thread."""
    link = LocalNodeLink("motor", 1)
    unit = Unit(link, description("motor"), 1, Timing())
    numbers = ["2.1", "2.3", "2.4", "2.5", "2.6", "2.8", "2.10", "2.12", "2.16", "2.17", "2.23", "3.24", "6.9", "8.10"]
    results = {one.case.id: one.result for one in run(unit, select(numbers)).outcomes}
    failed = {number for number, result in results.items() if result == "fail"}
    assert failed == {"2.5", "2.10", "2.17", "2.23", "3.24", "6.9", "8.10"}
    assert results["2.16"] == "pass"
