"""What workers gain: wall and CPU seconds of a recording of 512x512 pixels, in the same bytes.

The recording repeats examples/didson/lamprey.avi.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from benchmarks.bench_live import recording
from benchmarks.shared import Options, Section, Table

SIDE_PX = 512
FRAMES = 512
WORKERS = (1, 2, 3)


def measure(options: Options) -> Section:
    """Seconds by number of workers; their margins cost CPU time."""
    count = options.amount(FRAMES, 40)
    rows = []
    results = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        frames = [cv2.resize(frame, (SIDE_PX, SIDE_PX)) for frame in recording(count)]
        np.save(folder / "a.npy", np.stack(frames))
        for workers in WORKERS:
            out = folder / str(workers)
            wall_s, cpu_s = _run(folder / "a.npy", out, workers)
            rows.append((str(workers), wall_s / count, cpu_s / count))
            results.append((out / "a.npy").read_bytes())
    said = "the same bytes" if len(set(results)) == 1 else "OTHER BYTES"
    title = f"{count} frames of {SIDE_PX}x{SIDE_PX} pixels, {said}"
    columns = ("workers", "wall s per frame", "CPU s per frame")
    return Section((Table(columns, rows, title=title),))


def _run(source: Path, out: Path, workers: int) -> tuple[float, float]:
    """Wall and CPU seconds of denoising a recording."""
    words = [str(source), "--out", str(out), "--workers", str(workers), "--device", "cpu"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start_s = time.perf_counter()
    subprocess.run([sys.executable, "-m", "simnfnd", "denoise", *words], check=True)
    wall_s = time.perf_counter() - start_s
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall_s, cpu_s
