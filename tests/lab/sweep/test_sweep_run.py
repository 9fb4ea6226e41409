"""A sweep from file to table: the same numbers whoever runs it, in whatever pieces; nothing is lost."""

from __future__ import annotations

import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet
import pytest

from coulombus.lab.simulate import simulate
from coulombus.lab.sweep import one_run, workers
from coulombus.lab.sweep import sweep as module
from coulombus.lab.sweep.figures import FIGURES
from coulombus.lab.sweep.one_run import FinishedRun, Job, carry_out, run_request
from coulombus.lab.sweep.picture import map_of
from coulombus.lab.sweep.sweep import run_sweep
from coulombus.lab.sweep.sweep_file import read_sweep
from coulombus.lab.sweep.sweep_folder import Folder, SweepFolderError
from coulombus.lab.sweep.workers import on_processes
from coulombus.lab.sweep.worst import shrunk
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig, load_rig_text, packaged_rig
from places import ROOT

pytestmark = pytest.mark.slow


def table(folder):
    return pyarrow.parquet.read_table(folder / "runs.parquet").to_pylist()


KNOWN = {}


def known(job, order):
    """Carry out a run; one of the same numbers, by the same `virtual_run`, is done once for all tests."""
    asked = (one_run.virtual_run, job.rig.effective(), repr((job.seconds, job.vary, job.rates, job.keep, order)))
    if asked not in KNOWN:
        KNOWN[asked] = carry_out(job, order)
    return replace(KNOWN[asked], row=dict(KNOWN[asked].row))


PICTURES = {}


def drawn(*of):
    """Draw a map, each once for all tests."""
    return PICTURES.get(repr(of)) or PICTURES.setdefault(repr(of), map_of(*of))


def here(job, requests, count):
    """Carry out the runs in this process."""
    return (known(job, order) for order in requests)


@pytest.fixture
def at_once(monkeypatch):
    """Runs are carried out in this process: no other has to start. What is the same is done once."""
    monkeypatch.setattr(module, "on_processes", here)
    monkeypatch.setattr("coulombus.lab.sweep.worst.carry_out", known)
    monkeypatch.setattr(module, "map_of", drawn)


@pytest.mark.thorough
def test_any_number_of_processes_comes_to_the_same_table(sweep_file, tmp_path, monkeypatch):
    sweep = read_sweep(sweep_file())
    monkeypatch.setattr(module, "map_of", drawn)
    found = [run_sweep(sweep, tmp_path / f"by{n}", processes=n) for n in (2,)]
    monkeypatch.setattr(module, "on_processes", here)
    found.append(run_sweep(sweep, tmp_path / "here"))
    assert len({(tmp_path / name / "runs.parquet").read_bytes() for name in ("by2", "here")}) == 1
    assert len({str(one.rates) for one in found}) == 1
    assert found[0].runs == 6
    assert found[0].simulated_s_per_core_s > 1


def test_a_row_is_what_simulate_comes_to(sweep_file, tmp_path, at_once):
    run_sweep(read_sweep(sweep_file()), tmp_path / "out")
    first, second, *_ = table(tmp_path / "out")
    for row in (first, second):
        rig = load_rig_text(row["rig"], str(packaged_rig("bench")))
        assert rig.one_axis().operator.inertia_kg_m2 == row["operator.inertia_kg_m2"]
        result = simulate(rig, row["mode"], 2.0, seed=row["seed"], record=tmp_path / "run.pcapng", force=True)
        told = result.as_dict()
        for name in FIGURES:
            if "." not in name and not isinstance(told[name], tuple):
                numeric = isinstance(told[name], float)
                assert row[name] == (pytest.approx(told[name], rel=1e-12) if numeric else told[name]), name
        assert row["remarks"] == ("\n".join(told["remarks"]) or None)
        assert row["counters.lost_pdos"] == told["counters"]["lost_pdos"]
        assert row["rates.still"] == (result.hold_counts_p2p <= 2)


def test_a_sweep_that_was_interrupted_goes_on(sweep_file, tmp_path, monkeypatch, at_once):
    sweep = read_sweep(sweep_file())
    run_sweep(sweep, tmp_path / "whole")
    carried = []

    def interrupted(job, requests, count):
        for order in reversed(list(requests)[:4]):  # whatever comes first
            carried.append(order.run)
            yield known(job, order)
        raise KeyboardInterrupt

    monkeypatch.setattr("coulombus.lab.sweep.sweep_folder.PART_RUNS", 2)
    monkeypatch.setattr(module, "on_processes", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_sweep(sweep, tmp_path / "out")
    assert not (tmp_path / "out" / "runs.parquet").exists()
    monkeypatch.setattr(
        module, "on_processes", lambda job, requests, count: (carried.append(o.run) or known(job, o) for o in requests)
    )
    told = []
    run_sweep(sweep, tmp_path / "out", progress=lambda what, done, of, failed: told.append((what, done, of)))
    assert sorted(carried) == list(range(6))
    assert told[0] == ("runs", 4, 6)
    assert table(tmp_path / "out") == table(tmp_path / "whole")
    assert sorted(path.name for path in (tmp_path / "out").iterdir() if path.suffix != ".png") == [
        *(".lock", "runs.parquet", "sweep.json", "sweep.toml", "worst-still.toml")
    ]


def dies(action, call, monkeypatch):
    """Let another process do it, and kill that at the `call`-th time it puts something on the disk.

    Return whether it came to that.
    """
    child = os.fork()
    if child == 0:
        calls = iter(range(1, call))

        def counted(call):
            def called(*arguments):
                if next(calls, None) is None:
                    os.kill(os.getpid(), signal.SIGKILL)
                return call(*arguments)

            return called

        for name in ("fsync", "replace"):
            monkeypatch.setattr(os, name, counted(getattr(os, name)))
        try:
            action()
        finally:
            os._exit(0)
    return os.waitpid(child, 0)[1] == signal.SIGKILL


def test_a_sweep_that_is_killed_anywhere_goes_on_to_the_same_table(sweep_file, tmp_path, monkeypatch):
    sweep, carried = read_sweep(sweep_file()), []

    def remembered(job, requests, count):
        for order in requests:
            carried.append(order.run)
            yield known(job, order)

    monkeypatch.setattr("coulombus.lab.sweep.sweep_folder.PART_RUNS", 2)
    monkeypatch.setattr(module, "on_processes", remembered)
    worst = {}
    monkeypatch.setattr(
        module, "shrunk", lambda job, rate, *more: worst.get(rate) or worst.setdefault(rate, shrunk(job, rate, *more))
    )
    monkeypatch.setattr(module, "map_of", drawn)
    run_sweep(sweep, tmp_path / "whole")
    killed = 0
    for k in range(2, 200, 5):
        out = tmp_path / f"out{k}"
        died = dies(lambda out=out: run_sweep(sweep, out), k, monkeypatch)
        parts = [pyarrow.parquet.read_table(part).to_pylist() for part in (out / "parts").glob("0*.parquet")]
        kept = {row["run"] for part in parts for row in part}
        carried.clear()
        run_sweep(sweep, out)
        assert not kept & set(carried)
        assert table(out) == table(tmp_path / "whole")
        assert [path.name for path in out.rglob(".*")] == [".lock"]
        if not died:
            break
        killed += 1
    assert killed > 3
    assert not died


def test_a_sweep_that_is_done_runs_nothing_again(sweep_file, tmp_path, monkeypatch, at_once):
    sweep = read_sweep(sweep_file())
    first = run_sweep(sweep, tmp_path / "out")
    monkeypatch.setattr(module, "on_processes", lambda *_: pytest.fail("a run is done twice"))
    monkeypatch.setattr(module, "shrunk", lambda *_: pytest.fail("a worst case is looked for twice"))
    assert run_sweep(sweep, tmp_path / "out") == first


@pytest.mark.thorough
def test_a_folder_of_another_sweep_is_not_mixed(sweep_file, tmp_path, at_once):
    out = tmp_path / "out"
    run_sweep(read_sweep(sweep_file()), out)
    (out / "mine.txt").write_text("mine")
    before = (out / "runs.parquet").read_bytes()
    other = read_sweep(sweep_file(**{"seed = 3": "seed = 4"}))
    with pytest.raises(SweepFolderError, match=r"runs of another sweep.*--overwrite"):
        run_sweep(other, out)
    assert (out / "runs.parquet").read_bytes() == before
    run_sweep(other, out, force=True)
    assert {row["seed"] for row in table(out)}.isdisjoint(
        row["seed"] for row in pyarrow.parquet.read_table(pyarrow.BufferReader(before)).to_pylist()
    )
    assert (out / "mine.txt").read_text() == "mine"
    assert "seed = 4" in (out / "sweep.toml").read_text()


def test_a_table_that_is_nobodys_is_not_replaced(sweep_file, tmp_path):
    (tmp_path / "runs.parquet").write_text("mine")
    with pytest.raises(SweepFolderError, match=r"runs.parquet is there"):
        run_sweep(read_sweep(sweep_file()), tmp_path)
    assert (tmp_path / "runs.parquet").read_text() == "mine"


def test_two_sweeps_do_not_share_a_folder(sweep_file, tmp_path):
    sweep = read_sweep(sweep_file())
    with Folder.open(tmp_path / "out", sweep), pytest.raises(SweepFolderError, match="another sweep is at work"):
        run_sweep(sweep, tmp_path / "out")


@pytest.mark.thorough
def test_a_sweep_file_in_its_own_folder_stays(sweep_file, tmp_path, at_once):
    path = sweep_file(**{"runs = 6": "runs = 1", "latin_hypercube": "random"})
    text = path.read_text()
    for force in (False, True):
        run_sweep(read_sweep(path), tmp_path, force=force)
        assert path.read_text() == text
    assert len(table(tmp_path)) == 1


@pytest.mark.thorough
def test_a_run_that_fails_is_a_row_and_misses_its_rates(sweep_file, tmp_path, at_once):
    text = """
design = "grid"
seconds = 0.5
[vary]
mode.hybrid.F_s_Nm = { values = [3.5, 1000.0] }
limits.net_work_J = { values = [0.15, 1e-9] }
[rates]
known = "cycles > 0"
"""
    result = run_sweep(read_sweep(sweep_file(text)), tmp_path / "out")
    rows = table(tmp_path / "out")
    assert result.runs == 4
    assert [row["error"] and row["error"].partition(": ")[0] for row in rows] == [None, "trip", "refused", "refused"]
    assert "1000" in rows[2]["error"]
    assert result.failed == 3
    assert (result.rates["known"].count, result.rates["known"].of) == (2, 4)
    assert rows[1]["trip"].startswith("NET_WORK")
    assert (rows[2]["cycles"], rows[2]["rates.known"]) == (None, False)


@pytest.mark.thorough
def test_a_mistake_of_the_program_ends_no_sweep(sweep_file, tmp_path, monkeypatch, at_once):
    def mistaken(run):
        if run.rig.one_axis().operator.inertia_kg_m2 > 5e-3:
            raise KeyError("6072h")
        return simulate(run.rig, "active", 0.01, measured=True)

    monkeypatch.setattr("coulombus.lab.sweep.one_run.virtual_run", mistaken)
    result = run_sweep(read_sweep(sweep_file()), tmp_path / "out")
    errors = [row["error"] for row in table(tmp_path / "out")]
    assert errors.count("KeyError: '6072h'") == result.failed == 3


@pytest.mark.thorough
def test_a_killed_process_costs_one_run(sweep_file, monkeypatch):
    sweep = read_sweep(sweep_file())
    requests = [run_request(sweep, run) for run in range(sweep.runs)]
    started = []
    own = workers._Worker

    def starting(job):
        started.append(own(job))
        return started[-1]

    monkeypatch.setattr(workers, "_Worker", starting)
    rows = {}
    for done in on_processes(Job.from_sweep(sweep), requests, 1):
        rows[done.row["run"]] = done.row
        if len(rows) == 1:
            os.kill(started[0].process.pid, signal.SIGKILL)
    assert sorted(rows) == list(range(6))
    assert [row["error"] for _, row in sorted(rows.items())].count("the process of the run ended by SIGKILL") == 1
    assert all(worker.process.poll() is not None for worker in started)


@pytest.mark.thorough
def test_a_process_has_its_next_run_before_the_present_is_done(sweep_file, monkeypatch):
    sweep = read_sweep(sweep_file())
    requests = [run_request(sweep, run) for run in range(sweep.runs)]
    held, own = [], workers._Worker.send

    def send(worker, request):
        own(worker, request)
        held.append(len(worker.requests))

    monkeypatch.setattr(workers._Worker, "send", send)
    assert sorted(done.row["run"] for done in on_processes(Job.from_sweep(sweep), requests, 1)) == list(range(6))
    assert held[:2] == [1, 2]
    assert held[-1] == 1
    assert max(held) == 2


def test_processes_that_cannot_start_end_the_sweep(sweep_file, monkeypatch):
    sweep = read_sweep(sweep_file())
    monkeypatch.setattr(workers, "MODULE", "coulombus.lab.sweep.none")
    with pytest.raises(RuntimeError, match="with exit status 1 before their first run"):
        list(on_processes(Job.from_sweep(sweep), [run_request(sweep, 0)], 1))


@pytest.mark.parametrize(("keep", "kept"), [("none", 0), ("failing", 2), ("all", 3)])
def test_recordings_are_kept_as_asked(sweep_file, tmp_path, keep, kept, at_once):
    text = """
design = "grid"
seconds = 0.5
[vary]
limits.net_work_J = { values = [1e-9, 0.15, 2e-9] }
[rates]
untripped = "trip == none"
"""
    run_sweep(read_sweep(sweep_file(text)), tmp_path / "out", keep=keep)
    rows = table(tmp_path / "out")
    assert [row["rates.untripped"] for row in rows] == [False, True, False]
    recordings = [row["recording"] for row in rows if row["recording"]]
    assert len(recordings) == kept
    for row in rows:
        if row["recording"]:
            recording = read(tmp_path / "out" / row["recording"])
            assert recording.rig.one_axis().limits.net_work_J == row["limits.net_work_J"]
            assert any(text.startswith("trip NET_WORK") for _, text in recording.markers) == (
                not row["rates.untripped"]
            )


@pytest.mark.thorough
def test_the_worst_case_is_a_rig_that_simulate_takes_and_that_fails(sweep_file, tmp_path, at_once):
    text = """
design = "grid"
seconds = 0.8
[vary]
limits.net_work_J = { low = 1e-9, high = 2e-9, count = 2 }
operator.tremor_Hz = { values = [8.5, 9.0] }
operator.tremor_Nm = { values = [0.02, 0.04] }
[rates]
untripped = "trip == none"
"""
    sweep = read_sweep(sweep_file(text))
    result = run_sweep(sweep, tmp_path / "out")
    assert result.rates["untripped"].count < result.runs
    worst = result.worst["untripped"]
    assert set(worst["values"]) == {"limits.net_work_J"}  # all others go back to the rig's own
    assert worst["values"]["limits.net_work_J"] > 0.0
    again = simulate(load_rig(worst["file"]), worst["mode"], 0.8, seed=worst["seed"])
    assert again.trip is not None
    milder = load_rig(worst["file"], [f"limits.net_work_J={worst['values']['limits.net_work_J'] + 0.15 / 60}"])
    assert simulate(milder, worst["mode"], 0.8, seed=worst["seed"]).trip is None


def test_a_worst_case_is_bisected_to_the_boundary(sweep_file, monkeypatch):
    """Against a plain function of the values, whose boundary is known."""
    text = """
design = "random"
runs = 1
[vary]
operator.tremor_Hz = { low = 9.0, high = 29.0 }
operator.inertia_kg_m2 = { low = 1e-4, high = 1.0, scale = "log" }
operator.tremor_Nm = { values = [0.02, 0.5] }
[rates]
still = "cycles == 1"
"""
    sweep = read_sweep(sweep_file(text))
    asked = []

    def judged(job, order):
        asked.append(order.values)
        Hz, inertia, _ = order.values
        return FinishedRun({"rig": "", "error": None, "cycles": 1, "rates.still": not (Hz > 12.0 and inertia > 0.05)})

    monkeypatch.setattr("coulombus.lab.sweep.worst.carry_out", judged)
    start = replace(run_request(sweep, 0), values=(28.0, 0.9, 0.5))
    worst = shrunk(Job.from_sweep(sweep), "still", start)
    assert worst.values.keys() == {"operator.tremor_Hz", "operator.inertia_kg_m2"}
    assert 12.0 < worst.values["operator.tremor_Hz"] < 12.0 + 19.0 / 60
    assert 0.05 < worst.values["operator.inertia_kg_m2"] < 0.05 * (0.9 / 5e-4) ** (1 / 60)
    assert worst.tried == len(asked) == 2 * 7 + 1


@pytest.mark.thorough
def test_the_worst_case_of_a_rig_elsewhere_finds_its_files(tmp_path, at_once):
    (tmp_path / "lab").mkdir()
    eds = (Path(packaged_rig("bench")).parents[1] / "eds" / "motor.eds").read_text()
    (tmp_path / "lab" / "mine.eds").write_text(eds)
    (tmp_path / "lab" / "law.py").write_text((ROOT / "examples" / "own_law.py").read_text())
    rig = packaged_rig("bench").read_text().replace('eds = "motor.eds"', 'eds = "mine.eds"')
    (tmp_path / "lab" / "rig.toml").write_text(
        rig.replace('"karnopp"', '"law.py:stribeck"').replace("user = []", "user = [0.5]")
    )
    (tmp_path / "lab" / "sweep.toml").write_text(
        'rig = "rig.toml"\nseconds = 0.5\ndesign = "random"\nruns = 1\n'
        "[vary]\nlimits.net_work_J = { values = [1e-9] }\n[rates]\nuntripped = 'trip == none'\n"
    )
    result = run_sweep(read_sweep(tmp_path / "lab" / "sweep.toml"), tmp_path / "elsewhere")
    file = result.worst["untripped"]["file"]
    assert simulate(file, "hybrid", 0.5, seed=result.worst["untripped"]["seed"]).trip is not None
    assert (tmp_path / "elsewhere" / "worst-untripped-1.eds").read_text() == eds


@pytest.mark.thorough
def test_maps_are_pictures_and_the_same_each_time(sweep_file, tmp_path, at_once, monkeypatch):
    monkeypatch.setattr(module, "map_of", map_of)
    sweep = read_sweep(sweep_file())
    pictures = []
    for name in ("a", "b"):
        result = run_sweep(sweep, tmp_path / name)
        assert result.maps.keys() == {"still", "untripped"}
        pictures.append([path.read_bytes() for path in result.maps.values()])
    assert pictures[0] == pictures[1]
    assert all(picture.startswith(b"\x89PNG") for picture in pictures[0])


def test_a_disk_that_is_full_is_told_and_costs_nothing_that_is_done(sweep_file, tmp_path, monkeypatch, at_once):
    sweep = read_sweep(sweep_file())
    monkeypatch.setattr("coulombus.lab.sweep.sweep_folder.LEAST_PART_S", 0.0)
    own, written = workers, []
    from coulombus.lab.sweep import sweep_folder

    whole = sweep_folder.write_whole

    def full(path, content, *more):
        if path.suffix == ".parquet" and len(written) == 2:
            raise OSError(28, "No space left on device")
        written.append(path.name) if path.suffix == ".parquet" else None
        whole(path, content, *more)

    monkeypatch.setattr(sweep_folder, "write_whole", full)
    with pytest.raises(SweepFolderError, match=r"cannot be written \(No space left on device\).*make room"):
        run_sweep(sweep, tmp_path / "out")
    monkeypatch.setattr(sweep_folder, "write_whole", whole)
    carried = []
    monkeypatch.setattr(
        module, "on_processes", lambda job, requests, count: (carried.append(o.run) or known(job, o) for o in requests)
    )
    assert run_sweep(sweep, tmp_path / "out").runs == 6
    assert carried == [2, 3, 4, 5]
    assert own is workers


def test_a_torn_part_is_none(sweep_file, tmp_path, at_once, monkeypatch):
    """A power cut leaves files under their first names, never a torn one under its last."""
    monkeypatch.setattr("coulombus.lab.sweep.sweep_folder.LEAST_PART_S", 0.0)
    sweep = read_sweep(sweep_file())
    (tmp_path / "out" / "parts").mkdir(parents=True)
    with Folder.open(tmp_path / "out", sweep) as kept:
        kept.add(carry_out(Job.from_sweep(sweep), run_request(sweep, 0)).row)
    (tmp_path / "out" / "parts" / ".000003-1-beef.parquet").write_bytes(b"PAR1 torn")
    with Folder.open(tmp_path / "out", sweep) as kept:
        assert kept.left == [1, 2, 3, 4, 5]
    assert not list((tmp_path / "out" / "parts").glob(".*"))


def test_parts_of_another_size_are_carried_out_again(sweep_file, tmp_path, at_once, monkeypatch):
    sweep, out = read_sweep(sweep_file()), tmp_path / "out"
    monkeypatch.setattr("coulombus.lab.sweep.sweep_folder.PART_RUNS", 2)
    with Folder.open(out, sweep) as kept:
        for run in range(4):
            kept.add(carry_out(Job.from_sweep(sweep), run_request(sweep, run)).row)
    monkeypatch.setattr("coulombus.lab.sweep.sweep_folder.PART_RUNS", 3)
    with Folder.open(out, sweep) as kept:
        assert kept.left == [2, 3, 4, 5]
    run_sweep(sweep, out)
    run_sweep(sweep, tmp_path / "whole")
    assert table(out) == table(tmp_path / "whole")


def test_a_short_sweep_is_written_as_one_part(sweep_file, tmp_path):
    sweep = read_sweep(sweep_file())
    with Folder.open(tmp_path / "out", sweep) as kept:
        assert kept.rows_of_part > sweep.runs


def test_the_result_is_what_the_verb_prints(sweep_file, tmp_path, at_once):
    result = run_sweep(read_sweep(sweep_file()), tmp_path / "out")
    told = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    assert {"runs", "failed", "rates", "simulated_s_per_core_s"} <= told.keys()
    assert told["rates"].keys() == {"still", "untripped"}
    assert told["rates"]["untripped"].keys() == {"count", "of", "low", "high"}
