"""A raw client beside a live host: it says what only the host or a device may say, in every mode.

Function is asserted, never speed: that it acts in the same cycle is tested in virtual time.
"""

from __future__ import annotations

import struct

import pytest

from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.wire.client import pack_frame
from real_bench import HOLD, Observer, host, result, simulation

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.patient,
    pytest.mark.usefixtures("private_sockets"),
    pytest.mark.skipif(JIT_DISABLED, reason="plain Python is no real-time loop"),
]
BUS = "coulombus:stranger"
DISABLE = b"\x00\x00"
SENT = 4
"""Times that a stranger says it: a frame that collides with the host's own of the same identifier is
not heard by the host, which is in the midst of its error flag (docs/bus.md).
"""


def download(index, subindex, value):
    return struct.pack("<BHBI", 0x23, index, subindex, value)


SAID = {
    "motor set-point": (0x201, struct.pack("<Hh", 0x0F, 97), "SECOND_HOST"),
    "motor set-point, short": (0x201, b"\x0f", ("SECOND_HOST", "EMCY_MOTOR")),  # the drive complains, too
    "brake set-point": (0x202, struct.pack("<h", 4500), "SECOND_HOST"),
    "drive's torque limit": (0x601, download(0x6072, 0, 3000), "SECOND_HOST"),
    "set-point's age": (0x601, download(0x2001, 0, 0), "SECOND_HOST"),
    "RPDO deadline": (0x602, download(0x1400, 5, 0), "SECOND_HOST"),
    "heartbeat consumer": (0x602, download(0x1016, 1, 0), "SECOND_HOST"),
    "block download": (0x601, b"\xc6" + download(0x1016, 1, 64)[1:], "SECOND_HOST"),
    "SYNC": (0x080, b"", "SECOND_HOST"),
    "host's heartbeat": (0x77F, b"\x05", "SECOND_HOST"),
    "EMCY of 6 bytes": (0x082, b"\x10\x23\x01\x00\x00\x00", "EMCY_BRAKE"),
    "EMCY of 2 bytes": (0x081, b"\x10\x23", "EMCY_MOTOR"),
    "EMCY of no byte": (0x081, b"", "EMCY_MOTOR"),
}
FEW = {"motor set-point", "brake set-point", "EMCY of 2 bytes"}
"""One of a kind: a run for each takes seconds."""


@pytest.mark.parametrize(
    ("mode", "said"),
    [
        *(pytest.param("hybrid", said, marks=() if said in FEW else pytest.mark.thorough) for said in SAID),
        ("active", "drive's torque limit"),
        *(
            pytest.param("active", said, marks=pytest.mark.thorough)
            for said in ("motor set-point", "brake set-point", "EMCY of 6 bytes")
        ),
    ],
)
def test_what_a_stranger_says_makes_the_rig_safe(mode, said):
    can_id, data, trip = SAID[said]
    overrides = (f"phase={HOLD}",)
    with (
        simulation(BUS, mode=mode, overrides=overrides),
        Observer(BUS) as observer,
        host(BUS, mode=mode, overrides=overrides) as run,
    ):
        observer.until_enabled(run)
        observer.watch(1.7)
        assert run.poll() is None, result(run)
        before = len(observer.log)
        for _ in range(SENT):
            observer.client.send(pack_frame(can_id, data))
            observer.watch(0.0037)
        observer.until(run, lambda can_id, data: can_id == 0x201 and data[:2] == DISABLE)
        status, found, err = result(run)
    assert status == 7, err
    assert found["trip"].startswith(trip)
    commands = [data for _, can_id, data in observer.log[before:] if can_id == 0x201]
    sent_on = next(k for k, data in enumerate(commands) if data[:2] == DISABLE)
    assert all(data == b"\x00\x00\x00\x00" for data in commands[sent_on:])


@pytest.mark.thorough
@pytest.mark.parametrize("mode", ["hybrid", "active"])
def test_who_only_reads_disturbs_nobody(mode):
    overrides = (f"phase={HOLD}",)
    with (
        simulation(BUS, mode=mode, overrides=overrides),
        Observer(BUS) as observer,
        host(BUS, mode=mode, overrides=overrides, seconds=3.0) as run,
    ):
        observer.until_enabled(run)
        for _ in range(10):
            assert observer.upload(1, 0x6072)[1] >= 0
            observer.watch(0.02)
        observer.client.send(pack_frame(0x703, b"\x05"))  # a node that the rig does not have
        status, found, err = result(run)
    assert (status, found["trip"]) == (0, None), err
