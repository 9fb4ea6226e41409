"""Rigs that lack a transducer, coil sensors or a measured torque, or have them on nodes of their
own: every verb works on them, and says what is not there.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.analysis.figures.report import hold_lines
from coulombus.analysis.figures.rig import write_fig14, write_identification, write_stick_figure
from coulombus.analysis.rig.hold import hold_study
from coulombus.analysis.rig.through_bus import bus_cycle
from coulombus.cli.main import main
from coulombus.lab.demo.demo import judge
from coulombus.lab.demo.traces import figure_14, traces
from coulombus.lab.replay.host_replay import host_replay
from coulombus.lab.simulate import simulate
from coulombus.monitor.decode import rows
from coulombus.monitor.live import Live
from coulombus.monitor.screen import as_dict
from coulombus.recording.friction.identify import IdentifyError, identify
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.recording.reading import blocks
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import data_bytes
from eds_edit import SENSOR
from foreign_rigs import brake, drive, rig_of
from places import CORPUS, beside

HOLD_AND_STROKE = """phase=[{kind="rest", duration_s=0.6},
{kind="hold", duration_s=1.2, push_F_s=0.6, frequency_Hz=1.0, taps_s=[0.3], tap_Nm=0.6, tap_s=0.01},
{kind="stroke", duration_s=2.4, speed_rad_s=2.0, move_s=0.6, dwell_s=0.6}]""".replace("\n", " ")
SECONDS = 4.2


def none(*roles):
    return "".join(f'\n[role.{role}]\nobject = "none"\n' for role in roles)


COIL = ("coil_current", "coil_temperature")
FIVE = SENSOR + "".join(
    SENSOR.replace("cell]", f"{name}]").replace("node_id = 3", f"node_id = {node_id}").partition("[role")[0]
    + f'\n[role.{role}]\nnode = "{name}"\nobject = "{place}"\n'
    for name, node_id, role, place in (("coil", 4, COIL[0], "7130:2"), ("heat", 5, COIL[1], "7130:3"))
)
RIGS = {
    "no handle torque": none("handle_torque"),
    "no sensor": none("handle_torque", "torque", *COIL),
    "no torque": none("torque"),
    "sensors on nodes of their own": FIVE,
}


class Recorded:
    """A rig, and recordings of it in two modes."""

    def __init__(self, name, folder):
        self.name, self.measured, self.torque = name, "handle" not in name and name != "no sensor", name == "no torque"
        period = ("bus.period_s=0.002", "bus.tpdo_window_s=0.0016") if name.startswith("sensors") else ()
        self.rig = rig_of(drive("own"), brake("own"), HOLD_AND_STROKE, *period, text=RIGS[name])
        self.paths = {mode: folder / f"{mode}.pcapng" for mode in ("active", "hybrid")}
        self.results = {m: simulate(self.rig, m, SECONDS, record=path) for m, path in self.paths.items()}


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(name, id=name.replace(" ", "-"), marks=[pytest.mark.thorough] if n else [])
        for n, name in enumerate(RIGS)
    ],
)
def recorded(request, tmp_path_factory):
    return Recorded(request.param, tmp_path_factory.mktemp("r"))


def test_demo_judges_what_can_be_judged(recorded, tmp_path):
    assert all(result.trip is None for result in recorded.results.values())
    last = judge(recorded.rig, recorded.results)[-1]
    assert last.holds is (True if recorded.measured else None)
    assert ("not measured, the rig has no handle torque" in last.found) is not recorded.measured
    data = {mode: traces(blocks(path), mode) for mode, path in recorded.paths.items()}
    for one in data.values():
        assert (len(one.handle_Nm) > 0) is recorded.measured
        assert one.handle_label.endswith(" measured" if recorded.measured else " not measured")
        assert len(one.velocity_rad_s) > 1000
    figure_14({mode: (mode, blocks(path)) for mode, path in recorded.paths.items()}, tmp_path / "demo.png")
    assert (tmp_path / "demo.png").stat().st_size > 5000


def test_identify_says_what_it_lacks(recorded, tmp_path):
    path = recorded.paths["active"]
    if not recorded.measured:
        with pytest.raises(IdentifyError, match=r"does not measure the hand's torque.*role.handle_torque"):
            identify(path)
        return
    found = identify(path)
    told = [text for text in found.remarks if "the motor's torque is not measured" in text]
    assert bool(told) is recorded.torque
    assert found.device.coulomb_Nm.value == pytest.approx(0.14, abs=0.03)
    assert write_identification(tmp_path / "f.png", found).exists()


@pytest.mark.thorough
def test_decode_replay_and_watch_take_it(recorded):
    path = recorded.paths["hybrid"]
    assert host_replay(path).difference is None
    recording = blocks(path)
    assert sum(1 for row in rows(recording) if row["pdo"] == "TPDO1") > 1000
    live = Live(KnownBus(recorded.rig))
    frames = next(iter(recording)).frames[:500]
    live.add_frames(
        [(int(f["t_ns"]), int(f["can_id"]), int(f["length"]), data_bytes(int(f["word"]), 8)) for f in frames]
    )
    facts = {"bus": "", "bitrate_bit_s": 1_000_000, "lost": 0, "malformed": 0}
    shown = as_dict(live.snapshot(int(frames["t_ns"][-1])), facts, 0)["signals"]
    assert ("brake.handle_torque_Nm" in shown) is recorded.measured
    assert shown["motor.position_rad"] is not None


@pytest.mark.thorough
def test_the_hold_study_and_the_limit_cycle(tmp_path):
    rig = rig_of(drive("own"), brake("own"), HOLD_AND_STROKE, text=RIGS["no sensor"])
    found = hold_study(rig)
    slow = found.row("hybrid").slow
    assert (slow.slid, slow.torque_Nm, slow.verdict(".0%")) == (True, None, "slid")
    assert list(hold_lines(found))[-1].startswith("note: the rig does not measure the hand's torque")
    assert json.dumps(found.as_dict(), allow_nan=False)
    for write in (write_fig14, write_stick_figure):
        assert all(path.exists() for path in write(tmp_path, found))
    cycle = bus_cycle(rig, "bench", settle_s=0.2, window_s=0.3)
    assert len(cycle.force_N) == len(cycle.v_m_s)
    assert np.all(np.isfinite(cycle.force_N))


@pytest.mark.thorough
@beside(CORPUS)
@pytest.mark.parametrize("file", ["systec_IO-X6_8AO.eds", "canopennode_demoDevice.eds"])
def test_verbs_on_a_rehearsed_rig_of_another_makers_brake(tmp_path, file):
    def verb(*arguments):
        result = CliRunner().invoke(main, [str(one) for one in arguments])
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
        assert "Traceback" not in result.output
        return result

    rig, record = tmp_path / "rig.toml", tmp_path / "r.pcapng"
    verb("init", "--drive", "bench", "--brake", CORPUS / file, "--rehearse", "--no-trials", "-o", rig)
    assert load_rig(str(rig)).one_axis().allocation.bound.get("handle_torque") is None
    assert verb("simulate", "--rig", rig, "--mode", "active", "--seconds", 2, "--record", record).exit_code == 0
    assert verb("identify", record).exit_code == 1
    assert verb("plan", "--rig", rig).exit_code in (0, 1)
    assert verb("dbc", "--rig", rig, "-o", tmp_path / "r.dbc").exit_code == 0
    assert verb("replay", record, "--host").exit_code == 0
