"""What a sweep of noise points over the same frames costs, beside one: frames are rendered once."""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks.report import Options, Section, Table
from benchmarks.shared import Command, run_factory

LOCATIONS, FRAMES = 4, 12
POINTS = (1, 8, 16)
# Background densities from 0.005 to 0.64, evenly by their logarithm, 16 of them.
DENSITIES = tuple(round(0.005 * 2 ** (7 * k / 15), 5) for k in range(16))


def measure(options: Options) -> Section:
    """Whole commands with Cycles, from their start to their end, each with an empty cache."""
    locations, frames = options.amount(LOCATIONS, 2), options.amount(FRAMES)
    spent: dict[int, Command] = {}
    with tempfile.TemporaryDirectory() as folder:
        for points in (1, 2) if options.quick else POINTS:
            root = Path(folder, str(points))
            spent[points] = _command(root, DENSITIES[:points], locations, frames)
    one = spent[1]
    rows = tuple(
        (
            points,
            points * locations * frames,
            done.cpu / one.cpu,
            done.wall / one.wall,
            done.cpu,
            done.wall,
        )
        for points, done in spent.items()
    )
    columns = ("noise points", "pairs", "times the CPU of one", "times the wall time", "CPU s", "s")
    note = f"{locations * frames} frames of 968x608; one worker a core."
    return Section((Table(columns, rows, bars="times the CPU of one"),), note)


def _command(folder: Path, densities: tuple[float, ...], locations: int, frames: int) -> Command:
    values = ",".join(map(str, densities))
    return run_factory(
        [
            *("-m", f"scenes.locations={locations}", f"scenes.frames_per_location={frames}"),
            *(f"noise.background.density={values}", "render=cycles", "dataset.preview_pairs=0"),
            *(f"cache.dir={folder / 'cache'}", f"hydra.sweep.dir={folder / 'sweep'}"),
            *("scheduler.shard_size=12", f"dataset.dir={folder}/set-${{hydra:job.num}}"),
        ]
    )
