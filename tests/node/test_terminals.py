"""Where hardware is wired to a kind's core, and what it bounds there."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from coulombus.node import emcy
from coulombus.node.brake404 import BRAKE404
from coulombus.node.kinds import PROFILES
from coulombus.node.record import NODE
from node_bench import MS, Bench


@pytest.mark.parametrize("profile", PROFILES, ids=lambda profile: profile.name)
def test_each_terminal_is_a_field_of_the_record_and_an_object_of_the_kind(profile):
    for one in profile.terminals:
        field = NODE[one.field]
        assert one.field.startswith(("in_", "out_"))
        assert one.k < (field.shape[0] if field.shape else 0) or one.k == -1
        assert one.key in {row.key for row in profile.objects}
        assert all(name in NODE.names for name in (one.low, one.high) if name)
        assert one.is_output or not (one.low or one.high)


def test_the_brake_puts_out_no_more_than_its_board_may():
    bench = Bench("mr_brake", 2, BRAKE404)
    bench.node["board_Nm"] = 2.5
    bench.power_on()
    bench.frame(0x000, b"\x01\x02")
    for setpoint, wanted in ((2000, 2.0), (4000, 2.5)):
        bench.frame(0x202, struct.pack("<h", setpoint))
        bench.frame(0x080)
        assert bench.node["out_brake_Nm"] == pytest.approx(wanted)
    bench.node["coil_A_Nm"], bench.node["in_coil_degC"] = 0.3, 100.0  # derated: the coil allows 3.75 Nm
    bench.frame(0x080)
    assert bench.node["derated"] == 1
    assert bench.node["limit_Nm"] == 2.5


def test_hardware_that_fails_is_told_and_the_output_goes_to_0():
    bench = Bench("mr_brake", 2, BRAKE404)
    bench.power_on()
    bench.frame(0x000, b"\x01\x02")
    bench.frame(0x202, struct.pack("<h", 3000))
    bench.frame(0x080)
    assert bench.node["out_brake_Nm"] == pytest.approx(3.0)
    bench.sent.clear()
    bench.node["in_faults"] = 1 << emcy.HARDWARE - emcy.FIRST_DEVICE_CAUSE
    bench.frame(0x080)
    assert [frame.data[:3] for frame in bench.sent if frame.can_id == 0x082] == [b"\x00\x50\x01"]
    bench.until(bench.t + 1000 * MS)
    assert bench.node["out_brake_Nm"] == 0.0
    assert np.all(bench.node["causes"] >> emcy.HARDWARE & 1)
