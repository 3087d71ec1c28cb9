"""Where many diagnoses run: processes of this host, or a Dask cluster."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import joblib

from schemas.errors import DataError

REACHED_S = 10.0  # for a scheduler to answer, and to have a worker


@contextmanager
def backend(name: str, jobs: int, scheduler: str | None) -> Iterator[None]:
    """Run joblib on `name`: loky on this host, or dask, on this host or on the workers of `scheduler`.

    Raises:
        DataError: dask is not installed, or `scheduler` does not answer or has no workers.
    """
    if name != "dask":
        with warnings.catch_warnings(), joblib.parallel_config(backend=name, n_jobs=jobs):
            # loky replaces a worker whose memory has grown, and gives what it had to another: nothing to worry about
            warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
            yield
        return
    try:
        from dask.distributed import Client, LocalCluster
    except ImportError as error:
        raise DataError("--backend dask needs dask[distributed]: install deltatwin[dask]") from error
    if scheduler:
        try:
            client = Client(scheduler, timeout=REACHED_S)
            client.wait_for_workers(1, REACHED_S)
        except (OSError, ValueError) as error:
            raise DataError(f"--scheduler {scheduler}: {error}") from error
        with client, joblib.parallel_config(backend="dask"):
            yield
        return
    here = "127.0.0.1"  # the status page would listen on every interface
    local = LocalCluster(n_workers=jobs, threads_per_worker=1, dashboard_address=f"{here}:0", host=here)
    with local as cluster, Client(cluster), joblib.parallel_config(backend="dask"):
        yield
