"""What a worker of a local Dask cluster loads first."""

from planeopt.executors.worker import settle


def dask_setup(_: object) -> None:
    """Settle the worker's process; Dask calls this by its name."""
    settle()
