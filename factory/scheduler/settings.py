"""The `scheduler` group: how the work is spread over processes.  Nothing here changes a pixel."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import psutil
from pydantic import Field
from pydantic.dataclasses import dataclass

from factory.settings import STRICT

MAX_AUTO_WORKERS = 48


@dataclass(frozen=True, config=STRICT)
class SchedulerSettings:
    """Keys of the `scheduler` group.

    workers: number of worker processes; auto is one a core, as many as fit the memory, at most 48.
    shard_size: samples in a shard.  It decides which file a sample lies in.
    threads: of each worker's numerical libraries.
    frame_timeout_s: a frame that takes longer is given up and its worker replaced.
    retries: how often a frame is tried again after its worker died or it took too long.
    recycle_frames: a worker is replaced by a fresh process after about this many frames.
    memory_per_worker_gb: what `auto` counts for one worker.
    """

    workers: Annotated[int, Field(ge=1, le=1024)] | Literal["auto"] = "auto"
    shard_size: Annotated[int, Field(ge=1)] = 32
    threads: Annotated[int, Field(ge=1)] = 1
    frame_timeout_s: Annotated[float, Field(gt=0)] = 300.0
    retries: Annotated[int, Field(ge=0)] = 1
    recycle_frames: Annotated[int, Field(ge=1)] = 200
    memory_per_worker_gb: Annotated[float, Field(gt=0)] = 1.0

    def worker_count(self, tasks: int) -> int:
        """Number of worker processes for that many shards, at least 1."""
        if self.workers != "auto":
            return min(self.workers, tasks)
        fitting = int(available_memory_bytes() / (self.memory_per_worker_gb * 1e9))
        return max(1, min(usable_cores(), fitting, MAX_AUTO_WORKERS, tasks))


def usable_cores() -> int:
    """Cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def available_memory_bytes() -> int:
    """Memory that can be had without swapping, under a container's limit when there is one."""
    available = int(psutil.virtual_memory().available)
    control_group = Path("/sys/fs/cgroup")
    try:
        limit = int((control_group / "memory.max").read_text())
        used = int((control_group / "memory.current").read_text())
    except (OSError, ValueError):
        return available
    return min(available, max(0, limit - used))
