"""Where the kernel keeps its converters, and what it says of them."""

from __future__ import annotations

import pytest

from coulombus.node.hardware import channels
from coulombus.node.hardware.channels import HardwareError, PwmOutput, SafeWrite, counter, find, iio
from fake_sysfs import FakeSysfs


@pytest.fixture
def sysfs(tmp_path, monkeypatch):
    for name in ("IIO", "PWM", "COUNTERS"):
        monkeypatch.setattr(channels, name, tmp_path)
    return FakeSysfs(tmp_path)


def test_a_device_is_found_by_folder_by_number_and_by_name(sysfs):
    assert find(sysfs.folder, str(sysfs.folder / "adc")) == sysfs.folder / "adc"
    assert find(sysfs.folder, "adc") == sysfs.folder / "adc"
    assert find(sysfs.folder, "mcp3208") == sysfs.folder / "adc"
    with pytest.raises(HardwareError, match=r"no device 'mcp9'; there are: adc \(mcp3208\), dac \(mcp4725\)"):
        find(sysfs.folder, "mcp9")
    with pytest.raises(HardwareError, match="folder not found"):
        find(sysfs.folder, "/nowhere/adc")
    sysfs.put("dac/name", "mcp3208")
    with pytest.raises(HardwareError, match="2 devices are called 'mcp3208'"):
        find(sysfs.folder, "mcp3208")


def test_a_channel_has_its_own_scale_and_offset_or_those_of_its_type(sysfs):
    sysfs.put("adc/in_voltage0_raw", "100")
    assert iio("adc", "in_voltage0", scaled=False).read() == 100.0
    assert iio("adc", "in_voltage0", scaled=True).read() == 50.0
    sysfs.put("adc/in_voltage0_scale", "2.0")
    sysfs.put("adc/in_voltage0_offset", "-20")
    channel = iio("adc", "in_voltage0", scaled=True)
    assert channel.read() == 160.0
    channel.write(161.0)
    assert sysfs.get("adc/in_voltage0_raw") == "100"
    assert channel.spelled(161.0) == 160.0
    assert list(channel.orders(300.0)) == [SafeWrite(str(sysfs.folder / "adc/in_voltage0_raw"), "170\n")]
    sysfs.put("adc/in_voltage0_scale", "0")
    with pytest.raises(HardwareError, match="the scale of in_voltage0 is 0"):
        iio("adc", "in_voltage0", scaled=True)


def test_a_shorter_number_leaves_nothing_of_the_longer(sysfs):
    channel = iio("adc", "in_voltage0", scaled=False)
    channel.write(4000.0)
    channel.write(-7.4)
    assert sysfs.get("adc/in_voltage0_raw") == "-7"


def test_a_counter_is_read(sysfs):
    assert counter("counter0", "count0").read() == 123456.0
    with pytest.raises(HardwareError, match="No such file"):
        counter("counter0", "count1").read()


def test_a_pwm_channel_is_exported_where_it_is_not(sysfs):
    PwmOutput("pwmchip0", 3, 1000)
    assert sysfs.get("pwmchip0/export") == "3"


def test_a_pwm_channel_that_somebody_switched_off_fails(sysfs):
    pwm = PwmOutput("pwmchip0", 0, 1000)
    pwm.set_up(200.0)
    assert pwm.read_back() == 200.0
    pwm.write(5000.0)
    assert pwm.read_back() == 1000.0
    sysfs.put("pwmchip0/pwm0/enable", "0")
    with pytest.raises(HardwareError, match="it is switched off"):
        pwm.read_back()
