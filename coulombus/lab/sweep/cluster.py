"""Runs of a sweep on a cluster of dask.distributed, in batches.

The scheduler takes some milliseconds per task, as long as a short run takes. A batch therefore has as
many runs as take `BATCH_S`: each completed batch gives the size of the next, at most twice its own.

A batch has all that it needs with it, so any worker can take it, also one that joined later. If its
worker ends, the scheduler gives it to another.
"""

from __future__ import annotations

import importlib
import pickle
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.metadata import version
from itertools import islice
from typing import Any

from coulombus.lab.sweep.one_run import FinishedRun, Job, RunRequest, carry_out, failed_row
from coulombus.recording.recorder import project_version
from coulombus.system.errors import CoulombusError

__all__ = ["ClusterError", "carry_out_batch", "on_cluster"]

BATCH_S = 1.5
"""Processor time of a batch [s]."""
AHEAD = 2
"""Batches per thread of the cluster: the present one and the next."""
CONNECT_S = 10
_GO_ON = "finished runs are kept, the same command continues"


class ClusterError(CoulombusError):
    """A cluster cannot be used; the text has the reason and the remedy."""

    exit_status = 2


def on_cluster(job: Job, requests: Iterable[RunRequest], address: str) -> Iterator[FinishedRun]:
    """Yield the results of the runs, by the workers of the dask.distributed scheduler at `address`.

    Its workers need this package, and the file of a user-defined law.

    If a run ends several workers, it fails; the scheduler counts them (``allowed-failures``).

    Raises
    ------
    ClusterError
        dask.distributed is not installed, no scheduler responds there, or a worker has other versions
    """
    cluster, client = _connected(address)
    packed, versions, waiting = pickle.dumps(job), _versions(), iter(requests)
    at_work: dict[Any, Sequence[RunRequest]] = {}
    with client:
        if not client.nthreads():
            raise ClusterError(f"--dask {address}: the cluster has no worker; start one with dask worker {address}")
        coming = cluster.as_completed()

        def give(batch: Sequence[RunRequest]) -> None:
            task = client.submit(carry_out_batch, packed, batch, versions, pure=False)
            at_work[task] = batch
            coming.add(task)

        def give_next(runs: int) -> None:
            while len(at_work) < AHEAD * max(1, sum(client.nthreads().values())):
                if not (batch := list(islice(waiting, runs))):
                    return
                give(batch)

        give_next(1)
        for task in coming:
            batch = at_work.pop(task)
            try:
                done = task.result()
            except cluster.KilledWorker as error:
                if len(batch) > 1:  # one of its runs ends its worker: each comes alone
                    for request in batch:
                        give([request])
                    continue
                done = [FinishedRun(failed_row(job, batch[0], f"the cluster lost the run: {error}"))]
            except ClusterError as error:
                raise ClusterError(f"--dask {address}: {error}; {_GO_ON}") from None
            except Exception as error:  # the scheduler is lost, or a worker has not what a run needs
                reason = f"{type(error).__name__}: {error}"
                raise ClusterError(f"--dask {address}: a batch of runs failed ({reason}); {_GO_ON}") from None
            give_next(_next_runs(job, done))
            yield from done


def carry_out_batch(packed: bytes, requests: Sequence[RunRequest], expected: Mapping[str, str]) -> list[FinishedRun]:
    """Carry out runs in a worker; `packed` is the pickled job, which another version could not read.

    Raises
    ------
    ClusterError
        the worker has other versions than `expected`
    OSError
        a recording cannot be written
    """
    versions = _versions()
    if versions != expected:
        worker = importlib.import_module("distributed").get_worker().address
        raise ClusterError(f"the worker {worker} has {_text(versions)}, expected {_text(expected)}")
    job = pickle.loads(packed)
    return [carry_out(job, request) for request in requests]


def _connected(address: str) -> tuple[Any, Any]:
    """Return the module distributed, and its client of the scheduler."""
    try:
        cluster: Any = importlib.import_module("distributed")
    except ImportError:
        raise ClusterError(
            "a dask cluster needs dask and distributed: pip install -e '.[cluster]' in the clone"
        ) from None
    try:
        return cluster, cluster.Client(address, timeout=CONNECT_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise ClusterError(
            f"--dask {address}: no scheduler answers ({error}); expected one such as tcp://HOST:8786"
        ) from None


def _next_runs(job: Job, done: Sequence[FinishedRun]) -> int:
    """Return the number of runs that take `BATCH_S`, at most twice as many as `done`."""
    if job.keep != "none":
        return 1  # a batch of recordings could exceed the worker's memory
    share = sum(finished.cpu_s for finished in done) / BATCH_S
    return max(1, round(len(done) / max(share, 0.5)))


def _versions() -> dict[str, str]:
    """Return the versions that the numbers depend on."""
    return {"coulombus": project_version(), "numba": version("numba")}


def _text(versions: Mapping[str, str]) -> str:
    return " and ".join(f"{name} {number}" for name, number in versions.items())
