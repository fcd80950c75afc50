"""CPU milliseconds of every stage between a rendered frame and a finished pair.

One procedural 968x608 frame, the default sonar and noise; medians of repeated runs in one process.
Ratios are to one plain pass over the points (a copy of their coordinates), which cancels most of
what differs between machines.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.shared import cpu_seconds, write_pair
from factory import noise, pairs, resample, seeds
from factory.commands.compose import compose_config
from factory.render import open_renderer
from factory.scenes import open_reader
from factory.sonar import polar, transfer
from factory.sonar.fan import fan_table

REPEATS = 9


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as name:
        measure(Path(name))


def measure(folder: Path) -> None:
    """Time every stage, writing to `folder`, and print the table."""
    config = compose_config(["render=embree", "scenes.locations=1"])
    sonar = config.sonar
    reader, renderer = open_reader(config.scenes), open_renderer(config.render)
    frame = reader.load(reader.discover().frames[0])
    rendered = renderer.render(frame, sonar.mount)
    scene = pairs.observe(frame, rendered, sonar)
    window, names = scene.window, ("seabed", "seabed-0000", "0000", 0)
    kept = resample.random_subset(scene.echoes, 0.6, seeds.stream(0, "thin"))
    drawn = noise.draw(config.noise, config.seed, *names)
    made = noise.layers(kept, kept, window, drawn, config.seed, *names)
    cloud = noise.combine(kept, made, 1.0)
    level = polar.accumulate(cloud, window, sonar)
    full_scale = transfer.full_scale(level, sonar.transfer)
    grey = transfer.grey(level, full_scale, sonar.transfer)
    table = fan_table(sonar, window.near_fraction)
    pair = pairs.make_pair(scene, 0, config)

    stages: dict[str, Callable[[], Any]] = {
        "observe: pixels to echoes, window, shadow": lambda: pairs.observe(frame, rendered, sonar),
        "resample (random, 0.6)": lambda: resample.random_subset(
            scene.echoes, 0.6, seeds.stream(0, "thin")
        ),
    }
    for effect in drawn:
        alone = {effect: drawn[effect]}
        stages[f"noise: {effect}"] = partial(
            noise.layers, kept, kept, window, alone, config.seed, *names
        )
    stages |= {
        "join the layers": lambda: noise.combine(kept, made, full_scale),
        "accumulate in bins": lambda: polar.accumulate(cloud, window, sonar),
        "point-spread": lambda: polar.spread_points(level, sonar),
        "grey values": lambda: transfer.grey(level, full_scale, sonar.transfer),
        "fan, bilinear": lambda: table.bilinear(grey),
        "gzip-1 of a pair": lambda: write_pair(pair, folder),
        "**make_pair, all of it**": lambda: pairs.make_pair(scene, 0, config),
    }
    plain = cpu_seconds(lambda: np.stack([cloud.range_m, cloud.azimuth_rad]).copy(), REPEATS)
    print(f"{len(scene.echoes)} echoes, {len(cloud)} points in the noisy cloud\n")
    print("| stage | CPU ms | times one plain pass |")
    print("|---|---:|---:|")
    for name, action in stages.items():
        spent = cpu_seconds(action, REPEATS)
        print(f"| {name} | {1000 * spent:.2f} | {spent / plain:.1f} |")


if __name__ == "__main__":
    main()
