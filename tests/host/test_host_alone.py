"""What stands on a rig's PC: the host without the virtual bus, the nodes, the lab and the
analysis.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys

import pytest

from coulombus.rigs.rig import RigError, load_rig, load_rig_text
from places import ROOT
from real_bench import SHARED_MACHINE, simulation

FAR = ("sim_bus", "node", "lab", "analysis")
"""Rooms that a rig's PC does not have."""

REFUSING = f"""
import sys
from importlib.abc import MetaPathFinder

class Refusing(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[:1] == ["coulombus"] and name.split(".")[1:2] and name.split(".")[1] in {FAR!r}:
            raise ModuleNotFoundError(f"{{name}} is not here", name=name)

sys.meta_path.insert(0, Refusing())
"""


def host_rig() -> str:
    """Return the bench's rig file without the simulated rig, hand and schedule."""
    text = load_rig("bench").effective()
    sections = re.split(r"(?m)^(?=\[)", text)
    return "".join(one for one in sections if not one.startswith(("[plant]", "[operator]", "[[phase]]")))


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """Return a function that runs a verb in an installation of the host alone."""
    root = tmp_path_factory.mktemp("rigs-pc")
    (root / "sitecustomize.py").write_text(REFUSING)  # in every process of the run
    (root / "rig.toml").write_text(host_rig())

    def run(*words, **options):
        return subprocess.run(
            [sys.executable, "-P", "-m", "coulombus", *map(str, words)],
            cwd=root,
            env={**os.environ, "PYTHONPATH": f"{root}{os.pathsep}{ROOT}"},
            capture_output=True,
            text=True,
            timeout=500,
            **options,
        )

    return run


@pytest.mark.thorough
def test_the_rooms_are_really_gone(alone):
    done = alone("simulate", "--rig", "rig.toml", "--seconds", 1)
    assert done.returncode == 2
    assert "this installation has no coulombus.lab, which this verb needs" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        ("check --rig rig.toml", 0, "ok"),
        pytest.param("plan --rig rig.toml", 0, "SYNC", marks=pytest.mark.thorough),
        pytest.param(
            "measure --rig rig.toml --bus coulombus:nobody-there", 4, "nobody-there", marks=pytest.mark.thorough
        ),
        pytest.param("run --help", 0, "coulombus stop", marks=pytest.mark.thorough),
        pytest.param("stop --help", 0, "Stop the running host", marks=pytest.mark.thorough),
        ("scan --bus coulombus:nobody-there", 4, "nobody-there"),
        ("stop --rig rig.toml --bus coulombus:nobody-there", 4, "no host"),
        ("run --rig rig.toml --seconds 1 --bus coulombus:nobody-there", 4, "nobody-there"),
        pytest.param("run --rig rig.toml --bus coulombus:nobody-there", 4, "nobody-there", marks=pytest.mark.thorough),
    ],
)
def test_the_hosts_verbs_need_the_hosts_rooms_only(alone, words, status, text):
    done = alone(*words.split())
    assert done.returncode == status, done.stderr
    assert text in done.stdout + done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.thorough
@pytest.mark.real_time
def test_a_run_comes_to_its_end_on_a_bus_of_a_whole_installation(alone, tmp_path):
    bus, record = f"coulombus:alone-{os.getpid()}", tmp_path / "run.pcapng"
    sets = [word for text in SHARED_MACHINE for word in ("--set", text)]
    with simulation(bus):
        words = ("run", "--rig", "rig.toml", "--bus", bus, "--seconds", 0.5, "--record", record, "--json", *sets)
        done = alone(*words)
    assert done.returncode == 0, done.stderr + done.stdout
    result = json.loads(done.stdout)
    assert result["trip"] is None
    assert result["cycles"] > 0
    assert record.exists()


def test_a_rig_file_without_the_simulated_rig_is_whole_for_the_host():
    rig = load_rig_text(host_rig(), "rig.toml")
    axis = rig.one_axis()
    assert axis.plant is None
    assert axis.operator is None
    assert rig.schedule_s == 0.0
    assert load_rig_text(rig.effective(), "rig.toml") == rig
    with pytest.raises(
        RigError, match=r"rig.toml: the rig bench has no \[plant\] and \[operator\]; a rig that is simulated needs both"
    ):
        _ = axis.simulation


@pytest.mark.parametrize(("one", "other"), [("plant", "operator"), ("operator", "plant")])
def test_a_simulated_rig_has_both_halves_of_the_simulation(one, other):
    sections = re.split(r"(?m)^(?=\[)", load_rig("bench").effective())
    text = "".join(section for section in sections if not section.startswith(f"[{other}]"))
    with pytest.raises(RigError, match=rf"{other}: the section is missing; expected \[{other}\] beside \[{one}\]"):
        load_rig_text(text, "rig.toml")
