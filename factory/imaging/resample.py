"""Resampling: the sonar resolves far less than the camera (paper section 3.3.5).

`rate` is the fraction of points kept; it stands for the sonar's frequency.  `random` keeps a random
subset.  For it, thinning the scene first and then adding noise points in proportion has the same
distribution as adding the noise to the dense cloud and thinning everything, and costs far less.
`voxel` keeps one averaged point per cube (Open3D), of scene and noise together, with the cube's
size searched so that the scene keeps the asked fraction.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic.dataclasses import dataclass

from ..distribution import PositiveFraction, uniform
from ..errors import FactoryError
from ..settings import STRICT
from ..sonar.echoes import Echoes, from_xyz


@dataclass(frozen=True, config=STRICT)
class ResampleSettings:
    """Keys of the `resample` group.  rate: fraction of the points kept, in (0, 1]."""

    kind: Literal["random", "voxel"] = "random"
    rate: PositiveFraction = uniform(0.35, 0.9)

    @property
    def is_default(self) -> bool:
        """Whether nothing else was asked for."""
        usual = ResampleSettings.__dataclass_fields__["rate"].default
        return (self.kind, self.rate.kind, self.rate.values) == ("random", usual.kind, usual.values)


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


def voxel_size_m(echoes: Echoes, rate: float) -> float:
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
