"""48 workers on one machine: how many processes there are, and what memory they take together."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

from benchmarks.memory import workers_of


def main() -> None:
    """A whole run with Cycles, watched from outside; PSS counts shared pages once."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            *(sys.executable, "-m", "factory", "scheduler=paper48", "scheduler.shard_size=1"),
            *("scenes.locations=6", "scenes.frames_per_location=8", "dataset.preview_pairs=0"),
            *(f"dataset.dir={folder}/dataset", f"cache.dir={folder}/cache"),
        ]
        started = time.monotonic()
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        most, pss, uss, samples = 0, 0, 0, 0
        while process.poll() is None:
            tree = [psutil.Process(process.pid), *workers_of(process.pid)]
            memory = []
            for one in tree:
                try:
                    memory.append(one.memory_full_info())
                except psutil.Error:
                    continue
            samples += 1
            most = max(most, len(tree) - 1)
            pss = max(pss, sum(part.pss for part in memory))
            uss = max(uss, sum(part.uss for part in memory))
            time.sleep(0.5)
        seconds = time.monotonic() - started
        pairs = len(list(Path(folder, "dataset").glob("*/*.h5")))
    print("| pairs | seconds | worker processes | peak PSS, GB | peak USS, GB | exit code |")
    print("|---:|---:|---:|---:|---:|---:|")
    row = f"| {pairs} | {seconds:.0f} | {most} | {pss / 1e9:.2f} | {uss / 1e9:.2f} |"
    print(f"{row} {process.returncode} |")
    if process.returncode or most < 48:
        raise SystemExit(f"{most} workers, exit code {process.returncode}")
