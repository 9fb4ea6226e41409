"""The kernels' cache: nothing compiles twice, and an edited kernel is never served stale."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from eds.compiled import CACHE_DIR, JIT_DISABLED, source_key

import pytest  # isort: skip

ROOT = Path(__file__).resolve().parent.parent

CALLEE = "from eds.compiled import kernel\n@kernel\ndef callee(x):\n    return x + {}\n"
CALLER = "from eds.compiled import kernel\nfrom host.callee import callee\n@kernel\ndef caller(x):\n    return 10 * callee(x)\n"


def run(code, directory, **environment):
    clean = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=directory,
        env={**clean, "PYTHONPATH": str(directory), **environment},
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    return done.stdout.strip()


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_an_edited_callee_in_another_file_is_compiled_anew(tmp_path):
    for package in ("eds", "host"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").touch()
    (tmp_path / "eds" / "compiled.py").write_text((ROOT / "eds" / "compiled.py").read_text())
    (tmp_path / "host" / "caller.py").write_text(CALLER)
    call = "from host.caller import caller; print(caller(1), sum(caller.stats.cache_hits.values()))"
    cache = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    (tmp_path / "host" / "callee.py").write_text(CALLEE.format(1))
    assert run(call, tmp_path, **cache) == "20 0"
    assert run(call, tmp_path, **cache) == "20 1"
    (tmp_path / "host" / "callee.py").write_text(CALLEE.format(2))
    assert run(call, tmp_path, **cache) == "30 0"


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_nothing_compiles_on_the_second_start():
    code = "from lab.simulate import simulate; simulate('bench', 'hybrid', 0.01)"
    base = {"NUMBA_CACHE_DIR": str(CACHE_DIR)}
    run(code, ROOT, **base)
    before = {path: path.stat().st_mtime_ns for path in CACHE_DIR.rglob("*") if path.is_file()}
    run(code, ROOT, **base)
    after = {path: path.stat().st_mtime_ns for path in CACHE_DIR.rglob("*") if path.is_file()}
    assert before
    assert after == before


def test_the_key_follows_every_source(tmp_path):
    (tmp_path / "node").mkdir()
    empty = source_key(tmp_path)
    (tmp_path / "node" / "core.py").write_text("a = 1\n")
    one = source_key(tmp_path)
    (tmp_path / "node" / "core.py").write_text("a = 2\n")
    two = source_key(tmp_path)
    (tmp_path / "node" / "deeper").mkdir()
    (tmp_path / "node" / "deeper" / "core.py").write_text("a = 1\n")
    three = source_key(tmp_path)
    (tmp_path / "node" / "deeper" / "core.py").write_text("a = 2\n")
    assert len({empty, one, two, three, source_key(tmp_path)}) == 5


def test_old_caches_are_removed_and_an_unwritable_place_is_left_alone(tmp_path):
    base = tmp_path / "coulombus" / "numba"
    for n in range(8):
        (base / f"{n:016x}").mkdir(parents=True)
    (base / "mine").mkdir()
    code = "import eds.compiled; print(eds.compiled.CACHE_DIR)"
    chosen = Path(run(code, ROOT, XDG_CACHE_HOME=str(tmp_path)))
    assert chosen.parent == base
    assert (base / "mine").is_dir()
    assert len([path for path in base.iterdir() if len(path.name) == 16]) == 4
    nowhere = tmp_path / "file"
    nowhere.write_text("")
    assert "coulombus-" in run(code, ROOT, XDG_CACHE_HOME=str(nowhere))
