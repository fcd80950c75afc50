"""Workers kept from one run to the next (the points of a sweep), which spares their start.

Nothing is kept unless `keep_workers` was called, and only idle workers of this machine.  The same
workers can serve any number of runs, because every task brings all that it needs.
"""

from __future__ import annotations

import atexit
from collections.abc import Iterator
from contextlib import contextmanager

from .contract import Backend, WorkerSettings, open_backend


class _Keeper:
    """What is kept: one backend at most, and what it was opened with."""

    def __init__(self) -> None:
        self.keeping = False
        self.kept: tuple[WorkerSettings, Backend] | None = None

    def take(self, settings: WorkerSettings) -> Backend | None:
        """The kept backend if it has these settings; one with others is stopped."""
        kept, self.kept = self.kept, None
        if kept is None or kept[0] == settings:
            return kept and kept[1]
        kept[1].stop()
        return None


_keeper = _Keeper()


def keep_workers() -> None:
    """From now on, keep the workers of a run that ended well for the next."""
    if not _keeper.keeping:
        # For sweeps that end in an error; before multiprocessing's own, which would wait for them.
        atexit.register(release_workers)
    _keeper.keeping = True


def release_workers() -> None:
    """Stop what is kept, and keep no more."""
    _keeper.keeping = False
    atexit.unregister(release_workers)
    kept, _keeper.kept = _keeper.kept, None
    if kept is not None:
        kept[1].stop()


@contextmanager
def leased(settings: WorkerSettings) -> Iterator[Backend]:
    """The workers that the last run left if they have these settings, otherwise new ones.

    When the block ends well they are kept if `keep_workers` was called; else they are stopped.
    Raises FactoryError as `open_backend` does.
    """
    backend = _keeper.take(settings) or open_backend(settings)
    try:
        yield backend
    except BaseException:
        backend.stop()
        raise
    if _keeper.keeping and settings.backend == "local":
        _keeper.kept = (settings, backend)
    else:
        backend.stop()
