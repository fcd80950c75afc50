"""What `simnfnd.Denoiser` costs: a frame of 512x512 pixels on one core, and memory over 10,000.

The frames are those of examples/didson/lamprey.avi.  Time is that of frames behind the first
window.  Memory is that of the process, of a
stream of small frames with copies and sizes that change.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import psutil

from benchmarks.shared import Options, Section, Table
from simnfnd import Denoiser

SIDE_PX = 512
LAMPREY = Path(__file__).parents[1] / "examples/didson/lamprey.avi"
FRAMES = 10_000


def measure(options: Options) -> Section:
    """CPU and wall seconds of a frame, the slowest one, and memory."""
    cv2.setNumThreads(1)
    rows = []
    cores = os.sched_getaffinity(0)
    for used in ({min(cores)}, cores):
        # A stream takes as many threads as cores that it may use when it is opened.
        os.sched_setaffinity(0, used)
        for name, frames in (("single frames", 1), ("in time, 15 frames", 15)):
            label = f"{name}, {len(used)} core{'s' * (len(used) > 1)}"
            rows.append((label, *_times(frames, options.amount(60, 18))))
    count = options.amount(FRAMES, 200)
    memory = _memory_mib(count)
    return Section(
        (
            Table(
                ("512x512 pixels", "CPU s per frame", "wall s per frame", "slowest, wall s"), rows
            ),
            Table(
                ("memory, MiB", f"after {count // 10:,} frames", f"after {count:,} frames"),
                [("small frames", *memory)],
            ),
        )
    )


def _times(frames: int, count: int) -> tuple[float, float, float]:
    """Mean CPU and wall seconds of a frame, and the most wall seconds of one."""
    cpu_s = wall_s = slowest_s = 0.0
    counted = 0
    with Denoiser(frames=frames, device="cpu") as stream:
        for number, frame in enumerate(recording(count)):
            cpu = time.process_time()
            wall = time.perf_counter()
            stream(frame)
            elapsed_s = time.perf_counter() - wall
            if number >= frames:
                cpu_s += time.process_time() - cpu
                wall_s += elapsed_s
                slowest_s = max(slowest_s, elapsed_s)
                counted += 1
    return cpu_s / counted, wall_s / counted, slowest_s


def recording(count: int) -> Iterator[np.ndarray]:
    """Frames of the example, from the first on again when they end."""
    video = cv2.VideoCapture(str(LAMPREY))
    for _ in range(count):
        is_read, image = video.read()
        if not is_read:
            video = cv2.VideoCapture(str(LAMPREY))
            is_read, image = video.read()
        large = cv2.resize(image, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA)
        yield cv2.cvtColor(large, cv2.COLOR_BGR2GRAY)


def _memory_mib(count: int) -> tuple[float, float]:
    """Of the process after a tenth of a stream and at its end."""
    rng = np.random.default_rng(0)
    process = psutil.Process()
    early = 0.0
    with Denoiser(frames=3, device="cpu") as stream:
        frame = np.zeros((32, 32), np.uint8)
        for number in range(count):
            # Every fifth frame is a copy.
            if number % 5:
                side = 32 + 4 * (number // 500 % 4)
                frame = rng.integers(0, 255, (side, 32), dtype=np.uint8)
            stream(frame)
            if number == count // 10:
                early = process.memory_info().rss / 2**20
    return early, process.memory_info().rss / 2**20
