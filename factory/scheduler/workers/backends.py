"""The backends by name."""

from __future__ import annotations

from .contract import Backend, WorkerSettings


def open_backend(settings: WorkerSettings) -> Backend:
    """The backend that `settings.backend` names.  Raises FactoryError when it cannot be had."""
    if settings.backend == "serial":
        from .serial import SerialBackend

        return SerialBackend()
    if settings.backend == "dask":
        # Half a second of imports, and an optional dependency.
        from .dask_cluster import DaskBackend

        return DaskBackend(settings)
    from .local import LocalBackend

    return LocalBackend(settings)
