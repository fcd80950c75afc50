"""48 workers on one machine: how many processes there are, and what memory they take together."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

from benchmarks.memory import workers_of
from benchmarks.report import Options, Section, Table


def measure(options: Options) -> Section:
    """A whole run with Cycles, watched from outside; PSS counts shared pages once."""
    workers = options.amount(48, 3)
    with tempfile.TemporaryDirectory() as folder:
        command = [
            *(
                sys.executable,
                "-m",
                "simnfnd.factory",
                "scheduler=paper48",
                "scheduler.shard_size=1",
            ),
            *(f"scenes.locations={options.amount(6)}", "dataset.preview_pairs=0"),
            f"scenes.frames_per_location={options.amount(8)}",
            *(f"dataset.dir={folder}/dataset", f"cache.dir={folder}/cache"),
            *((f"scheduler.workers={workers}",) if options.quick else ()),
        ]
        started = time.monotonic()
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        most, pss, uss = 0, 0, 0
        while process.poll() is None:
            tree = [psutil.Process(process.pid), *workers_of(process.pid)]
            memory = []
            for one in tree:
                try:
                    memory.append(one.memory_full_info())
                except psutil.Error:
                    continue
            most = max(most, len(tree) - 1)
            pss = max(pss, sum(part.pss for part in memory))
            uss = max(uss, sum(part.uss for part in memory))
            time.sleep(0.5)
        seconds = time.monotonic() - started
        pairs = len(list(Path(folder, "dataset").glob("*/*.h5")))
    columns = ("pairs", "seconds", "worker processes", "peak PSS, GB", "peak USS, GB")
    table = Table(columns, ((pairs, seconds, most, pss / 1e9, uss / 1e9),))
    bad = process.returncode or most < workers
    failed = f"{most} workers, exit code {process.returncode}" if bad else ""
    return Section((table,), failed=failed)
