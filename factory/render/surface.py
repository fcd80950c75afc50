"""A frame made ready for rendering: its surface pixels, their albedo, and light in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..frame import Frame, Intrinsics
from . import kernels
from .albedo import albedo
from .base import RenderSettings
from .mesh import cut_quads

# Traced and closed-form light differ by rounding; a ratio of anything fainter tells nothing.
_FAINTEST = 1e-12


Grid = tuple[npt.NDArray[Any], ...]


def grid_of(depth_m: npt.NDArray[np.floating[Any]], camera: Intrinsics, edge_ratio: float) -> Grid:
    """(H, W) depths as `kernels` want them, a border of one unmeasured pixel all around.

    Depth, its joints, and what it is multiplied by to give x in each column and y in each row:
    P = z K^-1 (u, v, 1)^T (Yang et al. 2024, Eq. 2).  Pixel (u, v) stands for its centre, so the
    top left pixel's centre is (0, 0); lens distortion is not looked at.
    """
    height, width = depth_m.shape
    bordered = np.zeros((height + 2, width + 2), np.float32)
    bordered[1:-1, 1:-1] = depth_m
    across = (np.arange(-1, width + 1) - camera.cx) / camera.fx
    down = (np.arange(-1, height + 1) - camera.cy) / camera.fy
    return bordered, kernels.joints(bordered, edge_ratio), across, down


@dataclass(frozen=True, eq=False)
class Surface:
    """What every n-th pixel of a frame shows, in camera axes.

    points_m: (h, w, 3) float32.  normals: (h, w, 3) float32, unit, towards the camera.
    albedo: (h, w) float32 in [0, 1].  mask: (h, w) bool, pixels that are surface.
    intrinsics: of a camera with these pixels alone.
    """

    points_m: npt.NDArray[np.float32]
    normals: npt.NDArray[np.float32]
    albedo: npt.NDArray[np.float32]
    mask: npt.NDArray[np.bool_]
    intrinsics: Intrinsics


@dataclass(frozen=True, eq=False)
class Pixels:
    """A frame at full resolution: which pixels are surface, and how strongly each scatters.

    depth_m, albedo: (H, W) float32.  mask: (H, W) bool.  grid: see `grid_of`.
    edge_ratio: see `RenderSettings`.  stride: every how-manieth row and column is traced.
    """

    depth_m: npt.NDArray[np.float32]
    intrinsics: Intrinsics
    albedo: npt.NDArray[np.float32]
    grid: Grid
    mask: npt.NDArray[np.bool_]
    edge_ratio: float
    stride: int

    @property
    def traced(self) -> slice:
        """The rows and columns that are traced: the middle one of each `stride`."""
        return slice((self.stride - 1) // 2, None, self.stride)

    @property
    def traced_edge_ratio(self) -> float:
        """`edge_ratio` between traced pixels: on the same slope their steps are larger."""
        return min(1.0, self.edge_ratio * self.stride)

    def surface(self) -> Surface:
        """Points and normals of the traced pixels; the normals are those of full resolution."""
        first, at, camera = self.traced.start, (self.traced, self.traced), self.intrinsics
        mask = np.ascontiguousarray(self.mask[at])
        points_m = np.empty((*mask.shape, 3), np.float32)
        normals = np.empty_like(points_m)
        kernels.orient(self.grid, first, self.stride, points_m, normals)
        if self.stride > 1:
            # At this distance what hangs loose could join a surface that it is no part of.
            points_m[~mask] = 0
        return Surface(
            points_m,
            normals,
            np.ascontiguousarray(self.albedo[at]),
            mask,
            Intrinsics(
                camera.fx / self.stride,
                camera.fy / self.stride,
                (camera.cx - first) / self.stride,
                (camera.cy - first) / self.stride,
            ),
        )

    def radiance(self, sonar_m: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.float32]:
        """(H, W) float32 light of a sonar at (3,) metres in camera axes, without shadows."""
        light = kernels.shade(self.grid, self.mask, self.albedo, np.asarray(sonar_m, np.float32))
        return np.asarray(light)

    def apply(
        self,
        radiance: npt.NDArray[np.float32],
        traced: npt.NDArray[np.float32],
        known: npt.NDArray[np.bool_],
    ) -> npt.NDArray[np.float32]:
        """(H, W) float32 full-resolution light from the closed form and the traced pixels.

        radiance: (H, W) of `radiance`.  traced: (h, w), what tracing found where `known`.
        The closed form has each pixel's own detail, tracing knows what is in shadow: their ratio
        is what is spread over the pixels in between.
        """
        coarse = radiance[self.traced, self.traced]
        known = known & (coarse > _FAINTEST)
        ratio = np.where(known, traced / np.where(known, coarse, 1), 0).astype(np.float32)
        limit = np.float32(self.traced_edge_ratio)
        places = self.traced.start, self.stride, limit
        return np.asarray(kernels.apply_traced(radiance, self.depth_m, known, ratio, *places))


def pixels_of(frame: Frame, settings: RenderSettings, stride: int = 1) -> Pixels:
    """Albedo and surface pixels of a frame of which every `stride`-th row and column is traced."""
    depth_m = np.ascontiguousarray(frame.depth_m, np.float32)
    grid = grid_of(depth_m, frame.intrinsics, settings.edge_ratio)
    shade = albedo(frame.rgb, frame.valid, settings.albedo)
    mask = np.ascontiguousarray(cut_quads(grid[1]).mask()[1:-1, 1:-1])
    return Pixels(depth_m, frame.intrinsics, shade, grid, mask, settings.edge_ratio, stride)
