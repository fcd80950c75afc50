"""What eight noise points over the same frames cost, beside one: the frames are rendered once."""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks.shared import factory_seconds

FRAMES = ("scenes.locations=4", "scenes.frames_per_location=12")
DENSITIES = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64)


def main() -> None:
    """Whole commands with Cycles, from their start to their end, each with an empty cache."""
    with tempfile.TemporaryDirectory() as folder:
        one = _seconds(Path(folder, "one"), DENSITIES[:1])
        eight = _seconds(Path(folder, "eight"), DENSITIES)
    print("| noise points | frames | pairs | seconds | times one point |")
    print("|---:|---:|---:|---:|---:|")
    print(f"| 1 | 48 | 48 | {one:.1f} | 1.00 |")
    print(f"| 8 | 48 | 384 | {eight:.1f} | {eight / one:.2f} |")


def _seconds(folder: Path, densities: tuple[float, ...]) -> float:
    values = ",".join(map(str, densities))
    words = [
        *("-m", *FRAMES, f"noise.background.density={values}"),
        *("render=cycles", "dataset.preview_pairs=0", f"cache.dir={folder / 'cache'}"),
        *(f"hydra.sweep.dir={folder / 'sweep'}", "scheduler.shard_size=12"),
        f"dataset.dir={folder}/set-${{hydra:job.num}}",
    ]
    return factory_seconds(words)
