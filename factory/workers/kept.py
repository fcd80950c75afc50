"""Workers kept from one point of a sweep to the next, which spares their start.

Nothing is kept unless somebody asked for it (`keep_workers`), and only workers of this machine that
wait for work.  A worker builds its source anew when the configuration of a task is another one, so
the same workers serve any number of datasets.
"""

from __future__ import annotations

import atexit
from collections.abc import Mapping

from simnfnd.factory.jobs.settings import Crew, Kind, SchedulerSettings
from simnfnd.factory.workers.backend import Backend, open_backend

_Key = tuple[SchedulerSettings, Crew, tuple[tuple[Kind, int], ...]]


class _Keeper:
    """What is kept: one backend at most, and what it was opened with."""

    def __init__(self) -> None:
        self.asked = False
        self.held: tuple[_Key, Backend] | None = None

    def take(self, key: _Key) -> Backend | None:
        """The kept backend, if it is of this kind; one of another kind is stopped."""
        held, self.held = self.held, None
        if held is None or held[0] == key:
            return held and held[1]
        held[1].stop()
        return None


_keeper = _Keeper()


def keep_workers() -> None:
    """From now on, keep the workers of a run that ended well for the next."""
    if not _keeper.asked:
        # For sweeps that end in an error; before multiprocessing's own, which would wait for them.
        atexit.register(release_workers)
    _keeper.asked = True


def release_workers() -> None:
    """Stop what is kept, and keep no more."""
    _keeper.asked = False
    atexit.unregister(release_workers)
    held, _keeper.held = _keeper.held, None
    if held is not None:
        held[1].stop()


def lease(settings: SchedulerSettings, crew: Crew, tasks_per_worker: Mapping[Kind, int]) -> Backend:
    """The workers that the last run left, where they are the right ones, or new ones.

    Raises FactoryError as `open_backend` does.
    """
    found = _keeper.take(_key(settings, crew, tasks_per_worker))
    return found or open_backend(settings, crew, tasks_per_worker)


def give_back(
    backend: Backend, settings: SchedulerSettings, crew: Crew, tasks_per_worker: Mapping[Kind, int]
) -> None:
    """After a run that ended well: keep the workers if that was asked for, else stop them."""
    if _keeper.asked and settings.backend == "local":
        _keeper.held = (_key(settings, crew, tasks_per_worker), backend)
    else:
        backend.stop()


def _key(settings: SchedulerSettings, crew: Crew, tasks_per_worker: Mapping[Kind, int]) -> _Key:
    return settings, crew, tuple(sorted(tasks_per_worker.items()))
