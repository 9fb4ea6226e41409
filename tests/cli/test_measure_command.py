"""``coulombus measure``: what it proposes, what it writes, what it refuses; and once on a
live bus.
"""

from __future__ import annotations

import json
import socket
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.host.cycle.step import SOURCE_HOST
from coulombus.host.errors import SafetyTrip
from coulombus.host.run import measure as measuring
from coulombus.host.run.control_socket import HostSocket, control_path
from coulombus.host.run.host_latency import compute_times_ns
from coulombus.host.run.measure import Measured, TimeQuantiles, proposed_ns, quiet_mode
from coulombus.host.setup.device_response import DeviceTimes, PdoTimes
from coulombus.rigs.rewrite import NewValue, rewritten
from coulombus.rigs.rig import load_rig, load_rig_text
from coulombus.wire.address import parse_address
from coulombus.wire.frame import FRAME
from eds_edit import SENSOR
from places import RIGS, ROOT
from real_bench import end, simulation, start

EDS = {name: (ROOT / "eds" / name).read_text() for name in ("motor.eds", "mr_brake.eds")}
EDS["cell.eds"] = EDS["mr_brake.eds"]


def call(*words):
    return CliRunner().invoke(main, ["measure", *map(str, words)])


def device(name, role, *times_us, missed=0, node_id=1):
    pdo = PdoTimes("TPDO1", 0x180 + node_id, tuple(round(1e3 * t) for t in times_us), missed)
    plan = SimpleNamespace(name=name, role=role, node_id=node_id)
    return DeviceTimes(plan, (pdo,)) if times_us else DeviceTimes(plan, (), (), "it has no TPDO")


def measured(*devices):
    host = TimeQuantiles(100, 20.0, 30.0, 41.0)
    return Measured(devices, host, ({"name": "SCHED_FIFO", "granted": False, "detail": "no", "remedy": "sudo"},))


@pytest.mark.parametrize(("longest_us", "wanted_us"), [(0, 10), (4, 10), (6, 20), (95, 110), (100, 110), (100.1, 120)])
def test_a_margin_is_added_and_rounded_up(longest_us, wanted_us):
    assert proposed_ns(longest_us * 1e3) == wanted_us * 1000


def test_the_values_have_the_keys_of_the_rig_file():
    rig = load_rig("two_axes")
    found = measured(
        device("left.motor", "motor", 20, 95), device("left.brake", "brake"), device("right.brake", "brake", 5)
    )
    assert found.numbers(rig) == {
        ("host", "compute_s"): 50e-6,
        ("axis", "left", "motor", "response_us"): 110.0,
        ("axis", "right", "brake", "response_us"): 10.0,
    }


def test_a_sensors_value_is_in_its_section():
    bench = (RIGS / "bench.toml").read_text()
    rig = load_rig_text(bench + SENSOR, str(RIGS / "x.toml"), EDS)
    numbers = measured(device("cell", "cell", 7, node_id=3)).numbers(rig)
    assert numbers[("sensor", "cell", "response_us")] == 20.0
    text = rewritten(bench + SENSOR, {key: NewValue(value, "") for key, value in numbers.items()}, "measured", "x.toml")
    assert load_rig_text(text, "x.toml", EDS).one_axis().sensor["cell"].response_us == 20.0


def test_the_devices_are_configured_in_the_mode_with_the_least_torque():
    assert quiet_mode(load_rig("bench")) == "passive"
    assert quiet_mode(load_rig("paper")) in load_rig("paper").modes


def log_of(*rows):
    log = np.zeros(len(rows), FRAME).view(np.recarray)
    for row, (t_ns, can_id, source) in zip(log, rows, strict=True):
        row.t_ns, row.can_id, row.source = t_ns, can_id, source
    return log


def test_the_hosts_time_is_from_an_axis_last_tpdo_to_its_last_rpdo():
    us, host, bus = 1000, SOURCE_HOST, 0
    axes = [({0x181, 0x182}, {0x201, 0x202}), ({0x183}, {0x203})]
    rows = [
        *(
            (0, 0x80, host),
            (100 * us, 0x181, bus),
            (200 * us, 0x182, bus),
            (215 * us, 0x201, host),
            (220 * us, 0x202, host),
        ),
        *((300 * us, 0x183, bus), (307 * us, 0x203, host)),
        *((1000 * us, 0x80, host), (1100 * us, 0x181, bus), (1740 * us, 0x201, host), (1745 * us, 0x202, host)),
        *((1750 * us, 0x182, bus), (1760 * us, 0x183, bus), (1770 * us, 0x203, host)),  # one too late: waited for
        (2000 * us, 0x80, host),
    ]
    assert compute_times_ns(log_of(*rows), axes) == (20 * us, 7 * us, 10 * us)
    assert compute_times_ns(log_of(), axes) == ()


@pytest.fixture
def figures(monkeypatch):
    """Replace the measurement: its result is in the list."""
    found = [measured(device("motor", "motor", 20, 95), device("brake", "brake", 60, 80, missed=2, node_id=2))]
    monkeypatch.setattr(measuring, "measure_rig", lambda *arguments, **options: found[0])
    return found


def test_write_changes_the_rig_file_and_keeps_the_old_one(figures, tmp_path):
    mine = tmp_path / "my.toml"
    mine.write_text((RIGS / "bench.toml").read_text())
    result = call("--rig", mine, "--write")
    assert result.exit_code == 0, result.output
    rig = load_rig(str(mine))
    axis = rig.one_axis()
    assert (axis.motor.response_us, axis.brake.response_us, rig.host.compute_s) == (110.0, 90.0, 50e-6)
    assert "# measured by coulombus measure 2" in mine.read_text()
    assert "p50 20, p99 30, max 41 us of 100" in mine.read_text()
    assert (tmp_path / "my.toml.bak").read_text() == (RIGS / "bench.toml").read_text()
    assert "brake: TPDO1 did not come after 2 SYNCs" in result.output
    assert "SCHED_FIFO: refused (no); to have it: sudo" in result.output
    assert max(map(len, result.stdout.splitlines()[:4])) <= 80


def test_times_with_which_the_plan_does_not_fit_are_a_failed_check(figures, tmp_path):
    figures[0] = measured(device("motor", "motor", 400), device("brake", "brake", 20, node_id=2))
    result = call("--rig", "bench", "--json")
    assert result.exit_code == 1
    document = json.loads(result.stdout)
    assert document["fits"] is False
    assert document["values"] == {"host.compute_s": 50e-6, "motor.response_us": 440.0, "brake.response_us": 30.0}
    assert document["devices"][0]["before_us"] == 20.0
    assert document["backup"] is None
    shown = call("--rig", "bench").output
    assert (
        "FAIL: the plan does not fit with these times: coulombus plan --rig bench --set host.compute_s=5e-05" in shown
    )


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (("--rig", "bench", "--write"), 2, "copy it first"),
        (("--rounds", 0), 2, "--rounds"),
        (
            ("--rig", "two_axes", "--set", "axis.left.bus.channel=l", "--set", "axis.right.bus.channel=r"),
            2,
            "--channel",
        ),
        (("--rig", "bench", "--channel", "left"), 2, "one bus, without a name"),
    ],
)
def test_mistakes_are_told_before_anything_is_measured(figures, words, status, text):
    result = call(*words)
    assert result.exit_code == status, result.output
    assert text in " ".join(result.output.replace("│", " ").split())


def test_overrides_are_not_written(figures, tmp_path):
    mine = tmp_path / "my.toml"
    mine.write_text((RIGS / "bench.toml").read_text())
    assert call("--rig", mine, "--write", "--set", "motor.node_id=5").exit_code == 2
    assert [one.name for one in tmp_path.iterdir()] == ["my.toml"]


def test_what_was_measured_is_told_where_the_file_cannot_be_written(figures, tmp_path, monkeypatch):
    mine = tmp_path / "my.toml"
    text = (RIGS / "bench.toml").read_text()
    mine.write_text(text)

    def measure_rig(*arguments, **options):
        mine.write_text(text + "# somebody's\n")  # while it was measured
        return figures[0]

    monkeypatch.setattr(measuring, "measure_rig", measure_rig)
    result = call("--rig", mine, "--write")
    assert result.exit_code == 3
    assert "motor.response_us = 110.0" in result.stderr
    assert "the file was changed meanwhile" in result.stderr
    assert mine.read_text() == text + "# somebody's\n"
    (tmp_path / "my.toml.bak").mkdir()
    mine.write_text(text)
    result = call("--rig", mine, "--write")
    assert result.exit_code == 2
    assert "my.toml.bak is a directory" in " ".join(result.output.replace("│", " ").split())


def test_a_bus_with_a_host_is_refused(private_sockets):
    door = HostSocket(parse_address("coulombus:bench"))
    try:
        result = call("--rig", "bench")
    finally:
        door.close()
    assert result.exit_code == SafetyTrip.exit_status
    assert "another host runs on bus coulombus:bench" in result.output


def test_a_rehearsal_is_not_measured_on_a_real_bus(tmp_path):
    mine = tmp_path / "my.toml"
    mine.write_text((RIGS / "bench.toml").read_text() + "# REHEARSAL\n")
    result = call("--rig", mine, "--bus", "socketcan:none0")
    assert result.exit_code == 3
    assert "REHEARSAL" in result.output


@pytest.mark.real_time
def test_on_a_live_bus_the_times_are_found_and_nothing_is_armed(private_sockets, tmp_path):
    with simulation("coulombus:live"):
        process = start("measure", "--bus", "coulombus:live", "--rounds", 100, "--cycles", 200, "--json")
        try:
            out, err = process.communicate(timeout=240)
        finally:
            end(process)
    assert process.returncode in (0, 1), err
    document = json.loads(out)
    assert [one["node"] for one in document["devices"]] == ["motor", "brake"]
    for one in document["devices"]:
        assert one["tpdos"][0]["count"] >= 90
        assert 10 <= one["tpdos"][0]["p50_us"] <= 70  # the simulated devices take 20 us
    assert document["host"]["count"] >= 20
    assert 0 < document["host"]["p50_us"] < 1000


def test_coulombus_stop_ends_a_measurement(monkeypatch, private_sockets):
    address = parse_address("coulombus:stopped")
    nothing = {"close": lambda: None, "check_alone": lambda until: None, "wait_ns": lambda at_ns: None}
    monkeypatch.setattr(measuring, "RealControlPlane", lambda rig, address: SimpleNamespace(**nothing))
    monkeypatch.setattr(measuring, "_BusWire", lambda address: SimpleNamespace(**nothing))
    asked = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    steps = []

    def devices(controllers, control, wire, rounds, report):
        report("motor", 1)
        asked.connect(str(control_path(address)))
        asked.send(b"stop")
        report("motor", 2)

    def note(what, done):
        steps.append(done)

    monkeypatch.setattr(measuring, "measure_devices", devices)
    with asked, pytest.raises(SafetyTrip, match="ended by `coulombus stop`; nothing was armed"):
        measuring.measure_rig(load_rig("bench"), address, rounds=3, cycles=10, progress=note)
    assert steps == [1]
