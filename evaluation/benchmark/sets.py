"""The simulated sets: procedural places and FLSea frames by fixed words of `simnfnd make`."""

from __future__ import annotations

import csv
import io
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...factory.cli.compose import compose_config
from ...factory.config import FactoryConfig
from ...factory.dataset.format.sample import Pair
from ...factory.errors import FactoryError, FrameError
from ...factory.files import write_atomically
from ...factory.frame import FrameRef
from ...factory.pairs import PairMaker
from ...factory.render.cache.views import OneView, ViewMaker
from ...factory.render.view import View
from ...factory.scenes import frames_of, open_reader
from ...factory.selection import choose_frames
from ...factory.sonar.geometry import FanGeometry
from . import pictures
from .folder import CLEAN, GEOMETRY, MASKS, Entry, SetEntry

PAIRS, SIZES, SEED = 16, (256, 512), 1
MOST_PAIRS = 1000
VARIANTS = 2
"""Pictures of a place or frame, each with noise of its own."""

_TEST, _PRACTICE, _PRACTICE_PAIRS = 9000, 8000, 8
# Name of the sets -> what they are, and the words that make them.
_NOISES = {
    "places": ("the paper's points and noise", "experiment=simnfnd"),
    "physical": ("the sonar equation, speckle and logarithmic display", "experiment=physical"),
}

PUBLISHED = {
    "places-256": "f8307060424185bd648f1adde5b3763ffdcaa67fdb1a1cdf83930e80c2fadf34",
    "places-512": "e278434d579d84c1d1798ce6375a7df66bf3146af09d8b2d8f7d75a1a5aaa700",
    "physical-256": "342890a5044fc8777c78dcfaf0ccc2ddb9ef8fe97babb8569fff17db2811b03f",
    "physical-512": "522501fd43d9c8208d5cc2fccc1a4c6f74608d05ed189c0c7c56a8500d7f82bc",
}
"""Set -> its digest in version 1 with the default seed and number of pairs."""


@dataclass(frozen=True)
class Recipe:
    """A set before it is made.  words: of `simnfnd make`.  by_place: whether a place is a group."""

    name: str
    about: str
    words: tuple[str, ...]
    practice: str
    by_place: bool


def recipes(sizes: Sequence[int], pairs: int, seed: int, flsea: Path | None) -> list[Recipe]:
    """The sets to be made."""
    found = []
    for noise, (about, experiment) in _NOISES.items():
        for size in sizes:
            name = f"{noise}-{size}"
            words = (experiment, *_places(_TEST, pairs), *_common(size, seed))
            text = f"procedural places, {size}x{size} pixels: {about}"
            found.append(Recipe(name, text, words, name, True))
    for size in sizes if flsea is not None else ():
        frames = math.ceil(pairs / VARIANTS)
        words = ("experiment=simnfnd", f"scenes.root={_quoted(flsea)}", f"frames.total={frames}")
        about = f"frames of FLSea VI, {size}x{size} pixels: {_NOISES['places'][0]}"
        common = _common(size, seed)
        found.append(Recipe(f"flsea-{size}", about, (*words, *common), f"places-{size}", False))
    return found


def practice_recipes(sizes: Sequence[int], pairs: int, seed: int) -> list[Recipe]:
    """The practice pairs: the same noise in other places."""
    fewer = min(pairs, _PRACTICE_PAIRS)
    return [
        Recipe(
            f"{noise}-{size}",
            f"practice: procedural places, {size}x{size} pixels: {about}",
            (experiment, *_places(_PRACTICE, fewer), *_common(size, seed)),
            "",
            True,
        )
        for noise, (about, experiment) in _NOISES.items()
        for size in sizes
    ]


class Renders:
    """Renders of frames, made once for all sets that show the same."""

    def __init__(self) -> None:
        self._makers: dict[str, ViewMaker] = {}
        self._views: dict[tuple[str, FrameRef], View] = {}

    def view(self, config: FactoryConfig, ref: FrameRef) -> View:
        """The render of a frame.  Raises FrameError when the frame is bad."""
        key = repr((config.scenes, config.render, config.sonar.mount))
        if (key, ref) not in self._views:
            maker = self._makers.setdefault(key, ViewMaker(config))
            self._views[key, ref] = maker.render(ref)
        return self._views[key, ref]


def make(recipe: Recipe, pairs: int, noisy: Path, references: Path, renders: Renders) -> SetEntry:
    """Write the pictures of a set; FactoryError when there is nothing to make them of.

    noisy, references: folders for what methods get, and for what it is compared with.
    """
    config = compose_config(recipe.words)
    found: list[Entry] = []
    fans: dict[str, FanGeometry] = {}
    for ref, pair in _pairs(config, renders):
        if len(found) == pairs:
            break
        name = f"{len(found):04d}"
        masks = references / MASKS["simulated"]
        shadow: npt.NDArray[np.bool_] = pair.shadow
        found.append(
            Entry(
                name=name,
                group=ref.scene if recipe.by_place else ref.name,
                noisy=pictures.write(noisy / f"{name}.png", pair.noisy),
                clean=pictures.write(references / CLEAN / f"{name}.png", pair.clean),
                mask=pictures.write(masks / f"{name}.png", shadow),
            )
        )
        fans[f"{name}.png"] = FanGeometry.from_record(config.sonar, pair.record)
    if not found:
        raise FactoryError(f"{recipe.name}: no frame of it can be used ({recipe.words[1]})")
    write_fans(noisy / GEOMETRY, fans)
    return SetEntry("simulated", recipe.about, recipe.practice, tuple(found))


def write_fans(path: Path, fans: dict[str, FanGeometry]) -> None:
    """The table that `simnfnd denoise --geometry` reads; polar pictures have no line in it."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("file", "apex_x", "apex_y", "edge_slope", "top_row", "bottom_row", "squeeze"))
    for name, fan in fans.items():
        half = fan.sector_rad / 2
        if fan.layout != "fan" or half >= math.pi / 2:
            continue
        bottom = fan.apex_y_px - fan.near_px * math.cos(half)
        values = (
            fan.apex_x_px,
            fan.apex_y_px,
            math.tan(half) * fan.x_scale,
            fan.apex_y_px - fan.far_px,
            bottom,
            fan.x_scale,
        )
        table.writerow((name, *(round(value, 6) for value in values)))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text.getvalue().encode(), durable=False, key="--out")


def _pairs(config: FactoryConfig, renders: Renders) -> Iterator[tuple[FrameRef, Pair]]:
    for ref in choose_frames(frames_of(open_reader(config.scenes)), config):
        try:
            maker = PairMaker(config, OneView(renders.view(config, ref)))
            made = maker.pairs(ref, tuple(range(VARIANTS)))
        except FrameError as error:
            print(f"left out: {error}", file=sys.stderr)
            continue
        yield from ((ref, pair) for pair in made)


def _places(first: int, pairs: int) -> tuple[str, ...]:
    return (
        "scenes=seabed",
        f"scenes.first_location={first}",
        f"scenes.locations={math.ceil(pairs / VARIANTS)}",
        "scenes.frames_per_location=1",
    )


def _common(size: int, seed: int) -> tuple[str, ...]:
    # In closed form: exact where the sonar is at the camera, and it needs no further library.
    sides = (f"sonar.image.width_px={size}", f"sonar.image.height_px={size}")
    return ("render=analytic", *sides, f"seed={seed}")


def _quoted(path: Path | None) -> str:
    return "'" + str(path).replace("\\", "\\\\").replace("'", "\\'") + "'"
