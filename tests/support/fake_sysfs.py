"""Converters as files: what `coulombus node --io` finds of a DAC, an ADC, a PWM chip and a counter,
below a folder of the test.
"""

from __future__ import annotations

import os
from pathlib import Path

from coulombus.node.hardware.channels import HardwareError

BRAKE_IO = """
[loop]
period_s = 0.001

[brake]
coil_A_Nm = 0.3

[[output]]
object = "7300:01"
kind = "iio"
device = "{folder}/dac"
channel = "out_voltage0"
raw_per_unit = 800.0      # counts for 1 Nm
raw_at_zero = 10.0
low = 0.0
high = 4.0
safe = 0.0

[[input]]
object = "AI Input PV 1 (handle torque)"
kind = "iio"
device = "{folder}/adc"
channel = "in_voltage0"
raw_per_unit = 100.0
raw_at_zero = 2048.0
low = -10.0
high = 10.0

[[input]]
object = "7130:02"
kind = "iio"
device = "{folder}/adc"
channel = "in_voltage1"
scaled = true
raw_per_unit = 1000.0     # mV for 1 A
"""


class FakeSysfs:
    """A DAC (12 bits, stands at 4095), an ADC with handle torque 0 and coil current 0, a PWM chip
    with channel 0 exported, a counter.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.mend()

    def mend(self) -> None:
        """Put everything as it is at first."""
        for folder in (self.folder / "adc").glob("*/"):
            if not any(folder.iterdir()):
                folder.rmdir()
        self.put("dac/name", "mcp4725")
        self.put("dac/out_voltage0_raw", "4095")
        self.put("adc/name", "mcp3208")
        self.put("adc/in_voltage0_raw", "2048")
        self.put("adc/in_voltage1_raw", "0")
        self.put("adc/in_voltage_scale", "0.5")
        self.put("pwmchip0/export", "")
        self.put("pwmchip0/pwm0/period", "0")
        self.put("pwmchip0/pwm0/duty_cycle", "0")
        self.put("pwmchip0/pwm0/enable", "0")
        self.put("counter0/count0/count", "123456")

    def buffered(self, trigger: str = "rtc", **types: str) -> None:
        """Give the ADC a buffer; `types` are its channels' types in a scan, in their order.

        ``dev/adc`` is the FIFO behind it.
        """
        for index, (channel, kind) in enumerate(types.items()):
            self.put(f"adc/scan_elements/{channel}_en", "0")
            self.put(f"adc/scan_elements/{channel}_index", str(index))
            self.put(f"adc/scan_elements/{channel}_type", kind)
        self.put("adc/scan_elements/in_timestamp_en", "1")
        self.put("adc/buffer/length", "0")
        self.put("adc/buffer/enable", "0")
        self.put("adc/trigger/current_trigger", trigger)
        (self.folder / "dev").mkdir(exist_ok=True)
        os.mkfifo(self.folder / "dev" / "adc")

    def put(self, name: str, text: str) -> None:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{text}\n")

    def get(self, name: str) -> str:
        return (self.folder / name).read_text().strip()

    @property
    def dac(self) -> int:
        """What the DAC was given last; while another process writes it a plain file is empty, which one
        of sysfs never is.
        """
        texts = (self.get("dac/out_voltage0_raw") for _ in range(100_000))
        return int(next(filter(None, texts), ""))

    def io_file(self, text: str = BRAKE_IO) -> Path:
        path = self.folder / "io.toml"
        path.write_text(text.replace("{folder}", str(self.folder)))
        return path


class FakeGuard:
    """A watchdog that only counts."""

    def __init__(self, watchdog_s, orders, claims):
        self.watchdog_s, self.orders, self.claims = watchdog_s, list(orders), list(claims)
        self.fed, self.closed, self.trouble = 0, 0, ""

    def feed(self):
        self.fed += 1
        if self.trouble:
            trouble, self.trouble = self.trouble, ""
            raise HardwareError(trouble)

    def close(self):
        self.closed += 1
