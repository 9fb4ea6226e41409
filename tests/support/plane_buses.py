"""The packaged arm with its joints on two buses, at 1 kHz."""

from __future__ import annotations

ONE_CYCLE = (
    'axis.shoulder.bus.channel="a"',
    'axis.elbow.bus.channel="b"',
    "bus.period_s=0.001",
    "bus.tpdo_window_s=800e-6",
    "law.velocity_window_cycles=8",
)
