"""The backends by name."""

from __future__ import annotations

from simnfnd.factory.workers.contract import Backend, WorkerSettings


def open_backend(settings: WorkerSettings) -> Backend:
    """The backend that `settings.backend` names.  Raises FactoryError when it cannot be had."""
    if settings.backend == "serial":
        from simnfnd.factory.workers.serial import SerialBackend

        return SerialBackend()
    if settings.backend == "dask":
        # Half a second of imports, and an optional dependency.
        from simnfnd.factory.workers.dask_cluster import DaskBackend

        return DaskBackend(settings)
    from simnfnd.factory.workers.local import LocalBackend

    return LocalBackend(settings)
