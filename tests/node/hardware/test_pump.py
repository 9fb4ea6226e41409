"""The brake's core on converters that are files, in virtual time: what is put out, and each fault."""

from __future__ import annotations

import struct

import pytest

from coulombus.eds.cia301 import NmtState
from coulombus.node.brake404 import BRAKE404
from coulombus.node.hardware.channels import HardwareError, SysfsFile
from coulombus.node.hardware.io_file import read_io_file
from coulombus.node.hardware.pump import Pump
from coulombus.node.kinds import GENERIC
from fake_sysfs import BRAKE_IO, FakeGuard, FakeSysfs
from node_bench import MS, Bench, description

SAFE = 10  # the DAC's count at 0 Nm


class Rig:
    """A brake, its converters, and a host that sends a set-point and SYNC each period."""

    def __init__(self, folder, text=BRAKE_IO, kind=BRAKE404):
        self.sysfs = FakeSysfs(folder)
        self.guards, self.told = [], []
        plan = read_io_file(self.sysfs.io_file(text), description("mr_brake"), kind)
        self.pump = Pump(plan, self.guard, self.told.append)
        self.bench = Bench("mr_brake", 2, kind)

    def guard(self, *arguments):
        self.guards.append(FakeGuard(*arguments))
        return self.guards[-1]

    def start(self):
        self.pump.open()
        self.pump.attach(self.bench.device)
        self.bench.power_on()
        self.bench.nmt(1)
        return self

    def period(self, setpoint=None):
        if setpoint is not None:
            self.bench.frame(0x202, struct.pack("<h", setpoint))
            self.bench.sync()
        self.pump.period(self.bench.t)
        self.bench.run(MS)


@pytest.fixture
def rig(tmp_path):
    made = Rig(tmp_path)
    yield made
    made.pump.close()


def test_the_safe_value_is_written_and_read_back_before_anything_runs(rig):
    assert rig.sysfs.dac == 4095
    rig.pump.open()
    assert rig.sysfs.dac == SAFE
    assert [tuple(one) for one in rig.guards[0].orders] == [(str(rig.sysfs.folder / "dac/out_voltage0_raw"), "10\n")]
    assert len(rig.guards[0].claims) == 1
    assert rig.guards[0].fed == 0  # its watch begins with the loop


def test_setpoints_go_out_and_measurements_come_in(rig):
    rig.start()
    rig.sysfs.put("adc/in_voltage0_raw", "1848")
    rig.sysfs.put("adc/in_voltage1_raw", "1500")  # 750 mV: 0.75 A
    rig.period(2500)
    assert rig.sysfs.dac == SAFE + 2000
    assert rig.bench.number(0x7130, 1, signed=True) == -2000
    assert rig.bench.node["in_coil_A"] == pytest.approx(0.75)
    rig.period(4900)  # the EDS allows 5 Nm, the board 4
    assert rig.sysfs.dac == SAFE + 3200
    assert rig.bench.node["out_brake_Nm"] == 4.0
    assert rig.guards[0].fed == 2


def test_without_a_setpoint_the_ramp_reaches_the_converter(rig):
    rig.start()
    rig.period(2000)
    outputs = []
    for _ in range(700):
        rig.period()
        outputs.append(rig.sysfs.dac)
    assert outputs == sorted(outputs, reverse=True)
    assert SAFE < outputs[len(outputs) // 4] <= SAFE + 1600
    assert outputs[-1] == SAFE


def vanish(sysfs):
    (sysfs.folder / "adc/in_voltage0_raw").unlink()


def rubbish(sysfs):
    sysfs.put("adc/in_voltage0_raw", "12 monkeys")


def too_much(sysfs):
    sysfs.put("adc/in_voltage0_raw", "4000")


def nothing(sysfs):
    (sysfs.folder / "adc/in_voltage0_raw").write_text("")


def not_finite(sysfs):
    sysfs.put("adc/in_voltage1_raw", "nan")


def endless(sysfs):
    sysfs.put("adc/in_voltage0_raw", "1" * 4000)


def not_a_file(sysfs):
    vanish(sysfs)
    (sysfs.folder / "adc/in_voltage0_raw").mkdir()


@pytest.mark.parametrize("fault", [vanish, rubbish, too_much, nothing, not_finite, endless, not_a_file])
def test_a_failing_input_makes_the_output_safe_and_is_told_until_a_reset(rig, fault):
    rig.start()
    rig.period(3000)
    assert rig.sysfs.dac == SAFE + 2400
    rig.bench.sent.clear()
    fault(rig.sysfs)
    rig.period(3000)
    assert rig.sysfs.dac == SAFE
    rig.period(3000)
    assert [code for code, *_ in rig.bench.emcy()] == [0x5000]
    assert rig.bench.number(0x1001) & 1
    assert len(rig.told) == 1
    assert "the outputs are safe" in rig.told[0]

    rig.sysfs.mend()  # the DAC stands at 4095 again; nothing is put out for that
    for _ in range(150):
        rig.period(3000)
    assert rig.sysfs.dac == SAFE  # written again meanwhile
    rig.bench.nmt(129)
    rig.period()
    assert rig.pump.failure == ""
    rig.bench.nmt(1)
    rig.period(1000)
    rig.period(1000)
    assert rig.sysfs.dac == SAFE + 800
    assert rig.bench.number(0x1001) == 0


def test_a_reset_alone_does_not_help(rig):
    rig.start()
    vanish(rig.sysfs)
    rig.period(3000)
    rig.bench.nmt(129)
    rig.period()
    rig.bench.nmt(1)
    rig.period(3000)
    rig.period(3000)
    assert rig.sysfs.dac == SAFE
    assert rig.pump.failure
    assert rig.bench.number(0x1001) & 1
    assert [text.partition(";")[0] for text in rig.told] == [rig.told[0].partition(";")[0]] * 2


def test_a_watchdog_that_acts_again_at_the_reset_is_told_again(rig):
    """Nothing was told, and who waited for an answer to the reset waited for ever."""
    rig.start()
    rig.guards[0].trouble = why = "the node hung for 1 s, and its watchdog acted"
    rig.period()
    rig.bench.nmt(129)
    rig.guards[0].trouble = why
    rig.period()
    assert [why in text for text in rig.told] == [True, True]
    rig.bench.nmt(129)
    rig.period()
    assert rig.told[2:] == ["after the reset all converters answer again"]


def test_an_output_that_is_gone_is_told_as_not_safe(rig):
    rig.start()
    (rig.sysfs.folder / "dac/out_voltage0_raw").unlink()
    rig.period(3000)
    assert "NOT SAFE" in rig.told[0]
    assert "No such file" in rig.told[0]
    rig.period(3000)
    assert [code for code, *_ in rig.bench.emcy()] == [0x5000]


@pytest.mark.parametrize("why", ["the watchdog process is gone", "the node hung for 0.05 s"])
def test_a_watchdog_that_acted_or_is_gone_is_a_fault(rig, why):
    rig.start()
    rig.period(3000)
    rig.guards[0].trouble = why
    rig.period(3000)
    assert rig.sysfs.dac == SAFE
    assert why in rig.told[0]
    assert rig.bench.node["in_faults"]


def test_a_mistake_of_the_program_is_a_fault_too(rig, monkeypatch):
    rig.start()
    rig.period(3000)
    monkeypatch.setattr(rig.pump, "_read", lambda *arguments: 1 / 0)
    rig.period(3000)
    assert rig.sysfs.dac == SAFE
    assert "ZeroDivisionError" in rig.told[0]


def test_1029h_takes_the_node_to_its_error_state(rig):
    rig.start()
    rig.bench.write(0x1029, 2, 0, 1)
    vanish(rig.sysfs)
    rig.period(3000)
    rig.period()
    assert rig.bench.node["nmt"] == NmtState.PRE_OPERATIONAL


def test_the_end_is_safe(rig):
    rig.start()
    rig.period(3000)
    rig.pump.close()
    assert rig.sysfs.dac == SAFE
    assert rig.guards[0].closed == 1


def refused(rig):
    with pytest.raises(HardwareError) as caught:
        rig.pump.open()
    return str(caught.value)


def test_two_nodes_do_not_drive_one_output(rig, tmp_path):
    rig.pump.open()
    other = Rig(tmp_path)
    assert "another process drives it already" in refused(other)
    assert other.sysfs.dac == 4095  # untouched
    rig.pump.close()
    other.pump.open()
    other.pump.close()


def test_a_start_is_refused_where_a_file_is_not_there(rig):
    (rig.sysfs.folder / "dac/out_voltage0_raw").unlink()
    assert "it has no channel 'out_voltage0'; it has none" in refused(rig)


def test_a_start_is_refused_where_an_input_cannot_be_read_and_the_output_is_safe(rig):
    rubbish(rig.sysfs)
    assert "got '12 monkeys', expected a number" in refused(rig)
    assert rig.sysfs.dac == SAFE


def test_a_start_is_refused_where_the_safe_value_does_not_come_back(rig, monkeypatch):
    monkeypatch.setattr(SysfsFile, "read_back", lambda self: 11.0)
    assert "the safe value 10 was written, 11 is read back" in refused(rig)


def test_a_start_is_refused_without_the_right_to_write(rig, monkeypatch):
    def put(path, text):
        raise HardwareError(f"{path}: Permission denied")

    monkeypatch.setattr("coulombus.node.hardware.channels.put", put)
    assert "out_voltage0_raw: Permission denied" in refused(rig)


def test_an_object_without_a_kind_is_put_out_while_the_node_is_operational(tmp_path):
    rig = Rig(tmp_path, BRAKE_IO.replace('"7300:01"', '"7341:01"').replace("[brake]\ncoil_A_Nm = 0.3", ""), GENERIC)
    rig.start()
    rig.bench.write(0x7341, 1, 2, 2)
    rig.period()
    assert rig.sysfs.dac == SAFE + 1600
    assert rig.bench.device[0x7130, 1] == 0
    rig.bench.nmt(128)
    rig.period()
    assert rig.sysfs.dac == SAFE
    rig.pump.close()


PWM_IO = """
[[output]]
object = "7300:01"
kind = "pwm"
device = "{folder}/pwmchip0"
pwm_period_s = 5e-5
raw_per_unit = 10000.0
low = 0.0
high = 5.0
safe = 0.0
"""


def test_a_pwm_channel_is_set_up_safe_and_follows_the_output(tmp_path):
    rig = Rig(tmp_path, PWM_IO)
    rig.sysfs.put("pwmchip0/pwm0/period", "900000")
    rig.sysfs.put("pwmchip0/pwm0/duty_cycle", "800000")
    rig.start()
    names = ("period", "duty_cycle", "enable")
    assert [rig.sysfs.get(f"pwmchip0/pwm0/{name}") for name in names] == ["50000", "0", "1"]
    rig.period(2500)
    assert rig.sysfs.get("pwmchip0/pwm0/duty_cycle") == "25000"
    rig.pump.close()
    assert rig.sysfs.get("pwmchip0/pwm0/duty_cycle") == "0"


BOARD = '''
class Board:
    """A driver that keeps its values in a file."""

    def __init__(self):
        self.values = {"coil": 99.0}

    def read(self):
        return {"torque": 1.25, **self.values}

    def write(self, values):
        self.values.update(values)
'''

BOARD_IO = """
[python]
board = "board.py:Board"

[[output]]
object = "7300:01"
kind = "python"
channel = "coil"
low = 0.0
high = 5.0
safe = 0.0

[[input]]
object = "7130:01"
kind = "python"
channel = "torque"
"""


def test_a_python_class_is_read_and_written(tmp_path):
    (tmp_path / "board.py").write_text(BOARD)
    rig = Rig(tmp_path, BOARD_IO).start()
    rig.period(2500)
    assert rig.pump._board._object.values == {"coil": 2.5}
    assert rig.bench.node["in_handle_Nm"] == 1.25
    board = rig.pump._board._object
    board.read = lambda: {"torque": "much", "coil": 0}
    rig.period(2500)
    assert board.values == {"coil": 0.0}
    assert "got 'much', expected a finite number" in rig.told[0]
    rig.pump.close()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("class Board:\n    pass\n", "expected a class with read() and write(values)"),
        ("import nothing_of_that_name\n", "cannot be imported"),
        (BOARD.replace('self.values = {"coil": 99.0}', "raise OSError(5, 'no bus')"), "it cannot be made"),
        (BOARD.replace('return {"torque": 1.25, **self.values}', "return {}"), "read() gave no 'coil'"),
        (BOARD.replace('return {"torque": 1.25, **self.values}', "return 7"), "returned int, expected a mapping"),
        (BOARD.replace("self.values.update(values)", "1 / 0"), "write() raised ZeroDivisionError"),
        (BOARD.replace("self.values.update(values)", "pass"), "the safe value 0 was written, 99 is read back"),
    ],
)
def test_a_python_class_that_does_not_do_is_refused(tmp_path, change, told):
    (tmp_path / "board.py").write_text(change)
    assert told in refused(Rig(tmp_path, BOARD_IO))
