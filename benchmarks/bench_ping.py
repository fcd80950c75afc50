"""What `Sonar.ping` costs: latency of the noisy image, the first ping, memory, and a pair by make.

Three devices in a procedural place, and one in a mesh; on one thread, and on two that ping in turn.
"Grain kept" is the rank correlation of the grain between pings, 0 for another seed and 1 for a
second ping of the same pose; see docs/physics.md.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import psutil
from scipy import ndimage, stats

from benchmarks.shared import Options, Section, Table
from simnfnd import Pose, Sonar

DEVICES = ("oculus_c550d_hf", "aris_3000", "oculus_m1200d_hf")
WINDOW = ("sonar.range.min_m=.2", "sonar.range.max_m=10")
FULL_CAMERA = ("scenes.width=968", "scenes.height=608", "render.albedo=flattened")
_FIRST = """
import time
from simnfnd import Pose, Sonar
with Sonar("seabed", sonar="oculus_c550d_hf") as sonar:
    sonar.ping(Pose()).noisy
print(time.process_time())
"""


def measure(options: Options) -> Section:
    """Latencies, grain, first ping and memory."""
    count = options.amount(200, 4)
    rows: list[tuple[str | float, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        world = _write_floor(Path(folder) / "floor.obj")
        for device in DEVICES:
            with Sonar("seabed", sonar=device, overrides=WINDOW) as sonar:
                rows += _latencies(f"seabed, {device}", sonar, _sailed, count)
        words = (*WINDOW, f"scenes.file={world}", "scenes.up=z")
        with Sonar("mesh", sonar=DEVICES[0], overrides=words) as sonar:
            rows += _latencies(f"mesh, {DEVICES[0]}", sonar, _flown, count)
    return Section(
        (
            Table(
                ("scene, device", "threads", "median, ms wall", "95 %, ms wall", "ms CPU", "Hz"),
                rows,
            ),
            Table(
                ("grain kept", "turned by 1 beam", "turned by 20 beams", "2 mm ahead"),
                [
                    ("default of Sonar", *_grain(())),
                    ("default camera of make", *_grain(FULL_CAMERA)),
                ],
            ),
            Table(
                ("first ping, s CPU", "memory after 100 pings, MB", f"after {10 * count:,}"),
                [(_first_ping_s(), *_memory_mb(10 * count))],
            ),
        )
    )


def _sailed(number: int) -> Pose:
    return Pose(surge_m=0.01 * number, yaw_deg=0.2 * number)


def _flown(number: int) -> Pose:
    """Level over the floor, 30 degrees down, along +y."""
    half_rad = np.deg2rad(-120) / 2
    turn = (float(np.sin(half_rad)), 0.0, 0.0, float(np.cos(half_rad)))
    return Pose(position_m=(0.0, 0.01 * number - 5, 1.5), quaternion=turn)


def _latencies(
    label: str, sonar: Sonar, pose_of: Callable[[int], Pose], count: int
) -> list[tuple[str | float, ...]]:
    sonar.ping(pose_of(0)).noisy.any()
    rows: list[tuple[str | float, ...]] = []
    for threads in (1, 2):
        took_ms: list[float] = []

        def ping(number: int, took_ms: list[float] = took_ms) -> None:
            began_s = time.perf_counter()
            sonar.ping(pose_of(number), index=number).noisy.any()
            took_ms.append(1000 * (time.perf_counter() - began_s))

        began_s = time.perf_counter()
        began_cpu_s = time.process_time()
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(ping, range(count)))
        cpu_ms = 1000 * (time.process_time() - began_cpu_s) / count
        rate_hz = count / (time.perf_counter() - began_s)
        median_ms, slow_ms = np.percentile(took_ms, [50, 95]).tolist()
        rows.append((label, threads, median_ms, slow_ms, cpu_ms, rate_hz))
    return rows


def _grain(words: tuple[str, ...]) -> tuple[float, ...]:
    """What is kept of the grain by two turns and a step ahead."""
    beam_deg = 90 / 256
    overrides = (*WINDOW, "sonar.image.layout=polar", *words)
    poses = (
        Pose(), Pose(yaw_deg=beam_deg), Pose(yaw_deg=-20 * beam_deg), Pose(surge_m=0.002), Pose(),
    )  # fmt: skip
    images = []
    for seed, chosen in ((1, poses), (2, poses[:1])):
        with Sonar("seabed", sonar=DEVICES[0], seed=seed, overrides=overrides) as sonar:
            images += [
                sonar.ping(pose, index=index).noisy.astype(float)
                for index, pose in enumerate(chosen)
            ]
    level = ndimage.uniform_filter(images[0], 9)
    lit = level > 0.08 * level.max()
    lit[:, :24] = lit[:, -24:] = False

    def likeness(number: int, beams: int = 0) -> float:
        first, second = (
            image / np.maximum(ndimage.uniform_filter(image, 9), 1e-6 * image.max())
            for image in (images[0], np.roll(images[number], beams, axis=1))
        )
        return float(stats.spearmanr(first[lit], second[lit])[0])

    again = likeness(4)
    unlike = likeness(5)
    return tuple(
        (max(likeness(number, beams) for beams in (-shift, shift)) - unlike) / (again - unlike)
        for number, shift in ((1, 1), (2, 20), (3, 0))
    )


def _first_ping_s() -> float:
    done = subprocess.run(
        [sys.executable, "-c", _FIRST], capture_output=True, text=True, check=True
    )
    return float(done.stdout)


def _memory_mb(count: int) -> tuple[float, float]:
    """Resident memory after 100 pings (a tenth of fewer), and after `count`."""
    early = min(100, count // 10)
    process = psutil.Process()
    with Sonar("seabed", sonar=DEVICES[0], overrides=WINDOW) as sonar:
        for number in range(count):
            sonar.ping(_sailed(number % 200), index=number).noisy.any()
            if number == early:
                before = process.memory_info().rss
    return before / 1e6, process.memory_info().rss / 1e6


def _write_floor(path: Path) -> Path:
    """A wavy floor of 320,000 triangles, 40 m on a side."""
    side = np.linspace(-20, 20, 401)
    x, y = np.meshgrid(side, side)
    z = 0.1 * np.sin(1.7 * x) * np.cos(1.3 * y) + 0.02 * np.sin(9 * x + 4 * y)
    corner = (np.arange(400)[:, None] * 401 + np.arange(400) + 1).reshape(-1)
    quads = np.stack([corner, corner + 1, corner + 402, corner + 401], axis=1)
    with path.open("w") as file:
        np.savetxt(file, np.stack([x, y, z], axis=-1).reshape(-1, 3), "v %.4f %.4f %.4f")
        np.savetxt(file, quads, "f %d %d %d %d")
    return path
