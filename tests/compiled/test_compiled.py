"""The kernels' cache: nothing compiles twice, and an edited kernel is never served stale."""

from __future__ import annotations

import fcntl
import os
import stat
import subprocess
import sys
from pathlib import Path

from coulombus.compiled.decorator import CACHE_DIR, JIT_DISABLED
from coulombus.compiled.kernel_cache import KEPT, MARKER
from coulombus.compiled.kernel_files import KernelCache
from coulombus.compiled.notice import compiling, on_compiling
from coulombus.compiled.sources import source_key

import pytest  # isort: skip
from numba.core.registry import cpu_target  # isort: skip

ROOT = Path(__file__).resolve().parent.parent.parent

CALLEE = "from coulombus.compiled.decorator import kernel\n@kernel\ndef callee(x):\n    return x + {}\n"
CALLER = (
    "from coulombus.compiled.decorator import kernel\n"
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


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_an_edited_callee_in_another_file_is_compiled_anew(tmp_path):
    for package in ("coulombus", "coulombus/compiled", "coulombus/host"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").touch()
    rooms = tmp_path / "coulombus"
    for module in (ROOT / "compiled").glob("*.py"):
        name = module.name
        (rooms / "compiled" / name).write_text((ROOT / "compiled" / name).read_text())
    (rooms / "private_folder.py").write_text((ROOT / "coulombus" / "private_folder.py").read_text())
    (rooms / "host" / "caller.py").write_text(CALLER)
    call = "from coulombus.host.caller import caller; print(caller(1), sum(caller.stats.cache_hits.values()))"
    cache = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    (rooms / "host" / "callee.py").write_text(CALLEE.format(1))
    assert run(call, tmp_path, **cache) == "20 0"
    assert run(call, tmp_path, **cache) == "20 1"
    (rooms / "host" / "callee.py").write_text(CALLEE.format(2))
    assert run(call, tmp_path, **cache) == "30 0"
    (rooms / "host" / "other.py").write_text("edited = 1\n")  # a new directory, but nothing to compile
    assert run(call, tmp_path, **cache) == "30 1"
    (rooms / "host" / "callee.py").write_text(CALLEE.format(1))  # edited back: an older directory has it
    assert run(call, tmp_path, **cache) == "20 1"
    for kept in (tmp_path / "cache" / "coulombus").iterdir():
        kept.chmod(0o770)
    (rooms / "host" / "other.py").write_text("edited = 2\n")  # nothing is taken from where others could write
    assert run(call, tmp_path, **cache) == "20 0"


LISTENED = "import sys; from numba.core import event; heard = event.RecordingListener(); event.register('numba:compile', heard)"
TOLD = "print('numba.np.arraymath' in sys.modules, sum(one.is_start for _, one in heard.buffer))"
COMPILED = "import numba; numba.njit(lambda x: x + 1)(1)"


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_nothing_compiles_on_the_second_start_nor_is_prepared_for_it():
    """What numba registers before it compiles took an eighth of each start.

    Others may compile into the same cache meanwhile: what this process compiles is counted.
    """
    code = "from coulombus.lab.simulate import simulate; simulate('bench', 'hybrid', 0.01)"
    base = {"NUMBA_CACHE_DIR": str(CACHE_DIR)}
    run(code, ROOT, **base)
    assert next(CACHE_DIR.rglob("*.nbc"), None) is not None
    assert run(f"{LISTENED}; {code}; {TOLD}; {COMPILED}; {TOLD}", ROOT, **base).split() == ["False", "0", "True", "1"]


IMPORTS = """
from coulombus.wire.one import (
    a,
    b as c,
)
from coulombus.wire import two, three as third

def late():
    import coulombus.wire.four.five
    from coulombus.six import seven
"""


def test_the_stamp_follows_what_is_imported_and_nothing_else(tmp_path):
    names = ("wire/one", "wire/two", "wire/three", "wire/four/five", "six", "wire/__init__", "wire/four/__init__")
    (tmp_path / "wire" / "four").mkdir(parents=True)
    (tmp_path / "top.py").write_text(IMPORTS)
    for name in (*names, "wire/unrelated", "wire/deep"):
        (tmp_path / f"{name}.py").write_text("")
    (tmp_path / "wire" / "one.py").write_text("from coulombus.wire.deep import d\n")

    def now():
        code = f"print(stamp({str(tmp_path / 'top.py')!r}, Path({str(tmp_path)!r})))"
        return run(f"from pathlib import Path; from coulombus.compiled.sources import stamp; {code}", ROOT)

    found = [now()]
    for name in (*names, "wire/deep"):
        with (tmp_path / f"{name}.py").open("a") as file:
            file.write("x = 1\n")
        found.append(now())
    assert len(set(found)) == len(found)
    (tmp_path / "wire" / "unrelated.py").write_text("x = 1\n")
    assert now() == found[-1]


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


def test_a_source_that_is_edited_meanwhile_keeps_the_stamp_of_what_was_compiled(tmp_path):
    file = tmp_path / "wire" / "one.py"
    file.parent.mkdir()
    file.write_text("a = 1\n")
    asked = f"stamp({str(file)!r}, root)"
    before = f"from pathlib import Path; from coulombus.compiled.sources import source_key, stamp; root = Path({str(tmp_path)!r})"
    old = run(f"{before}; print({asked})", ROOT)
    edited = f"source_key(root); Path({str(file)!r}).write_text('a = 2\\n')"
    assert run(f"{before}; {edited}; print({asked})", ROOT) == old
    assert run(f"{before}; print({asked})", ROOT) != old


WHERE = "import coulombus.compiled.decorator; print(coulombus.compiled.decorator.CACHE_DIR)"


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
    for n in range(1000, 1000 + 2 * KEPT):
        made_before(tmp_path, n, n)
    run(WHERE, ROOT, NUMBA_CACHE_DIR=str(tmp_path))
    assert [path for path in user if not (path / "data.nbi").exists()] == []
    assert (moved / MARKER).exists()  # it says another name than its own


def test_the_oldest_of_our_own_caches_are_removed(tmp_path):
    old = [made_before(tmp_path, n, n) for n in range(1, 2 * KEPT)]
    chosen = Path(run(WHERE, ROOT, NUMBA_CACHE_DIR=str(tmp_path)))
    assert chosen.parent == tmp_path / "coulombus"
    assert [path for path in old if path.exists()] == old[-(KEPT - 1) :]


def test_a_cache_that_a_process_uses_stays(tmp_path):
    old = [made_before(tmp_path, n, n) for n in range(1, 2 * KEPT)]
    with (old[0] / MARKER).open() as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)
        run(WHERE, ROOT, NUMBA_CACHE_DIR=str(tmp_path))
    assert (old[0] / "host_1a2b" / "step.f-1.py311.nbi").exists()
    assert not old[1].exists()


def test_a_process_holds_its_cache_as_long_as_it_lives(tmp_path):
    # LOCK_EX | LOCK_NB
    code = "import fcntl, coulombus.compiled.decorator as c; m = open(c.CACHE_DIR / 'coulombus-kernels', 'r+'); fcntl.flock(m, 6)"
    with pytest.raises(subprocess.CalledProcessError) as refused:
        run(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path))
    assert "BlockingIOError" in refused.value.stderr


def test_no_link_is_followed_out_of_a_cache(tmp_path):
    base, user = tmp_path / "base", tmp_path / "user"
    user.mkdir()
    (user / "data.nbi").write_text("mine")
    old = [made_before(base, n, n) for n in range(1, 2 * KEPT)]
    (old[0] / "linked").symlink_to(user)
    (old[1] / "host_1a2b" / "notes.txt").write_text("mine")
    stranger = base / "coulombus" / f"kernels-{77:016x}"
    stranger.symlink_to(old[2].rename(tmp_path / "elsewhere"))
    run(WHERE, ROOT, NUMBA_CACHE_DIR=str(base))
    assert (user / "data.nbi").read_text() == "mine"
    assert (old[1] / "host_1a2b" / "notes.txt").read_text() == "mine"
    assert (tmp_path / "elsewhere" / MARKER).exists()


def test_a_child_takes_the_place_of_its_parent(tmp_path):
    child = (
        "import subprocess, sys; print(subprocess.check_output([sys.executable, '-c', sys.argv[1]], text=True).strip())"
    )
    code = f"{WHERE}; import sys; sys.argv = ['', {WHERE!r}]; {child}"
    first, second = run(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path)).splitlines()
    assert first == second
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


def test_without_any_place_to_write_everything_is_compiled_in_memory(tmp_path):
    (tmp_path / "own.py").write_text(
        "from coulombus.compiled.decorator import kernel\n@kernel\ndef f(x):\n    return x + 1\n"
    )
    code = f"import sys, tempfile; tempfile.tempdir = '/proc'; sys.path.append({str(tmp_path)!r}); import own; print(own.f(1))"
    done = python(code, ROOT, NUMBA_CACHE_DIR="/proc")
    assert done.stdout.strip() == "2"
    assert done.stderr.count("no directory can be written; name one by NUMBA_CACHE_DIR") == 1


OWN = "from coulombus.compiled.decorator import kernel\n@kernel\ndef f(x):\n    return x + 1\n@kernel\ndef g(x):\n    return x - f(x)\n"


@pytest.fixture
def own_kernels(tmp_path):
    """Return a call of two kernels in a process of its own: what it printed, and on stderr."""
    (tmp_path / "own.py").write_text(OWN)

    def call(more="pass"):
        code = f"import sys; sys.path.append({str(tmp_path)!r}); import own; {more}; print(own.f(1), own.g(5), sum(own.f.stats.cache_hits.values()))"
        done = python(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
        return done.stdout.strip(), done.stderr

    return call


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_a_kernel_that_only_kernels_call_has_no_machine_code(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    code = f"import sys; sys.path.append({str(tmp_path)!r}); import own; print(own.g(5), len(own.f.signatures), len(own.f.bodies))"
    assert run(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path / "cache")) == "-1 0 1"
    assert [len(list((tmp_path / "cache").rglob(f"own.{name}-*.nbc"))) for name in "fg"] == [1, 2]


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_with_another_numba_all_is_compiled_in_its_way(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    code = (
        "import numba.core.utils, numba; numba.version_info = numba.version_info._replace(short=(0, 59))\n"
        f"import sys; sys.path.append({str(tmp_path)!r}); import own\n"
        "from coulombus.compiled.decorator import compile_together\n"
        "compile_together(own.g, [(own.f, (1,))])\n"
        "print(own.g(5), type(own.f).__name__, len(own.f.signatures), len(own.g.stats.cache_hits))"
    )
    said = [run(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path / "cache")) for _ in range(2)]
    assert said == ["-1 CPUDispatcher 1 0", "-1 CPUDispatcher 0 1"]


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_a_callee_that_is_no_longer_kept_is_lowered_again(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    begin = f"import sys; sys.path.append({str(tmp_path)!r}); import own, numba; "
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    assert run(begin + "own.g.body((numba.int64,)); print(len(own.f.bodies))", ROOT, **cache) == "1"
    for path in (tmp_path / "cache").rglob("own.f-*"):
        path.unlink()
    code = begin + "print(own.g(5), len(own.f.bodies))"
    assert run(code, ROOT, **cache) == "-1 1"
    assert len(list((tmp_path / "cache").rglob("own.f-*.nbc"))) == 1


ON_A_RECORD = (
    "import sys; sys.path.append({path!r}); import numba, numpy as np\n"
    "for k in range({before}): numba.from_dtype(np.dtype([(str(k), 'i8')]))\n"
    "import own; a = np.zeros(1, [('x', 'i8')]); a['x'] = 5; print(own.g(a))"
)
OF_A_RECORD = (
    "from coulombus.compiled.decorator import kernel\n@kernel\ndef f(r):\n    return r.x + 1\n"
    "@kernel\ndef g(rows):\n    return rows[0].x - f(rows[0])\n"
)


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_a_callee_is_found_whatever_types_a_process_had_before(tmp_path):
    """Numba numbers the types of a process as they come, and names a record by its number: a callee
    that another process lowered anew was not found by its name, and the call ended at address 0.
    """
    (tmp_path / "own.py").write_text(OF_A_RECORD)
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    assert run(ON_A_RECORD.format(path=str(tmp_path), before=0), ROOT, **cache) == "-1"
    for pattern in ("own.f-*", "own.g-*"):  # what refers to it by name stays: the body of g
        for path in (tmp_path / "cache").rglob(pattern):
            if pattern == "own.f-*" or b"\x7fELF" in path.read_bytes():
                path.unlink()
    assert run(ON_A_RECORD.format(path=str(tmp_path), before=7), ROOT, **cache) == "-1"


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
@pytest.mark.parametrize(
    "spoil",
    [
        lambda whole: b"",
        lambda whole: whole[: len(whole) // 2],
        lambda whole: bytes(len(whole)),
        lambda whole: whole[:-20] + bytes([whole[-20] ^ 1]) + whole[-19:],
    ],
    ids=["empty", "half", "zeros", "one bit"],
)
def test_a_damaged_cache_is_told_once_and_compiled_again(own_kernels, tmp_path, spoil):
    assert own_kernels() == ("2 -1 0", "")
    for pattern in ("own.f-*.nbc", "own.g-*.nbi"):
        body, entry = (tmp_path / "cache").rglob(pattern)
        for path in (body, entry):
            path.write_bytes(spoil(path.read_bytes()))
    result, told = own_kernels()
    assert result == "2 -1 0"
    assert told.count("\n") == told.count("was damaged; it is compiled again") == 1
    assert own_kernels() == ("2 -1 1", "")


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_a_file_that_two_processes_named_alike_is_not_taken_for_the_other(own_kernels, tmp_path):
    own_kernels()
    f, g = (sorted((tmp_path / "cache").rglob(f"own.{name}-*.nbc")) for name in "fg")
    assert len(f) == len(g) == 2  # a body and an entry
    for one, other in zip(f, g, strict=True):
        one.write_bytes(other.read_bytes())  # whole, and of another function
    assert own_kernels()[0] == "2 -1 0"


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_a_cache_that_takes_no_more_is_told_once(own_kernels):
    full = "import os; from numba.core.caching import IndexDataCacheFile as F; F._save_data = lambda *_: os.write(os.open('/dev/full', 1), b'x')"
    result, told = own_kernels(full)
    assert result == "2 -1 0"
    assert told.count("\n") == told.count("cannot be kept") == 1
    assert "No space left on device" in told


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_of_several_processes_one_compiles(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    code = f"import sys; sys.path.append({str(tmp_path)!r}); import own; input(); print(own.g(5), len(own.g.stats.cache_hits))"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    several = [
        subprocess.Popen(
            [sys.executable, "-c", code], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(3)
    ]
    for one in several:  # all have been started when the first begins
        one.stdin.write("\n")
        one.stdin.flush()
    said = sorted(one.communicate(timeout=120)[0].strip() for one in several)
    assert said == ["-1 0", "-1 1", "-1 1"]


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_what_another_process_compiles_comes_last(tmp_path):
    (tmp_path / "several.py").write_text(
        "from coulombus.compiled.decorator import compile_together, kernel\n"
        "@kernel\ndef first(x):\n    return x\n@kernel\ndef second(x):\n    return x\n"
        "@kernel\ndef whole(x):\n    return x\n"
        "def taken_until_the_other_is_there():\n"
        "    place, base = Path(first.body_cache.cache_path), first.body_cache._base\n"
        "    lock, wanted = _lock_of(place, base)\n"
        "    fcntl.fcntl(lock, fcntl.F_OFD_SETLK, wanted)\n"
        "    assert first.body_cache.taken and not second.body_cache.taken\n"
        "    threading.Thread(target=free, args=(lock,)).start()\n"
        "def free(lock):\n"
        "    while not second.bodies:\n        pass\n"
        "    order.append(len(first.bodies))\n"
        "    os.close(lock)\n"
        "order = []\nimport fcntl, os, threading\nfrom pathlib import Path\n"
        "from coulombus.compiled.kernel_files import _lock_of\n"
    )
    code = (
        f"import sys; sys.path.append({str(tmp_path)!r}); import several as own\n"
        "own.taken_until_the_other_is_there()\n"
        "own.compile_together(own.whole, [(own.first, (1,)), (own.second, (1,))])\n"
        "print(own.first.body_cache.taken, own.first(3), own.order)"
    )
    done = python(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert (done.stdout, done.stderr) == ("False 3 [0]\n", "")


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_who_waits_for_the_last_part_is_told_that_another_process_goes_on(tmp_path):
    (tmp_path / "several.py").write_text(
        "from coulombus.compiled.decorator import compile_together, kernel, kept, taken\n"
        "@kernel\ndef part(x):\n    return x\n@kernel\ndef whole(x):\n    return part(x)\n"
        "def take(cache):\n"
        "    lock, wanted = _lock_of(Path(cache.cache_path), cache._base)\n"
        "    fcntl.fcntl(lock, fcntl.F_OFD_SETLK, wanted)\n"
        "    return lock\n"
        "def free(lock):\n"
        "    while not part._compiling_counter:\n        pass\n"
        "    os.close(lock)\n"
        "import fcntl, os, threading\nfrom pathlib import Path\n"
        "from coulombus.compiled.kernel_files import _lock_of\n"
    )
    code = (
        f"import sys; sys.path.append({str(tmp_path)!r}); from several import *\n"
        "threading.Thread(target=free, args=(take(part.body_cache),)).start()\n"
        "said = [compile_together(whole, [(part, (1,))]) for _ in range(2)]\n"
        "said += [kept(whole), taken(whole)]\n"
        "lock = take(whole._cache); said.append(taken(whole)); os.close(lock)\n"
        "print(*said, whole(3), kept(whole), taken(whole), compile_together(whole, []))"
    )
    done = python(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert (done.stdout, done.stderr) == ("True False False False True 3 True False False\n", "")


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_a_kernel_that_cannot_be_compiled_keeps_nobody_waiting(own_kernels, tmp_path):
    bad = "import numba\nwhile True:\n try:\n  own.f('x')\n except numba.TypingError:\n  break\nimport fcntl, struct, pathlib, compiled_dir"
    (tmp_path / "compiled_dir.py").write_text(
        "import fcntl, os, struct\n"
        "from coulombus.compiled.decorator import CACHE_DIR\n"
        "lock = os.open(CACHE_DIR / 'compiling', os.O_RDWR)\n"
        "fcntl.fcntl(lock, fcntl.F_OFD_SETLK, struct.pack('hhqqi4x', fcntl.F_WRLCK, 0, 0, 0, 0))\n"  # all of it
        "os.close(lock)\n"
    )
    (tmp_path / "own.py").write_text(OWN)
    code = f"import sys; sys.path.append({str(tmp_path)!r}); import own\n{bad}\nprint(own.f(1))"
    done = python(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert (done.stdout, done.stderr) == ("2\n", "")


def test_a_signal_while_a_kernel_is_loaded_keeps_nobody_waiting():
    class Interrupted:
        def _load_overload(self, sig, target_context):
            raise KeyboardInterrupt

    cache = KernelCache(test_the_key_follows_every_source, {})
    cache._numbas, cache._lock = Interrupted(), os.open(os.devnull, os.O_RDWR)
    held = cache._lock
    with pytest.raises(KeyboardInterrupt):
        cache.load_overload(None, cpu_target.target_context)
    assert cache._lock is None
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(held)


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_a_law_that_is_a_kernel_elsewhere_keeps_its_address(tmp_path):
    kernels = (
        "from coulombus.compiled.decorator import kernel; from coulombus.host.laws import laws; import numpy as np"
    )
    records = "[np.zeros(1, kind).view(np.recarray)[0] for kind in (laws.MOTION, laws.LAW, laws.LAW_STATE)]"
    code = f"{kernels}; print(kernel(laws.coulomb)(*{records})); law = laws.load_law('coulomb', None); print(law.__wrapper_address__() != 0)"
    for _ in range(2):
        assert run(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["0.0", "True"]


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_a_kernel_that_stands_in_no_file_is_compiled_and_not_kept(tmp_path):
    code = "from coulombus.compiled.decorator import kernel\n@kernel\ndef f(x):\n    return x + 1\nprint(f(1))"
    assert run(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path)) == "2"
    assert list(tmp_path.rglob("*.nbc")) == []


INTERRUPTED = """
import os, signal, sys
from numba.core.codegen import JITCodeLibrary

def hook(module, _):
    if module.name == "f":
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(9):
            pass

JITCodeLibrary._object_compiled_hook = hook
sys.path.append({place!r})
import own
try:
    own.f(1)
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_ctrl_c_within_the_compiler_ends_it(own_kernels, tmp_path):
    """LLVM calls this hook back; what is raised in it nobody can catch."""
    code = INTERRUPTED.format(place=str(tmp_path))
    done = python(code, ROOT, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert (done.stdout, done.stderr) == ("interrupted\n", "")


def test_who_asked_hears_once_that_something_is_compiled():
    told = []
    on_compiling(lambda: told.append("one"))
    compiling()
    compiling()
    assert told == ["one"]


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_a_compilation_is_told_and_what_is_loaded_is_not(own_kernels):
    ask = "from coulombus.compiled import notice; notice.on_compiling(lambda: print('compiling'))"
    told = [own_kernels(ask)[0].count("compiling") for _ in range(2)]
    assert told == [1, 0]
