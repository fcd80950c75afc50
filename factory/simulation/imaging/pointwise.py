"""The paper's image formation: every echo is a point, a bin's level gathers its points.

echoes -> resampled scene -+-> bins -> point-spread -> transfer curve -> clean image
+ noise  -+-> the same                               -> noisy image
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...common import seeds
from ...common.array_types import Bools, Float32s
from ..sonar import polar, transfer
from ..sonar.ghosts import ghost_echoes
from ..sonar.polar import Echoes
from ..sonar.surface import LitSurface
from .contract import EffectCloud, SceneSample, effect_clouds
from .effect import DrawnEffect
from .settings import ResampleSettings


@dataclass(frozen=True, eq=False)
class PointwiseScene:
    """A frame as echoes at full density, and the seed of the random streams of its samples.

    static: the same of the scene without moving objects, which decides the scale of the image;
        None where nothing moves.
    """

    surface: LitSurface
    seed: int
    resample: ResampleSettings
    static: PointwiseScene | None = None

    @cached_property
    def echoes(self) -> Echoes:
        """Every insonified surface point in the window, then ghosts; with time-varying gain."""
        echoes = self.surface.insonified.echoes
        ghosts = ghost_echoes(self.surface)
        if ghosts is None:
            return echoes
        pairs = zip(vars(echoes).values(), vars(ghosts).values(), strict=True)
        return Echoes(*(np.concatenate(pair) for pair in pairs))

    @property
    def filled(self) -> Bools:
        """(range_bins, beams) bool: bins in which insonified surface lies."""
        return self.surface.insonified.hit

    def sample(self, variant: int, effects: Sequence[DrawnEffect]) -> PointwiseSample:
        """One sample; equal calls, equal bytes."""
        ref = self.surface.frame.ref
        names = ("resample", ref.location, ref.scene, ref.frame, variant)
        rate = self.resample.rate.draw(seeds.stream(self.seed, "parameter", *names))
        sampled_echoes = random_subset(self.echoes, rate, seeds.stream(self.seed, *names))
        level = self.level([sampled_echoes])
        full_scale = transfer.full_scale(level, self.surface.sonar.transfer, "intensity")
        if self.static is not None:
            full_scale = self.static.sample(variant, ()).full_scale
        clouds = effect_clouds(effects, sampled_echoes, self.surface.window)
        return PointwiseSample(
            effects, clouds, rate, len(sampled_echoes), full_scale, self, sampled_echoes, level
        )

    def level(self, echoes: Sequence[Echoes]) -> Float32s:
        """(range_bins, beams) echo level as the device resolves it; 0 in beams without data."""
        (scene, *added) = echoes
        window = self.surface.window
        sonar = self.surface.sonar
        level = polar.spread_points(polar.accumulate(scene, window, sonar, *added), sonar)
        level[:, ~polar.seen_beams(window, sonar)] = 0
        return level


@dataclass(frozen=True, eq=False)
class PointwiseSample(SceneSample):
    """A resampled scene and what each effect makes of it.

    echoes: the scene's echoes before the noise; level: theirs, (range_bins, beams).
    """

    scene: PointwiseScene
    echoes: Echoes
    level: Float32s

    @property
    def clean(self) -> Float32s:
        """See `SceneSample`."""
        curve = self.scene.surface.sonar.transfer
        return transfer.grey(self.level, self.full_scale, curve, "intensity")

    def noisy(self, effects: Collection[str]) -> Float32s:
        """See `SceneSample`."""
        chosen = [cloud for cloud in self.clouds if cloud.name in effects]
        level = self.scene.level(noisy_cloud(self.echoes, chosen, self.full_scale))
        return transfer.grey(level, self.full_scale, self.scene.surface.sonar.transfer, "intensity")


def noisy_cloud(scene: Echoes, clouds: Iterable[EffectCloud], full_scale: float) -> list[Echoes]:
    """The (displaced) scene, then the added echoes of each effect.

    full_scale: the echo level shown as grey value 1; strengths of added echoes are fractions of it.
    """
    added = []
    for cloud in clouds:
        if cloud.moves:
            scene = cloud.echoes
        else:
            strength = cloud.echoes.strength * np.float32(full_scale)
            added.append(replace(cloud.echoes, strength=strength))
    return [scene, *added]


def random_subset(echoes: Echoes, rate: float, rng: np.random.Generator) -> Echoes:
    """Each echo kept with probability `rate`."""
    if rate >= 1:
        return echoes
    from ..sonar import kernels  # loads numba

    chance = rng.random(len(echoes), dtype=np.float32)
    source = tuple(map(np.ascontiguousarray, vars(echoes).values()))
    subset = tuple(np.empty(len(echoes) + 1, np.float32) for _ in source)
    count = kernels.thin(source, chance, np.float32(rate), subset)
    return Echoes(*(values[:count] for values in subset))
