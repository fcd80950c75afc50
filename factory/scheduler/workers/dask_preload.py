"""Read by Dask workers when they start, by `--preload`."""

from __future__ import annotations

from typing import Any

from .start import start_worker_process


def dask_setup(worker: Any) -> None:
    """Called by Dask in the new worker process."""
    start_worker_process()
