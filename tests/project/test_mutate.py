"""The mutation runner: what it changes, and what it says of a change that no test sees."""

from __future__ import annotations

import importlib.util
import os
import re
import signal
import subprocess
import sys
import time
import types

import pytest

from places import ROOT

SCRIPTS = ROOT / "scripts"


def load(name):
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


Source = load("mutants").Source
mutant_runs, mutant_map = load("mutant_runs"), load("mutant_map")
mutate, mutate_drawn = load("mutate"), load("mutate_drawn")

TEXT = '''"""A module."""

STEP = 2


def limited(x, most):
    """Return x within its limits."""
    if abs(x) > most and not most == 0:
        x = min(x, most) - 1.5
        return x
    return -x * STEP
'''


def changes(text, unit="limited", units=()):
    return {mutant.change for mutant in Source("own.py", text, units).mutants() if mutant.unit == unit}


@pytest.mark.parametrize(
    "change",
    [
        "abs(x) -> x",
        "abs(x) > most -> abs(x) >= most",
        "abs(x) > most -> abs(x) <= most",
        "abs(x) > most and (not most == 0) -> abs(x) > most or not most == 0",
        "abs(x) > most and (not most == 0) -> abs(x) > most",
        "abs(x) > most and (not most == 0) -> True",
        "abs(x) > most and (not most == 0) -> False",
        "not most == 0 -> most == 0",
        "most == 0 -> most == 1",
        "min(x, most) -> max(x, most)",
        "min(x, most) -> x",
        "min(x, most) - 1.5 -> min(x, most) + 1.5",
        "min(x, most) - 1.5 -> min(x, most) - 2.5",
        "min(x, most) - 1.5 -> min(x, most) - -1.5",
        "x = min(x, most) - 1.5 -> deleted",
        "return x -> deleted",
        "-x -> x",
        "-x * STEP -> -x / STEP",
    ],
)
def test_a_function_is_changed_by_every_operator(change):
    assert change in changes(TEXT)


def test_constants_of_the_module_are_changed_unless_a_function_is_named():
    assert changes(TEXT, "") == {"STEP = 2 -> STEP = 3", "STEP = 2 -> STEP = 1"}
    assert changes(TEXT, "", ("limited",)) == set()


def test_a_function_that_the_module_does_not_have_is_named():
    text = TEXT + "\n\nclass Own:\n    def method(self):\n        return 1\n"
    units = ("limited", "step", "Own.method", "Own.limited", "method", "Own")
    assert Source("own.py", text, units).lacking == ["step", "Own.limited", "method", "Own"]


LISTED = sorted({module for module, *_ in mutate.Equivalents(mutate.EQUIVALENTS).proofs})


@pytest.mark.parametrize("name", mutate.TARGETS)
def test_the_targets_name_functions_and_tests_that_are_there(name):
    target = mutate.TARGETS[name]
    assert all(mutate._file(test) for test in target.tests)
    assert Source(name, (ROOT / name).read_text(), target.functions).lacking == []


TABLE = re.findall(
    r"^\| (`.*?) \| (\d+) \|", (ROOT / "docs" / "safety.md").read_text().partition("| module | mutants |")[2], re.M
)


@pytest.mark.parametrize(("cell", "count"), TABLE)
def test_the_table_tells_of_the_mutants_that_there_are(cell, count):
    """After a change of a module: run scripts/mutate.py --module with it, and write its row anew."""
    names = re.findall(r"`([^`]+)`", cell)
    sources = [Source(name, (ROOT / name).read_text(), mutate.TARGETS[name].functions) for name in names]
    assert sum(len(source.mutants()) for source in sources) == int(count)


@pytest.mark.parametrize("name", LISTED)
def test_the_equivalents_name_lines_and_functions_that_are_there(name):
    text = (ROOT / name).read_text()
    listed = [key for key in mutate.Equivalents(mutate.EQUIVALENTS).proofs if key[0] == name]
    assert {line for _, _, line, *_ in listed} <= {line.strip() for line in text.splitlines()}
    functions = {function for _, function, *_ in listed if function}
    assert Source(name, text, tuple(functions)).lacking == []


def test_every_mutant_differs_and_the_source_stays():
    source = Source("own.py", TEXT)
    before = source._code("limited")
    mutants = source.mutants()
    assert source._code("limited") == before
    assert len({(m.unit, m.line, m.change) for m in mutants}) == len(mutants)
    assert [m.line for m in mutants if m.unit] == sorted(m.line for m in mutants if m.unit)


def test_what_python_does_not_compile_is_no_mutant():
    text = "def own(x):\n    last = 1\n    def inner():\n        nonlocal last\n        last = max(2, *x)\n    return inner\n"
    assert "max(2, *x) -> 2" in changes(text, "own")
    assert not changes(text, "own") & {"last = 1 -> deleted", "max(2, *x) -> *x"}


def test_the_function_of_a_command_and_of_a_cached_property_is_exchanged():
    text = (
        "import functools, click\n@click.command()\ndef verb():\n    return 5 < 4\n"
        "class Own:\n    @functools.cached_property\n    def size(self):\n        return 5 < 4\n"
    )
    for unit, result in (
        ("verb", lambda module: module.verb.callback()),
        ("Own.size", lambda module: module.Own().size),
    ):
        module = types.ModuleType("own")
        module.__file__ = "own.py"
        exec(text, vars(module))
        source = Source("own.py", text)
        next(m for m in source.mutants() if m.unit == unit and m.change == "5 < 4 -> 5 >= 4").apply()
        source.install(module, unit)
        assert result(module) is True


@pytest.mark.parametrize(
    ("change", "result"),
    [
        ("5 < 4 -> 5 >= 4", [True, 1, 2]),
        ("super().size() -> deleted", [False, 2]),
        ("super().shape -> deleted", [False, 1]),
    ],
)
def test_a_decorated_function_is_exchanged_and_its_call_of_the_base_is_deleted(change, result):
    text = (
        "import contextlib\nclass Base:\n    def size(self):\n        self.log.append(1)\n"
        "    @property\n    def shape(self):\n        self.log.append(2)\n"
        "class Own(Base):\n    log = []\n    @contextlib.contextmanager\n    def held(self):\n        yield 5 < 4\n"
        "    def size(self):\n        super().size()\n"
        "    @property\n    def shape(self):\n        super().shape\n"
    )
    module = types.ModuleType("own")
    module.__file__ = "own.py"
    exec(text, vars(module))
    source = Source("own.py", text)
    mutant = next(m for m in source.mutants() if m.change == change)
    mutant.apply()
    source.install(module, mutant.unit)
    own = module.Own()
    with own.held() as held:
        own.size()
        assert own.shape is None
    assert [held, *own.log] == result
    assert vars(module.Own)["size"].__code__.co_freevars == ("__class__",)


def test_a_draw_is_of_the_product_without_its_examples():
    modules = mutate_drawn.product()
    assert {"coulombus.host.laws.karnopp", "coulombus.recording.logs.blf", "coulombus.cli.main"} <= modules.keys()
    assert not any("examples" in str(path) for path in modules.values())


@pytest.mark.thorough
def test_a_mutant_is_run_against_the_shortest_tests_that_cover_its_line_and_pass(tmp_path):
    folder = tmp_path / "map"
    code = f"import mutant_map, pytest, sys; mutant_map.FOLDER = mutant_map.Path({str(folder)!r})\n" + (
        "sys.exit(pytest.main(['-q', '-p', 'mutant_map', '-Wignore', 'tests/host/run/test_histogram.py']))"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(SCRIPTS)})
    covering = mutant_map.Map(folder)
    path = ROOT / "host/run/histogram.py"
    found = covering.tests(path, range(1, 1000))
    assert found == sorted(found, key=covering.seconds.__getitem__) != []
    assert all(test.startswith("tests/host/run/test_histogram.py::") for test in found)
    assert covering.tests(path, [1]) == covering.tests(ROOT / "host/run/deadman.py", range(1, 1000)) == []
    covering.failed = {found[0]}
    assert covering.tests(path, range(1, 1000)) == found[1:]
    mutant = Source("host/run/histogram.py", path.read_text()).mutants()[0]
    assert mutate_drawn.tests_of(path, mutant, covering) <= set(found[1:])


@pytest.mark.thorough
def test_the_same_seed_draws_the_same_mutants_and_another_draws_others():
    command = [sys.executable, SCRIPTS / "mutate_drawn.py", "4", "--list", "--seed"]
    first, again, other = (subprocess.check_output([*command, seed], text=True, timeout=300) for seed in "334")
    assert first == again != other
    assert len(first.splitlines()) == len(other.splitlines()) == 4


def test_a_mutant_is_exchanged_in_the_loaded_module_where_others_have_taken_it_from():
    module = types.ModuleType("own")
    module.__file__ = "own.py"
    exec(TEXT, vars(module))
    taken = module.limited
    source = Source("own.py", TEXT)
    (mutant,) = (m for m in source.mutants() if m.change == "-x * STEP -> -x / STEP")
    mutant.apply()
    source.install(module, mutant.unit)
    assert taken(3, 10) == -1.5
    source = Source("own.py", TEXT)
    (mutant,) = (m for m in source.mutants() if m.change == "STEP = 2 -> STEP = 3")
    mutant.apply()
    source.install(module, mutant.unit)
    assert module.STEP == 3


@pytest.mark.thorough
def test_a_sample_is_run_against_the_tests_of_its_module_and_found_again(tmp_path):
    results = tmp_path / "mutants.jsonl"
    command = [
        sys.executable,
        SCRIPTS / "mutate.py",
        "--module",
        "host/laws/karnopp.py",
        "--sample",
        "4",
        "--results",
        results,
    ]
    for _ in range(2):
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, env={**os.environ})
        assert done.returncode == 0, done.stdout + done.stderr
        assert "| `host/laws/karnopp.py` | 4 |" in done.stdout
        assert 1 <= len(results.read_text().splitlines()) <= 4


@pytest.mark.parametrize("own_group", [True, False])
def test_a_mutant_that_waits_for_ever_is_ended_by_the_clock(own_group):
    def wait(pipe):
        if own_group:
            os.setpgid(0, 0)
        signal.pause()

    runner = mutant_runs._Runner(None, [], 1, 10.0)
    told = []
    runner.tell = lambda number, verdict: told.append((number, verdict.status))
    pipe, pid = runner._fork(wait)
    running = {pipe: mutant_runs._Child(0, pid, pipe, time.monotonic())}
    while running:
        runner._collect(running)
    assert told == [(0, "timeout")]
