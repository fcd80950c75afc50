"""How much faster 2, 4 and 48 workers add noise than one, on frames that are rendered already.

More workers than cores cannot be faster; that they are hardly slower is what the row shows.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from benchmarks.report import Cell, Options, Section, Table
from benchmarks.shared import run_factory

FRAMES, VARIANTS = 12, 24
WORKERS = (1, 2, 4, 48)


def measure(options: Options) -> Section:
    """Whole commands; the time that a command needs to start is measured apart and taken off."""
    variants = options.amount(VARIANTS, 4)
    rows: list[tuple[Cell, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        _seconds(Path(folder), 2, 1)  # renders
        idle = min(_seconds(Path(folder), 1, 1) for _ in range(options.amount(2)))
        first = 0.0
        for workers in (1, 2) if options.quick else WORKERS:
            seconds = _seconds(Path(folder), workers, variants)
            rate = FRAMES * (variants - 1) / max(seconds - idle, 1e-3)
            first = first or rate
            rows.append((workers, rate / first, rate, seconds))
    columns = ("workers", "times one worker", "pairs a second, without the start", "s")
    note = f"{os.cpu_count()} cores; start and {FRAMES} pairs: {idle:.1f} s"
    return Section((Table(columns, tuple(rows), note=note, bars="times one worker"),))


def _seconds(folder: Path, workers: int, variants: int) -> float:
    words = [
        *("render=analytic", f"cache.dir={folder / 'cache'}"),
        *("scenes.locations=2", "scenes.frames_per_location=6", "dataset.preview_pairs=0"),
        *(f"scheduler.workers={workers}", f"frames.variants={variants}"),
        # Enough shards that every worker gets some.
        *(f"scheduler.shard_size={min(variants, 4)}", "dataset.on_existing=overwrite"),
        f"dataset.dir={folder / 'dataset'}",
    ]
    return run_factory(words).wall
