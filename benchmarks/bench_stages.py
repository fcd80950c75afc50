"""CPU milliseconds of every stage from a frame's file to a finished pair.

One procedural 968x608 frame (with --frame the first of FLSea VI), the default sonar and noise;
medians of repeated runs in one process.
Ratios are to one plain pass over the points (a copy of their coordinates), which cancels most of
what differs between machines.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.shared import Options, Section, Table, cpu_seconds, frame_words
from simnfnd.factory.common import seeds
from simnfnd.factory.common.workers.machine import keep_freed_memory
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.imaging import pointwise
from simnfnd.factory.simulation.imaging.contract import effect_clouds
from simnfnd.factory.simulation.imaging.pointwise import noisy_cloud
from simnfnd.factory.simulation.noise.draws import StreamNames, draw
from simnfnd.factory.simulation.pairs import pair_maker as pairs
from simnfnd.factory.simulation.render import open_renderer
from simnfnd.factory.simulation.render.view import decode, encode, view_of
from simnfnd.factory.simulation.scenes import open_reader
from simnfnd.factory.simulation.sonar import polar, transfer
from simnfnd.factory.simulation.sonar.fan import fan_table
from simnfnd.factory.simulation.sonar.surface import insonified

REPEATS = 9


def measure(options: Options) -> Section:
    """Time every stage."""
    keep_freed_memory()  # as the workers do
    return Section((_table(options),))


def _table(options: Options) -> Table:
    config = compose_config(["render=embree", *frame_words(options.frame)])
    repeats = options.amount(REPEATS)
    sonar = config.sonar
    reader = open_reader(config.scenes)
    renderer = open_renderer(config.render)
    mirroring = open_renderer(replace(config.render, bounces=1))
    ref = reader.discover().frames[0]
    frame = reader.load(ref)
    rendered = renderer.render(frame, sonar.mount)
    observed = pairs.observe(frame, rendered, config)
    window = observed.window
    names = StreamNames.of(frame.ref, 0, has_pose=True)
    echoes = insonified(frame, rendered, window, sonar).echoes
    echo_subset = pointwise.random_subset(echoes, 0.6, seeds.stream(0, "thin"))
    draws = draw(config.noise, config.seed, names)
    clouds = effect_clouds(draws.effects, echo_subset, window)
    cloud, *added = noisy_cloud(echo_subset, clouds, 1.0)
    level = polar.accumulate(cloud, window, sonar, *added)
    full_scale = transfer.full_scale(level, sonar.transfer)
    grey = transfer.grey(level, full_scale, sonar.transfer)
    table = fan_table(sonar, window.near_fraction)

    view = view_of(frame, rendered, sonar.mount)
    packed = encode(view)

    stages: dict[str, Callable[[], Any]] = {
        "load the frame (decode, or build the scene)": lambda: reader.load(ref),
        "render, embree": lambda: renderer.render(frame, sonar.mount),
        "render, embree, with one bounce": lambda: mirroring.render(frame, sonar.mount),
        "cached render: encode": lambda: encode(view),
        "cached render: decode": lambda: decode(packed),
        "observe: pixels to echoes, window, shadow": lambda: pairs.observe(frame, rendered, config),
        "resample (random, 0.6)": lambda: pointwise.random_subset(
            echoes, 0.6, seeds.stream(0, "thin")
        ),
    }
    for effect in draws.effects:
        stages[f"noise: {effect.name}"] = partial(effect_clouds, (effect,), echo_subset, window)
    stages |= {
        "accumulate in bins": lambda: polar.accumulate(cloud, window, sonar, *added),
        "point-spread": lambda: polar.spread_points(level, sonar),
        "grey values": lambda: transfer.grey(level, full_scale, sonar.transfer),
        "fan, bilinear": lambda: table.bilinear(grey),
        "**make_pair, all of it**": lambda: pairs.make_pair(observed, 0, config),
    }
    plain = cpu_seconds(lambda: np.stack([cloud.range_m, cloud.azimuth_rad]).copy(), repeats)
    rows = tuple(
        (name, spent / plain, 1000 * spent)
        for name, spent in ((name, cpu_seconds(stage, repeats)) for name, stage in stages.items())
    )
    note = f"{len(echoes)} echoes, {len(cloud)} points in the noisy cloud."
    columns = ("stage", "times one plain pass", "CPU ms")
    return Table(columns, rows, note=note)
