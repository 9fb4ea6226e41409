"""Device faults on purpose, as docs/devices.md tells them: its table is walked, in the whole
simulated rig, by scripts.
"""

from __future__ import annotations

import re

import pytest

from coulombus.host.sdo.sdo_client import SdoClient
from coulombus.lab.set_up import set_up
from coulombus.lab.simulate import simulate
from coulombus.rigs.rig import load_rig, load_rig_text
from coulombus.sim_bus.network.script import FAULTS, ScriptEntry, ScriptError, read_script
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from eds_edit import SENSOR
from node_bench import EDS
from places import RIGS, ROOT

MS = 1_000_000
DOCS = ROOT / "docs" / "devices.md"
NODE = {"motor": 1, "brake": 2}


def rows():
    section = DOCS.read_text().split("## Device faults on purpose")[1].split("\n## ")[0]
    found = []
    for line in section.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if cells[0] in NODE:
            found.append((cells[0], cells[1].strip("`"), int(cells[2][:-1], 16), int(cells[3][:-1], 16), *cells[4:]))
    return found


ROWS = rows()


def test_the_table_has_every_fault_of_every_node():
    assert {(row[0], row[1]) for row in ROWS} == {(node, fault) for node in FAULTS for fault in FAULTS[node]}
    assert len(ROWS) == 9


class Master:
    """A rig under a master of 1 kHz that is no host of ours: SYNC and both RPDOs."""

    def __init__(self, *overrides: str) -> None:
        self.frames = []
        keep = lambda batch: self.frames.extend((int(f["can_id"]), int(f["word"])) for f in batch)  # noqa: E731
        self.world = VirtualRig(load_rig("bench", ("operator.tremor_Nm=0.0", *overrides)), "hybrid", on_frames=keep)
        set_up(self.world)
        self.torque, self.raw = 90, 3000
        for word in (0x06, 0x07, 0x0F):
            self.cycle(2, word)

    def cycle(self, ms: int, word: int = 0x0F) -> None:
        world = self.world
        for _ in range(ms):
            world.send(0x080, b"")
            world.send(0x201, word.to_bytes(2, "little") + self.torque.to_bytes(2, "little"))
            world.send(0x202, self.raw.to_bytes(2, "little"))
            world.wait_ns(MS)

    def emcy(self, node: str) -> list[tuple[int, int]]:
        """Take the EMCYs of a node: (code, register)."""
        self.world.flush()
        taken = [(word & 0xFFFF, word >> 16 & 0xFF) for can_id, word in self.frames if can_id == 0x80 + NODE[node]]
        self.frames.clear()
        return taken

    def read(self, node: str, index: int, subindex: int = 0) -> int:
        return int.from_bytes(SdoClient(self.world, NODE[node]).upload(index, subindex), "little")


@pytest.mark.parametrize(("node", "fault", "code", "register", "state", "output", "reset"), ROWS)
def test_the_table(node, fault, code, register, state, output, reset):
    master = Master("brake.ramp_s=0.1")
    world = master.world
    motor, brake = world.nodes[0], world.nodes[1]
    master.cycle(20)
    assert (motor.out_torque_pm, brake.out_brake_Nm) == (90, pytest.approx(3.0))
    assert master.emcy(node) == []
    begin = world.t_ns + 5 * MS + 300_000
    world.plan(
        [
            ScriptEntry(begin, node, "fault", "start", fault),
            ScriptEntry(begin + 400 * MS, node, "clear", "start", fault),
        ]
    )
    master.cycle(5)
    assert (motor.out_torque_pm, brake.out_brake_Nm) == (90, pytest.approx(3.0))  # not before its time
    outputs = []
    while not (emcy := master.emcy(node)):
        assert world.t_ns < begin + 60 * MS
        outputs.append(brake.out_brake_Nm)
        master.cycle(1)
    assert emcy == [(code, register)]
    if fault != "coil_open":
        assert world.t_ns <= begin + 2 * MS
    if output.startswith("torque 0"):
        assert motor.out_torque_pm == 0
        assert brake.out_brake_Nm == pytest.approx(3.0)  # the other device goes on
    elif output == "0 at once":
        assert brake.out_brake_Nm == 0
    else:
        assert output == "ramp to 0"
        assert 2.8 < brake.out_brake_Nm <= 3.0
        master.cycle(50)
        assert 1.2 < brake.out_brake_Nm < 1.7
        master.cycle(60)
        assert brake.out_brake_Nm == 0
    assert state == ("FAULT" if node == "motor" else "OPERATIONAL")
    if node == "motor":
        assert master.read(node, 0x6041) & 0x4F == 0x08
        assert master.read(node, 0x603F) == code
    assert (motor if node == "motor" else brake).nmt == 5
    assert master.read(node, 0x1001) == register
    assert master.read(node, 0x1003, 1) & 0xFFFF == code
    if node == "motor":  # the fault reset is refused while the cause is there
        master.cycle(2, 0x00)
        master.cycle(2, 0x80)
        assert motor.power_state == 7
    while world.t_ns < begin + 410 * MS:
        master.cycle(1, 0x00 if node == "motor" else 0x0F)
        assert (motor if node == "motor" else brake)["out_torque_pm" if node == "motor" else "out_brake_Nm"] == 0 or (
            world.t_ns >= begin + 400 * MS
        )
    # and the reset that the table tells
    assert "cause gone" in reset
    if "fault reset" in reset:
        assert master.emcy(node) == []
        for word in (0x80, 0x06, 0x07, 0x0F):
            master.cycle(2, word)
        assert motor.out_torque_pm == 90
    else:
        if "set-point 0" in reset:
            assert brake.out_brake_Nm == 0
            assert master.emcy(node) == []
            master.raw = 0
            master.cycle(3)
            master.raw = 3000
        master.cycle(3)
        assert brake.out_brake_Nm == pytest.approx(3.0)
    assert master.emcy(node) == [(0x0000, 0x00)]
    assert master.read(node, 0x1001) == 0
    assert master.read(node, 0x1003, 1) & 0xFFFF == code  # the history remembers


def test_a_lost_encoder_stands_still():
    master = Master()
    master.torque, master.raw = 0, 0
    master.cycle(50)
    master.world.plant[0].v = 5.0
    master.world.inject(0, "encoder_lost", True)
    before = int(master.world.nodes[0].in_position_counts)
    master.cycle(3)
    assert master.world.plant[0].v > 0.1
    assert int(master.world.nodes[0].in_position_counts) == before
    assert master.world.nodes[0].out_torque_pm == 0


def test_over_temperature_comes_by_itself_from_a_coil_that_gets_warm():
    heat = ("plant.coil_thermal_K_W=1000.0", "plant.coil_thermal_s=1.0", "plant.temperature_degC=85.0")
    master = Master(*heat, "brake.ramp_s=0.1")
    master.cycle(40)
    assert master.emcy("brake") == [(0x4210, 0x09)]
    master.cycle(120)
    assert master.world.nodes[1].out_brake_Nm == 0
    shown = master.read("brake", 0x7130, 3) / 10
    assert shown == pytest.approx(float(master.world.plant[0].temperature), abs=0.5)


SCRIPT = """
[[at]]
t_s = 0.25
node = "brake"
action = "fault"
fault = "coil_open"
after = "enabled"

[[at]]
t_s = 1
node = "brake"
action = "clear"
"""


def test_scripts_with_faults_are_read(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(SCRIPT)
    assert read_script(path) == (
        ScriptEntry(250 * MS, "brake", "fault", "enabled", "coil_open"),
        ScriptEntry(1000 * MS, "brake", "clear", "start", None),
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('fault = "coil_open"\n', ""), "entry 1 of .*the key fault is missing; expected .*coil_open"),
        (('"coil_open"', '"encoder_lost"'), "entry 1 .*encoder_lost.*expected for node = \"brake\".*coil_short"),
        (('"fault"\n', '"reset"\n'), "entry 1 .*fault = 'coil_open'; expected with action"),
        (('"clear"', '"repair"'), "entry 2 .*repair.*expected .*\"clear\""),
        (('"coil_open"', "7"), "entry 1 .*fault = 7"),
        (('"coil_open"', "[1]"), "entry 1 .*fault ="),
    ],
)  # fmt: skip
def test_wrong_faults_are_refused_with_the_entry(tmp_path, change, message):
    path = tmp_path / "s.toml"
    path.write_text(SCRIPT.replace(*change))
    with pytest.raises(ScriptError, match=message):
        read_script(path)


def test_a_script_may_name_a_sensor_and_an_axis(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text('[[at]]\nt_s = 0.2\nnode = "cell"\naction = "power_off"\nafter = "enabled"\n')
    with pytest.raises(ScriptError, match=r"entry 1 .*node = 'cell'; expected \"motor\" or \"brake\"$"):
        read_script(path)
    entries = read_script(path, ["motor", "brake", "cell"])
    bench = (RIGS / "bench.toml").read_text() + SENSOR
    eds = {name: (EDS / name).read_text() for name in ("motor.eds", "mr_brake.eds")}
    rig = load_rig_text(bench, "r.toml", {**eds, "cell.eds": eds["mr_brake.eds"]})
    result = simulate(rig, "hybrid", 1.0, script=lambda world: world.plan(entries))
    assert result.trip.startswith("TPDO_LOST: ")
    path.write_text(path.read_text().replace('"cell"', '"right.motor"'))
    entries = read_script(path, [node.name for node in load_rig("two_axes").nodes])
    result = simulate("two_axes", "hybrid", 1.0, script=lambda world: world.plan(entries))
    assert result.trip.startswith("axis right: ")


def test_a_sensor_has_the_faults_of_every_node_only(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(SCRIPT.replace('"brake"', '"cell"'))
    with pytest.raises(ScriptError, match=r'entry 1 .*fault = .*expected for node = "cell": "heartbeat_off" or "pdo'):
        read_script(path, ["cell"])


@pytest.mark.parametrize("text", ["", "# nothing\n", "at = []\n"])
def test_a_script_in_which_nothing_stands_is_refused(tmp_path, text):
    path = tmp_path / "s.toml"
    path.write_text(text)
    with pytest.raises(ScriptError, match=r"s\.toml: it has no entry; expected \[\[at\]\]"):
        read_script(path)


def test_the_same_script_gives_the_same_bytes_and_the_host_trips(tmp_path):
    script = (ScriptEntry(500 * MS, "motor", "fault", "enabled", "encoder_lost"),)
    runs = []
    for name in ("a", "b"):
        record = tmp_path / f"{name}.pcapng"
        result = simulate("bench", "hybrid", 1.0, record=record, script=lambda world: world.plan(script))
        runs.append(record.read_bytes())
        assert result.exit_status == 7
        assert re.match("EMCY|DRIVE|FAULT|MOTOR", result.trip), result.trip
    assert runs[0] == runs[1]
