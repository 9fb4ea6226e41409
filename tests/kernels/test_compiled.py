"""The kernels' cache: nothing compiles twice, and an edited kernel is never served stale."""

from __future__ import annotations

import fcntl
import os
import shutil
import stat
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from coulombus.kernels import numba_inside
from coulombus.kernels.compile_notice import compiling, on_compiling
from coulombus.kernels.decorator import CACHE_DIR, JIT_DISABLED, Entry, kernel
from coulombus.kernels.kernel_cache import LONGEST_S, MARKER, alone, is_cached
from coulombus.kernels.sources import source_key
from coulombus.lab.simulate import simulate
from places import ROOT

CALLEE = "from coulombus.kernels.decorator import kernel\n@kernel\ndef callee(x):\n    return x + {}\n"
CALLER = (
    "from coulombus.kernels.decorator import kernel\n"
    "from coulombus.host.callee import callee\n@kernel\ndef caller(x):\n    return 10 * callee(x)\n"
)


def run(code, directory, **environment):
    return python(code, directory, **environment).stdout.strip()


def python(code, directory, umask=-1, **environment):
    clean = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=directory,
        env={**clean, "PYTHONPATH": str(directory), **environment},
        capture_output=True,
        text=True,
        check=True,
        timeout=900,
        umask=umask,
    )


@pytest.mark.thorough
@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_an_edited_callee_in_another_file_is_compiled_anew(tmp_path):
    for package in ("coulombus", "coulombus/kernels", "coulombus/host"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").touch()
    rooms = tmp_path / "coulombus"
    for module in (ROOT / "coulombus" / "kernels").glob("*.py"):
        name = module.name
        (rooms / "kernels" / name).write_text(module.read_text())
    shutil.copytree(ROOT / "coulombus" / "system", rooms / "system")
    (rooms / "host" / "caller.py").write_text(CALLER)
    call = "from coulombus.host.caller import caller; print(caller(1), sum(caller.stats.cache_hits.values()))"
    cache = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    (rooms / "host" / "callee.py").write_text(CALLEE.format(1))
    assert run(call, tmp_path, **cache) == "20 0"
    assert run(call, tmp_path, **cache) == "20 1"
    (rooms / "host" / "callee.py").write_text(CALLEE.format(2))
    assert run(call, tmp_path, **cache) == "30 0"
    (rooms / "host" / "callee.py").write_text(CALLEE.format(1))  # edited back: the older folder has it
    assert run(call, tmp_path, **cache) == "20 1"


LISTENED = (
    "from coulombus.kernels.compile_notice import on_compiling; heard = []; on_compiling(lambda: heard.append(1))"
)
TOLD = "print(len(heard))"
COMPILED = "import numba; numba.njit(lambda x: x + 1)(1)"


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_nothing_compiles_on_the_second_start():
    """Others may compile into the same cache meanwhile: what this process compiles is counted."""
    simulate("bench", "hybrid", 0.01)
    code = "from coulombus.lab.simulate import simulate; simulate('bench', 'hybrid', 0.01)"
    base = {"NUMBA_CACHE_DIR": str(CACHE_DIR)}
    assert next(CACHE_DIR.rglob("*.nbc"), None) is not None
    assert run(f"{LISTENED}; {code}; {TOLD}; {COMPILED}; {TOLD}", ROOT, **base).split() == ["0", "1"]


def test_the_key_follows_every_source(tmp_path):
    (tmp_path / "node").mkdir()
    empty = source_key(tmp_path)
    (tmp_path / "node" / "core.py").write_text("a = 1\n")
    key = source_key(tmp_path)
    (tmp_path / "node" / "core.py").write_text("a = 2\n")
    two = source_key(tmp_path)
    (tmp_path / "node" / "deeper").mkdir()
    (tmp_path / "node" / "deeper" / "core.py").write_text("a = 1\n")
    three = source_key(tmp_path)
    (tmp_path / "node" / "deeper" / "core.py").write_text("a = 2\n")
    assert len({empty, key, two, three, source_key(tmp_path)}) == 5


@pytest.mark.parametrize("flag", ["-O", "-OO"])
def test_optimised_python_keeps_its_kernels_elsewhere(flag):
    ask = "from coulombus.kernels.sources import source_key; print(source_key())"
    keys = [
        subprocess.run([sys.executable, *flags, "-c", ask], cwd=ROOT, capture_output=True, check=True).stdout
        for flags in ([], [flag])
    ]
    assert keys[0] != keys[1]


WHERE = "from coulombus.kernels import kernel_cache, sources; print(kernel_cache.choose(sources.source_key()))"
DECORATOR = "import coulombus.kernels.decorator as decorator; print(decorator.CACHE_DIR)"
"""The same, and numba's start."""


def made_before(base, number, mtime_s):
    """Make a cache as another state of the sources left it."""
    directory = base / "coulombus" / f"kernels-{number:016x}"
    (directory / "host_1a2b").mkdir(parents=True)
    for name in ("step.f-1.py311.nbi", "step.f-1.py311.1.nbc", "step.f-1.py311.nbi.tmp.0123456789abcdef"):
        (directory / "host_1a2b" / name).write_bytes(b"code")
    (directory / MARKER).write_text(f"{directory.name}\n")
    os.utime(directory / MARKER, (mtime_s, mtime_s))
    return directory


def test_directories_of_the_user_stay_whatever_they_are_called(tmp_path):
    user = [tmp_path / f"{n:016x}" for n in range(8)] + [tmp_path / "my-measurements1"]
    user += [tmp_path / "coulombus" / f"{n:016x}" for n in range(8)]
    user += [tmp_path / "coulombus" / f"kernels-{n:016x}" for n in range(8)]  # without a marker: not made here
    for directory in user:
        directory.mkdir(parents=True)
        (directory / "data.nbi").write_text("mine")
    moved = made_before(tmp_path, 99, 1).rename(tmp_path / "coulombus" / f"kernels-{98:016x}")
    for n in range(1000, 1008):
        made_before(tmp_path, n, n)
    run(WHERE, ROOT, NUMBA_CACHE_DIR=str(tmp_path))
    assert [path for path in user if not (path / "data.nbi").exists()] == []
    assert (moved / MARKER).exists()  # it says another name than its own


def test_our_own_caches_are_removed_a_week_after_their_last_use(tmp_path):
    used = [made_before(tmp_path, n, time.time() - LONGEST_S + 600 * (n - 2.5)) for n in range(10)]
    chosen = Path(run(WHERE, ROOT, NUMBA_CACHE_DIR=str(tmp_path)))
    assert chosen.parent == tmp_path / "coulombus"
    assert [path.exists() for path in used] == [False] * 3 + [True] * 7


def test_our_own_caches_are_kept_up_to_a_size_the_last_used_first(tmp_path):
    used = [made_before(tmp_path, n, time.time() - 600 * n) for n in range(1, 5)]
    for path in used:
        with (path / "large.1.nbc").open("wb") as file:
            file.truncate(900 << 20)  # without a block on the disk
    run(WHERE, ROOT, NUMBA_CACHE_DIR=str(tmp_path))
    assert [path.exists() for path in used] == [True, True, False, False]


def test_a_cache_that_a_process_uses_stays(tmp_path):
    old = [made_before(tmp_path, n, n) for n in range(1, 8)]
    with (old[0] / MARKER).open() as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)
        run(WHERE, ROOT, NUMBA_CACHE_DIR=str(tmp_path))
    assert (old[0] / "host_1a2b" / "step.f-1.py311.nbi").exists()
    assert not old[1].exists()


def test_a_process_holds_its_cache_as_long_as_it_lives(tmp_path):
    # LOCK_EX | LOCK_NB
    code = "import fcntl, coulombus.kernels.decorator as c; m = open(c.CACHE_DIR / 'coulombus-kernels', 'r+'); fcntl.flock(m, 6)"
    with pytest.raises(subprocess.CalledProcessError) as refused:
        run(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path))
    assert "BlockingIOError" in refused.value.stderr


def test_no_link_is_followed_out_of_a_cache(tmp_path):
    base, user = tmp_path / "base", tmp_path / "user"
    user.mkdir()
    (user / "data.nbi").write_text("mine")
    old = [made_before(base, n, n) for n in range(1, 8)]
    (old[0] / "linked").symlink_to(user)
    (old[1] / "host_1a2b" / "notes.txt").write_text("mine")
    stranger = base / "coulombus" / f"kernels-{77:016x}"
    stranger.symlink_to(old[2].rename(tmp_path / "elsewhere"))
    run(WHERE, ROOT, NUMBA_CACHE_DIR=str(base))
    assert (user / "data.nbi").read_text() == "mine"
    assert (old[1] / "host_1a2b" / "notes.txt").read_text() == "mine"
    assert (tmp_path / "elsewhere" / MARKER).exists()


@pytest.mark.thorough
def test_a_child_takes_the_place_of_its_parent(tmp_path):
    child = (
        "import subprocess, sys; print(subprocess.check_output([sys.executable, '-c', sys.argv[1]], text=True).strip())"
    )
    code = f"{DECORATOR}; import sys; sys.argv = ['', {DECORATOR!r}]; {child}"
    first, second = run(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path)).splitlines()
    assert first == second == run(WHERE, ROOT, NUMBA_CACHE_DIR=str(tmp_path))
    other = str(tmp_path / "coulombus" / f"kernels-{5:016x}")  # of a parent with other sources
    assert run(WHERE, ROOT, NUMBA_CACHE_DIR=other) == first


def test_a_place_that_cannot_be_written_is_told_or_has_a_substitute(tmp_path):
    (tmp_path / "file").write_text("")
    no_base = {"XDG_CACHE_HOME": str(tmp_path / "file"), "TMPDIR": str(tmp_path)}
    assert run(WHERE, ROOT, **no_base).startswith(str(tmp_path / f"coulombus-{os.getuid()}"))
    private = tmp_path / f"coulombus-{os.getuid()}"
    private.rename(tmp_path / "other")
    private.write_text("a file")
    done = python(WHERE, ROOT, **no_base)
    assert "every start compiles; name a directory by NUMBA_CACHE_DIR" in done.stderr
    assert not Path(done.stdout.strip()).exists()  # of no use to anybody else: removed at the end
    private.unlink()
    private.symlink_to(tmp_path / "other")
    assert "every start compiles" in python(WHERE, ROOT, **no_base).stderr


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o077, 0o277])
def test_the_cache_is_the_users_alone_whatever_the_umask(tmp_path, umask):
    chosen = Path(python(WHERE, ROOT, umask, XDG_CACHE_HOME=str(tmp_path / "a" / "b")).stdout.strip())
    assert chosen.parent == tmp_path / "a" / "b" / "coulombus"
    for folder in (chosen, chosen.parent, tmp_path / "a" / "b", tmp_path / "a"):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("level", "mode", "mend"),
    [
        (0, 0o777, "chmod 700"),
        (0, 0o770, "chmod 700"),
        (0, 0o701, "chmod 700"),
        (1, 0o777, "chmod go-w"),
        (1, 0o720, "chmod go-w"),
        (2, 0o702, "chmod go-w"),
    ],
)
def test_a_cache_that_another_user_may_enter_or_exchange_is_refused_with_what_mends_it(tmp_path, level, mode, mend):
    """What is kept there is run."""
    given = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "TMPDIR": str(tmp_path)}
    chosen = Path(run(WHERE, ROOT, **given))
    folder = (chosen, *chosen.parents)[level]
    folder.chmod(mode)
    done = python(WHERE, ROOT, **given)
    assert done.stdout.startswith(str(tmp_path / f"coulombus-{os.getuid()}"))
    assert f"refused for compiled code: {folder} has mode {mode:04o}" in done.stderr
    assert f"{mend} {folder}\n" in done.stderr
    subprocess.run([*mend.split(), str(folder)], check=True)
    done = python(WHERE, ROOT, **given)
    assert (done.stdout.strip(), done.stderr) == (str(chosen), "")


@pytest.mark.skipif(os.getuid() != 0, reason="only root gives a folder away")
@pytest.mark.parametrize("level", [0, 1, 2])
def test_a_cache_of_another_user_is_refused(tmp_path, level):
    given = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "TMPDIR": str(tmp_path)}
    chosen = Path(run(WHERE, ROOT, **given))
    folder = (chosen, *chosen.parents)[level]
    os.chown(folder, 65534, 65534)
    done = python(WHERE, ROOT, **given)
    assert done.stdout.startswith(str(tmp_path / f"coulombus-{os.getuid()}"))
    assert f"refused for compiled code: {folder} belongs to user 65534" in done.stderr


@pytest.mark.thorough
def test_without_any_place_to_write_everything_is_compiled_in_memory(tmp_path):
    (tmp_path / "own.py").write_text(
        "from coulombus.kernels.decorator import kernel\n@kernel\ndef f(x):\n    return x + 1\n"
    )
    code = f"import sys, tempfile; tempfile.tempdir = '/proc'; sys.path.append({str(tmp_path)!r}); import own; print(own.f(1))"
    done = python(code, ROOT, NUMBA_CACHE_DIR="/proc")
    assert done.stdout.strip() == "2"
    assert done.stderr.count("no directory can be written; name one by NUMBA_CACHE_DIR") == 1


OWN = "from coulombus.kernels.decorator import kernel\n@kernel\ndef f(x):\n    return x + 1\n@kernel\ndef g(x):\n    return x - f(x)\n"


class OwnKernels:
    """Two kernels in a file of a folder, and their cache."""

    def __init__(self, folder):
        self.folder, self.cache = folder, folder / "cache"
        (folder / "own.py").write_text(OWN)

    def call(self, more="pass"):
        """Call both in a process of their own; return what it printed, and on stderr."""
        done = self.python(f"{more}; print(own.f(1), own.g(5), sum(own.f.stats.cache_hits.values()))")
        return done.stdout.strip(), done.stderr

    def python(self, code):
        imported = f"import sys; sys.path.append({str(self.folder)!r}); import own; "
        return python(imported + code, ROOT, NUMBA_CACHE_DIR=str(self.cache))


@pytest.fixture(scope="module")
def cached_kernels(tmp_path_factory):
    """Return kernels that have been compiled, and a copy of their cache."""
    own = OwnKernels(tmp_path_factory.mktemp("own"))
    assert own.call() == ("2 -1 0", "")
    shutil.copytree(own.cache, own.folder / "copy")
    return own


SPOILT = """
from pathlib import Path
from coulombus.kernels.decorator import CACHE_DIR
from coulombus.cli.errors import _failure
try:
    own.f(1)
except Exception as error:
    print(_failure(error))
"""


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
@pytest.mark.parametrize(
    "spoil",
    [
        pytest.param(lambda whole: b"", id="empty", marks=pytest.mark.thorough),
        pytest.param(lambda whole: whole[: len(whole) // 2], id="half"),
    ],
)
@pytest.mark.parametrize("ending", [pytest.param("nbi", marks=pytest.mark.thorough), "nbc"])
def test_a_damaged_cache_is_told_and_removed(cached_kernels, spoil, ending):
    """As a power cut leaves it."""
    shutil.rmtree(cached_kernels.cache)
    shutil.copytree(cached_kernels.folder / "copy", cached_kernels.cache)
    for path in cached_kernels.cache.rglob(f"own.f-*.{ending}"):
        path.write_bytes(spoil(path.read_bytes()))
    done = cached_kernels.python(SPOILT).stdout.strip()
    assert done.startswith("the compiled code in")
    assert done.endswith("was damaged and is removed; start again")
    assert list(cached_kernels.cache.rglob("*.nb?")) == []


@pytest.mark.thorough
@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_kernels_of_a_removed_cache_are_compiled_again(cached_kernels):
    shutil.rmtree(cached_kernels.cache)
    shutil.copytree(cached_kernels.folder / "copy", cached_kernels.cache)
    assert cached_kernels.call() == ("2 -1 1", "")
    cached_kernels.python(
        "from coulombus.kernels import decorator, kernel_cache; kernel_cache.empty(decorator.CACHE_DIR)"
    )
    assert cached_kernels.call() == ("2 -1 0", "")
    assert cached_kernels.call() == ("2 -1 1", "")


@kernel
def _first(numbers):
    return numbers[0]


@kernel
def _applied(function, numbers):
    return 10 * function(numbers)


@kernel
def _second(numbers):
    return numbers[1]


@pytest.mark.thorough
def test_each_kind_of_argument_has_a_machine_code_of_its_own():
    """What is loaded for one kind is not called with another one."""
    whole, fraction = np.array([3, 4, 5]), np.array([1.5, 2.5, 3.5])
    record = np.array([(7.5, 2)], [("force", float), ("count", int)])
    fixed = whole.copy()
    fixed.flags.writeable = False
    for numbers in (whole, fraction, whole[::2], fixed, fraction, record["force"]):
        assert Entry(_first)(numbers) == numbers[0]
        assert Entry(_applied)(_first, numbers) == 10 * numbers[0]
    assert Entry(_applied)(_second, whole) == 40
    assert Entry(_first)((1, 2.5)) == 1
    assert Entry(_first)((1.5, 2)) == 1.5


@pytest.mark.thorough
@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_of_several_processes_one_compiles(tmp_path):
    """The others wait for it, say so, and load what it kept."""
    (tmp_path / "own.py").write_text(OWN)
    code = (
        f"import sys; sys.path.append({str(tmp_path)!r}); import own\n"
        "from coulombus.kernels.decorator import Entry\n"
        "input(); print(Entry(own.g)(5), len(own.g.stats.cache_hits))"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    several = [
        subprocess.Popen(
            [sys.executable, "-c", code], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(3)
    ]
    for process in several:  # all have been started when the first begins
        process.stdin.write("\n")
        process.stdin.flush()
    said = sorted(process.communicate(timeout=120)[0].strip() for process in several)
    assert said == ["-1 0", "-1 1", "-1 1"]


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_who_waits_for_another_process_says_that_something_is_compiled(tmp_path):
    lines = []
    on_compiling(lambda: lines.append("one"))
    with alone(tmp_path, "other.entry"):
        code = (
            "from pathlib import Path; from coulombus.kernels.kernel_cache import alone\n"
            "from coulombus.kernels.compile_notice import on_compiling\n"
            "on_compiling(lambda: print('waits', flush=True))\n"
            f"with alone(Path({str(tmp_path)!r}), 'own.entry'): print('goes on')"
        )
        waits = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, text=True)
        assert waits.stdout.readline() == "waits\n"
    assert waits.communicate(timeout=120)[0] == "goes on\n"
    assert lines == []
    assert is_cached(tmp_path, "other.entry")
    assert is_cached(tmp_path, "own.entry")
    assert not is_cached(tmp_path, "entry")
    compiling()


def test_what_cannot_be_compiled_counts_as_nothing_and_keeps_nobody_waiting(tmp_path):
    for _ in range(2):
        with pytest.raises(RuntimeError), alone(tmp_path, "own.entry"):
            raise RuntimeError
    assert not is_cached(tmp_path, "own.entry")


@pytest.mark.thorough
@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_a_constant_is_compiled_once_with_what_is_variable(tmp_path):
    (tmp_path / "own.py").write_text(
        "from coulombus.kernels.decorator import constant, kernel\n"
        "ONE, TWO = constant(1), constant(2)\n"
        "@kernel\ndef f(x):\n    return x + 1\n"
        "@kernel\ndef g(x):\n    return f(ONE) + f(TWO) + f(x)\n"
    )
    code = f"import sys; sys.path.append({str(tmp_path)!r}); import own; print(own.g(5), len(own.f.signatures))"
    assert run(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path / "cache")) == "11 1"


@pytest.mark.thorough
@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_a_law_that_is_a_kernel_elsewhere_keeps_its_address(tmp_path):
    kernels = "from coulombus.kernels.decorator import kernel; from coulombus.host.laws import laws; import numpy as np"
    records = "[np.zeros(1, kind).view(np.recarray)[0] for kind in (laws.MOTION, laws.LAW, laws.LAW_STATE)]"
    code = f"{kernels}; print(kernel(laws.coulomb)(*{records})); law = laws.load_law('coulomb', None); print(law.__wrapper_address__() != 0)"
    for _ in range(2):
        assert run(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["0.0", "True"]


@pytest.mark.thorough
@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_a_kernel_that_stands_in_no_file_is_compiled_and_not_kept(tmp_path):
    code = "from coulombus.kernels.decorator import kernel\n@kernel\ndef f(x):\n    return x + 1\nprint(f(1))"
    assert run(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path)) == "2"
    assert list(tmp_path.rglob("*.nbc")) == []


def test_ctrl_c_within_the_compiler_is_raised_behind_it(monkeypatch):
    """LLVM calls Python back; what is raised in there nobody can catch, and Python hands it over."""
    others = []
    monkeypatch.setattr(sys, "unraisablehook", others.append)
    heard = numba_inside.Compilations()
    heard.on_start(None)
    heard.on_start(None)
    sys.unraisablehook(SimpleNamespace(exc_value=KeyboardInterrupt()))
    sys.unraisablehook(SimpleNamespace(exc_value=ValueError("another")))
    with pytest.raises(KeyboardInterrupt):
        heard.on_end(None)
    heard.on_end(None)
    assert sys.unraisablehook == others.append
    assert [str(record.exc_value) for record in others] == ["another"]


def test_who_asked_hears_once_that_something_is_compiled():
    lines = []
    on_compiling(lambda: lines.append("one"))
    compiling()
    compiling()
    assert lines == ["one"]


@pytest.mark.thorough
@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_a_compilation_is_told_and_what_is_loaded_is_not(tmp_path):
    own = OwnKernels(tmp_path)
    ask = "from coulombus.kernels import compile_notice; compile_notice.on_compiling(lambda: print('compiling'))"
    counts = [own.call(ask)[0].count("compiling") for _ in range(2)]
    assert counts == [1, 0]
