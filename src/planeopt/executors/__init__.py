"""One ordered `map` over any `concurrent.futures.Executor`: in process, over processes, over a Dask cluster."""

from planeopt.executors.dask_cluster import LOCAL, cluster
from planeopt.executors.order import AHEAD, ordered_map
from planeopt.executors.places import workers
from planeopt.executors.pool import processes
from planeopt.executors.worker import ATTEMPTS, WorkerLost

__all__ = ["AHEAD", "ATTEMPTS", "LOCAL", "WorkerLost", "cluster", "ordered_map", "processes", "workers"]
