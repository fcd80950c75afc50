"""How much faster two workers add noise than one, on frames that are rendered already."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from benchmarks.shared import factory_seconds

PAIRS = 12 * 24


def main() -> None:
    """Whole commands; the time that a command needs to start is measured apart and taken off."""
    with tempfile.TemporaryDirectory() as folder:
        _seconds(Path(folder), 2, 1)  # renders
        idle = min(_seconds(Path(folder), 1, 1) for _ in range(2))
        print("| workers | seconds | pairs a second, without the start | times one worker |")
        print("|---:|---:|---:|---:|")
        first = 0.0
        for workers in (1, 2):
            seconds = _seconds(Path(folder), workers, 24)
            rate = (PAIRS - 12) / (seconds - idle)
            first = first or rate
            print(f"| {workers} | {seconds:.1f} | {rate:.1f} | {rate / first:.2f} |")
    print(f"\n{os.cpu_count()} cores; start and 12 pairs: {idle:.1f} s")


def _seconds(folder: Path, workers: int, variants: int) -> float:
    words = [
        *("render=analytic", f"cache.dir={folder / 'cache'}"),
        *("scenes.locations=2", "scenes.frames_per_location=6", "dataset.preview_pairs=0"),
        *(f"scheduler.workers={workers}", f"frames.variants={variants}"),
        *(f"scheduler.shard_size={variants}", "dataset.on_existing=overwrite"),
        f"dataset.dir={folder / 'dataset'}",
    ]
    return factory_seconds(words)
