"""Processes that run tasks, one module a backend; `contract` is what all of them keep."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from .contract import Backend, SerialBackend, WorkerSettings


@contextmanager
def workers_of(settings: WorkerSettings) -> Iterator[Backend]:
    """The backend that `settings.backend` names, stopped at the end of the block.

    Raises FactoryError when it cannot be had.
    """
    backend: Backend
    if settings.backend == "serial":
        backend = SerialBackend()
    elif settings.backend == "dask":
        # Half a second of imports, and an optional dependency.
        from .dask_cluster import DaskBackend

        backend = DaskBackend(settings)
    else:
        from .local import LocalBackend

        backend = LocalBackend(settings)
    try:
        yield backend
    finally:
        backend.stop()
