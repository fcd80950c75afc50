"""Workers of a Dask cluster: one on this machine, or any that a scheduler's address leads to.

Each worker has one thread and a nanny that replaces it when it dies.  Retries stay in our run loop:
a death is told at once (`allowed-failures` 0 on clusters started here; docs/cluster.md tells how to
set it for others).  Render tasks go only to workers with the resource `render`.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeVar

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.jobs.settings import Crew, Kind, SchedulerSettings
from simnfnd.factory.workers.local import THREAD_VARIABLES

T = TypeVar("T")

RESOURCE = "render"
_LOGGING = "DASK_LOGGING__DISTRIBUTED"
_CONNECT_S = 20.0
_STOP_S = 4.0
_LOOK_S = 2.0
_STARTS = 5


@dataclass(eq=False)
class _Task:
    kind: Kind
    future: Future[Any]
    there: Any
    deadline: float


class DaskBackend:
    """A `simnfnd.factory.workers.backend.Backend` over `distributed.Client`."""

    def __init__(self, settings: SchedulerSettings, crew: Crew) -> None:
        """Connect, or start a cluster.  Raises FactoryError when neither works."""
        try:
            import dask
            import distributed
        except ImportError as error:
            raise FactoryError(
                "scheduler.backend=dask needs the package distributed: "
                "pip install 'simnfnd[cluster]', or choose scheduler=local"
            ) from error
        self._distributed: Any = distributed
        self._cluster: Any = None
        self._specs: dict[int, Any] = {}
        self._looked = 0.0
        self._tasks: dict[Future[Any], _Task] = {}
        self._lock = threading.Lock()
        self._settings: Any = dask.config.set({"distributed.scheduler.allowed-failures": 0})
        # Read by the processes of a cluster that is started here: no line for every worker.
        self._environment = os.environ.get(_LOGGING)
        os.environ[_LOGGING] = "critical"
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        address = settings.address
        try:
            if address is None:
                self._cluster = _start_cluster(distributed, crew, settings.threads)
                self._specs = dict(self._cluster.worker_spec)
                address = self._cluster.scheduler_address
            self._client: Any = self._distributed.Client(
                address, timeout=_CONNECT_S, set_as_default=False
            )
            self._workers = self._count(crew)
        except (TimeoutError, OSError, ValueError) as error:
            self.stop()
            raise FactoryError(
                f"scheduler.address={settings.address}: no Dask scheduler answers ({error}); "
                "check the address, or start one (docs/cluster.md)"
            ) from error

    def _count(self, crew: Crew) -> dict[Kind, int]:
        """How many workers can take a task of either kind."""
        if self._cluster is not None:
            self._client.wait_for_workers(crew.total, timeout=120)
        told = self._client.scheduler_info(n_workers=-1)["workers"].values()
        render = sum(RESOURCE in worker.get("resources", {}) for worker in told)
        if not told:
            raise ValueError("it has no workers")
        if crew.render and not render:
            raise ValueError(f"no worker was started with --resources {RESOURCE}=1")
        return {"render": render, "noise": len(told)}

    def free(self, kind: Kind) -> bool:
        """Whether fewer tasks fly than there are workers for them."""
        with self._lock:
            flying = [task.kind for task in self._tasks.values()]
        if len(flying) >= self._workers["noise"]:
            return False
        return kind == "noise" or flying.count("render") < self._workers["render"]

    def submit(
        self, function: Callable[..., T], argument: Any, timeout_s: float, kind: Kind
    ) -> Future[T]:
        """Send `function(argument)` to a worker."""
        there = self._client.submit(
            function,
            argument,
            pure=False,
            retries=0,
            resources={RESOURCE: 1} if kind == "render" else None,
        )
        future: Future[T] = Future()
        task = _Task(kind, future, there, time.monotonic() + timeout_s)
        with self._lock:
            self._tasks[future] = task
        there.add_done_callback(lambda _: self._done(task))
        return future

    def _done(self, task: _Task) -> None:
        with self._lock:
            if self._tasks.pop(task.future, None) is None:
                return
        status = task.there.status
        if status == "finished":
            task.future.set_result(task.there.result())
        else:
            error = task.there.exception() if status == "error" else None
            task.future.set_exception(error or _Lost("its task was lost"))

    def why_died(self, error: BaseException) -> str | None:
        """What killed the worker, if that is what `error` of a future means; else None."""
        if isinstance(error, self._distributed.KilledWorker):
            return "native crash or kill, its Dask worker died"
        lost = (
            _Lost,
            self._distributed.CancelledError,
            self._distributed.scheduler.NoValidWorkerError,
        )
        return f"its Dask worker was lost ({error})" if isinstance(error, lost) else None

    def poll(self) -> None:
        """End what is too late: Dask cannot stop a function, so its worker is restarted."""
        now = time.monotonic()
        if self._cluster is not None and now - self._looked > _LOOK_S:
            self._looked = now
            self._revive()
        with self._lock:
            late = [task for task in self._tasks.values() if now > task.deadline]
            for task in late:
                self._tasks.pop(task.future)
        for task in late:
            with suppress(Exception):
                where = [
                    worker
                    for worker, keys in self._client.processing().items()
                    if task.there.key in keys
                ]
                self._client.restart_workers(where, timeout=30, raise_for_error=False)
            task.future.set_exception(TimeoutError())

    def _revive(self) -> None:
        """Replace nannies of our own cluster that gave up: their worker died while it started."""
        cluster = self._cluster
        gone = [
            name
            for name in self._specs
            if name not in cluster.workers
            or cluster.workers[name].status.name in ("closed", "failed")
        ]
        if not gone:
            return
        for name in gone:
            cluster.workers.pop(name, None)
            cluster.worker_spec[name] = self._specs[name]
        # What fails again is found again next time.
        with suppress(Exception):
            cluster.sync(cluster._correct_state, callback_timeout=60)

    def stop(self) -> None:
        """Leave the cluster; one that was started here is taken down."""
        with self._lock:
            self._tasks.clear()
        if hasattr(self, "_client"):
            with suppress(Exception):
                self._client.close(timeout=_STOP_S)
        if self._cluster is not None:
            with suppress(Exception):
                self._cluster.close(timeout=_STOP_S)
        self._settings.__exit__(None, None, None)
        if self._environment is None:
            os.environ.pop(_LOGGING, None)
        else:
            os.environ[_LOGGING] = self._environment


class _Lost(Exception):
    """A task came to no end of its own."""


def _start_cluster(distributed: Any, crew: Crew, threads: int) -> Any:
    """A scheduler and the crew's workers as processes of this machine."""
    env = dict.fromkeys(THREAD_VARIABLES, str(threads))

    def spec(kind: Kind) -> dict[str, Any]:
        options = {
            "nthreads": 1,
            "env": env,
            "memory_limit": 0,
            "resources": {RESOURCE: 1} if kind == "render" else {},
            "preload": ["simnfnd.factory.workers.dask_preload"],
            "dashboard": False,
        }
        return {"cls": distributed.Nanny, "options": options}

    for last in (False,) * (_STARTS - 1) + (True,):
        try:
            return distributed.SpecCluster(
                workers={number: spec(kind) for number, kind in enumerate(crew.kinds())},
                scheduler={
                    "cls": distributed.Scheduler,
                    "options": {"dashboard": False, "host": "127.0.0.1", "port": 0},
                },
                silence_logs=50,
            )
        except RuntimeError as error:  # a worker died while it started
            if last:
                raise FactoryError(
                    f"scheduler.backend=dask: no cluster comes up on this machine ({error}); "
                    "choose scheduler=local"
                ) from error
    raise AssertionError("unreachable")
