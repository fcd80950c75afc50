"""What an image formation is: from a frame's surface to clean and noisy polar images.

`simnfnd.factory.simulation.pairs.pair_maker` assembles pairs with it and knows no more.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from ...common.array_types import Array, Float32s
from ..sonar.polar import Echoes
from ..sonar.window import Window
from .effect import DrawnEffect


class EffectCloud(NamedTuple):
    """What one effect makes: echoes of its own, or (moves) the scene's, displaced."""

    name: str
    echoes: Echoes
    moves: bool


@dataclass(frozen=True, eq=False)
class SceneSample(ABC):
    """One sample of a scene.

    Images are (range_bins, beams) float32 grey values, 0 to 1, and 0 in beams without data.
    effects: the effects drawn for it.  clouds: what each effect of stage points makes.
    rate: fraction of the scene's points that are kept.  points: number of points in the images.
    full_scale: echo intensity, after time-varying gain, that is shown as grey value 1.
    """

    effects: Sequence[DrawnEffect]
    clouds: tuple[EffectCloud, ...]
    rate: float
    points: int
    full_scale: float

    @cached_property
    def added(self) -> Mapping[str, int]:
        """Points that each effect of stage points has added or moved, by its name."""
        return {cloud.name: len(cloud.echoes) for cloud in self.clouds}

    @property
    @abstractmethod
    def clean(self) -> Float32s:
        """The clean image."""

    @abstractmethod
    def noisy(self, effects: Collection[str]) -> Float32s:
        """The image with the named ones of the drawn effects alone."""

    def without(self, artefacts: Collection[str]) -> Float32s:
        """The image as it would be without these artefacts, under the same random streams.

        Without speckle it is the expected displayed image: what averages out is averaged.
        """
        return self.noisy(self.free_of(artefacts))

    def free_of(self, artefacts: Collection[str]) -> set[str]:
        """Names of the drawn effects that show none of these artefacts."""
        return {drawn.name for drawn in self.effects if drawn.effect.artefact not in artefacts}

    def measured(self, effects: Collection[str], layers: Collection[str]) -> Mapping[str, Array]:
        """Layers of what was received, and those of the drawn effects."""
        return {}


def effect_clouds(
    effects: Sequence[DrawnEffect], scene: Echoes, window: Window
) -> tuple[EffectCloud, ...]:
    """The cloud of each effect of stage points; densities are fractions of the scene's points."""
    return tuple(
        EffectCloud(effect.name, effect.apply(scene, window), effect.effect.moves)
        for effect in effects
        if effect.stage == "points"
    )
