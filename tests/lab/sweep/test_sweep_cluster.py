"""A sweep on a dask cluster: the table of this machine, in batches, whatever happens to the workers."""

from __future__ import annotations

import os
import signal

import pytest

from coulombus.lab.sweep import cluster
from coulombus.lab.sweep import sweep as module
from coulombus.lab.sweep.cluster import ClusterError, on_cluster
from coulombus.lab.sweep.one_run import FinishedRun, Job, carry_out, failed_row, run_request
from coulombus.lab.sweep.sweep import run_sweep
from coulombus.lab.sweep.sweep_file import read_sweep

pytestmark = pytest.mark.slow

distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed (extra [cluster])")


@pytest.fixture
def in_threads():
    """Return a cluster of two workers in this process."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None, silence_logs=False
    ) as local:
        yield local.scheduler_address


@pytest.fixture
def batches(monkeypatch):
    """Return the runs of each batch, as they are submitted."""
    submitted, own = [], distributed.Client.submit

    def submit(client, call, packed, requests, *more, **options):
        submitted.append([request.run for request in requests])
        return own(client, call, packed, requests, *more, **options)

    monkeypatch.setattr(distributed.Client, "submit", submit)
    return submitted


def rows_of(job, requests, address):
    return {done.row["run"]: done.row for done in on_cluster(job, requests, address)}


@pytest.fixture
def many(sweep_file):
    """Return the job and the requests of 100 runs."""
    sweep = read_sweep(sweep_file(**{"runs = 6": "runs = 100"}))
    return Job.from_sweep(sweep), [run_request(sweep, run) for run in range(sweep.runs)]


@pytest.mark.long
def test_a_worker_killed_in_mid_batch_changes_no_byte_of_the_table(sweep_file, tmp_path, monkeypatch):
    sweep = read_sweep(sweep_file())
    monkeypatch.setattr(
        module, "on_processes", lambda job, requests, _: (carry_out(job, request) for request in requests)
    )
    run_sweep(sweep, tmp_path / "here")
    killed = []
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, dashboard_address=None, silence_logs=False
    ) as local:

        def killing(*arguments):
            for done in on_cluster(*arguments):
                if not killed:
                    killed.append(local.workers[0].pid)
                    os.kill(killed[0], signal.SIGKILL)
                yield done

        monkeypatch.setattr(module, "on_cluster", killing)
        run_sweep(sweep, tmp_path / "there", dask=local.scheduler_address)
        assert local.workers[0].pid != killed[0]
    assert (tmp_path / "there" / "runs.parquet").read_bytes() == (tmp_path / "here" / "runs.parquet").read_bytes()


def test_batches_grow_to_their_time(many, in_threads, batches, monkeypatch):
    job, requests = many
    monkeypatch.setattr(
        cluster,
        "carry_out",
        lambda job, request: FinishedRun(failed_row(job, request, "none"), cpu_s=cluster.BATCH_S / 8),
    )
    assert sorted(rows_of(job, requests, in_threads)) == list(range(100))
    assert [len(batch) for batch in batches[:4]] == [1, 1, 1, 1]
    assert max(map(len, batches)) == 8
    assert sorted(run for batch in batches for run in batch) == list(range(100))


def test_recordings_come_one_by_one(many):
    job, requests = many
    done = [FinishedRun(failed_row(job, request, "none"), cpu_s=0.01) for request in requests[:4]]
    assert cluster._next_runs(job, done) == 8
    assert cluster._next_runs(Job(job.rig, job.seconds, job.vary, job.rates, "failing"), done) == 1


def test_a_run_that_ends_its_workers_fails_alone(many, in_threads, batches, monkeypatch):
    job, requests = many

    def deadly(job, request):
        if request.run == 37:
            raise distributed.KilledWorker("batch", distributed.Worker, 3)
        return FinishedRun(failed_row(job, request, "none"), cpu_s=cluster.BATCH_S / 8)

    monkeypatch.setattr(cluster, "carry_out", deadly)
    rows = rows_of(job, requests, in_threads)
    assert sorted(rows) == list(range(100))
    assert [run for run, row in rows.items() if row["error"].startswith("the cluster lost the run")] == [37]
    assert [len(batch) > 1 for batch in batches if 37 in batch] == [True, False]


@pytest.mark.parametrize(("name", "number"), [("coulombus", "0.0.1"), ("numba", "0.59.0")])
def test_a_worker_of_another_version_is_refused_by_name(sweep_file, tmp_path, in_threads, monkeypatch, name, number):
    ours = cluster._versions()
    other = iter([ours])  # the first who asks is the client
    monkeypatch.setattr(cluster, "_versions", lambda: next(other, ours | {name: number}))
    with pytest.raises(
        ClusterError, match=rf"the worker inproc://\S+ has .*{name} {number}.*, expected .*{name} {ours[name]}"
    ):
        run_sweep(read_sweep(sweep_file()), tmp_path / "out", dask=in_threads)
    assert not (tmp_path / "out" / "runs.parquet").exists()


def test_a_worker_that_cannot_run_a_batch_ends_the_sweep(sweep_file, tmp_path, in_threads, monkeypatch):
    def missing(job, request):
        raise ModuleNotFoundError("No module named 'numba'")

    monkeypatch.setattr(cluster, "carry_out", missing)
    with pytest.raises(
        ClusterError,
        match=r"a batch of runs failed .ModuleNotFoundError: No module named 'numba'.; finished runs are kept",
    ):
        run_sweep(read_sweep(sweep_file()), tmp_path / "out", dask=in_threads)


def test_a_cluster_that_cannot_be_used_is_refused(sweep_file, tmp_path, monkeypatch):
    sweep = read_sweep(sweep_file())
    monkeypatch.setattr(cluster, "CONNECT_S", 0.1)
    with pytest.raises(ClusterError, match=r"tcp://127.0.0.1:1: no scheduler answers"):
        run_sweep(sweep, tmp_path / "out", dask="tcp://127.0.0.1:1")
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(ClusterError, match=r"'\.\[cluster\]'"):
        run_sweep(sweep, tmp_path / "out", dask="tcp://127.0.0.1:1")
