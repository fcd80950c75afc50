"""The `scheduler` group: how the work is spread over processes.  No pixel depends on it."""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple

from pydantic import Field
from pydantic.dataclasses import dataclass

from ..settings import STRICT
from .machine import available_memory_bytes, usable_cores, workers_that_fit

MAX_AUTO_WORKERS = 48
# The rest is for the system's file cache and for other programs.
_MEMORY_SHARE = 0.8
# Measured of one that adds noise, and of one that holds Blender and a scene.
WORKER_GB = 0.3
RENDERER_GB = 1.0

RENDER = "render"
NOISE = "noise"


class WorkerCounts(NamedTuple):
    """Workers that may load Blender, which add noise when nothing is left to render; light ones."""

    render: int
    noise: int

    @property
    def total(self) -> int:
        """All workers."""
        return self.render + self.noise


@dataclass(frozen=True, config=STRICT)
class ShardSlice:
    """Keys of `shard`: this run makes every `count`-th shard, from number `index` on."""

    index: Annotated[int, Field(ge=0)] = 0
    count: Annotated[int, Field(ge=1, le=100_000)] = 1

    def __post_init__(self) -> None:
        if self.index >= self.count:
            raise ValueError(f"index must be 0 to count - 1 = {self.count - 1}, got {self.index}")

    @property
    def part(self) -> str:
        """What the slice's own files are named after, such as 0-of-4; empty for the whole."""
        return f"{self.index}-of-{self.count}" if self.count > 1 else ""


@dataclass(frozen=True, config=STRICT)
class SchedulerSettings:
    """Keys of the `scheduler` group.

    backend: local (processes on this machine), serial (none; to debug), dask (a cluster).
    address: of a Dask scheduler, tcp://host:port; None starts a Dask cluster on this machine.
    workers: number of worker processes; auto is one per core as memory allows, at most 48.
    render_workers: how many of them render; auto is at most one per core and what fits the memory.
    shard_size: samples in a shard.  It decides which file a sample lies in.
    frame_timeout_s: a frame that takes longer is given up and its worker replaced.
    retries: how often a frame is tried again after its worker died or it took too long.
    recycle_frames: a worker is replaced by a fresh process after about this many frames.
    """

    backend: Literal["local", "serial", "dask"] = "local"
    address: str | None = None
    workers: Annotated[int, Field(ge=1, le=1024)] | Literal["auto"] = "auto"
    render_workers: Annotated[int, Field(ge=1, le=1024)] | Literal["auto"] = "auto"
    shard_size: Annotated[int, Field(ge=1, le=100_000)] = 32
    frame_timeout_s: Annotated[float, Field(gt=0, le=1_000_000)] = 300.0
    retries: Annotated[int, Field(ge=0, le=1000)] = 1
    recycle_frames: Annotated[int, Field(ge=1, le=1_000_000)] = 200

    def __post_init__(self) -> None:
        if self.address is not None and self.backend != "dask":
            raise ValueError("address is for scheduler.backend=dask only")

    def worker_counts(self, shards: int, frames: int) -> WorkerCounts:
        """How many workers of either kind for that many shards, and frames to prepare.

        Raises FactoryError when the limits of this process allow none.
        """
        memory_gb = available_memory_bytes() / 1e9 * _MEMORY_SHARE
        cores = usable_cores()
        total = max(1, min(cores, int(memory_gb / WORKER_GB), MAX_AUTO_WORKERS))
        total = min(total if self.workers == "auto" else self.workers, max(shards, frames))
        if self.backend == "local":
            total = workers_that_fit(total)
        room = int((memory_gb - total * WORKER_GB) / (RENDERER_GB - WORKER_GB))
        render = max(1, min(cores, room)) if self.render_workers == "auto" else self.render_workers
        render = min(render, total, frames)
        return WorkerCounts(render, total - render)
