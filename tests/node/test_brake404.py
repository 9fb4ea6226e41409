"""The MR brake: set-point, hold, ramp, fault mode and value, input blocks."""

from __future__ import annotations

import struct

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from node_bench import MS, US, Bench, SdoAborted

HOLD_MS, RAMP_MS = 100, 500  # defaults of 2001h and 2005h


def brake(**settings: int) -> Bench:
    bench = Bench("mr_brake", 2)
    bench.power_on()
    bench.write(0x1400, 5, settings.get("deadline_ms", 10), 2)
    if "transmission" in settings:
        bench.write(0x1400, 2, settings["transmission"], 1)
    bench.nmt(1)
    bench.take()
    return bench


def command(bench: Bench, raw: int) -> None:
    """A set-point, received now, that acts on the SYNC of the same time."""
    bench.frame(0x202, raw.to_bytes(2, "little", signed=True))
    bench.sync()


def test_setpoint_acts_on_the_next_sync_with_its_decimals():
    bench = brake()
    bench.frame(0x202, (3500).to_bytes(2, "little"))
    assert bench.node.out_brake_Nm == 0
    bench.sync()
    assert bench.node.out_brake_Nm == pytest.approx(3.5)
    assert bench.number(0x7300, 1) == 3500


def test_setpoint_acts_at_once_with_transmission_255():
    bench = brake(transmission=255)
    bench.frame(0x202, (1200).to_bytes(2, "little"))
    assert bench.node.out_brake_Nm == pytest.approx(1.2)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(-32768, 32767), min_size=1, max_size=20))
@example([-1])
@example([-32768])
def test_output_is_never_negative_and_negatives_are_counted(raws):
    bench = brake()
    for raw in raws:
        command(bench, raw)
        assert bench.node.out_brake_Nm == pytest.approx(min(max(raw, 0), 5000) / 1000)
    assert bench.node.negative_setpoints == sum(raw < 0 for raw in raws)
    assert bench.number(0x7300, 1) == min(max(raws[-1], 0), 5000)


def test_setpoint_above_the_high_limit_is_clipped_and_counted():
    bench = brake()
    bench.node.setpoint_high = 4500  # as an EDS with a lower limit gives it
    command(bench, 4500)
    assert bench.node.clipped_setpoints == 0
    command(bench, 4501)
    command(bench, 32767)
    assert bench.node.out_brake_Nm == pytest.approx(4.5)
    assert bench.node.clipped_setpoints == 2


def test_negative_setpoint_over_sdo_is_refused():
    bench = brake()
    with pytest.raises(SdoAborted, match="06090032"):
        bench.write(0x7300, 1, -5, 2)
    assert bench.node.out_brake_Nm == 0
    bench.write(0x7300, 1, 5, 2)
    assert bench.node.out_brake_Nm == pytest.approx(0.005)


def test_hold_then_a_straight_ramp_to_zero():
    bench = brake()
    bench.run(3 * MS)
    command(bench, 2000)
    last = bench.t
    expected = {0: 2.0, 50: 2.0, 100: 2.0, 101: 2.0 * 499 / 500, 350: 1.0, 599: 2.0 / 500, 600: 0.0, 2000: 0.0}
    for elapsed_ms, output in expected.items():
        bench.until(last + elapsed_ms * MS)
        assert bench.node.out_brake_Nm == pytest.approx(output, abs=1e-12)
    codes = [code for code, _, _ in bench.emcy()]
    assert codes == [0x8250]


def test_the_ramp_is_a_line_whenever_it_is_computed():
    bench = brake()
    command(bench, 1000)
    bench.until(399 * MS + 999 * US + 999)
    bench.sync()
    assert bench.node.out_brake_Nm == pytest.approx(1 - 299.999999 / 500, abs=1e-9)


def test_ramp_goes_to_the_fault_value_up_or_down():
    for start, fault_value in ((2000, 500), (100, 500)):
        bench = brake()
        bench.write(0x7341, 1, fault_value, 2)
        command(bench, start)
        bench.until((HOLD_MS + RAMP_MS // 2) * MS)
        assert bench.node.out_brake_Nm == pytest.approx((start + fault_value) / 2000)
        bench.run(RAMP_MS * MS)
        assert bench.node.out_brake_Nm == pytest.approx(0.5)


def test_a_new_setpoint_ends_the_ramp():
    bench = brake()
    command(bench, 2000)
    bench.until(350 * MS)
    bench.frame(0x202, (1500).to_bytes(2, "little"))
    assert bench.node.out_brake_Nm == pytest.approx(1.0)
    bench.sync()
    assert bench.node.out_brake_Nm == pytest.approx(1.5)
    assert [code for code, _, _ in bench.emcy()] == [0x8250, 0x0000]
    bench.until(450 * MS)
    assert bench.node.out_brake_Nm == pytest.approx(1.5)
    bench.until(700 * MS)
    assert bench.node.out_brake_Nm == pytest.approx(1.5 * (1 - 250 / 500))


def test_fault_mode_0_keeps_the_output():
    bench = brake()
    bench.write(0x6340, 1, 0, 1)
    command(bench, 2000)
    bench.run(5000 * MS)
    assert bench.node.out_brake_Nm == pytest.approx(2.0)
    bench.nmt(129)  # a reset releases all the same
    bench.run(RAMP_MS * MS)
    assert bench.node.out_brake_Nm == 0


@pytest.mark.parametrize("nmt", [2, 128, 129, 130])
def test_leaving_operational_ramps_at_once_from_the_present_output(nmt):
    bench = brake()
    command(bench, 3000)
    bench.run(5 * MS)
    bench.nmt(nmt)
    assert bench.node.out_brake_Nm == pytest.approx(3.0)
    bench.run(250 * MS)
    assert bench.node.out_brake_Nm == pytest.approx(1.5)
    bench.run(250 * MS)
    assert bench.node.out_brake_Nm == 0
    assert bench.emcy() == []


def test_stop_from_pre_operational_ramps_too():
    bench = Bench("mr_brake", 2)
    bench.power_on()
    bench.write(0x2001, 0, 0, 4)  # the age of a set-point is not watched
    bench.write(0x7300, 1, 3000, 2)
    bench.run(200 * MS)
    assert bench.node.out_brake_Nm == pytest.approx(3.0)
    bench.nmt(2)
    bench.run(RAMP_MS * MS)
    assert bench.node.out_brake_Nm == 0


def test_ramp_time_0_is_at_once():
    bench = brake()
    bench.write(0x2005, 0, 0, 4)
    command(bench, 3000)
    bench.until(HOLD_MS * MS)
    assert bench.node.out_brake_Nm == 0


def test_power_off_is_no_current():
    bench = brake()
    command(bench, 3000)
    bench.device.power_off()
    assert bench.node.out_brake_Nm == 0


def test_coil_fault_tells_and_ramps_and_bars_setpoints_while_it_lasts():
    bench = brake()
    command(bench, 3000)
    bench.node.in_faults = 1 << 3
    bench.sync()
    assert bench.emcy() == [(0x5410, 0x21, 0)]
    bench.run(250 * MS)
    command(bench, 3000)
    assert bench.node.out_brake_Nm == pytest.approx(1.5)
    bench.run(250 * MS)
    assert bench.node.out_brake_Nm == 0
    bench.node.in_faults = 0
    bench.sync()
    command(bench, 1000)
    assert bench.node.out_brake_Nm == pytest.approx(1.0)


def test_input_blocks_have_decimals_and_saturate():
    bench = brake()
    bench.node.in_handle_Nm, bench.node.in_coil_A, bench.node.in_coil_degC = -1.2345, 0.7004, 22.46
    bench.sync()
    raw = struct.unpack("<hhh", bench.take(0x182)[0].data)
    assert raw in ((-1234, 700, 225), (-1235, 700, 225))  # 3, 3, 1 decimals; a half may go either way
    bench.node.in_handle_Nm, bench.node.in_coil_A, bench.node.in_coil_degC = 40.0, -40.0, float("nan")
    bench.sync()
    assert struct.unpack("<hhh", bench.take(0x182)[0].data) == (32767, -32768, -32768)


def test_input_scaling_factor_and_offset():
    bench = brake()
    bench.download(0x6126, 1, struct.pack("<f", -2.0))
    bench.download(0x6127, 1, struct.pack("<f", 0.5))
    bench.node.in_handle_Nm = 1.25
    assert bench.number(0x7130, 1, signed=True) == round((1.25 * -2.0 + 0.5) * 1000)
    bench.device[0x6132, 1] = 1
    assert bench.device[0x7130, 1] == -20


def test_no_scale_gives_more_than_full_scale():
    bench = brake()
    bench.write(0x7322, 1, 3000, 2)  # a line that is at full scale, 5 Nm, at 3000 already
    command(bench, 1500)
    assert bench.node.out_brake_Nm == pytest.approx(2.5)
    command(bench, 5000)
    assert bench.node.out_brake_Nm == pytest.approx(5.0)
    assert bench.number(0x7330, 1) == 1000
    bench.write(0x7341, 1, 5000, 2)  # nor as a fault value
    bench.run((HOLD_MS + RAMP_MS) * MS)
    assert bench.node.out_brake_Nm == pytest.approx(5.0)
