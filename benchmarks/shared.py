"""What the benchmarks share: clocks for calls and for whole commands, frames, pairs on disk."""

from __future__ import annotations

import multiprocessing
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from simnfnd.factory.dataset.format.sample import Pair
from simnfnd.factory.dataset.format.schema import Provenance
from simnfnd.factory.dataset.format.settings import DatasetSettings

T = TypeVar("T")

PROVENANCE = Provenance({}, "0" * 16, "benchmark")


@dataclass(frozen=True)
class Spent:
    """Medians over the repeats, in seconds; least and most are of the CPU time.

    cpu: of all threads of the process.  peak_mb: most memory the process had until now.
    """

    cpu: float
    wall: float
    least: float
    most: float
    peak_mb: float

    @property
    def spread(self) -> str:
        """Least to most CPU seconds."""
        return f"{self.least:.3g} to {self.most:.3g}"


def clock(action: Callable[[], Any], repeats: int, per: int = 1) -> Spent:
    """Time `action` after one run that is not counted.  per: it does its work so many times."""
    action()
    cpu, wall = [], []
    for _ in range(repeats):
        began = time.process_time(), time.perf_counter()
        action()
        cpu.append((time.process_time() - began[0]) / per)
        wall.append((time.perf_counter() - began[1]) / per)
    return Spent(
        statistics.median(cpu), statistics.median(wall), min(cpu), max(cpu), peak_memory_mb()
    )


def cpu_seconds(action: Callable[[], Any], repeats: int) -> float:
    """Median CPU time of `action`, all threads, after one run that is not counted."""
    return clock(action, repeats).cpu


def peak_memory_mb() -> float:
    """Most resident memory that this process had, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


def in_own_process(function: Callable[..., T], *arguments: object) -> T:
    """Call an importable function in a fresh process: no memory, cache or thread of another."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn) as pool:
        return pool.submit(function, *arguments).result()


@dataclass(frozen=True)
class Command:
    """What a whole command took: wall and CPU seconds, it and its children together."""

    wall: float
    cpu: float


def run_command(command: Sequence[str], cwd: Path | None = None) -> Command:
    """Run a command to its end; ends the benchmark with its last words if it fails."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd)
    if done.returncode:
        raise SystemExit(done.stderr[-2000:])
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Command(time.monotonic() - began, cpu)


def run_factory(words: Sequence[str]) -> Command:
    """Run `simnfnd make WORDS`."""
    return run_command([sys.executable, "-m", "simnfnd.factory", *words])


def frame_words(root: str) -> list[str]:
    """Words that choose the procedural frame, or with `root` the first one of FLSea VI there."""
    if not root:
        return ["scenes=seabed", "scenes.locations=1", "scenes.frames_per_location=1"]
    return ["scenes=flsea", f"scenes.root={root}"]


def write_pair(pair: Pair, axes: Any, columns: Any, folder: Path, **how: Any) -> None:
    """A shard of one pair, as the factory writes it."""
    from simnfnd.factory.dataset.write.writer import write_shard

    write_shard(folder, "train/pair.h5", [pair], axes, columns, PROVENANCE, DatasetSettings(**how))


@contextmanager
def quiet() -> Iterator[None]:
    """Blender tells of every render on the C level; the report is on stdout."""
    sys.stdout.flush()
    keep = os.dup(1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(keep, 1)
        os.close(keep)
