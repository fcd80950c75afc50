"""What is used of other packages without being public there.

Public ways do something else or do not exist: `hydra.compose` works on one global instance;
`multiprocessing` tells neither whether a fork server runs nor ends it, and forbids workers of pools
to start processes; numba compiles a loop that
is not on disk instead of saying so; torch ends the processes of a `DataLoader` when nothing refers
to it any more, and offers averages of many tensors at once to its own optimisers alone.
tests/factory/common/test_private_apis.py fails first when an update takes one of them away.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any


def hydra_loader(search_root: str) -> Any:
    """Hydra's loader of configurations, without its global instance.

    search_root: where the root configurations are, such as `pkg://simnfnd.conf`.
    """
    from hydra._internal.config_loader_impl import ConfigLoaderImpl
    from hydra._internal.utils import create_config_search_path

    return ConfigLoaderImpl(create_config_search_path(search_root))


def fork_server_pid() -> int | None:
    """Process id of the fork server of `multiprocessing`; None where none was started."""
    process_id: int | None = _fork_server()._forkserver_pid
    return process_id


def kill_fork_server() -> None:
    """Kill the fork server, so that another can be started; what was forked from it lives on."""
    server = _fork_server()
    if server._forkserver_pid is None:
        return
    with suppress(OSError):
        os.kill(server._forkserver_pid, signal.SIGKILL)
        server._stop()


def _fork_server() -> Any:
    from multiprocessing import forkserver  # `simnfnd --help` must not wait for it

    return vars(forkserver)["_forkserver"]


@contextmanager
def children_allowed() -> Iterator[None]:
    """Let a worker of a pool (of multiprocessing, Celery or Airflow) start processes.

    They are forbidden because a worker that is killed leaves them behind; those of this project
    and of torch end with their parent.
    """
    from multiprocessing import current_process

    settings = vars(current_process())["_config"]
    is_daemon = settings.pop("daemon", None)
    try:
        yield
    finally:
        if is_daemon is not None:
            settings["daemon"] = is_daemon


def has_compiled_form(dispatcher: Any, signature: str) -> bool:
    """Whether the machine code of a loop of numba is on disk; loads it if so."""
    return dispatcher._cache.load_overload(signature, dispatcher.targetctx) is not None


def end_reading_processes(loader: Any) -> None:
    """End the processes of a `torch.utils.data.DataLoader` that keeps them; does nothing else."""
    iterator = loader._iterator
    if iterator is not None and loader.num_workers:
        iterator._shutdown_workers()


def move_averages(averages: Sequence[Any], values: Sequence[Any], share: float) -> None:
    """Move each tensor by `share` of its distance to another, in place, all in one call."""
    import torch

    torch._foreach_lerp_(list(averages), list(values), share)
