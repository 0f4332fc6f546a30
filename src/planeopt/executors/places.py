"""Where to work, as a command line says it."""

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from planeopt.errors import InputError
from planeopt.executors.dask_cluster import LOCAL, cluster
from planeopt.executors.pool import processes


@contextmanager
def workers(jobs: int = 1, dask: str | None = None) -> Iterator[Executor | None]:
    """Open what `--jobs N` and `--dask ADDRESS` ask for.

    Parameters
    ----------
    jobs : int
        Processes; of a local cluster, workers.
    dask : str, optional
        Address of a Dask scheduler, or `LOCAL`.

    Yields
    ------
    An executor, or None: for work in this process.

    Raises
    ------
    InputError
        If `jobs` is below 1 or goes with a cluster that runs already; and as `cluster`.
    """
    if jobs < 1:
        raise InputError(f"--jobs must be at least 1, not {jobs}")
    if dask is None:
        with processes(jobs) as executor:
            yield executor
        return
    if dask != LOCAL and jobs != 1:
        raise InputError(
            f"--jobs goes with processes or with --dask {LOCAL}: the cluster at {dask} has its own workers"
        )
    with cluster(dask, jobs) as executor:
        yield executor
