"""The folders and the import name `coulombus.*`: each module has one name, and each folder at the
top its link.
"""

from __future__ import annotations

import ast
import importlib
import os
import re
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest

import coulombus
from places import ROOT

LINKED = ["eds", "host", "node", "sim_bus"]
ROOMS = sorted(path.parent.name for path in (ROOT / "coulombus").glob("*/__init__.py"))
SOURCES = [
    path
    for top in (*LINKED, "coulombus", "tests", "benchmarks", "examples")
    for path in sorted((ROOT / top).rglob("*.py"))
]

MOST_LINES = 450


@cache
def read(path):
    return path.read_text()


def parsed(path):
    return ast.parse(read(path))


def test_the_package_is_one_folder_and_four_links():
    folders = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert folders == {"coulombus", *LINKED}
    assert sorted(path.name for path in (ROOT / "coulombus").iterdir() if path.is_symlink()) == LINKED
    for room in LINKED:
        assert os.readlink(ROOT / "coulombus" / room) == f"../{room}"


def test_no_module_of_the_package_is_too_long():
    lengths = {
        path.relative_to(ROOT).as_posix(): len(read(path).splitlines())
        for path in SOURCES
        if path.relative_to(ROOT).parts[0] in {*LINKED, "coulombus"}
    }
    assert len(lengths) > 300
    assert {name for name, lines in lengths.items() if lines > MOST_LINES} == set()


def test_no_source_imports_a_folder_by_its_bare_name():
    assert len(SOURCES) > 300
    bare = re.compile(rf"^\s*(from\s+|import\s+(.*,\s*)?)({'|'.join(LINKED)})\b", re.M)  # most need not be parsed
    for path in SOURCES:
        if not bare.search(read(path)):
            continue
        for node in ast.walk(parsed(path)):
            names = [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert not {name.partition(".")[0] for name in names} & set(LINKED), f"{path}:{node.lineno}"


@pytest.mark.parametrize("room", LINKED)
def test_a_folder_is_refused_as_a_package_of_its_own(room):
    with pytest.raises(ImportError, match=f"import coulombus.{room} instead"):
        __import__(room)


def test_no_module_is_loaded_under_two_names():
    importlib.import_module("coulombus.rigs.rig")  # alone, this test would have nothing to look at
    files = [os.path.realpath(getattr(module, "__file__", None) or "") for module in sys.modules.values()]
    ours = [file for file in files if any(Path(file).is_relative_to(ROOT / room) for room in (*LINKED, "coulombus"))]
    assert len(ours) > 10
    assert len(ours) == len(set(ours))


def test_the_package_shows_what_a_script_needs_and_no_verbs():
    assert {"CoulombusError", "Device", "VirtualNetwork", "live", "load_rig", "read", "simulate"} <= set(dir(coulombus))
    assert all(callable(getattr(coulombus, name)) for name in dir(coulombus))  # tests/test_api.py has each of them
    with pytest.raises(AttributeError, match="no attribute 'decode'"):
        coulombus.decode  # noqa: B018


def contracts():
    linter = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    return linter, linter["contracts"]


@pytest.mark.parametrize("room", ROOMS)
def test_each_folder_within_a_folder_has_its_place_in_a_contract(room):
    inner = {path.parent.name for path in (ROOT / "coulombus" / room).glob("*/*.py")}
    placed = {
        name
        for one in contracts()[1]
        if one.get("containers") == [f"coulombus.{room}"]
        for layer in one["layers"]
        for name in layer.replace("|", " ").split()
    }
    assert inner <= placed


def test_circles_are_forbidden_everywhere_also_among_imports_for_types():
    linter, all_of_them = contracts()
    assert "exclude_type_checking_imports" not in linter
    assert [one["ancestors"] for one in all_of_them if one["type"] == "acyclic_siblings"] == [["coulombus"]]
    assert not [one["name"] for one in all_of_them if {"ignore_imports", "depth", "skip_descendants"} & set(one)]


@pytest.mark.thorough
def test_plugins_of_python_can_load_without_numba():
    points = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]
    modules = sorted({place.partition(":")[0] for group in points.values() for place in group.values()})
    assert len(modules) == 3
    code = f"import sys, {', '.join(modules)}; sys.exit('numba' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_an_eds_is_checked_without_numba_and_numpy():
    code = "import sys, coulombus.cli.eds, coulombus.eds.check, coulombus.kernels.compile_notice; "
    code += "sys.exit(bool({'numba', 'numpy', 'pydantic'} & set(sys.modules)))"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_a_record_of_one_letter_is_explained_at_the_modules_head():
    seen = 0
    for path in SOURCES:
        if not re.search("@(kernel|inlined)", read(path)):
            continue
        tree = parsed(path)
        head = ast.get_docstring(tree) or ""
        for function in ast.walk(tree):
            if not isinstance(function, ast.FunctionDef) or not {"kernel", "inlined"} & {
                one.id for one in function.decorator_list if isinstance(one, ast.Name)
            }:
                continue
            for one in function.args.args:
                if len(one.arg) == 1 and one.annotation is not None and ast.unparse(one.annotation).endswith("Record"):
                    seen += 1
                    assert re.search(rf"\b{one.arg}\b[, a-z]* : |`{one.arg}`", head), (
                        f"{path}:{function.lineno}: {one.arg}"
                    )
    assert seen > 200
