"""The I/O file: what it says, and every mistake with its line."""

from __future__ import annotations

import re

import pytest

from coulombus.node.brake404 import BRAKE404
from coulombus.node.hardware import io_file
from coulombus.node.hardware.io_file import read_io_file
from coulombus.node.kinds import GENERIC
from coulombus.rigs.errors import RigError
from coulombus.rigs.field_help import fields_of
from fake_sysfs import BRAKE_IO
from node_bench import description
from places import ROOT


def read(folder, text, kind=BRAKE404):
    path = folder / "io.toml"
    path.write_text(text)
    return read_io_file(path, description("mr_brake"), kind)


def mistakes(folder, text, kind=BRAKE404):
    with pytest.raises(RigError) as caught:
        read(folder, text, kind)
    assert caught.value.exit_status == 3
    return [line.removeprefix(f"{folder}/") for line in caught.value.errors]


def test_objects_are_found_by_number_and_by_name(tmp_path):
    plan = read(tmp_path, BRAKE_IO)
    assert [(line.key, line.terminal.field) for line in (*plan.outputs, *plan.inputs)] == [
        ((0x7300, 1), "out_brake_Nm"),
        ((0x7130, 1), "in_handle_Nm"),
        ((0x7130, 2), "in_coil_A"),
    ]
    assert plan.file.loop.watchdog_s == 0.05
    assert plan.outputs[0].where.endswith("io.toml:8")
    for name in ("7300:01", "7300h:1", "0x7300:0x01"):
        assert read(tmp_path, BRAKE_IO.replace("7300:01", name)).outputs[0].key == (0x7300, 1)


def line_of(text, word):
    return next(number for number, line in enumerate(text.splitlines(), 1) if word in line)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("safe = 0.0", "safe = 9.0", "output.0.safe: got '9.0', expected 0 to 4, the limits"),
        ("safe = 0.0", "saef = 0.0", "output.0.safe: missing in [output.0]"),
        ("safe = 0.0", "safe = nan", "output.0.safe: got 'nan', expected a number"),
        ("high = 4.0", "high = -1.0", "output.0.low: got '0.0', expected less than `high`, -1"),
        ("high = 4.0", "", "output.0.high: missing in [output.0]; expected a number"),
        (
            "raw_per_unit = 800.0 ",
            "raw_per_unit = 0.0 ",
            "output.0.raw_per_unit: got '0', expected a number other than 0",
        ),
        ("raw_per_unit = 800.0 ", 'raw_per_unit = "8"', "output.0.raw_per_unit: got '\"8\"', expected a number"),
        ("period_s = 0.001", "period_s = 0.1", "loop.watchdog_s: got '0.05', expected at least 3 times loop.period_s"),
        ("period_s = 0.001", "period_s = 0", "loop.period_s: got '0', expected a number from 0.0001 to 0.1"),
        ("period_s = 0.001", "period_s = 1 ms", "cannot be read"),
        ("[loop]", "[lop]", "lop: unknown section; expected one of the sections"),
        ('kind = "iio"', 'kind = "i2c"', 'output.0.kind: got \'"i2c"\', expected one of "iio", "pwm", "python"'),
        ('kind = "iio"', 'kind = "python"', "output.0.device: unknown key"),
        ('"7300:01"', '"7301:01"', "output.0.object: got '\"7301:01\"', expected an object of"),
        ('"7300:01"', '"7300:09"', "it has 7300:00, 7300:01"),
        ('"7300:01"', '"AO Output PV 1 (brake torqe)"', "did you mean 'AO Output PV 1 (brake torque)'?"),
        ('"7300:01"', '"Highest sub-index supported"', "expected one object; this is the name of"),
        ('"7300:01"', '"7130:01"', "expected no [[output]], as it is the device's other direction"),
        ('"7300:01"', '"1017"', "expected an object from 2000h on"),
        ('"AI Input PV 1 (handle torque)"', '"7130:02"', "input.1.object: is in [[input]] number 1 already"),
        ('"in_voltage1"', '"in_voltage0"', "input.1.channel: is in [[input]] number 1 already"),
        ('"in_voltage1"', '"voltage1"', "input.1.channel: got '\"voltage1\"', expected a text"),
        ("scaled = true", "scaled = 1", "input.1.scaled: got '1', expected true or false"),
    ],
)
def test_each_mistake_is_told_with_its_line(tmp_path, old, new, told):
    text = BRAKE_IO.replace(old, new, 1)
    found = mistakes(tmp_path, text)
    assert any(told in line for line in found), found
    assert all(line.startswith("io.toml:") and line.split(":")[1].isdigit() for line in found)


def test_all_mistakes_come_at_once(tmp_path):
    text = BRAKE_IO.replace('"7300:01"', '"7301:01"').replace("7130:02", "7139:02").replace("safe = 0.0", "safe = 7.0")
    assert len(mistakes(tmp_path, text)) == 3


@pytest.mark.parametrize("text", ["", "[loop]\nperiod_s = 0.002\n"])
def test_a_file_without_a_channel_is_refused(tmp_path, text):
    assert mistakes(tmp_path, text) == ["io.toml:1: got no channel; expected [[output]] or [[input]]"]


def test_a_pwm_duty_beyond_the_period_is_refused(tmp_path):
    text = BRAKE_IO.replace('kind = "iio"', 'kind = "pwm"\npwm_period_s = 1e-6', 1)
    text = text.replace('channel = "out_voltage0"', "channel = 0")
    found = mistakes(tmp_path, text)
    assert found == [
        f"io.toml:{line_of(text, 'high = 4.0')}: output.0.high: got '4.0', expected a value whose raw is 0 to 1000 ns, "
        "the period; here it is 3210"
    ]


def test_a_python_channel_needs_the_class(tmp_path):
    text = '[[input]]\nobject = "7130:01"\nkind = "python"\nchannel = "torque"\n'
    assert mistakes(tmp_path, text) == [
        "io.toml:3: input.0.kind: got 'python', but there is no class; expected [python] with `board`"
    ]


def test_what_is_the_brakes_alone_is_refused_elsewhere(tmp_path):
    found = mistakes(tmp_path, BRAKE_IO, GENERIC)
    assert found == ["io.toml:5: brake: the node is of kind generic; expected no such section"]


@pytest.mark.parametrize("what", ["missing", "folder", "bytes"])
def test_a_file_that_cannot_be_read_is_refused(tmp_path, what):
    path = tmp_path / "x.toml"
    if what == "folder":
        path.mkdir()
    if what == "bytes":
        path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RigError, match="expected an I/O file"):
        read_io_file(path, description("mr_brake"), BRAKE404)


def test_the_page_names_each_key():
    text = (ROOT / "docs" / "own-device.md").read_text()
    for model in (io_file.Loop, io_file.Brake, io_file.Python, io_file.IioOutput, io_file.PwmOutput, io_file.IioInput):
        for name in fields_of(model):
            assert re.search(rf"\b{name}\b", text), f"{model.__name__}.{name}"
