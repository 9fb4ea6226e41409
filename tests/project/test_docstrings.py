"""Every example in a docstring is what it says: Python that runs, TOML that its reader takes."""

from __future__ import annotations

import ast
import math
import os
import re
import textwrap
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated

import pytest

from bench_recording import record
from coulombus.host.laws.law import Field, LawRecord, MotionRecord, Parameters, declaration_of, friction_law
from coulombus.host.laws.plane.plane_law import plane_law
from coulombus.kernels import records
from coulombus.lab.study.study import read_study
from coulombus.lab.sweep.sweep_file import read_sweep
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.faults.fault_file import read_faults
from coulombus.sim_bus.network.script import read_script
from places import EDS, RIGS, ROOT

BLOCK = re.compile(r"::\n\n((?:    .*(?:\n|\Z)|\n)+)")
ELSEWHERE = {
    "analysis/rig/maps.py": "tests/analysis/rig/test_maps.py",
    "lab/study/bridge.py": "tests/lab/study/test_bridge.py",
    "monitor/callbacks.py": "tests/monitor/test_callbacks.py",
}
"""Examples that need minutes, or a rig: who runs them."""


def examples():
    """Yield (module, example) of every indented block of a docstring that is Python or TOML."""
    for folder, below, names in os.walk(ROOT / "coulombus", followlinks=True):
        below[:] = sorted(name for name in below if name != "__pycache__")
        for path in sorted(Path(folder) / name for name in names if name.endswith(".py")):
            text = path.read_text()
            for node in ast.walk(ast.parse(text)) if BLOCK.search(text) else ():
                if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                    for block in BLOCK.findall(ast.get_docstring(node) or ""):
                        yield str(path.relative_to(ROOT / "coulombus")), textwrap.dedent(block)


def is_python(text):
    try:
        body = ast.parse(text).body
    except SyntaxError:
        return False
    formula = len(body) == 1 and not isinstance(body[0], ast.ImportFrom | ast.With | ast.ClassDef | ast.FunctionDef)
    return not formula and any(isinstance(node, ast.Call | ast.ImportFrom) for node in ast.walk(ast.Module(body, [])))


def is_toml(text):
    try:
        return bool(tomllib.loads(text))
    except tomllib.TOMLDecodeError:
        return False


FOUND = list(examples())
PYTHON = {module: text for module, text in FOUND if is_python(text) and not is_toml(text)}
TOML = {module: text for module, text in FOUND if is_toml(text)}


def test_the_examples_are_found():
    assert set(PYTHON) == {*ELSEWHERE, *RUN}
    assert set(TOML) == set(READERS)
    for module, place in ELSEWHERE.items():
        called = re.findall(r"\b(oscillation_map|open_session|live)\(", PYTHON[module])
        assert called, module
        assert f"{called[0]}(" in (ROOT / place).read_text()


def of_the_package(names):
    assert callable(names["read"])
    assert callable(names["simulate"])


def of_a_record(names):
    assert names["frame"].t_ns == 0
    assert len(names["frame"].words) == 8


def of_a_recording(names):
    assert names["angle"].unit == "rad"
    assert len(names["angle"].t_s) == len(names["angle"].values) > 0


def of_a_law(names):
    law = declaration_of(names["my_law"])
    assert (law.name, law.names, law.state) == ("my_law", ("F_c_Nm",), (("z_rad", 1),))


def of_a_law_in_the_plane(names):
    law = declaration_of(names["my_law"])
    assert (law.name, law.names, law.state) == ("my_law", ("F_c_N",), ())


def of_a_plain_law(names):
    motion, law, state = records.new_records(MotionRecord)[0], records.new_records(LawRecord)[0], SimpleNamespace()
    motion.v_rad_s, law.F_d = -0.1, 2.0
    assert names["my_law"](motion, law, state) == -1.0
    assert state.brake_Nm == 2.0


def of_the_network(names):
    assert names["device"] is not None


RUN = {
    "__init__.py": (dict, of_the_package),
    "kernels/records.py": (lambda: {**vars(records), "Annotated": Annotated}, of_a_record),
    "recording/signals.py": (lambda: {"read": read}, of_a_recording),
    "host/laws/laws.py": (dict, of_a_plain_law),
    "host/laws/law.py": (
        lambda: {"Parameters": Parameters, "Field": Field, "friction_law": friction_law, "math": math},
        of_a_law,
    ),
    "host/laws/plane/plane_law.py": (
        lambda: {"Parameters": Parameters, "Field": Field, "plane_law": plane_law, "math": math},
        of_a_law_in_the_plane,
    ),
    "sim_bus/network/network.py": (dict, of_the_network),
}


@pytest.mark.parametrize("module", RUN)
def test_python_runs(module, tmp_path, monkeypatch):
    if "hybrid.pcapng" in PYTHON[module]:
        record(tmp_path / "hybrid.pcapng")
    os.symlink(ROOT / "eds", tmp_path / "eds")
    monkeypatch.chdir(tmp_path)
    given, check = RUN[module]
    names = given() | {"__name__": "example"}
    exec(compile(PYTHON[module], module, "exec", dont_inherit=True), names)
    check(names)


def rig_of(path):
    """The bench rig with the example's axes."""
    folder = path.parent / "rigs"
    folder.mkdir()
    os.symlink(EDS, path.parent / "eds")
    (folder / "two.toml").write_text((RIGS / "bench.toml").read_text() + path.read_text())
    return load_rig(str(folder / "two.toml")).axes


READERS = {
    "rigs/axes.py": rig_of,
    "lab/study/study.py": read_study,
    "lab/sweep/sweep_file.py": read_sweep,
    "sim_bus/faults/fault_file.py": read_faults,
    "sim_bus/network/script.py": lambda path: read_script(path, ["motor", "brake"]),
}


@pytest.mark.parametrize("module", READERS)
def test_toml_is_read(module, tmp_path):
    path = tmp_path / "example.toml"
    path.write_text(TOML[module])
    assert READERS[module](path)
