"""The storm in full: at least 100 workers killed, the run killed twice, local and on Dask."""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks.storm import HANGS, KILLS, storm, undisturbed

SHARDS = 44


def main() -> None:
    """Print what happened and whether all came out as without it; ends with 1 when not."""
    print("| backend | shards | workers killed | run killed | commands | seconds | outcome |")
    print("|---|---:|---:|---:|---:|---:|---|")
    bad = False
    with tempfile.TemporaryDirectory() as folder:
        expected = undisturbed(Path(folder, "calm", "dataset"), SHARDS)
        for backend in ("local", "dask"):
            directory = Path(folder, backend, "dataset")
            done = storm(directory, backend, shards=SHARDS, kills=110, run_kills=2, delay_s=0.6)
            good = done.shards == expected and done.named == (KILLS, HANGS)
            bad |= not good
            row = f"| {backend} | {len(done.shards)} | {done.worker_kills} | {done.run_kills} "
            row += f"| {done.runs} | {done.seconds:.0f} "
            print(row + f"| {'byte-identical, both bad frames named' if good else done.named} |")
    raise SystemExit(bad)
