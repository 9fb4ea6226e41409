"""Faults in the whole stack: whatever fails, torque goes to zero, the brake is ramped, and the
reason is told.
"""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.host.cycle.records import Trip
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.sim_bus.network.event_loop import BRAKE, MOTOR

MS = 1_000_000
SECOND = 1_000_000_000


def emcys(recording):
    """(t_s, node, error code) of every EMCY in a recording."""
    frames = recording.frames
    some = frames[np.isin(frames["can_id"], (0x81, 0x82)) & (frames["length"] == 8)]
    return [(f["t_ns"] * 1e-9, int(f["can_id"]) & 0x7F, int(f["word"]) & 0xFFFF) for f in some if f["word"] & 0xFFFF]


def when_enabled(world, delay_ns, action):
    """Call `action(world)` `delay_ns` after Operation Enabled."""

    def look(w):
        if w.enabled_ns is None:
            w.at(w.t_ns + MS, look)
        else:
            w.at(w.enabled_ns + delay_ns, action)

    world.at(MS, look)


@pytest.mark.parametrize(("node", "mode"), [(MOTOR, "hybrid"), (BRAKE, "hybrid"), (MOTOR, "active"), (BRAKE, "active")])
def test_a_node_powered_off_makes_the_other_one_safe(tmp_path, node, mode):
    seen = {}

    def off(world):
        world.power_off(node)
        seen["world"], seen["t_ns"] = world, world.t_ns
        world.at(world.t_ns + 20 * MS, lambda w: seen.update(torque=w.nodes[MOTOR].out_torque_pm))

    result = simulate(
        "bench",
        mode,
        8.0,
        record=tmp_path / "r.pcapng",
        truth=tmp_path / "t.npz",
        script=lambda world: when_enabled(world, 5 * SECOND + 500 * MS, off),
    )  # in mid-stroke
    assert result.exit_status == 7
    assert result.trip.startswith("TPDO_LOST")
    # the host needs three cycles to be sure, and one to tell
    world = seen["world"]
    assert world.controller.host["trip_ns"][0] - seen["t_ns"] <= 5 * MS
    if node == BRAKE:
        assert seen["torque"] == 0.0
    else:
        assert world.nodes[BRAKE].out_brake_Nm == 0.0  # ramped off by the end of the run
        setpoint = read(tmp_path / "r.pcapng")["brake.setpoint_Nm"]
        assert setpoint.values[-1] == 0.0
        if mode == "hybrid":
            trip_s = world.controller.host["trip_ns"][0] * 1e-9
            ramp = setpoint.t_s > trip_s + 0.003
            released = setpoint.values[ramp]
            assert np.max(released) <= 3.5
            assert np.all(np.diff(released) <= 0)
            assert np.max(-np.diff(released)) <= 4.5 / 1800 + 0.0011  # a count is 1 mNm
            assert setpoint.t_s[setpoint.values > 0][-1] - trip_s == pytest.approx(1.2, abs=0.02)
    target = read(tmp_path / "r.pcapng")["motor.target_torque_Nm"]
    after = target.t_s > (seen["t_ns"] + 5 * MS) * 1e-9
    assert np.all(target.values[after] == 0)


@pytest.mark.parametrize(("mode", "at_s"), [("active", 2.5), ("active", 5.5), ("hybrid", 5.7)])
def test_the_host_gone_silent(tmp_path, mode, at_s):
    """Both nodes become safe inside their own deadlines, and say so."""
    seen = {}

    def die(world):
        world.stop_host()
        t = world.t_ns
        seen["t_ns"] = t
        world.at(t + 5 * MS, lambda w: seen.update(early=float(w.nodes[MOTOR].out_torque_pm)))
        world.at(t + 90 * MS, lambda w: seen.update(held=float(w.nodes[BRAKE].out_brake_Nm)))
        world.at(t + 400 * MS, lambda w: seen.update(ramping=float(w.nodes[BRAKE].out_brake_Nm)))
        world.at(
            t + 700 * MS,
            lambda w: seen.update(off=float(w.nodes[BRAKE].out_brake_Nm), fault=int(w.nodes[MOTOR].power_state)),
        )

    simulate(
        "bench", mode, 8.0, record=tmp_path / "r.pcapng", script=lambda w: when_enabled(w, round(at_s * SECOND), die)
    )
    told = [(t - seen["t_ns"] * 1e-9, node, code) for t, node, code in emcys(read(tmp_path / "r.pcapng"))]
    assert seen["early"] == 0.0
    for node in (1, 2):
        codes = {code: t for t, n, code in told if n == node}
        assert codes[0x8250] <= 0.013  # RPDO deadline 10 ms
        assert codes[0x8130] <= 0.22  # heartbeat 150 ms after the last one, at most 50 ms before
        assert 0x8700 in codes
    assert min(t for t, n, _ in told if n == 1) <= 0.1
    assert seen["fault"] in (6, 7)
    if mode == "hybrid":
        assert seen["held"] > 2.5
        assert 0.2 < seen["ramping"] < seen["held"]
    assert seen["off"] == 0.0


def test_a_pdo_of_the_wrong_length_changes_nothing(tmp_path):
    def inject(world):
        for _ in range(3):
            world.send(0x201, b"\x0f\x00\xff")  # too short for controlword and torque
            world.send(0x202, b"\x01")

    result = simulate(
        "bench", "hybrid", 3.0, record=tmp_path / "r.pcapng", script=lambda w: when_enabled(w, 2 * SECOND, inject)
    )
    codes = {code for _, _, code in emcys(read(tmp_path / "r.pcapng"))}
    assert codes == {0x8210}  # PDO not processed due to length error
    assert result.trip.startswith("EMCY")


def test_unknown_identifiers_are_ignored(tmp_path):
    def inject(world):
        for can_id in (0x001, 0x07F, 0x101, 0x33, 0x455, 0x7E5, 0x77E, 0x6FF):
            world.send(can_id, b"\xff" * 8)

    result = simulate(
        "bench", "hybrid", 4.0, record=tmp_path / "r.pcapng", script=lambda w: when_enabled(w, 2 * SECOND, inject)
    )
    assert result.trip is None
    assert result.hold_counts_p2p <= 2


@pytest.mark.parametrize("mode", ["active", "hybrid"])
@pytest.mark.parametrize("key", ["motor_polarity", "encoder_polarity", "transducer_polarity"])
def test_a_reversed_sign_is_refused_before_the_law_runs(tmp_path, mode, key):
    result = simulate("bench", mode, 3.0, truth=tmp_path / "t.npz", overrides=(f"plant.{key}=-1",))
    assert result.exit_status == 7
    assert result.trip.startswith(("SIGN_ENCODER", "SIGN_TRANSDUCER"))
    with np.load(tmp_path / "t.npz") as truth:
        assert np.max(np.abs(truth["angle_rad"])) < 0.25


def test_an_emcy_of_the_drive_trips(tmp_path):
    def fault(world):
        world.nodes[MOTOR].in_supply_ok = 0
        world.nodes[MOTOR].next_ns = world.t_ns

    result = simulate(
        "bench", "hybrid", 3.0, record=tmp_path / "r.pcapng", script=lambda w: when_enabled(w, 2 * SECOND, fault)
    )
    assert result.exit_status == 7
    assert result.trip.startswith(("EMCY_MOTOR", "VOLTAGE", "DRIVE_STATE"))
    assert emcys(read(tmp_path / "r.pcapng"))


def test_the_drive_limits_a_torque_command_beyond_its_limit():
    """A host gone mad: its RPDO asks for 32 Nm, the drive gives 6072h at most."""
    seen = []

    def shout(world):
        def again(w):
            w.send(0x201, b"\x0f\x00" + (20_000).to_bytes(2, "little", signed=True))
            seen.append(float(w.nodes[MOTOR].out_torque_pm))
            if len(seen) < 30:
                w.at(w.t_ns + 200_000, again)

        again(world)

    simulate("bench", "hybrid", 3.0, script=lambda w: when_enabled(w, 2 * SECOND, shout))
    limit = int(0.168 / (0.18 * 9.587 / 1000))
    assert max(seen) <= limit


def test_a_full_disk_ends_the_run_safely(tmp_path, monkeypatch):
    from coulombus.recording import pcapng_writer

    real = pcapng_writer.os.write
    written = {"bytes": 0}

    def full(fd, data):
        written["bytes"] += len(data)
        if written["bytes"] > 800_000:
            raise OSError(28, "No space left on device")
        return real(fd, data)

    monkeypatch.setattr(pcapng_writer.os, "write", full)
    result = simulate("bench", "hybrid", 8.0, record=tmp_path / "r.pcapng")
    assert result.exit_status == 7
    assert "RECORDING" in result.trip
    assert "No space left" in result.trip
    assert result.cycles < 7000
    assert len(read(tmp_path / "r.pcapng").frames) > 1000  # what was written before stays readable


def test_trip_codes_have_words():
    from coulombus.host.cycle.trip_text import TRIP_TEXT

    assert set(TRIP_TEXT) == set(Trip) - {Trip.NONE}
