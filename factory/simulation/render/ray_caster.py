"""Rays through the surface that a frame shows, by Embree (through Open3D)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...common.array_types import Bools, Float32s, Int64s
from .surface import SHADOW_BIAS, Pixels, surface_mesh


class Hits(NamedTuple):
    """Where K of the cast rays meet the surface first.

    ray: (K,) int64, which of the rays.  place_m: (K, 3) float32 in camera axes.
    pixel: (K,) int64, flat number of the nearest pixel.
    """

    ray: Int64s
    place_m: Float32s
    pixel: Int64s


class RayCaster:
    """The triangle mesh of a frame's surface, ready for rays.

    surface: points and normals of its pixels.
    """

    def __init__(self, open3d: Any, pixels: Pixels) -> None:
        """pixels: of a frame of which every pixel is traced."""
        self.surface = pixels.surface()
        self._mesh = surface_mesh(pixels, self.surface)
        self._tensor = open3d.core.Tensor
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            self._mesh.vertices_m * np.float32(1 + SHADOW_BIAS),
            self._mesh.triangles.astype(np.uint32),
        )

    def hidden(self, points_m: Float32s, from_m: Float32s) -> Bools:
        """(N,) bool: which of (N, 3) points of the surface it hides from (3,) another place."""
        rays = np.concatenate([points_m, from_m - points_m], axis=-1)
        return np.asarray(
            self._scene.test_occlusions(self._tensor(rays), tnear=0.0, tfar=1.0).numpy()
        )

    def first_hits(self, origins_m: Float32s, directions: Float32s) -> Hits:
        """Cast rays from (N, 3) points of the surface along (N, 3) unit vectors."""
        rays = np.concatenate([origins_m, directions], axis=-1)
        cast = self._scene.cast_rays(self._tensor(rays))
        ray = np.flatnonzero(np.isfinite(cast["t_hit"].numpy()))
        corners = self._mesh.triangles[cast["primitive_ids"].numpy()[ray]]
        second, third = cast["primitive_uvs"].numpy()[ray].T
        shares = np.stack([1 - second - third, second, third], axis=-1)
        # Places on the mesh as it is, not as it was moved away for shadows.
        place_m = (self._mesh.vertices_m[corners] * shares[..., None]).sum(axis=1)
        nearest = np.take_along_axis(corners, shares.argmax(axis=1)[:, None], axis=1)[:, 0]
        return Hits(ray, place_m.astype(np.float32), self._mesh.pixel[nearest])
