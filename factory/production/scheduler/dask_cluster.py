"""Workers of a Dask cluster: one on this machine, or any that a scheduler's address leads to.

Each worker has one thread and a nanny that replaces it when it dies, and takes tasks of all kinds.
Dask is to retry nothing itself: docs/how-to/cluster.md says how to start such a cluster elsewhere.
"""

from __future__ import annotations

import logging
import pickle
import threading
import time
import uuid
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from ...common.errors import FactoryError
from ...common.workers import ERROR, Backend, Task, WorkerDied, answered
from ...common.workers.local import END_S, FIRST_S, LOOK_S
from ...common.workers.template import THREAD_VARIABLES

_ANSWER_S = 30  # most time to reach the scheduler, for its answers, and to fetch a result


@dataclass(eq=False)
class _Sent:
    """A task that was sent to a worker.

    future: what the caller waits for.  remote: Dask's future.  heard_at: time of the last message.
    """

    task: Task
    future: Future[Any]
    remote: Any
    heard_at: float

    def is_late(self) -> bool:
        """Whether its worker has been silent for too long; an end that is on its way is none."""
        silent_s = time.monotonic() - self.heard_at
        return silent_s > self.task.silence_s and not self.remote.done()


class DaskBackend(Backend):
    """A `Backend` over `distributed.Client`."""

    def __init__(self, workers: int, address: str | None) -> None:
        """Connect, or start a cluster of this many.  Raises FactoryError when neither works."""
        import dask
        import distributed

        self._distributed: Any = distributed
        self._cluster: Any = None
        self._client: Any = None
        self._tasks: dict[str, _Sent] = {}
        # Tasks whose workers are being restarted.
        self._late: list[_Sent] = []
        self._topic = f"simnfnd-{uuid.uuid4().hex}"
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self._workers = 0
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        try:
            if address is None:
                with dask.config.set({"distributed.scheduler.allowed-failures": 0}):
                    self._cluster = self._distributed.LocalCluster(
                        n_workers=workers,
                        threads_per_worker=1,
                        memory_limit=0,
                        dashboard_address=None,
                        preload=["simnfnd.factory.common.workers"],
                        env=dict.fromkeys(THREAD_VARIABLES, "1"),
                        silence_logs=logging.CRITICAL,
                    )
                self._cluster.wait_for_workers(workers, timeout=FIRST_S)
            scheduler_address = address or self._cluster.scheduler_address
            self._client = self._distributed.Client(
                scheduler_address, timeout=_ANSWER_S, set_as_default=False
            )
            self._client.subscribe_topic(self._topic, self._heard)
            self._count()
            if not self._workers:
                raise ValueError("it has no workers")
        except (TimeoutError, OSError, ValueError, RuntimeError) as error:
            self.close()
            key = f"address={address}" if address else "backend=dask"
            raise FactoryError(
                f"scheduler.{key}: no Dask cluster answers ({error}); check the address, or start "
                "one (docs/how-to/cluster.md)"
            ) from error
        threading.Thread(target=self._watch, daemon=True).start()

    def _count(self) -> None:
        """Update the number of workers, which may join and leave."""
        with suppress(Exception):
            self._workers = (
                len(self._ask_scheduler("identity", n_workers=-1)["workers"]) or self._workers
            )

    def _ask_scheduler(self, method: str, **arguments: Any) -> Any:
        """Call a method of the scheduler and return its answer."""
        function = getattr(self._client.scheduler, method)
        return self._client.sync(function, **arguments, callback_timeout=_ANSWER_S)

    def free(self, kind: str) -> bool:
        """Whether fewer tasks are under way than there are workers."""
        with self._lock:
            return len(self._tasks) + len(self._late) < self._workers

    def submit(self, task: Task) -> Future[Any]:
        """Send a task to a worker; returns its future result."""
        name = uuid.uuid4().hex
        remote = self._client.submit(
            _run, task.request(), self._topic, name, key=f"task-{name}", pure=False, retries=0
        )
        future: Future[Any] = Future()
        # Until it is heard of, its worker may still be starting.
        heard_at = time.monotonic() + FIRST_S
        with self._lock:
            self._tasks[name] = _Sent(task, future, remote, heard_at)
        # Not in the one thread of all callbacks, which a result that is lost would hold up.
        done = threading.Thread(target=self._done, args=(name, remote), daemon=True)
        remote.add_done_callback(lambda _: done.start())
        return future

    def _heard(self, event: tuple[float, Any]) -> None:
        name, message = event[1]
        with self._lock:
            sent = self._tasks.get(name)
        if sent is not None:
            sent.heard_at = time.monotonic()
            if message:
                sent.task.hear(tuple(message))

    def _done(self, name: str, remote: Any) -> None:
        """Pass the result of a remote task, or why there is none, to whoever waits for it."""
        kind = ERROR
        value: Any = WorkerDied("its task was lost by Dask")
        dask = self._distributed
        no_worker = self._distributed.scheduler.NoValidWorkerError
        # A timeout is not the task's: `_watch` has its limit.
        lost = TimeoutError, dask.KilledWorker, dask.CancelledError, no_worker
        try:
            if remote.status == "finished":
                kind, value = pickle.loads(remote.result(timeout=_ANSWER_S))
            elif remote.status == "error":
                raise remote.exception(timeout=_ANSWER_S)
        except lost as error:
            value = WorkerDied(f"its Dask worker died or was lost ({type(error).__name__})")
        except Exception as error:
            value = error
        with self._lock:
            sent = self._tasks.pop(name, None)
        if sent is not None:
            (sent.future.set_exception if kind == ERROR else sent.future.set_result)(value)

    def _watch(self) -> None:
        """Ends tasks that are too late: Dask cannot stop a function, so its worker is restarted."""
        while not self._stopped.wait(LOOK_S):
            self._count()
            with self._lock:
                silent = (name for name, task in self._tasks.items() if task.is_late())
                self._late = [self._tasks.pop(name) for name in tuple(silent)]
            for task in self._late:
                with suppress(Exception):
                    processing = self._ask_scheduler("processing", workers=None)
                    addresses = [
                        address for address, keys in processing.items() if task.remote.key in keys
                    ]
                    self._client.restart_workers(
                        addresses, timeout=_ANSWER_S, raise_for_error=False
                    )
                task.future.set_exception(TimeoutError())
            self._late = []

    def close(self) -> None:
        """Leave the cluster; one that was started here is taken down."""
        self._stopped.set()
        with self._lock:
            self._tasks.clear()
        for connection in (self._client, self._cluster):
            with suppress(Exception):
                if connection is not None:
                    connection.close(timeout=END_S)


def _run(request: bytes, topic: str, key: str) -> bytes:
    """What a worker does with a task: it tells by way of the scheduler how far it is."""
    from distributed import get_worker
    from distributed.utils import sync

    worker = get_worker()

    def say(message: Any) -> None:
        # Not by the worker's own queue of messages, which would be lost with it.
        sync(worker.loop, worker.scheduler.log_event, topic=topic, msg=[key, message])

    return answered(request, say)
