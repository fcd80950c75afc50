"""Workers of a Dask cluster: one on this machine, or any that a scheduler's address leads to.

Each worker has one thread and a nanny that replaces it when it dies, and takes tasks of all pools.
Dask is to retry nothing itself: docs/cluster.md says how to start such a cluster elsewhere.
"""

from __future__ import annotations

import logging
import pickle
import threading
import time
import uuid
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeVar

from ...errors import FactoryError
from .contract import RESULT, Hear, WorkerSettings, answered
from .template import THREAD_VARIABLES

T = TypeVar("T")

_CONNECT_S = 20.0
_STOP_S = 4.0
_COUNT_EVERY_S = 2.0
# A worker's start, and the way of a result that a worker has ready.
_START_S = 120
_RESULT_S = 60
_RESTART_S = 30


class _Lost(Exception):
    """A task ended without a result of its own."""


@dataclass(eq=False)
class _Task:
    future: Future[Any]
    remote: Any
    silence_s: float
    hear: Hear | None
    heard_at: float


class DaskBackend:
    """A `contract.Backend` over `distributed.Client`."""

    def __init__(self, settings: WorkerSettings) -> None:
        """Connect, or start a cluster.  Raises FactoryError when neither works."""
        import distributed

        self._distributed: Any = distributed
        self._cluster: Any = None
        self._client: Any = None
        self._counted = 0.0
        self._tasks: dict[str, _Task] = {}
        self._topic = f"simnfnd-{uuid.uuid4().hex}"
        self._lock = threading.Lock()
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self._workers = 0
        try:
            address = settings.address
            if address is None:
                self._cluster = self._started(settings.total)
                address = self._cluster.scheduler_address
            self._client = self._distributed.Client(
                address, timeout=_CONNECT_S, set_as_default=False
            )
            self._client.subscribe_topic(self._topic, self._heard)
            self._count()
            if not self._workers:
                raise ValueError("it has no workers")
        except (TimeoutError, OSError, ValueError, RuntimeError) as error:
            self.stop()
            where = (
                f"scheduler.address={settings.address}: no Dask scheduler answers"
                if settings.address
                else "scheduler.backend=dask: no cluster comes up on this machine"
            )
            raise FactoryError(
                f"{where} ({error}); check the address, or start one (docs/cluster.md)"
            ) from error

    def _started(self, workers: int) -> Any:
        """A scheduler and its workers as processes of this machine."""
        import dask

        with dask.config.set({"distributed.scheduler.allowed-failures": 0}):
            cluster = self._distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                memory_limit=0,
                dashboard_address=None,
                preload=["simnfnd.factory.scheduler.workers.contract"],
                env=dict.fromkeys(THREAD_VARIABLES, "1"),
                silence_logs=logging.CRITICAL,
            )
        cluster.wait_for_workers(workers, timeout=_START_S)
        return cluster

    def _count(self) -> None:
        """Take in workers that have come or gone."""
        with suppress(Exception):
            found = self._client.sync(
                self._client.scheduler.identity, n_workers=-1, callback_timeout=_RESTART_S
            )
            self._workers = len(found["workers"]) or self._workers

    def free(self, pool: str) -> bool:
        """Whether fewer tasks are under way than there are workers."""
        with self._lock:
            return len(self._tasks) < self._workers

    def submit(
        self,
        function: Callable[[Any], T],
        argument: Any,
        silence_s: float,
        pool: str,
        hear: Hear | None = None,
    ) -> Future[T]:
        """Send `function(argument)` to a worker."""
        key = uuid.uuid4().hex
        remote = self._client.submit(
            _run,
            pickle.dumps((function, argument)),
            self._topic,
            key,
            key=f"task-{key}",
            pure=False,
            retries=0,
        )
        future: Future[T] = Future()
        # Until it is heard of, its worker may still be starting.
        heard_at = time.monotonic() + _START_S
        with self._lock:
            self._tasks[key] = task = _Task(future, remote, silence_s, hear, heard_at)
        remote.add_done_callback(lambda _: self._done(key, task))
        return future

    def _heard(self, event: tuple[float, Any]) -> None:
        key, message = event[1]
        with self._lock:
            task = self._tasks.get(key)
        if task is not None:
            task.heard_at = time.monotonic()
            if task.hear and message:
                task.hear(tuple(message))

    def _done(self, key: str, task: _Task) -> None:
        kind, value = "", None
        try:
            if task.remote.status == "finished":
                kind, value = pickle.loads(task.remote.result(timeout=_RESULT_S))
            elif task.remote.status == "error":
                value = task.remote.exception(timeout=_RESULT_S)
            else:
                value = _Lost("its task was lost")
        except TimeoutError:  # not of the task: `poll` has its limit
            value = _Lost("its result did not arrive")
        except Exception as failed:
            value = failed
        with self._lock:
            if self._tasks.pop(key, None) is None:
                return
        if kind == RESULT:
            task.future.set_result(value)
        else:
            task.future.set_exception(value)

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
        """End tasks that are too late: Dask cannot stop a function, so its worker is restarted."""
        now = time.monotonic()
        if now - self._counted > _COUNT_EVERY_S:
            self._counted = now
            self._count()
        with self._lock:
            gone = [k for k, one in self._tasks.items() if now > one.heard_at + one.silence_s]
            late = [self._tasks.pop(key) for key in gone]
        for task in late:
            with suppress(Exception):
                processing = self._client.sync(
                    self._client.scheduler.processing, workers=None, callback_timeout=_RESTART_S
                )
                where = [worker for worker, keys in processing.items() if task.remote.key in keys]
                self._client.restart_workers(where, timeout=_RESTART_S, raise_for_error=False)
            task.future.set_exception(TimeoutError())

    def stop(self) -> None:
        """Leave the cluster; one that was started here is taken down."""
        with self._lock:
            self._tasks.clear()
        for one in (self._client, self._cluster):
            with suppress(Exception):
                if one is not None:
                    one.close(timeout=_STOP_S)


def _run(request: bytes, topic: str, key: str) -> bytes:
    """What a worker does with a task: it tells by way of the scheduler how far it is."""
    from distributed import get_worker
    from distributed.utils import sync

    worker = get_worker()

    def say(message: Any) -> None:
        # Not by the worker's own queue of messages, which would be lost with it.
        sync(worker.loop, worker.scheduler.log_event, topic=topic, msg=[key, message])

    return answered(request, say)
