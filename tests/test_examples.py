"""Each example runs, in a directory of its own."""

from __future__ import annotations

import runpy
import shutil
import subprocess
import sys

import pytest

from coulombus import simulate
from coulombus.lab.study.study import read_study
from coulombus.lab.sweep.sweep_file import read_sweep
from places import ROOT

EXAMPLES = ROOT / "examples"


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run an example in a directory of its own; return what it printed."""

    def run(name, *arguments):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_simulate_and_plot(run, tmp_path):
    out = run("simulate_and_plot.py", "--seconds", "6", "--png")
    assert "trip: None" in out
    assert "hold: 0 counts" in out
    assert "phase hold" in out
    assert (tmp_path / "hybrid.pcapng").stat().st_size > 1e5
    assert (tmp_path / "hybrid.png").read_bytes().startswith(b"\x89PNG")


def test_own_law(run):
    out = run("own_law.py")
    assert "trip: None; hold: 0 counts" in out
    low, high = out.split("told ")[1].split(" Nm")[0].split(" to ")
    assert 1.45 <= float(low) < 2.0  # F_d in the moves
    assert float(high) == 3.5  # F_s in the dwells


def test_fault_script(run):
    out = run("fault_script.py")
    assert "exit status 7: TPDO_LOST" in out
    assert 0.0 < float(out.split("tripped ")[1].split(" ms")[0]) <= 5.0
    assert "at most 3." in out
    assert 0.0 < float(out.split("0 after ")[1].split(" s")[0]) <= 1.91


@pytest.mark.thorough
def test_release_of_a_hand(run, tmp_path):
    out = run("release.py")
    at_once, released = (float(part.split(" rad/s")[0]) for part in out.split(": ")[1:3])
    assert released <= 1.2 < at_once
    assert (tmp_path / "release.png").read_bytes().startswith(b"\x89PNG")


def test_every_example_is_run():
    assert {path.name for path in EXAMPLES.glob("*.py")} == {
        "simulate_and_plot.py",
        "own_law.py",
        "fault_script.py",
        "release.py",
        "servo_motions.py",
        "two_axes.py",
        "virtual_network.py",
        "own_device.py",  # tests/sim_bus/server/test_own_device.py
    }


def test_two_axes(run):
    out = run("two_axes.py").splitlines()
    assert out[0].startswith("node 1: the brake held up to 3.50 Nm")
    assert out[1].startswith("node 3: the brake held up to 2.50 Nm")
    assert out[2:] == [f"{name}: moved 0 counts while it was held, sign check agreed" for name in ("left", "right")]


def test_virtual_network(run):
    out = run("virtual_network.py")
    assert out.count("boot-up of node") == 2
    assert "node 2 is of device type 0x00020192" in out
    assert "100 SYNCs, TPDO1 of node 1: 100, of node 2: 100" in out


@pytest.mark.thorough
@pytest.mark.real_time
@pytest.mark.patient
def test_project_for_ci(tmp_path, private_sockets, short_path):
    project = shutil.copytree(EXAMPLES / "ci", tmp_path / "ci")
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run(words, cwd=project, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stdout
    assert int(done.stdout.split(" passed")[0].split()[-1]) >= 20
    assert not list((short_path / "coulombus").iterdir())


def test_every_study_file_can_be_read():
    found = [read_study(path) for path in sorted(EXAMPLES.glob("study_*.toml"))]
    assert [len(study.conditions) for study in found] == [2, 2]


def test_every_sweep_file_can_be_read():
    found = [read_sweep(path) for path in sorted(EXAMPLES.glob("sweep_*.toml"))]
    assert [sweep.runs for sweep in found] == [128, 400]


def test_on_the_elastic_rig_hybrid_holds_still_with_damping_alone():
    rig = str(EXAMPLES / "elastic.toml")
    soft, damping = "plant.cable.stiffness_Nm_rad=150.0", "plant.cable.damping_Nms_rad=0.01"
    swings = simulate(rig, "hybrid", 3, overrides=(soft,), measured=True)
    damped = simulate(rig, "hybrid", 3, overrides=(soft, damping), measured=True)
    assert (swings.trip, damped.trip) == (None, None)
    assert swings.hold_counts_p2p > 100
    assert damped.hold_counts_p2p == 0


@pytest.mark.thorough
def test_servo_motions(run, tmp_path):
    out = run("servo_motions.py", str(ROOT / "eds" / "servo.eds"))
    differences = [float(line.rpartition(" ")[2]) for line in out.splitlines()]
    assert len(differences) == 3
    assert differences[0] <= 20  # counts; the speed's step and the sine's begin have no bounded acceleration
    assert (tmp_path / "servo-motions.png").read_bytes().startswith(b"\x89PNG")
