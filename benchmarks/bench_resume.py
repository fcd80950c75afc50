"""What an interruption costs: CPU seconds of a recording that is killed three times and goes on.

The recording repeats examples/didson/lamprey.avi at 512x512 pixels.  A limit of CPU time kills each
run as KILL does.  What an interruption costs (Python, the network, the frames since the last note)
is the same for any length, so the share of an hour is computed, not measured.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

from benchmarks.bench_live import recording
from benchmarks.shared import Options, Section, Table

SIDE_PX = 512
FRAMES = 400
KILLS = 3
HOUR_FRAMES = 8 * 3600  # of a sonar of 8 Hz


def measure(options: Options) -> Section:
    """CPU seconds of an undisturbed run and of a killed one, whose bytes must be the same."""
    count = options.amount(FRAMES, 60)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        frames = [cv2.resize(frame, (SIDE_PX, SIDE_PX)) for frame in recording(count)]
        np.save(folder / "a.npy", np.stack(frames))
        start_s = _run(folder, "start", 1)
        whole_s = _run(folder, "whole", count)
        part_s = (whole_s - start_s) / (KILLS + 1)
        killed_s = 0.0
        for _ in range(KILLS):
            killed_s += _run(folder, "killed", count, limit_s=round(start_s + part_s))
        killed_s += _run(folder, "killed", count)
        is_same = (folder / "whole/a.npy").read_bytes() == (folder / "killed/a.npy").read_bytes()
    more_s = killed_s - whole_s
    hour_s = (whole_s - start_s) * HOUR_FRAMES / (count - 1)
    rows = [
        ("a run of one frame", start_s),
        (f"{count:,} frames, undisturbed", whole_s),
        (f"{count:,} frames, killed {KILLS} times", killed_s),
        ("an interruption", more_s / KILLS),
        (f"{KILLS} interruptions of an hour of 8 Hz, computed, %", 100 * more_s / hour_s),
    ]
    title = f"{SIDE_PX}x{SIDE_PX} pixels, {'the same bytes' if is_same else 'OTHER BYTES'}"
    return Section((Table(("run", "CPU s"), rows, title=title),))


def _run(folder: Path, out: str, count: int, limit_s: int | None = None) -> float:
    """CPU seconds of denoising the first frames; limit_s: after this many the run is killed."""
    source = folder / "a.npy"
    if count == 1:
        source = folder / "one.npy"
        np.save(source, np.load(folder / "a.npy")[:1])

    def limit() -> None:
        if limit_s is not None:
            resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))

    words = [sys.executable, "-m", "simnfnd", "denoise", str(source), "--out", str(folder / out)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(words, preexec_fn=limit, capture_output=True)
    if limit_s is None and done.returncode:
        raise RuntimeError(done.stderr.decode()[-500:])
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
