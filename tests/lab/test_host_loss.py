"""Loss of the host, for each class of drive, kind of brake and way to notice it: what `check`
prints is held against what the simulated rig does.
"""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.lab.set_up import set_up
from coulombus.rigs.device_services import life_of
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.faults.fault_file import read_faults
from coulombus.sim_bus.faults.injection import Injection
from coulombus.sim_bus.network.event_loop import MOTOR
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from foreign_rigs import brake, drive, written

MS = 1_000_000
SECOND = 1_000_000_000
AFTER_S = 1.2
"""From Operation Enabled to the fault: in mid-stroke, motor and brake both have torque."""
FRAME_NS = 300_000  # a frame that is on the wire still comes, and a device acts on the next step

DRIVES = ("own", "A", "B", "C", "D")
BRAKES = ("own", "404", "401", "402")
WATCHES = ("deadline", "heartbeat", "guarding")
RIGS = [("own", "own", "all"), ("own", "404", "sync")] + [
    (one, BRAKES[(k + n) % len(BRAKES)], watch) for n, watch in enumerate(WATCHES) for k, one in enumerate(DRIVES[1:])
]
"""Each class of drive with each watch, and each brake with each watch."""


class Lost:
    """A rig that displays, whose host is lost after `AFTER_S` s."""

    def __init__(self, rig, tmp_path, halves=None):
        self.world = world = VirtualRig(rig, "hybrid", seed=1)
        if halves is not None:
            file = tmp_path / "faults.toml"
            file.write_text(
                f'[[fault]]\nkind = "cut"\nat_s = {AFTER_S}\nafter = "enabled"\nhalves = {json.dumps(halves)}\n'
            )
            Injection(world, read_faults(file), 1)
        set_up(world)
        world.start_host()
        world.run_until(2 * SECOND, lambda: world.enabled_ns is not None)
        self.t_ns = world.enabled_ns + round(AFTER_S * SECOND)
        world.run_until(self.t_ns)
        assert world.controller.trip is None
        assert abs(self.torque) > 10
        assert self.brake_Nm > 1.0

    @property
    def torque(self):
        """The motor's torque [per mille of its rated torque]."""
        return float(self.world.nodes[MOTOR]["out_torque_pm"])

    @property
    def brake_Nm(self):
        """The torque that the brake's driver commands."""
        return float(self.world.plant[0]["brake_Nm"])

    def at(self, after_s):
        """Let time pass to `after_s` s after the fault."""
        self.world.run_until(self.t_ns + round(after_s * SECOND) + FRAME_NS)
        return self

    def hang(self, for_s):
        """The host stands still, and then goes on where it was."""
        self.world.stop_host()
        t_ns = self.t_ns + round(for_s * SECOND)

        def go_on(world):
            for one in world.controllers:
                one.host["next_ns"] = world.t_ns
            world._world["host_on"] = 1

        self.world.at(t_ns, go_on)


def checked(file, overrides):
    """What `check --json` says of each device when the bus is cut, and for how long it says so."""
    options = [text for one in overrides for text in ("--set", one)]
    result = CliRunner().invoke(main, ["check", "--rig", str(file), "--json", *options])
    said = json.loads(result.stdout)
    assert said["ok"], said["problems"]
    found = {(one["device"], one["fault"]): one for one in said["reactions"]}
    for device in ("motor", "brake"):
        assert found[device, "host dies"] | {"fault": ""} == found[device, "bus cut"] | {"fault": ""}
        assert found[device, "host dies"] | {"fault": ""} == found[device, "host hangs"] | {"fault": ""}
    return found["motor", "host dies"], found["brake", "host dies"]


@pytest.mark.parametrize(
    ("drive_", "brake_", "watch"),
    [pytest.param(*rig, id="-".join(rig), marks=[pytest.mark.thorough] if n > 3 else []) for n, rig in enumerate(RIGS)],
)
def test_motor_and_brake_are_off_within_the_printed_time(tmp_path, drive_, brake_, watch):
    file, overrides = written(tmp_path, drive(drive_, watch), brake(brake_, watch))
    motor, brake_s = checked(file, overrides)
    rig = load_rig(str(file), overrides)
    first, last = sorted((motor["safe_s"], brake_s["safe_s"]))

    def held(lost, motor_s, brake_off_s):
        for at in sorted((motor_s, brake_off_s)):
            lost.at(at)
            assert at < motor_s or lost.torque == 0
            assert at < brake_off_s or lost.brake_Nm == 0
        return lost

    killed = Lost(rig, tmp_path)
    killed.world.stop_host()
    held(killed, motor["safe_s"], brake_s["safe_s"])
    hung = Lost(rig, tmp_path)
    hung.hang(last + 0.01)
    held(hung, motor["safe_s"], brake_s["safe_s"])
    for after_s in (0.02, 0.05, 0.2, 0.5):  # it goes on, and finds what it left in a fault
        hung.at(last + after_s)
        assert hung.torque == 0
    assert hung.world.controller.trip is not None
    assert hung.at(last + 1.5).brake_Nm == 0

    axis = rig.one_axis()
    host_s = (axis.limits.missed_tpdo_cycles + 2) * axis.bus.period_s
    tells = any(pdo.node == "brake" and pdo.layout.direction == "tpdo" for pdo in axis.pdos())
    brakes_s = host_s if tells else axis.brake.heartbeat_timeout_s + 2 * axis.bus.period_s
    ramped_s = host_s + axis.limits.safe_hold_s + axis.limits.safe_ramp_s + 2 * axis.bus.period_s
    others = [one for one in axis.devices if one not in ("motor", "brake")]
    held(Lost(rig, tmp_path, [["motor"], ["host", "brake", *others]]), motor["safe_s"], ramped_s)
    held(Lost(rig, tmp_path, [["brake"], ["host", "motor", *others]]), brakes_s, brake_s["safe_s"])
    assert first <= last


@pytest.mark.parametrize(
    ("setting", "who", "within_s", "safe_s"),
    [
        ("brake.hold_s=0.05", "set-point age 2001h", 0.05, 0.55),
        ("brake.ramp_s=0", "set-point age 2001h", 0.1, 0.1),
        ("brake.hold_s=0", "heartbeat consumer 1016h:01", 0.15, 0.65),  # 0 switches the watch of the age off
    ],
)
def test_our_own_brake_is_ramped_off_by_the_rig_files_times(tmp_path, setting, who, within_s, safe_s):
    file, overrides = written(tmp_path, drive("own"), brake("own"))
    _, said = checked(file, (*overrides, setting))
    assert (said["who"], said["within_s"], said["safe_s"]) == (who, within_s, pytest.approx(safe_s))
    lost = Lost(load_rig(str(file), (*overrides, setting)), tmp_path)
    lost.world.stop_host()
    assert lost.at(within_s - 0.051).brake_Nm > 1.0  # not at once; the heartbeat was at most 50 ms old
    assert lost.at(safe_s).brake_Nm == 0


@pytest.mark.parametrize(
    ("guard_s", "timeout_s", "life"), [(0.05, 0.15, (50, 3)), (0.01, 0.07, (10, 7)), (0.04, 0.15, (40, 4))]
)
def test_the_life_time_is_no_shorter_than_the_rig_files_and_printed_as_it_is(tmp_path, guard_s, timeout_s, life):
    assert life_of(guard_s, timeout_s) == life
    file, overrides = written(tmp_path, drive("A", "guarding"), brake("own"))
    options = (*overrides, f"host.heartbeat_s={guard_s}", f"motor.heartbeat_timeout_s={timeout_s}")
    said, _ = checked(file, options)
    assert said["within_s"] == said["safe_s"] == pytest.approx(life[0] * life[1] * 1e-3)


@pytest.mark.parametrize(("drive_", "brake_"), [("A", "404"), ("B", "401"), ("C", "402"), ("D", "401")])
def test_what_was_acknowledged_to_notice_nothing_keeps_its_set_point(tmp_path, drive_, brake_):
    says = '"motor: no reaction to the host\'s loss", "brake: no reaction to the host\'s loss"'
    file, overrides = written(tmp_path, drive(drive_, "none"), brake(brake_, "none"), accept=says)
    for one in checked(file, overrides):
        assert (one["who"], one["within_s"], one["safe_s"]) == ("", None, None)
        assert one["what"] == "its last set-point stays"
    lost = Lost(load_rig(str(file), overrides), tmp_path)
    torque, brake_Nm = lost.torque, lost.brake_Nm
    lost.world.stop_host()
    lost.at(3.0)
    assert (lost.torque, lost.brake_Nm) == (torque, brake_Nm)
