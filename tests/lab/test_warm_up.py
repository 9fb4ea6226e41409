"""`coulombus warm-up`: what it compiles, once, and what it says."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from itertools import combinations
from pathlib import Path

import pytest

from coulombus.kernels import decorator
from coulombus.kernels.decorator import JIT_DISABLED, is_warm, warming
from coulombus.kernels.kernel_cache import SCOPES
from coulombus.kernels.sources import source_stamp
from coulombus.lab import warm_up as module
from coulombus.lab import warm_up_steps
from coulombus.lab.warm_up import GROUPS, WORKERS, WarmUp, WarmUpError, warm_up
from places import ROOT

COMPILED = pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
WARM_UP = "COULOMBUS_TEST_WARM_UP"
"""Variable with the folder of a cache that only `coulombus warm-up` has written."""
FAULTS = str(ROOT / "examples" / "faults.toml")
RUNS = """
import json, sys
from click.testing import CliRunner
from coulombus.cli.main import main

for words in json.loads(sys.argv[1]):
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
"""
WORLD = """
from coulombus import simulate
from coulombus.host.world.model_parts import Wall

simulate("bench", "hybrid", 0.2, world=lambda state: Wall(0.0, 2.0))
"""


NOISE = """
[[fault]]
kind = "noise"
rate = 1e-4
"""


def python(*words, **variables):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **variables}
    done = subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=ROOT,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def coulombus(*words, **variables):
    return python("-m", "coulombus", *words, **variables)


def kernels(folder):
    """Return the files of machine code, without the version that the compiler appends."""
    return {path.relative_to(folder).as_posix() for path in Path(folder).rglob("*.nbc")}


def test_every_group_has_its_steps():
    assert list(GROUPS) == list(warm_up_steps.GROUPS)


@pytest.mark.thorough
def test_without_a_compiler_nothing_is_compiled():
    output = coulombus("warm-up", NUMBA_DISABLE_JIT="1")
    assert output == "NUMBA_DISABLE_JIT=1: nothing is compiled\n"
    assert json.loads(coulombus("warm-up", "--json", NUMBA_DISABLE_JIT="1"))["directory"] is None


def test_what_is_warm_is_compiled_no_more(monkeypatch):
    monkeypatch.setattr(module, "is_warm", lambda scope: True)
    monkeypatch.setattr(module, "_start", None)
    assert warm_up().compiled == 0


def test_what_another_process_compiled_meanwhile_is_compiled_no_more(monkeypatch, tmp_path):
    answers = iter((False, True))
    monkeypatch.setattr(module, "is_warm", lambda scope: next(answers))
    monkeypatch.setattr(module, "CACHE_DIR", tmp_path)
    monkeypatch.setattr(module, "_start", None)
    assert warm_up().compiled == 0


def test_without_a_place_for_the_code_the_remedy_is_named(monkeypatch):
    monkeypatch.setattr(module, "is_warm", lambda scope: False)
    monkeypatch.setattr(module, "CACHE_DIR", None)
    with pytest.raises(WarmUpError, match="name one by NUMBA_CACHE_DIR") as error:
        warm_up()
    assert error.value.exit_status == 2


def started(monkeypatch, text):
    """Let each group be a process that runs `text`."""

    def start(group):
        return subprocess.Popen([sys.executable, "-c", text, group], stdout=subprocess.PIPE, bufsize=0)

    monkeypatch.setattr(module, "is_warm", lambda scope: False)
    monkeypatch.setattr(module, "CACHE_DIR", Path())
    monkeypatch.setattr(module, "_start", start)


def test_steps_are_reported_and_functions_counted(monkeypatch):
    started(monkeypatch, "import sys; n = len(sys.argv[1]); print(n); print(2 * n)")
    steps = []
    result = warm_up(lambda done, of: steps.append((done, of)))
    of = sum(group.steps for group in GROUPS.values())
    assert steps == [(done, of) for done in range(1, 2 * len(GROUPS) + 1)]
    assert result.compiled == sum(2 * len(group) for group in GROUPS)


def test_a_group_begins_after_those_that_it_needs_beside_one_other(monkeypatch):
    started(monkeypatch, "print(1)")
    begun, ended, start, check = [], [], module._start, module._check

    def starts(name):
        assert set(GROUPS[name].after) <= set(ended)
        begun.append(name)
        assert len(begun) - len(ended) <= WORKERS
        return start(name)

    monkeypatch.setattr(module, "_start", starts)
    monkeypatch.setattr(module, "_check", lambda name, status: (check(name, status), ended.append(name)))
    warm_up()
    assert sorted(begun) == sorted(ended) == sorted(GROUPS)


@pytest.mark.parametrize(("end", "how"), [("exit(3)", "with exit status 3"), ("kill", "by SIGKILL")])
def test_a_group_that_ends_early_is_an_error(monkeypatch, end, how):
    kill = "import os; print(1, flush=True); os.kill(os.getpid(), 9)"
    started(monkeypatch, kill if end == "kill" else "print(1, flush=True); raise SystemExit(3)")
    with pytest.raises(WarmUpError, match=how):
        warm_up()


@pytest.mark.parametrize(
    ("scope", "left_out"), [("run", {"loop", "arm", "arm_loop"}), ("simulate", {"arm", "arm_loop"}), ("arm", set())]
)
def test_groups_of_wider_scopes_are_left_out(monkeypatch, scope, left_out):
    started(monkeypatch, "print(1)")
    begun, start = [], module._start
    monkeypatch.setattr(module, "_start", lambda name: (begun.append(name), start(name))[1])
    assert warm_up(scope=scope).compiled == len(begun)
    assert set(begun) == set(GROUPS) - left_out


@COMPILED
@pytest.mark.parametrize("warmed", range(len(SCOPES)))
def test_what_is_warm_for_a_scope_is_warm_for_those_within(monkeypatch, tmp_path, warmed):
    monkeypatch.setattr(decorator, "CACHE_DIR", tmp_path)
    with warming(SCOPES[warmed]):
        pass
    assert [is_warm(scope) for scope in SCOPES] == [k <= warmed for k in range(len(SCOPES))]
    assert is_warm() == is_warm("arm")


def test_the_result_for_json_is_plain():
    assert WarmUp(3, 1.23456, Path("/cache")).as_dict() == {"compiled": 3, "seconds": 1.235, "directory": "/cache"}


def test_the_stamp_of_the_sources_changes_with_their_place_and_time(tmp_path, monkeypatch):
    stamps = set()
    for name in ("a", "b"):
        (tmp_path / name / "node").mkdir(parents=True)
        (tmp_path / name / "node" / "core.py").write_text("")
        os.utime(tmp_path / name / "node" / "core.py", (1, 1))
        stamps.add(source_stamp(tmp_path / name))
    os.utime(tmp_path / "a" / "node" / "core.py", (2, 2))
    stamps.add(source_stamp(tmp_path / "a"))
    monkeypatch.setenv("NUMBA_CPU_NAME", "another")
    stamps.add(source_stamp(tmp_path / "a"))
    assert len(stamps) == 4


@COMPILED
@pytest.mark.slow
@pytest.mark.long
def test_groups_that_may_run_at_the_same_time_have_two_kernels_in_common_at_most(tmp_path):
    before, compiled = {}, {}
    for name in GROUPS:
        folder = tmp_path / name
        folder.mkdir()
        for earlier in GROUPS[name].after:
            shutil.copytree(tmp_path / earlier, folder, dirs_exist_ok=True)
        known = kernels(folder)
        text = f"from coulombus.lab.warm_up_steps import GROUPS; list(GROUPS[{name!r}]())"
        python("-c", text, NUMBA_CACHE_DIR=str(folder))
        compiled[name] = {path.partition(".py3")[0] for path in kernels(folder) - known}
        before[name] = {name}.union(*(before[earlier] for earlier in GROUPS[name].after))
    for one, other in combinations(GROUPS, 2):
        if one not in before[other] and other not in before[one]:
            common = compiled[one] & compiled[other]
            names = {path.rpartition("/")[2].rpartition("-")[0] for path in common}
            assert names <= {"karnopp.karnopp", "recvmsg.receive"}, (one, other)


QUIET = ("--seconds", "0.2")


@pytest.fixture
def warmed_up(tmp_path):
    """Return variables for a cache with nothing in it but what a warm-up compiles: that of `scripts/test`
    is copied.
    """
    variables = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    if WARM_UP in os.environ:
        shutil.copytree(os.environ[WARM_UP], tmp_path / "cache")
    coulombus("warm-up", **variables)
    return variables


def display_in_real_time(variables):
    """Let a host run on an emulated bus, also with a world outside."""
    emulation = subprocess.Popen(
        [sys.executable, "-m", "coulombus", "emulate", "--bus", f"coulombus:warm-{os.getpid()}", "--json"],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), **variables},
        stdout=subprocess.PIPE,
    )
    with emulation:
        assert json.loads(emulation.stdout.readline())["event"] == "ready"
        run = (
            "run",
            "--bus",
            f"coulombus:warm-{os.getpid()}",
            *QUIET,
            "--shared-machine",
            "--set",
            'host.deadman="none"',
        )
        coulombus(*run, **variables)
        coulombus(*run, "--world", **variables)
        emulation.terminate()


@COMPILED
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.real_time
def test_the_first_scope_is_enough_for_a_display_in_real_time(tmp_path):
    variables = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    coulombus("warm-up", "--for", "run", **variables)
    before = kernels(tmp_path)
    display_in_real_time(variables)
    assert kernels(tmp_path) == before


@pytest.mark.thorough
@COMPILED
@pytest.mark.slow
@pytest.mark.real_time
@pytest.mark.patient
def test_after_a_warm_up_no_verb_compiles(tmp_path, warmed_up):
    variables = warmed_up
    before = kernels(tmp_path)
    assert len(before) > 300
    noise = tmp_path / "noise.toml"
    noise.write_text(NOISE)
    assert re.fullmatch("nothing to compile: all is kept in .*\n", coulombus("warm-up", **variables))
    runs = [
        ["--record", str(tmp_path / "run.pcapng")],
        ["--faults", FAULTS],
        ["--rig", "two_axes", "--set", "axis.left.plant.stribeck_Nm=0.03"],
        ["--rig", "plane", "--truth", str(tmp_path / "truth.npz")],
        ["--rig", "plane", "--faults", str(noise)],
    ]
    python("-c", RUNS, json.dumps([["simulate", *QUIET, *run] for run in runs]), **variables)
    python("-c", WORLD, **variables)
    display_in_real_time(variables)
    assert kernels(tmp_path) == before
