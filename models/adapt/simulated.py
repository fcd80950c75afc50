"""Simulated pictures that the weights must not forget while they are fitted to recordings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...factory.cli.compose import compose_config
from ...factory.dataset.read.pair_dataset import in_unit_range
from ...factory.errors import FrameError
from ...factory.frame import Frame, FrameRef, Intrinsics, checked
from ...factory.pairs import PairMaker
from ...factory.render import open_renderer
from ...factory.render.views import OneView
from ...factory.render.view import view_of
from ...factory.seeds import stream
from ...factory.sonar.geometry import FanGeometry
from ..data.pairs import Image, PairSource, Sample, hold_out, read_table

RECIPES: tuple[tuple[str, ...], ...] = (
    ("experiment=simnfnd",),
    ("experiment=physical",),
    ("experiment=aris_mdd",),
)
"""Words of `simnfnd make` by which pictures of reliefs are made, in turn."""

_HEIGHT, _WIDTH, _FOCAL_PX = 480, 640, 500.0
_LEAST_LIT = 0.15  # of a picture
_SPARE = 2  # reliefs for each picture wanted: the sonar sees nothing of some


class Simulated:
    """Samples to learn from, and others to measure on.

    known: whether their clean pictures are what is learned; else it is what the weights made of the
    noisy ones before.
    """

    def __init__(self, learning: list[Sample], held: list[Sample], known: bool, name: str) -> None:
        self.learning, self.held, self.known, self.name = learning, held, known, name


def of_dataset(folder: str | Path, seed: int, most: int = 64) -> Simulated:
    """Up to `most` pairs of a dataset's train split to learn from, and 8 of other scenes.

    Raises FactoryError when there are none.
    """
    table = read_table(folder, "train")
    learning, held = hold_out(table.samples, 0.2, seed)
    parts = []
    for number, (samples, limit) in enumerate(((learning, most), (held, 8))):
        order = stream(seed, "adapt", "pairs", number).permutation(len(samples))[:limit]
        chosen = [samples[i] for i in sorted(order.tolist())]
        source = PairSource(chosen, table.sonar)
        parts.append([source.sample(index, None) for index in range(len(source))])
    return Simulated(parts[0], parts[1], True, f"dataset {table.config_hash}")


def of_reliefs(
    seed: int, most: int = 24, recipes: tuple[tuple[str, ...], ...] = RECIPES
) -> Simulated:
    """Pictures of random reliefs by each of the recipes, three quarters to learn from."""
    samples: list[Sample] = []
    makers = [_maker(words, seed) for words in recipes]
    for number in range(_SPARE * most):
        try:
            sample = makers[number % len(makers)](relief(stream(seed, "relief", number)))
        except FrameError:
            continue
        if (sample.noisy > 0).mean() > _LEAST_LIT:
            samples.append(sample)
        if len(samples) == most:
            break
    return Simulated(
        [one for number, one in enumerate(samples) if number % 4],
        [one for number, one in enumerate(samples) if number % 4 == 0],
        False,
        "reliefs",
    )


def relief(rng: np.random.Generator) -> npt.NDArray[np.float32]:
    """(H, W) float32 depth in metres along the optical axis: a tilted floor with things on it."""
    rows, columns = np.mgrid[0:_HEIGHT, 0:_WIDTH]
    down = (rows - _HEIGHT / 2) / _FOCAL_PX
    tilt, above_m = np.deg2rad(rng.uniform(20, 40)), rng.uniform(1, 4)
    # A pixel's ray meets the floor where it has gone down as far as the camera is above it.
    falls = np.sin(tilt) + down * np.cos(tilt)
    depth = above_m / np.maximum(falls, 0.05)
    for _ in range(int(rng.integers(2, 9))):
        row, column = rng.uniform(0, _HEIGHT), rng.uniform(0, _WIDTH)
        tall, wide = rng.uniform(6, 80), rng.uniform(6, 120)
        turn = rng.uniform(0, np.pi)
        y, x = rows - row, columns - column
        u = (x * np.cos(turn) + y * np.sin(turn)) / wide
        v = (y * np.cos(turn) - x * np.sin(turn)) / tall
        rise = rng.uniform(0.03, 0.2)
        if rng.random() < 0.5:  # a ball, or a box
            height = np.sqrt(np.clip(1 - u**2 - v**2, 0, 1))
        else:
            height = ((np.abs(u) < 1) & (np.abs(v) < 1)).astype(float)
        depth = depth * (1 - rise * height)
    ripple = np.sin(columns / rng.uniform(6, 24) + rng.uniform(0, 6))
    depth = depth * (1 + rng.uniform(0, 0.01) * ripple)
    return np.asarray(np.where(depth < 6 * above_m, depth, 0), np.float32)


def _maker(words: tuple[str, ...], seed: int) -> Callable[[npt.NDArray[np.float32]], Sample]:
    scenes: dict[str, Any] = {"kind": "csv_list", "root": ".", "intrinsics": [1, 1, 0, 0]}
    config = compose_config((*words, "render=analytic", f"seed={seed}"), scenes)
    renderer = open_renderer(config.render)
    mount = config.sonar.mount
    count = 0

    def make(depth_m: npt.NDArray[np.float32]) -> Sample:
        nonlocal count
        ref = FrameRef("", "relief", f"{count:04d}")
        count += 1
        rgb = np.full((*depth_m.shape, 3), 128, np.uint8)
        intrinsics = Intrinsics(_FOCAL_PX, _FOCAL_PX, _WIDTH / 2, _HEIGHT / 2)
        frame = checked(Frame(ref, rgb, depth_m, intrinsics), bad_depth="mask")
        view = view_of(frame, renderer.render(frame, mount), mount)
        (pair,) = PairMaker(config, OneView(view)).pairs(ref, (0,))
        clean: Image = in_unit_range(pair.clean)
        geometry = FanGeometry.from_record(config.sonar, pair.record)
        return Sample(in_unit_range(pair.noisy), clean, None, geometry)

    return make
