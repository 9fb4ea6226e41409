"""The buffer of an IIO device: scans of every layout, and each way in which they fail."""

from __future__ import annotations

import errno
import os
import struct

import pytest

from coulombus.node.brake404 import BRAKE404
from coulombus.node.hardware import iio_buffer
from coulombus.node.hardware.channels import HardwareError
from coulombus.node.hardware.iio_buffer import IioBuffer, NoBuffer
from coulombus.node.hardware.io_file import read_io_file
from coulombus.node.hardware.pump import Pump
from fake_sysfs import BRAKE_IO, FakeGuard, FakeSysfs
from node_bench import MS, Bench, description

STALE_NS = 50 * MS
BUFFERED = BRAKE_IO.replace('channel = "in_', 'buffered = true\nchannel = "in_')
TYPES = {"in_voltage0": "le:u12/16>>4", "in_voltage1": "be:s16/16>>0"}


class Trigger:
    """An ADC with a buffer, and who starts its scans."""

    def __init__(self, folder, types=None, **options):
        self.sysfs = FakeSysfs(folder)
        self.sysfs.buffered(**(types or TYPES), **options)
        self.fd = os.open(folder / "dev" / "adc", os.O_RDWR | os.O_NONBLOCK)

    def raw(self, data):
        os.write(self.fd, data)

    def scan(self, torque=2048, coil=0):
        self.raw(struct.pack("<H", torque << 4) + struct.pack(">h", coil))


@pytest.fixture
def make(tmp_path, monkeypatch):
    monkeypatch.setattr(iio_buffer, "DEV", tmp_path / "dev")
    made = []

    def trigger(types=None, **options):
        made.append(Trigger(tmp_path, types, **options))
        return made[-1]

    yield trigger
    for one in made:
        os.close(one.fd)


def buffer(trigger, *channels):
    return IioBuffer(trigger.sysfs.folder / "adc", channels, STALE_NS)


@pytest.mark.parametrize(
    ("kind", "stored", "value"),
    [
        ("le:s12/16>>4", struct.pack("<H", 0xFFF0 | 0x5), -1),
        ("le:u12/16>>4", struct.pack("<H", 0xFFF0), 4095),
        ("be:s12/16>>0", struct.pack(">H", 0xF800), -2048),
        ("be:u24/32>>8", struct.pack(">I", 0x12345600), 0x123456),
        ("le:s8/8>>0", b"\x80", -128),
        ("le:s64/64>>0", struct.pack("<q", -(2**63)), -(2**63)),
        ("le:s16/16X1>>0", struct.pack("<h", -7), -7),
    ],
)
def test_a_count_is_read_as_its_type_says(make, kind, stored, value):
    trigger = make({"in_voltage0": kind})
    one = buffer(trigger, "in_voltage0")
    trigger.raw(stored)
    one.open(0.0)
    assert one.count("in_voltage0") == value
    one.close()


def test_each_channel_is_aligned_to_its_size_and_the_scan_to_the_largest(make):
    trigger = make({"in_a": "le:u8/8>>0", "in_b": "le:u32/32>>0", "in_c": "le:u16/16>>0"})
    one = buffer(trigger, "in_c", "in_a", "in_b")
    assert one.size == 12
    trigger.raw(struct.pack("<BxxxIHxx", 1, 2, 3))
    one.open(0.0)
    assert [one.count(name) for name in ("in_a", "in_b", "in_c")] == [1, 2, 3]
    one.close()


def test_it_is_on_with_its_channels_alone_and_off_at_the_end(make):
    trigger = make()
    one = buffer(trigger, "in_voltage1")
    trigger.raw(struct.pack(">h", 5))
    one.open(0.0)
    scans = {name: trigger.sysfs.get(f"adc/scan_elements/{name}_en") for name in (*TYPES, "in_timestamp")}
    assert scans == {"in_voltage0": "0", "in_voltage1": "1", "in_timestamp": "0"}
    assert trigger.sysfs.get("adc/buffer/enable") == "1"
    one.close()
    assert trigger.sysfs.get("adc/buffer/enable") == "0"


def test_the_newest_scan_counts_also_behind_a_torn_one(make):
    trigger = make()
    one = buffer(trigger, *TYPES)
    trigger.scan(1, 1)
    one.open(0.0)
    trigger.scan(2, 2)
    trigger.scan(3, 3)
    trigger.raw(b"\x40")  # the first byte of the next one
    one.refresh(0)
    assert (one.count("in_voltage0"), one.count("in_voltage1")) == (3, 3)
    trigger.raw(b"\x00\x00\x09")
    one.refresh(MS)
    assert (one.count("in_voltage0"), one.count("in_voltage1")) == (4, 9)
    one.close()


def test_a_trigger_that_stops_is_a_fault_and_no_torque_that_stays(make):
    trigger = make()
    one = buffer(trigger, *TYPES)
    trigger.scan()
    one.open(0.0)
    one.refresh(0)
    one.refresh(STALE_NS)
    with pytest.raises(HardwareError, match="no scan for 51 ms; the trigger stopped"):
        one.refresh(STALE_NS + MS)
    one.close()


def test_what_cannot_be_is_told(make, tmp_path):
    trigger = make()
    one = buffer(trigger, *TYPES)
    with pytest.raises(HardwareError, match=r"no scan within 0 s; does the trigger run\?"):
        one.open(0.0)
    one.close()
    with pytest.raises(HardwareError, match="No such file"):
        buffer(trigger, "in_voltage7")
    for kind in ("le:s12", "le:s20/16>>0", "le:s12/16>>8", "xe:s12/16>>4", "le:s16/16X2>>0", "le:s12/12>>0"):
        trigger.sysfs.put("adc/scan_elements/in_voltage0_type", kind)
        with pytest.raises(HardwareError, match="in_voltage0_type"):
            buffer(trigger, "in_voltage0")
    trigger.sysfs.put("adc/trigger/current_trigger", "")
    with pytest.raises(NoBuffer, match="no trigger is set"):
        buffer(trigger, "in_voltage0")


# behind a node


class Node:
    def __init__(self, folder, text=BUFFERED):
        self.told, path = [], folder / "io.toml"
        path.write_text(text.replace("{folder}", str(folder)))
        self.pump = Pump(read_io_file(path, description("mr_brake"), BRAKE404), FakeGuard, self.told.append)
        self.bench = Bench("mr_brake", 2, BRAKE404)

    def start(self):
        self.pump.open()
        self.pump.attach(self.bench.device)
        self.bench.power_on()
        self.bench.nmt(1)

    def period(self):
        self.pump.period(self.bench.t)
        self.bench.run(MS)


def test_a_node_reads_its_inputs_from_the_buffer(make, tmp_path):
    trigger, node = make(), Node(tmp_path)
    trigger.scan()
    node.start()
    trigger.scan(torque=2148, coil=500)  # 1 Nm; 500 counts of 0.5 mV
    node.period()
    assert not node.pump.failure
    assert node.bench.device.record["in_handle_Nm"] == pytest.approx(1.0)
    assert node.bench.device.record["in_coil_A"] == pytest.approx(0.25)
    node.pump.close()
    assert trigger.sysfs.get("adc/buffer/enable") == "0"


@pytest.mark.parametrize("fault", ["stale", "gone"])
def test_a_buffer_that_fails_makes_the_output_safe(make, tmp_path, monkeypatch, fault):
    trigger, node = make(), Node(tmp_path)
    trigger.scan()
    node.start()
    node.period()
    trigger.sysfs.put("dac/out_voltage0_raw", "2000")
    if fault == "gone":

        def gone(fd, size):
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

        monkeypatch.setattr(iio_buffer.os, "read", gone)
    for _ in range(60):
        node.period()
    assert ("trigger stopped" if fault == "stale" else "No such device") in node.pump.failure
    assert trigger.sysfs.dac == 10
    monkeypatch.undo()
    node.pump.close()


def test_a_device_without_a_buffer_is_read_one_by_one_and_that_is_told(tmp_path):
    sysfs = FakeSysfs(tmp_path)
    sysfs.put("adc/in_voltage0_raw", "2148")
    node = Node(tmp_path)
    node.start()
    node.period()
    assert node.bench.device.record["in_handle_Nm"] == pytest.approx(1.0)
    assert [one for one in node.told if "it has no buffer; its channels are read one by one" in one]
    node.pump.close()
