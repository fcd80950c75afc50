"""What the benchmarks share: clocks for calls and for whole commands, a pair on disk."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import h5py

from factory.sample import Pair


def cpu_seconds(action: Callable[[], Any], repeats: int) -> float:
    """Median CPU time of `action`, all threads, after one run that is not counted."""
    action()
    spent = []
    for _ in range(repeats):
        start = time.process_time()
        action()
        spent.append(time.process_time() - start)
    return statistics.median(spent)


def factory_seconds(words: Sequence[str]) -> float:
    """Wall time of the whole command `python -m factory WORDS`; ends the benchmark if it fails."""
    begun = time.monotonic()
    command = [sys.executable, "-m", "factory", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stderr[-2000:])
    return time.monotonic() - begun


def write_pair(pair: Pair, folder: Path) -> None:
    """Both pictures and the mask as a gzip-1 chunk each, as a shard has them."""
    with h5py.File(folder / "pair.h5", "w") as file:
        for name in ("noisy", "clean", "shadow"):
            picture = getattr(pair, name)
            file.create_dataset(
                name,
                data=picture[None],
                chunks=(1, *picture.shape),
                compression="gzip",
                compression_opts=1,
                fletcher32=True,
            )
