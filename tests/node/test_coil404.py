"""The brake driver's coil: current limit, temperature, open and short, the pulse; and the blocks'
scales and status.
"""

from __future__ import annotations

import struct

import pytest

from node_bench import MS, Bench, SdoAborted

A_NM = 0.2
TPDO, OPEN, SHORT, HOT = 0x182, 0x5410, 0x2320, 0x4210


class Coil:
    """A brake under a SYNC each ms, with a coil that the test makes good or bad."""

    def __init__(self, hold_us: int = 0) -> None:
        self.bench = Bench("mr_brake", 2)
        self.bench.node.coil_A_Nm = A_NM
        self.bench.power_on()
        self.bench.write(0x2001, 0, hold_us, 4)
        self.bench.nmt(1)
        self.bench.take()
        self.state = "good"

    @property
    def out(self) -> float:
        return float(self.bench.node.out_brake_Nm)

    def run(self, ms: int, raw: int | None = None) -> None:
        bench = self.bench
        for _ in range(ms):
            if raw is not None:
                bench.frame(0x202, raw.to_bytes(2, "little", signed=True))
            driven = self.out if self.out > 0 else 0.0
            reverse = float(bench.node.out_reverse_A)
            bench.node.in_coil_A = {
                "good": driven * A_NM - reverse,
                "open": 0.0,
                "short": 25.0 if driven > 0 else 0.0,
                "weak": 0.3 * driven * A_NM,
            }[self.state]
            bench.sync()
            bench.run(MS)

    def codes(self) -> list[int]:
        return [code for code, _, _ in self.bench.emcy()]


def test_a_good_coil_and_one_that_draws_a_third_are_no_fault():
    coil = Coil()
    coil.run(300, 4000)
    coil.state = "weak"
    coil.run(300, 4000)
    assert coil.out == pytest.approx(4.0)
    assert coil.codes() == []


def test_open_coil_is_found_after_its_time_ramps_off_and_wants_a_zero():
    coil = Coil()
    coil.run(10, 4000)
    coil.state = "open"
    coil.run(49, 4000)
    assert coil.codes() == []
    coil.run(3, 4000)
    assert coil.codes() == [OPEN]
    assert coil.bench.number(0x1001) == 0x21
    assert coil.bench.number(0x1003, 1) == OPEN
    coil.run(250, 4000)
    assert coil.out == pytest.approx(2.0, abs=0.05)
    coil.run(260, 4000)
    assert coil.out == 0
    coil.state = "good"
    coil.run(20, 4000)  # it cannot know
    assert (coil.out, coil.codes()) == (0, [])
    coil.run(2, 0)
    assert coil.codes() == [0x0000]
    coil.run(2, 1000)
    assert coil.out == pytest.approx(1.0)


def test_open_coil_below_the_least_current_is_not_looked_for():
    coil = Coil()
    coil.state = "open"
    coil.run(200, 250)  # 50 mA
    assert coil.codes() == []
    coil.bench.write(0x2010, 3, 20, 4)
    coil.bench.write(0x2010, 4, 10_000, 4)
    coil.run(9, 250)
    assert coil.codes() == []
    coil.run(5, 250)
    assert coil.codes() == [OPEN]


def test_short_circuit_is_off_at_once():
    coil = Coil()
    coil.run(10, 4000)
    coil.state = "short"
    coil.run(1, 4000)
    assert coil.out == 0
    assert coil.codes() == [SHORT]
    assert coil.bench.number(0x1001) == 0x03
    coil.state = "good"
    coil.run(5, 3000)
    assert coil.out == 0
    coil.run(2, 0)
    coil.run(2, 3000)
    assert coil.out == pytest.approx(3.0)
    assert coil.codes() == [0x0000]


def test_the_current_is_limited():
    coil = Coil()
    coil.bench.write(0x2010, 1, 500, 4)
    coil.run(5, 4000)
    assert coil.out == pytest.approx(0.5 / A_NM)
    assert coil.bench.number(0x7330, 1) == 500  # per mille of 5 Nm


@pytest.mark.parametrize(("degC", "share"), [(20, 1.0), (90, 1.0), (95, 0.875), (100, 0.75), (110, 0.5)])
def test_derating_above_the_warning_temperature(degC, share):
    coil = Coil()
    coil.bench.write(0x2010, 1, 600, 4)
    coil.bench.node.in_coil_degC = float(degC)
    coil.run(3, 5000)
    assert coil.out == pytest.approx(min(share * 0.6 / A_NM, 5.0))
    coil.bench.node.in_coil_degC = 20.0
    coil.run(3, 5000)
    assert coil.out == pytest.approx(3.0)


def test_over_temperature_ramps_off_with_hysteresis():
    coil = Coil()
    coil.run(5, 2000)
    coil.bench.node.in_coil_degC = 110.5
    coil.run(2, 2000)
    assert coil.codes() == [HOT]
    assert coil.bench.number(0x1001) == 0x09
    coil.run(250, 2000)
    assert coil.out == pytest.approx(1.0, abs=0.05)
    coil.run(260, 2000)
    assert coil.out == 0
    coil.bench.node.in_coil_degC = 100.5
    coil.run(5, 2000)
    assert (coil.out, coil.codes()) == (0, [])
    coil.bench.node.in_coil_degC = 99.5
    coil.run(3, 2000)
    assert coil.codes() == [0x0000]
    assert coil.out > 0


def test_a_device_fault_ends_at_zero_also_from_a_fault_value():
    coil = Coil(hold_us=5000)
    coil.bench.write(0x7341, 1, 1000, 2)
    coil.run(2, 1000)
    coil.run(600)
    assert coil.out == pytest.approx(1.0)
    coil.bench.node.in_coil_degC = 150.0
    coil.run(600)
    assert coil.out == 0


def test_the_pulse_comes_once_after_the_release_with_its_delay_and_length():
    coil = Coil()
    coil.bench.write(0x2012, 1, 40, 4)
    coil.bench.write(0x2012, 2, 6000, 4)
    coil.bench.write(0x2012, 3, 10_000, 4)
    coil.run(20, 3000)
    seen = []
    for _ in range(60):
        coil.run(1, 0)
        seen.append(float(coil.bench.node.out_reverse_A))
        assert coil.out == 0
    assert set(seen) == {0.0, 0.04}
    assert sum(value > 0 for value in seen) == 6
    assert 8 <= seen.index(0.04) <= 11
    coil.run(20, 3000)
    coil.run(12, 0)
    assert coil.bench.node.out_reverse_A == 0.04
    coil.run(2, 500)
    assert (coil.bench.node.out_reverse_A, coil.out) == (0, pytest.approx(0.5))


def test_a_fault_that_outlives_reset_node_is_told_behind_the_boot_up():
    bench = Bench("mr_brake", 2)
    bench.node.in_faults = 1 << 3
    for start in (bench.power_on, lambda: bench.nmt(129)):
        start()
        bench.run(MS)
        assert [sent.can_id for sent in bench.take()] == [0x702, 0x82]
        assert bench.number(0x1001) == 0x21


def test_no_pulse_by_default():
    coil = Coil()
    coil.run(20, 3000)
    for _ in range(60):
        coil.run(1, 0)
        assert coil.bench.node.out_reverse_A == 0


def test_output_scale():
    coil = Coil()
    bench = coil.bench
    bench.write(0x7323, 1, 500, 2)  # 5000 counts are half of full scale
    coil.run(2, 4000)
    assert coil.out == pytest.approx(2.0)
    bench.write(0x7321, 1, 100, 2)  # and 0 is a tenth
    coil.run(2, 0)
    assert coil.out == pytest.approx(0.5)
    coil.run(2, 5000)
    assert coil.out == pytest.approx(2.5)
    assert bench.number(0x7330, 1) == 500
    with pytest.raises(SdoAborted, match="06040043"):
        bench.write(0x7320, 1, 5000, 2)
    with pytest.raises(SdoAborted, match="06090031"):
        bench.write(0x7323, 1, 1001, 2)
    bench.write(0x7321, 1, 1000, 2)
    bench.write(0x7323, 1, 0, 2)  # upside down, and still never below 0
    coil.run(2, 5000)
    assert coil.out == 0


def test_input_status_span_and_operating_mode():
    coil = Coil()
    bench = coil.bench
    for k, value in ((1, -1000), (2, 0), (3, 0)):
        bench.write(0x7148, k, value, 2)
    bench.write(0x7149, 1, 2000, 2)
    for torque, raw, status in ((0.5, 500, 0), (2.0, 2000, 0), (2.1, 2100, 2), (-1.1, -1100, 4), (99.0, 32767, 2)):
        bench.node.in_handle_Nm = torque
        assert bench.number(0x7130, 1, signed=True) == raw
        assert bench.number(0x6150, 1) == status
    bench.node.in_coil_degC = float("nan")
    assert bench.number(0x6150, 3) == 1
    bench.write(0x6112, 1, 0, 1)
    assert (bench.number(0x7130, 1), bench.number(0x6150, 1)) == (0, 1)
    bench.write(0x6112, 1, 1, 1)
    bench.node.in_handle_Nm = 0.25
    assert (bench.number(0x7130, 1), bench.number(0x6150, 1)) == (250, 0)


def test_auto_zero_and_offset():
    coil = Coil()
    bench = coil.bench
    bench.download(0x6126, 1, struct.pack("<f", 2.0))
    bench.node.in_handle_Nm = 0.75
    with pytest.raises(SdoAborted, match="06090030"):
        bench.write(0x6125, 1, 1, 4)
    bench.write(0x6125, 1, int.from_bytes(b"zero", "little"), 4)
    assert bench.number(0x7130, 1) == 0
    assert struct.unpack("<f", bench.upload(0x6124, 1))[0] == pytest.approx(-1.5)
    bench.node.in_handle_Nm = 1.0
    assert bench.number(0x7130, 1) == 500
    bench.node.in_handle_Nm = -22.0
    bench.download(0x6126, 1, struct.pack("<f", 3.4e38))
    bench.write(0x6125, 1, int.from_bytes(b"zero", "little"), 4)
    assert struct.unpack("<f", bench.upload(0x6124, 1))[0] == pytest.approx(3.4028235e38)
    for value in (float("nan"), float("inf")):
        with pytest.raises(SdoAborted, match="06090030"):
            bench.download(0x6124, 1, struct.pack("<f", value))
