"""The paper's image formation: every echo is a point, a bin's level gathers its points.

echoes -> resampled scene -+-> bins -> point-spread -> transfer curve -> clean picture
+ noise  -+-> the same                               -> noisy picture
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .. import seeds
from ..errors import FactoryError
from ..frame import FrameRef
from ..sonar import polar, transfer
from ..sonar.polar import Echoes, from_xyz, join
from ..sonar.settings import SonarSettings
from ..sonar.surface import LitSurface
from ..sonar.window import Window
from .contract import Floats, Layers
from .effect import DrawnEffect

if TYPE_CHECKING:
    from .contract import ImagingSettings


@dataclass(frozen=True, eq=False)
class PointScene:
    """A frame as echoes at full density; a `contract.Scene`.

    echoes: every insonified surface point in the window, strengths after time-varying gain.
    filled: (range_bins, beams) bool, bins that hold one.
    """

    ref: FrameRef
    window: Window
    echoes: Echoes
    filled: npt.NDArray[np.bool_]

    def sample(
        self, variant: int, effects: Sequence[DrawnEffect], config: ImagingSettings
    ) -> PointSample:
        """See `contract.Scene`."""
        names = (self.ref.location, self.ref.scene, self.ref.frame, variant)
        parameter = seeds.stream(config.seed, "parameter", "resample", *names)
        rate, voxel_size_m = config.resample.rate.draw(parameter), None
        if config.resample.kind == "random":
            thinning = seeds.stream(config.seed, "resample", *names)
            kept = movable = random_subset(self.echoes, rate, thinning)
        else:
            voxel_size_m = find_voxel_size_m(self.echoes, rate)
            kept, movable = voxel(self.echoes, voxel_size_m), self.echoes
        clean_level = _image_level([kept], self.window, config.sonar)
        return PointSample(
            self.window,
            config.sonar,
            rate,
            len(kept),
            movable,
            voxel_size_m,
            clean_level,
            transfer.full_scale(clean_level, config.sonar.transfer, "intensity"),
            effect_clouds(effects, kept, movable, self.window),
            effects,
        )


@dataclass(frozen=True, eq=False)
class PointSample:
    """A resampled scene and what each effect makes of it; a `contract.Sample`.

    movable: the scene's echoes before the noise.  voxel_size_m: of the resampling that follows the
    noise, or None where `movable` is resampled already.  clouds: of each effect.  effects: all.
    """

    window: Window
    sonar: SonarSettings
    rate: float
    points: int
    movable: Echoes
    voxel_size_m: float | None
    clean_level: Floats
    full_scale: float
    clouds: tuple[EffectCloud, ...]
    effects: Sequence[DrawnEffect] = ()

    @cached_property
    def added(self) -> Mapping[str, int]:
        """See `contract.Sample`."""
        return {cloud.name: len(cloud.echoes) for cloud in self.clouds}

    @property
    def clean_full_scale(self) -> float:
        """See `contract.Sample`."""
        return self.full_scale

    @property
    def clean(self) -> Floats:
        """See `contract.Sample`."""
        return transfer.grey(self.clean_level, self.full_scale, self.sonar.transfer, "intensity")

    def noisy(self, effects: Collection[str]) -> Floats:
        """See `contract.Sample`."""
        chosen = [cloud for cloud in self.clouds if cloud.name in effects]
        echoes = noisy_cloud(self.movable, chosen, self.full_scale)
        if self.voxel_size_m is not None:
            echoes = [voxel(join(*echoes), self.voxel_size_m)]
        level = _image_level(echoes, self.window, self.sonar)
        return transfer.grey(level, self.full_scale, self.sonar.transfer, "intensity")

    def without(self, artefacts: Collection[str]) -> Floats:
        """See `contract.Sample`."""
        kept = {effect.name for effect in self.effects if effect.artefact not in artefacts}
        return self.noisy(kept) if kept else self.clean

    def measured(self, effects: Collection[str], layers: Collection[str]) -> Mapping[str, Layers]:
        """See `contract.Sample`; points have no units."""
        return {}


def observe(surface: LitSurface, config: ImagingSettings) -> PointScene:
    """See `contract.Formation`."""
    echoes, _, hit = surface.insonified
    return PointScene(surface.frame.ref, surface.window, echoes, hit)


def _image_level(echoes: Sequence[Echoes], window: Window, sonar: SonarSettings) -> Floats:
    """(range_bins, beams) echo level as the device resolves it; 0 in beams without data."""
    scene, *added = echoes
    level = polar.spread_points(polar.accumulate(scene, window, sonar, *added), sonar)
    level[:, ~polar.seen_beams(window, sonar)] = 0
    return level


@dataclass(frozen=True, eq=False)
class EffectCloud:
    """What one effect makes: echoes of its own, or (moves) the scene's, displaced."""

    name: str
    echoes: Echoes
    moves: bool


def effect_clouds(
    effects: Iterable[DrawnEffect], scene: Echoes, movable: Echoes, window: Window
) -> tuple[EffectCloud, ...]:
    """The cloud of each effect of stage points; the others are passed over.

    scene: the resampled scene; its number of points is what densities are fractions of.
    movable: the echoes that are displaced.
    """
    return tuple(
        EffectCloud(
            effect.name,
            effect.apply(movable if effect.effect.moves else scene, window),
            effect.effect.moves,
        )
        for effect in effects
        if effect.stage == "points"
    )


def noisy_cloud(scene: Echoes, clouds: Iterable[EffectCloud], full_scale: float) -> list[Echoes]:
    """The (displaced) scene, then the added echoes of each effect.

    full_scale: the echo level shown as grey value 1; strengths of added echoes are fractions of it.
    """
    added = []
    for cloud in clouds:
        if cloud.moves:
            scene = cloud.echoes
        else:
            added.append(cloud.echoes.louder(full_scale))
    return [scene, *added]


def random_subset(echoes: Echoes, rate: float, rng: np.random.Generator) -> Echoes:
    """Each echo kept with probability `rate`."""
    if rate >= 1:
        return echoes
    from ..sonar import kernels  # loads numba

    lot = rng.random(len(echoes), dtype=np.float32)
    given = tuple(map(np.ascontiguousarray, vars(echoes).values()))
    kept = tuple(np.empty(len(echoes) + 1, np.float32) for _ in given)
    count = kernels.thin(given, lot, np.float32(rate), kept)
    return Echoes(*(values[:count] for values in kept))


def find_voxel_size_m(echoes: Echoes, rate: float) -> float:
    """Edge of the cubes that leave `rate` of the echoes (bisection, within 2 %)."""
    points_m = echoes.xyz_m()
    low, high = 0.0, float(np.ptp(points_m, axis=0).max()) + 1e-6
    for _ in range(40):
        size = (low + high) / 2
        kept = len(_voxel_cloud(points_m, None, size).points) / len(points_m)
        if abs(kept - rate) <= 0.02 * rate:
            break
        low, high = (size, high) if kept > rate else (low, size)
    return size


def voxel(echoes: Echoes, size_m: float) -> Echoes:
    """One echo per occupied cube of edge `size_m`: mean position and mean strength."""
    strength = np.repeat(echoes.strength[:, None].astype(np.float64), 3, axis=1)
    cloud = _voxel_cloud(echoes.xyz_m(), strength, size_m)
    return from_xyz(np.asarray(cloud.points), np.asarray(cloud.colors)[:, 0])


def _voxel_cloud(
    points_m: npt.NDArray[np.float64], strength: npt.NDArray[np.float64] | None, size_m: float
) -> Any:
    try:
        import open3d  # 1 s to import, and absent on boxes that only make pairs from a cache
    except ImportError as error:
        raise FactoryError(
            'resample.kind=voxel needs Open3D: pip install "simnfnd[open3d]", or resample=random'
        ) from error
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points_m))
    if strength is not None:
        cloud.colors = open3d.utility.Vector3dVector(strength)
    return cloud.voxel_down_sample(size_m)
